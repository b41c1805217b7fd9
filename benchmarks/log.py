"""Measures how well logs survive damage: `python benchmarks/log.py [PART]...`, by default all
parts.

    torn        10,000 truncations and 10,000 changed bytes: how many complete chunks are recovered
    tampering   each field of each channel, record and attachment changed: how many are noticed

The output is the figures of docs/reference/durability.md. `--scale 0.1` does a tenth of the work.
"""

import argparse
import random
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "tests"))

from testkit.emulator.lab_logs import dish_log, lab_log  # noqa: E402
from testkit.fuzz import Original, fuzz  # noqa: E402
from testkit.tampering import score, sim_log  # noqa: E402

from tetractl.run.interrupt import Interrupt  # noqa: E402
from tetractl.run.logged_trial import log_path, run_logged  # noqa: E402
from tetractl.spec.load import parse_spec  # noqa: E402

SMALL = """
name: small
arena: {left: 0, bottom: 0, width: 1000, height: 1000}
robots:
  - {name: one, start: [100, 500], target: [300, 450], a: 6, speed: 200}
  - {name: two, start: [100, 300], target: [300, 350], a: 3, speed: 150}
controller: {type: pso-mpc, horizon_max: 6, steps_max: 5, optimizer: {particles: 6, iterations: 14}}
plant: {type: sim, camera_rate: 30, measurement_noise: {position: 1}, heading_noise: 0.1}
"""


def torn(folder: Path, scale: float) -> None:
    spec = parse_spec(SMALL, "small.yaml", ["plant.camera_rate=10"])
    run_logged(spec, folder, 0, (), Interrupt())
    original = Original(log_path(folder, 0))
    print("| damage | logs | no trial left in | chunks recovered of those complete | wrong | s |")
    print("|---|---|---|---|---|---|")
    for kind in ("truncated", "flipped"):
        count = round(10_000 * scale)
        began = time.perf_counter()
        copies = getattr(original, kind)(count, random.Random(1))
        tally = fuzz(original, copies, folder / "copy.mcap")
        chunks = f"{tally.chunks_recovered} of {tally.chunks_complete}"
        seconds = time.perf_counter() - began
        cells = (kind, tally.copies, tally.unreadable, chunks, len(tally.wrong), round(seconds))
        print("|", " | ".join(map(str, cells)), "|")
        for wrong in sorted(set(tally.wrong)):
            print(f"- {wrong}")


def tampering(folder: Path, scale: float) -> None:
    """Print how many changes of each channel's fields are noticed."""
    count = max(1, round(6 * scale))
    logs_of = {"simulation": sim_log, "emulated lab": lab_log, "emulated microscope": dish_log}
    for name, log_of in logs_of.items():
        place = folder / name
        place.mkdir()
        recovered, tried = score(log_of(place), count)
        print(f"\n| {name} | noticed | missed, by field |\n|---|---|---|")
        for channel in dict.fromkeys(channel for channel, _ in tried):
            kinds = [kind for kind in tried if kind[0] == channel]
            missed = [
                f"{kind[1]} {tried[kind] - recovered[kind]} of {tried[kind]}"
                for kind in kinds
                if recovered[kind] < tried[kind]
            ]
            total = (sum(recovered[k] for k in kinds), sum(tried[k] for k in kinds))
            print(f"| {channel} | {total[0]} of {total[1]} | {', '.join(missed)} |")
        print(f"| all | {recovered.total()} of {tried.total()} | |", flush=True)


PARTS = {"torn": torn, "tampering": tampering}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], metavar="PART")
    parser.add_argument("--scale", type=float, default=1.0)
    options = parser.parse_args()
    for name in options.parts or PARTS:
        print(f"\n## {name}\n", flush=True)
        with tempfile.TemporaryDirectory() as folder:
            PARTS[name](Path(folder), options.scale)


if __name__ == "__main__":
    main()
