"""The simulation of a trial once more: the plant rebuilt from the spec and the seed, steered by the
logged commands. Frames, true poses, verdict and the plant's facts must come out as logged.

On the machine and versions that wrote the log they must come out with the same bits; elsewhere to
`ROOM`, since a sine may differ in its last bit.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, Sample, Verdict
from tetractl.core.errors import TetractlError
from tetractl.core.operators import Operators
from tetractl.core.poses import Floats
from tetractl.log.read import bounds
from tetractl.log.read.trial_log import TrialLog
from tetractl.replay.recompute import Difference
from tetractl.run.seeds import trial_seeds

ROOM = 1e-6
"""Relative to a coordinate, or absolute below 1; of what another processor computes."""
COORDINATES = ("x", "y", "heading")


def resimulate(log: TrialLog, exact: bool) -> Difference | None:
    """Return the first thing that the plant does not do as logged, None for none.

    With `exact` bits are compared. A trial in the lab cannot be repeated, nor can the simulation of
    a log that lost a command.
    """
    plant = log.experiment.plant
    if log.start.plant.simulated != plant.simulated:
        mode = "sim" if log.start.plant.simulated else "lab"
        return Difference(None, "run.mode", f"states {mode!r}, but the spec's plant is another")
    if not plant.simulated or log.damage or log.stop is None:
        return None
    if _samples(log) > bounds.simulation_limit():
        text = "not simulated again: it has too many samples of robots and obstacles"
        return Difference(None, "plant", f"{text}; {bounds.FACTOR}=2 allows twice as many")
    try:
        return next(_differences(log, log.stop, exact), None)
    except (TetractlError, ValueError, OverflowError) as error:
        return Difference(None, "plant", f"cannot be simulated again: {error}")


def _samples(log: TrialLog) -> float:
    """Return how many positions of robots the simulation judges, times obstacles."""
    last = max(log.stop.sent_ns if log.stop else 0, *(one.sent_ns for one in log.commands), 0)
    rate = max(getattr(log.experiment.plant, "truth_rate", 0.0), log.start.plant.camera_rate_hz)
    setup = log.start.setup
    return last / SECOND * rate * len(setup.names) * (1 + len(setup.obstacles))


def _differences(log: TrialLog, stop: Command, exact: bool) -> Iterator[Difference]:
    setup, section = log.start.setup, log.experiment.plant
    _, seed = trial_seeds(log.start.seed, log.start.trial)
    clock = section.clock()
    plant = section.build(setup, clock, seed, Operators())
    info = plant.open()
    ours, theirs = (info.camera_rate_hz, info.facts), log.start.plant
    if exact and ours != (theirs.camera_rate_hz, theirs.facts):
        yield Difference(None, "run.plant", "the facts of the plant are not those of this seed")
    seen = 0
    for number, command in enumerate(log.commands):
        if command is stop:
            continue
        clock.sleep_until(command.sent_ns)
        plant.observe()
        sent = plant.steer(command.direction or 0.0)
        if sent.delivered != command.delivered or sent.sent_ns != command.sent_ns:
            yield Difference(None, f"commands.{number}", "reaches other robots or at another time")
        for name in ("left", "right"):
            one, two = getattr(sent, name), getattr(command, name)
            if (one is None) != (two is None) or not (one is None or _same(one, two, exact)):
                yield Difference(None, f"commands.{number}.{name}", "is not the wheels' speed")
        fresh = plant.samples()
        yield from _frames(log, fresh, seen, exact)
        seen += len(fresh)
    clock.sleep_until(stop.sent_ns)
    plant.observe()
    plant.stop()
    verdict = plant.settle()
    fresh = plant.samples()
    yield from _frames(log, fresh, seen, exact)
    if seen + len(fresh) != len(log.frames):
        text = f"{len(log.frames)} logged, {seen + len(fresh)} simulated"
        yield Difference(None, "frames", text)
    if log.result is not None:
        yield from _verdict(log.result.verdict, verdict, exact)


def _frames(
    log: TrialLog, samples: Sequence[Sample], first: int, exact: bool
) -> Iterator[Difference]:
    for row, sample in enumerate(samples, start=first):
        seen = sample.observation
        if row >= len(log.frames):
            return
        number = int(log.frames[row])
        ours = (seen.frame, seen.sampled_ns, seen.received_ns)
        logged = (number, int(log.mocap_ns[row]), int(log.received_ns[row]))
        if ours != logged:
            yield Difference(None, f"mocap.{number}", f"logged {logged}, simulated {ours}")
        if seen.valid.tolist() != log.valid[row].tolist():
            yield Difference(None, f"mocap.{number}.valid", "other robots are tracked")
        yield from _poses(f"mocap.{number}", seen.poses.array(), log.mocap[row], exact)
        if log.truth is not None and sample.truth is not None:
            yield from _poses(f"truth.{number}", sample.truth.array(), log.truth[row], exact)


def _poses(name: str, ours: Floats, logged: Floats, exact: bool) -> Iterator[Difference]:
    """Compare poses (N, 3)."""
    wrong = ~_alike(ours, logged, exact)
    if wrong.any():
        robot, axis = np.argwhere(wrong)[0]
        text = f"logged {float(logged[robot, axis])!r}, simulated {float(ours[robot, axis])!r}"
        yield Difference(None, f"{name}.{COORDINATES[axis]}.{robot}", text)


def _verdict(logged: Verdict, ours: Verdict, exact: bool) -> Iterator[Difference]:
    yield from _poses("result.final", ours.final.array(), logged.final.array(), exact)
    for robot, (one, two) in enumerate(zip(ours.clearance, logged.clearance, strict=True)):
        if not _same(np.array([one]), np.array([two]), exact):
            text = f"states {two}, the simulation gives {one}"
            yield Difference(None, f"result.clearance.{robot}", text)
    for robot, (one, two) in enumerate(zip(ours.entered, logged.entered, strict=True)):
        close = not exact and abs(ours.clearance[robot]) <= ROOM
        if one != two and not close:
            text = f"states {two}, the simulation gives {one}"
            yield Difference(None, f"result.entered.{robot}", text)


def _same(ours: Floats, logged: Floats, exact: bool) -> bool:
    return ours.shape == logged.shape and bool(_alike(ours, logged, exact).all())


def _alike(ours: Floats, logged: Floats, exact: bool) -> np.ndarray:
    if exact:
        return (ours == logged) | (np.isnan(ours) & np.isnan(logged))
    with np.errstate(invalid="ignore"):  # inf without obstacles
        near = np.abs(ours - logged) <= ROOM * np.maximum(1.0, np.abs(logged))
    return near | (ours == logged)
