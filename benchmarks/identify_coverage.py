"""Measures how often the 95 % intervals of `tetractl identify` contain the truth, on simulated
logs.

    nice python benchmarks/identify_coverage.py --logs 40 --first 9100 --trials 20
    nice python benchmarks/identify_coverage.py --logs 40 --first 20263300 --bench

The output is the table of docs/how-to/identify.md. In each log, the controller steers three robots
to their targets at the rate --trials. Turning rates a, speeds and a dead time are sampled for each
log. There is camera noise and a random walk of the headings, and 5 % of the commands are lost. With
--bench, the logs come from trials of experiments/three_m3pi_bench.yaml. The true a then follows
from the spec's a and a robot's gains and wheel base, and the true dead time is the radio's.
"""

import argparse
import json
from collections import defaultdict
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from tetractl_identify.identify import identify
from tetractl_identify.tracks import extract_track

import tetractl
from tetractl.core.clock import SECOND, VirtualClock
from tetractl.plant.simulation import SimPlant
from tetractl.run.spec_trial import trial_seeds
from tetractl.statistics.estimate import proportion_interval

EXPERIMENTS = Path(__file__).parent.parent / "experiments"
SPEC = EXPERIMENTS / "three_m3pi.yaml"
BENCH = EXPERIMENTS / "three_m3pi_bench.yaml"
RADIO_S = 0.0077  # mean delay of the bench's radio [s]
POSITION = 0.5
HEADING = 0.01
WALK = 0.03
NOISE = [
    f"plant.measurement_noise={{position: {POSITION}, heading: {HEADING}}}",
    f"plant.heading_noise={WALK}",
]


def _hits(identified, truths):
    """Check for each quantity whether its interval contains the truth, by name."""
    hits = defaultdict(list)
    for i, robot in enumerate(identified.robots):
        for name, truth in truths.items():
            interval = getattr(robot, name)
            hits[name].append(bool(interval.low <= truth[i] <= interval.high))
    return hits


def coverage(number: int, rate: float):
    """Simulate a log with a rate of control steps [Hz], and check which intervals contain the
    truth.
    """
    dead_time = float(np.random.default_rng([number, 2]).uniform(0.02, 0.15))
    sets = ["plant.a_error=0.2", "plant.speed_error=0.1", "plant.lost_commands=0.05"]
    sets += [f"plant.dead_time={dead_time}", f"controller.period={1 / rate}"]
    spec = tetractl.load_spec(SPEC, f"trials.seed={number}", *sets, *NOISE)
    with TemporaryDirectory() as folder:
        log = tetractl.run_trial(spec, folder=folder)
    identified = identify([extract_track(log)], spec.experiment.setup.a)
    facts = log.start.plant.facts
    hits = _hits(
        identified,
        {
            "a": json.loads(facts["true_a"]),
            "speed": json.loads(facts["true_speed"]),
            "heading_bias": [0.0] * 3,
            "position_noise": [POSITION] * 3,
            "heading_noise": [HEADING] * 3,
            "heading_walk": [WALK] * 3,
        },
    )
    # a plant's dead time counts from the exposure of the frame that a command answers
    ages = [step.command.sent_ns - step.observation.sampled_ns for step in log.steps]
    from_sending = dead_time - float(np.mean(ages)) / SECOND
    hits["dead_time"].append(identified.dead_time.low <= from_sending <= identified.dead_time.high)
    return hits


def bench_coverage(number: int):
    """Simulate a log of the bench, and check which intervals contain the truth."""
    spec = tetractl.load_spec(BENCH, f"trials.seed={number}")
    with TemporaryDirectory() as folder:
        log = tetractl.run_trial(spec, folder=folder)
    experiment = spec.experiment
    plant = SimPlant(experiment.plant, experiment.setup, VirtualClock(), trial_seeds(number, 0)[1])
    drive = plant.drive
    trains = drive.host.drivetrains
    gains = (trains.true_gain / trains.gain).mean(
        axis=0
    )  # of true speed to that sent, of both wheels
    a = plant.a * gains * experiment.setup.wheel_radius / drive.radius
    identified = identify([extract_track(log)], experiment.setup.a, experiment.controller.dead_time)
    hits = _hits(identified, {"a": a})
    hits["dead_time"].append(identified.dead_time.low <= RADIO_S <= identified.dead_time.high)
    return hits


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--logs", type=int, default=500)
    parser.add_argument("--first", type=int, default=0, help="number of the first log, its seed")
    parser.add_argument("--trials", type=float, metavar="HZ", default=20.0, help="at this rate")
    parser.add_argument("--bench", action="store_true", help="logs of trials of the bench")
    options = parser.parse_args()
    numbers = range(options.first, options.first + options.logs)
    total: dict[str, list[bool]] = defaultdict(list)
    for number in numbers:
        hits = bench_coverage(number) if options.bench else coverage(number, options.trials)
        for name, hits_of_value in hits.items():
            total[name] += hits_of_value
    print("share of 95 % intervals that contain the true value (simulated logs)")
    for name, hits in total.items():
        coverage_interval = proportion_interval(sum(hits), len(hits))
        low = 100 * coverage_interval.low
        high = 100 * coverage_interval.high
        print(
            f"  {name:16} {100 * np.mean(hits):5.1f} %  ({low:.1f} to {high:.1f}; n = {len(hits)})"
        )


if __name__ == "__main__":
    main()
