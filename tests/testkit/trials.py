"""Logged trials of the paper's three robots (section V) on a disturbed plant."""

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from tetractl.core.protocols import Observer
from tetractl.log.read.reader import read_trial
from tetractl.log.read.trial_log import Damage, TrialLog
from tetractl.run.interrupt import Interrupt
from tetractl.run.logged_trial import log_path, run_logged
from tetractl.spec.experiment import Experiment
from tetractl.spec.load import parse_spec

FRAMES = 24  # camera frames in a control period

THREE_M3PI = {
    "name": "three-m3pi",
    "arena": {"left": 600, "bottom": 350, "width": 1600, "height": 1800},
    "robots": [
        {"name": "green", "start": [900, 800], "target": [1700, 500], "a": 6, "speed": 180},
        {"name": "blue", "start": [900, 1200], "target": [1700, 1500], "a": 4, "speed": 200},
        {"name": "red", "start": [900, 1600], "target": [1700, 2000], "a": 3, "speed": 150},
    ],
    "obstacles": [{"type": "rectangle", "left": 1200, "bottom": 1100, "width": 200, "height": 200}],
    "controller": {"type": "pso-mpc", "arrival_tolerance": 20, "optimizer": {"iterations": 60}},
}
DISTURBED = {
    "plant": {
        "type": "sim",
        "measurement_noise": {"position": 1.5, "heading": 0.01},
        "a_error": 0.1,
        "speed_error": 0.08,
    }
}
SEED = 2  # 41 steps, all of them inside the arena


def experiment(**changes: object) -> Experiment:
    """The reference experiment, with whole sections replaced; the published controller."""
    spec = {**THREE_M3PI, **changes}
    controller = {"type": "pso-mpc", **spec["controller"]}
    return Experiment.model_validate(spec | {"controller": controller})


def run_three_robots(folder: Path, seed: int = SEED, observers: Sequence[Observer] = ()) -> Path:
    """Run trial 0 of the disturbed reference experiment; return its log."""
    text = json.dumps(THREE_M3PI | DISTURBED)
    spec = parse_spec(text, "three-m3pi.yaml", [f"trials.seed={seed}"])
    run_logged(spec, folder, 0, observers, Interrupt())
    return log_path(folder, 0)


@cache
def _recorded(seed: int) -> tuple[bytes, TrialLog]:
    """The bytes of a trial's log, and all that is in it."""
    with TemporaryDirectory() as folder:
        path = run_three_robots(Path(folder), seed)
        return path.read_bytes(), replace(read_trial(path), log=f"trial-{seed:03d}.mcap")


def three_robots(seed: int = SEED) -> TrialLog:
    """A whole trial that ran: 8.2 s at 120 Hz, made once a process."""
    return _recorded(seed)[1]


def cut_short(log: TrialLog, steps: int) -> TrialLog:
    """The same trial as a crash leaves it: the first steps, no stop, no result, damaged."""
    end = steps * FRAMES
    return replace(
        log,
        mocap_ns=log.mocap_ns[:end],
        mocap=log.mocap[:end],
        valid=log.valid[:end],
        truth=None if log.truth is None else log.truth[:end],
        steps=log.steps[:steps],
        stop=None,
        result=None,
        damage=Damage(("the file ends in the middle of a chunk",), (f"all after {steps / 5} s",)),
    )


def in_lab(log: TrialLog) -> TrialLog:
    """The same trial as if it came from a lab, so that nobody knows its true poses."""
    return replace(log, start=replace(log.start, plant=replace(log.start.plant, simulated=False)))


def write_trial(path: Path, seed: int = SEED) -> Path:
    """Store the log of `three_robots(seed)`."""
    path.write_bytes(_recorded(seed)[0])
    return path


def write_torn(path: Path) -> Path:
    """Store the first half of that log, as a crash leaves it."""
    data, _ = _recorded(SEED)
    path.write_bytes(data[: len(data) // 2])
    return path
