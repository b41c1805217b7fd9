"""Measures the closed loop under disturbances: tables of docs/reference/measured.md.

    python benchmarks/disturbed.py --part ablation --seed 20261201              gain from each part
    python benchmarks/disturbed.py --part given --seed 20261201                 after calibration
    python benchmarks/disturbed.py --part knowledge --trials 40 --seed 20261201 wrong assumptions
    python benchmarks/disturbed.py --part hurting --seed 20261201               disturbances
    python benchmarks/disturbed.py --part accept --trials 40 --seed 20261201    time against error
    python benchmarks/disturbed.py --part radio --trials 40 --seed 512306103    commands a second

All rows of a part have the same seeds, so their trials form pairs. The second table has the
differences between each row and the first one. Plants come from `benchmarks/worlds`.
"""

import argparse

from solverbench.report import describe_load, print_progress
from worlds.trials import HEAD, PAIRS_HEAD, Task, line, pair_line, run

DEAD_TIME_GIVEN = "controller.dead_time=0.06"
"""Setting that gives the controller the bench's dead time [s]."""
NOT_IDENTIFIED = "controller.estimate=false"
"""Setting that switches off the identification of the robots and the dead time."""
FIXED_MARGINS = ("controller.collision.adaptive=false", "controller.collision.margin=20")
WITHOUT_SAFETY = (
    *FIXED_MARGINS,
    "controller.collision.stop_before_collision=false",
    "controller.collision.radius=0",
    "controller.collision.separation=0",
)


def _bench_trial(*settings: str) -> str:
    """Compose the name of a trial on the bench with some settings, as `worlds.trials` reads it."""
    return " --set ".join(["bench", *settings])


TRUE_VALUES = (DEAD_TIME_GIVEN, "wheels.lag=0.04")
WRONG_VALUES = ("controller.dead_time=0.11", "wheels.lag=0.1")
OTHER_BATTERIES = ("plant.speed_error=0.15", "plant.a_error=0.15")


PARTS = {
    "ablation": {
        "whole": _bench_trial(),
        "without identification, dead time given": _bench_trial(NOT_IDENTIFIED, DEAD_TIME_GIVEN),
        "without identification, dead time not given": _bench_trial(NOT_IDENTIFIED),
        "without margins that follow: 20 mm and the radius": _bench_trial(*FIXED_MARGINS),
        "the wheels' lag not given": _bench_trial("wheels.lag=0"),
        "without identification and safety, dead time given": _bench_trial(
            NOT_IDENTIFIED, *WITHOUT_SAFETY, DEAD_TIME_GIVEN
        ),
        "the paper's, 5 Hz": "paper-on-bench",
    },
    "given": {
        "nothing given": _bench_trial(),
        "given": _bench_trial(*TRUE_VALUES),
        "given, without identification": _bench_trial(NOT_IDENTIFIED, *TRUE_VALUES),
        "given, other batteries": _bench_trial(*TRUE_VALUES, *OTHER_BATTERIES),
        "given, other batteries, without identification": _bench_trial(
            NOT_IDENTIFIED, *TRUE_VALUES, *OTHER_BATTERIES
        ),
        "given wrongly": _bench_trial(*WRONG_VALUES),
        "given wrongly, without identification": _bench_trial(NOT_IDENTIFIED, *WRONG_VALUES),
    },
    "knowledge": {
        "dead time given": _bench_trial(DEAD_TIME_GIVEN),
        "dead time assumed 0": _bench_trial(),
        "dead time assumed 50 ms less": _bench_trial("controller.dead_time=0.01"),
        "dead time assumed 50 ms more": _bench_trial("controller.dead_time=0.11"),
        "a up to 30 % off": _bench_trial("plant.a_error=0.3"),
        "two a 5 % apart, heading walk 0.05": _bench_trial(
            "robots.2.a=4.2", "plant.heading_noise=0.05"
        ),
    },
    "hurting": {
        "none of these": "base",
        "radio silent 1 s three times, 2 % lost": "silent",
        "each robot sticks 0.5 s every 5 s": "sticking",
        "old poses (0.2 s) shown as new, 0.4 s twice": "stale",
        "last picture shown as new, 0.4 s twice": "repeating",
        "no frames, 0.4 s twice": "no-frames",
        "markers 0.1 rad off": "marker",
        "speed falls by 15 % in 20 s": "battery",
        "a and speed wander by 10 %": "wander",
    },
    "accept": {
        f"accept {mm} mm": _bench_trial(f"controller.accept_error={mm}")
        for mm in (40, 30, 20, 15, 12, 10, 8)
    },
    "radio": {
        "60 commands per second": _bench_trial(),
        "40 commands per second": _bench_trial("plant.drive.rate=40"),
        "80 commands per second": _bench_trial("plant.drive.rate=80"),
        "60 commands per second, none lost": _bench_trial("plant.disturbances.3.loss=0"),
    },
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--part", choices=PARTS, default="ablation")
    parser.add_argument("--only", metavar="ROW", help="print this row alone")
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    rows = PARTS[options.part]
    if options.only not in (None, *rows):
        parser.error(f"--only: no row {options.only!r} of the part {options.part}")
    print(f"Simulated, {options.trials} trials a row, seed {options.seed}. {describe_load()}.\n")
    print(HEAD)
    trials = {}
    for name in rows if options.only is None else [options.only]:
        print_progress(name)
        tasks = [Task(options.seed, rows[name], trial) for trial in range(options.trials)]
        trials[name] = [run(task) for task in tasks]
        print(line(name, trials[name]), flush=True)
    first, *others = trials
    if others:
        print(f"\nDifferences from pairs: each row minus the row {first!r}.\n\n{PAIRS_HEAD}")
    for name in others:
        print(pair_line(name, rows[name], list(zip(trials[first], trials[name], strict=True))))


if __name__ == "__main__":
    main()
