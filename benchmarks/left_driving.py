"""Checks whether robots of the emulated lab are left driving after a trial or an abort.

    python benchmarks/left_driving.py [--seed 1] [--only NUMBER]

Each row is a trial of three m3pi robots in virtual time with a disturbance: another program drives
the robots, the radio delivers old packets, or robots restart. It happens during the trial, just
after the stop, in a pause, after an abort, or before the run. The observer of the rehearsals, which
shares no code with the guard, reports how fast robots drive when the run has ended, and whether the
run named them.
"""

import argparse
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tetractl_emulator.lab_rehearse import observe_day
from tetractl_emulator.rehearsal.day import run_day
from tetractl_emulator.rehearsal.day_plan import DayPlan

from tetractl.spec.load import load_spec
from tetractl.spec.plants import select_plant

SPEC = Path(__file__).parents[1] / "experiments" / "three_m3pi_lab.yaml"
SHORT = "controller.time_limit=3"
LOST = {"fault": "untracked", "robot": "green", "at": 1.0}
EMERGENCY = {"fault": "emergency", "at": 1.0}


def sender(left: int, right: int, at_s: float, since: str = "stop", **more: Any) -> dict[str, Any]:
    """Create the fault of another program that drives all robots with two counts."""
    return {
        "fault": "driven_elsewhere",
        "counts": [left, right],
        "at": at_s,
        "since": since,
        **more,
    }


def late(by_s: float, at_s: float = 0.0) -> dict[str, Any]:
    """Create the fault of a radio that delivers packets late, by up to a given time."""
    return {"fault": "overtaken_packets", "by": by_s, "at": at_s}


def reboots(robot: str, by_s: float, at_s: float, since: str = "run") -> dict[str, Any]:
    """Create the fault of a robot that restarts, and then obeys commands late."""
    return {"fault": "reboots", "robot": robot, "by": by_s, "at": at_s, "since": since}


SCHEDULES: tuple[tuple[str, Sequence[Mapping[str, Any]]], ...] = (
    ("sender with the stop, 10/10", [sender(10, 10, 0.0)]),
    ("sender with the stop, 20/20", [sender(20, 20, 0.0)]),
    ("sender with the stop, 60/60", [sender(60, 60, 0.0)]),
    ("sender with the stop, 20/-20", [sender(20, -20, 0.0)]),
    ("sender 0.2 s later, 20/20, 20 Hz", [sender(20, 20, 0.2, rate=20.0)]),
    ("sender 0.5 s later, 20/20, 200 Hz", [sender(20, 20, 0.5, rate=200.0)]),
    ("sender 0.9 s later, 30/10", [sender(30, 10, 0.9)]),
    ("sender 1.3 s later, 6/6", [sender(6, 6, 1.3, rate=40.0)]),
    ("sender numbers after ours, 20/20", [sender(20, 20, 0.0, follows=True)]),
    ("sender numbers after ours, 0.6 s later", [sender(20, 20, 0.6, rate=40.0, follows=True)]),
    ("sender after an abort, 20/20", [LOST, sender(20, 20, 0.3)]),
    ("sender 2 s after an abort, 60/60", [LOST, sender(60, 60, 2.0)]),
    ("sender 2.5 s after an abort, 20/20, 20 Hz", [LOST, sender(20, 20, 2.5, rate=20.0)]),
    ("sender after the emergency stop", [EMERGENCY, sender(60, 60, 0.3)]),
    ("sender in the trial, 20/20", [sender(20, 20, 0.6, "run")]),
    ("sender in the trial, 6/-6", [sender(6, -6, 0.6, "run")]),
    ("sender before the run, 20/20", [sender(20, 20, 0.2, "start")]),
    ("packets up to 0.9 s late, and an abort", [late(0.9), LOST]),
    ("packets up to 0.6 s late, and an abort", [late(0.6), LOST]),
    ("packets up to 0.4 s late, emergency stop", [late(0.4), EMERGENCY]),
    ("packets up to 0.9 s late, to the time limit", [late(0.9, 1.5)]),
    ("packets late, and the other sender", [late(0.9), LOST, sender(20, 20, 0.5)]),
    ("green starts again in the trial", [reboots("green", 0.05, 1.0)]),
    ("green starts again, obeys 2 s late", [reboots("green", 2.0, 1.0)]),
    ("green starts again with the stop", [reboots("green", 0.05, 0.0, "stop")]),
    ("packets late, green starts again", [late(0.9), LOST, reboots("green", 0.05, 0.2, "stop")]),
)


def row(what: str, faults: Sequence[Mapping[str, Any]], seed: int) -> tuple[str, bool]:
    """Run a row. Return its line, and whether robots were left driving or an invariant was
    violated.
    """
    sets = (SHORT, "controller.deadline=60")
    drawn = [{"kind": fault["fault"], "right": ".", **fault} for fault in faults]
    experiment = select_plant(load_spec(SPEC, sets), "emulated").experiment
    with tempfile.TemporaryDirectory() as scratch:
        day = run_day(SPEC, sets, DayPlan(seed, {}, drawn), Path(scratch))
        truth, broken = observe_day(day, experiment, experiment.plant)  # type: ignore[arg-type]
        speeds = truth.wheel_speed_mm_s[-1]
        left = np.flatnonzero(speeds > 1.5)
        after_s = truth.times_s > truth.driving_ended_s
        at_most = truth.wheel_speed_mm_s[after_s].max(initial=0.0)
        last = [line for line in day.output.splitlines() if line.startswith("error:")]
    broken = [it for it in broken if not it.finding.startswith("left behind")]  # by the first plays
    findings = "; ".join(f"{it.name}: {it.finding}" for it in broken) or "none"
    reason = last[0].removeprefix("error: ") if last else "trial counts"
    names = ", ".join(truth.setup.names[i] for i in left) or "none"
    unnamed = [truth.setup.names[i] for i in left if truth.setup.names[i] not in reason]
    cells = what, names, f"{at_most:.0f}", "yes" if unnamed else "no", reason, findings
    return f"| {' | '.join(cells)} |", bool(len(left) or broken)


def main() -> int:
    """Print the table. The exit code is 1 if robots are left driving or an invariant fails."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int)
    args = parser.parse_args()
    print("| schedule | left driving | fastest after [mm/s] | unnamed | last line | observer |")
    print("|---|---|--:|---|---|---|")
    wrong = 0
    for k, (what, faults) in enumerate(SCHEDULES):
        if args.only is None or args.only == k:
            text, is_wrong = row(what, faults, args.seed + k)
            wrong += is_wrong
            print(text, flush=True)
    print(f"\n{wrong} of {len(SCHEDULES)} schedules leave robots driving or break a sentence")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
