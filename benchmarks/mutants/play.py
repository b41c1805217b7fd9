"""Plays rehearsed days of each planted defect until an invariant finds it.

    python benchmarks/mutants/play.py 01 02 ... [--days 30] [--first 0] [--seed 2] [--met FAULT ...]

Applies NN.patch to a copy of the sources; `00` has none: play it first, since a violation that its
day has too finds nothing. With `--met`, only days that have one of these faults are played. Prints
for each on which day it was found, and by which invariant; `mutants-SEED/NN` keeps its days.
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
PARTS = ("tetractl", f"{EMULATOR}/tetractl_emulator", f"{EMULATOR}/firmware")


def rows_of(folder):
    text = "".join(file.read_text() for file in folder.glob("days.jsonl"))
    return {row["day"]: row for row in map(json.loads, text.splitlines())}


def broken(row):
    return [v for v in row["violations"] if not v[3]] if row else []


def play(folder, seed, days, met, honest):
    """Play days, with the sources first in PYTHONPATH, until one breaks an invariant."""
    from tetractl_emulator.lab_rehearse import rehearsed
    from tetractl_emulator.rehearsal import shrink
    from tetractl_emulator.rehearsal.day import plan_of_day
    from tetractl_emulator.rehearsal.participants import rehearsal_of

    from tetractl.control.build import warm_up
    from tetractl.experiment.load import load_spec
    from tetractl.experiment.plants import on_plant

    shrink.PLAYS_MAX = 0  # what a defect breaks is not shrunk
    experiment = on_plant(load_spec(SPEC, ()), "emulated").experiment
    setup, lab, known = experiment.setup, experiment.plant, rows_of(folder)
    warm_up(experiment, print)
    for day in days:
        plan = plan_of_day(seed, day, setup, rehearsal_of(lab, setup))
        if met and not met & {fault["kind"] for fault in plan.faults}:
            continue
        if day not in known:
            known[day] = rehearsed(SPEC, (), seed, folder, day)
            with (folder / "days.jsonl").open("a") as kept:
                kept.write(json.dumps(known[day]) + "\n")
        known_too = [name for name, *_ in broken(honest.get(day))]
        for name, _, found, _ in broken(known[day]):
            if folder.name != "00" and name not in known_too:
                return f"day {day}: {name}: {found}"
    return f"not found in {len(known)} days"


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("mutants", nargs="+")
    for name, number in (("--days", 30), ("--first", 0), ("--seed", 2)):
        parser.add_argument(name, type=int, default=number)
    parser.add_argument("--met", nargs="*", default=[])
    args, home = parser.parse_args(), os.environ.get("PLAYS_IN")
    for number in args.mutants:
        folder = Path(f"mutants-{args.seed}").absolute() / number
        if home:
            days = range(args.first, args.first + args.days)
            text = play(folder, args.seed, days, set(args.met), rows_of(folder.parent / "00"))
            print(number, text, flush=True)
            continue
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory() as tree:
            for part in PARTS:
                shutil.copytree(ROOT / part, Path(tree) / part)
            if number != "00":
                patch = Path(__file__).with_name(f"{number}.patch")
                subprocess.run(["git", "apply", patch], cwd=tree, check=True)
            path = f"{tree}:{tree}/{EMULATOR}"
            own = [sys.executable, __file__, number, *sys.argv[1 + len(args.mutants) :]]
            subprocess.run(own, env=os.environ | {"PYTHONPATH": path, "PLAYS_IN": tree}, check=True)


if __name__ == "__main__":
    main()
