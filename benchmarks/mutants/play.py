"""Runs rehearsals with planted defects until an invariant finds each defect.

    python benchmarks/mutants/play.py 01 02 ... --days 336 1600 [--seed 3] [--set KEY=VALUE ...]
        [--out mutants]

The script applies NN.patch to a copy of the sources, and runs test days one after another. Each day
also runs without the defect: a violation that occurs there too does not count. The output says
which invariant finds each defect, and on which day. Later days are not run. `--out` keeps the days,
which are then not run again.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[2]
SPEC = ROOT / "experiments" / "three_m3pi_lab.yaml"
EMULATOR = "packages/tetractl-emulator"
PARTS = ("tetractl", f"{EMULATOR}/tetractl_emulator", "firmware")


def play(folder, args):
    """Run test days with the sources that come first in PYTHONPATH."""
    from tetractl_emulator.lab_rehearse import rehearse_day

    from tetractl.control.methods.build import warm_up
    from tetractl.spec.load import load_spec
    from tetractl.spec.plants import select_plant

    warm_up(select_plant(load_spec(SPEC, args.set), "emulated").experiment, print)
    for day in args.days:
        result_file = folder / f"{day}.json"
        if not result_file.exists():
            result_file.write_text(json.dumps(rehearse_day(SPEC, args.set, args.seed, day)))
        if found(folder, day):
            return


def found(folder, day):
    """Return the invariants that a day violates only with a folder's defect, and the findings."""
    with_defect, without = (
        {name: what for name, _, what in json.loads((of / f"{day}.json").read_text())["violations"]}
        for of in (folder, folder.with_name("00"))
    )
    return {name: what for name, what in with_defect.items() if name not in without}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("mutants", nargs="+")
    parser.add_argument("--days", type=int, nargs="+", required=True)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--set", nargs="*", default=[])
    parser.add_argument("--out", type=Path, default=Path("mutants"))
    args = parser.parse_args()
    results = args.out.absolute()
    home = os.environ.get("PLAYS_IN")
    if home:
        play(Path(home), args)
        return
    for number in ["00", *args.mutants]:
        folder = results / number
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory() as tree:
            for part in PARTS:
                shutil.copytree(ROOT / part, Path(tree) / part)
            if number != "00":
                patch = Path(__file__).with_name(f"{number}.patch")
                subprocess.run(["git", "apply", patch], cwd=tree, check=True)
            environment = {"PYTHONPATH": f"{tree}:{tree}/{EMULATOR}", "PLAYS_IN": str(folder)}
            words = [sys.executable, __file__, number, *sys.argv[1 + len(args.mutants) :]]
            subprocess.run(words, env=os.environ | environment, check=True)
        if number != "00":
            print(number, finding(folder, args.days), flush=True)


def finding(folder, days):
    """Return the day on which a defect was found, and the invariant that found it."""
    for day in days:
        new = found(folder, day)
        if new:
            return f"day {day} {'; '.join(f'{name}: {what}' for name, what in new.items())}"
    return f"breaks nothing on {len(days)} days"


if __name__ == "__main__":
    main()
