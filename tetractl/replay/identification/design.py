"""Designs a motion from which robots can be identified accurately: a sequence of directions.

Of many random sequences, the one is taken that minimises the sum of the logarithms of the predicted
variances of the dead time and of each robot's turning rate and heading bias (a D-optimal design).
It is then improved one direction at a time. No robot may come within `margin` of the arena's edge
or an obstacle, and no two robots within twice `margin` of each other. Variances are those of the
filter that will identify the robots, run over the path without noise.

Source: Goodwin and Payne, "Dynamic System Identification: Experiment Design and Data Analysis",
Academic Press (1977), chapter 6.
"""

from dataclasses import dataclass, replace

import numpy as np

from tetractl.control.filter import USUAL
from tetractl.control.sequence import SequenceSection
from tetractl.core.errors import UsageError
from tetractl.core.poses import Floats, Poses, wrap
from tetractl.core.setup import Setup
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.load import LoadedSpec, parse_spec, resolved_yaml
from tetractl.model.free_space import clearance
from tetractl.model.motion.exact import step
from tetractl.model.path_check import separations
from tetractl.replay.identification.fit import WEAK
from tetractl.replay.identification.passes import SHORTEST_S, Belief, TrackFrames, marginal
from tetractl.replay.identification.tracks import Track

HOLD_S = 0.4  # least time for which a direction is held
# noise of positions over the speed [s] and of headings [rad], and their random walks, over sqrt(s)
NOISE = (USUAL.position_noise_s, USUAL.heading_noise), (USUAL.slip, 0.03)
APART_S = 0.0005  # spacing of the dead times from which the accuracy of theirs is predicted [s]
CANDIDATES, CHANGES = 60, 120
# most draws per direction; after a failed draw, probability to go back, and by how many directions
TRIES, GIVE_UP, GIVEN_UP = 60, 0.1, 3
TURN = 2.0  # largest change of direction [rad]: near pi, a robot may turn either way
AWAY = 0.15  # margin relative to the arena's shorter side; smaller for robots that start nearer


@dataclass(frozen=True, slots=True)
class Design:
    """A sequence of directions, one per control period, and the standard deviations predicted for
    the values that will be identified from it.

    `directions` (C,) [rad]; `dead_time_std` [s], `a_std` (N,) relative to the turning rate a,
    `heading_bias_std` (N,) [rad]. `clearance` [length unit] is the least distance of a robot from
    the edge or an obstacle, or half the least distance between two robots if that is smaller.
    """

    directions: Floats
    period_s: float
    dead_time_std: float
    a_std: Floats
    heading_bias_std: Floats
    clearance: float

    @property
    def seconds(self) -> float:
        """Duration of the motion [s]."""
        return len(self.directions) * self.period_s


def propose(experiment: Experiment, seconds: float, seed: int) -> Design:
    """Return a design that lasts about `seconds` [s]; UsageError if the robots have no room for
    it.
    """
    setup, rng = experiment.setup, np.random.default_rng(seed)
    period = setup.period_s
    hold = max(1, round(HOLD_S / period))
    count = max(2, round(seconds / (hold * period)))
    dead_time = experiment.controller.dead_time
    side = min(setup.arena.width, setup.arena.height)
    margin = min(AWAY * side, 0.5 * _room(setup, setup.starts.array()))
    found: list[tuple[float, Floats]] = []
    for _ in range(CANDIDATES):
        knots = _random_sequence(rng, count, setup, margin, hold * period)
        if knots is not None:
            found.append((_score(setup, np.repeat(knots, hold), dead_time), knots))
    if not found:
        raise UsageError(
            "the robots have no room to drive for that long",
            "shorten --seconds, or start the robots further from edges, obstacles and each other",
        )
    best, knots = min(found, key=lambda one: one[0])
    for _ in range(CHANGES):
        changed = knots.copy()
        changed[rng.integers(count)] = rng.uniform(-np.pi, np.pi)
        if np.abs(wrap(np.diff(changed, prepend=_ahead(setup)))).max() > TURN:
            continue
        if _room(setup, _path(setup, np.repeat(changed, hold), period)) < margin:
            continue
        score = _score(setup, np.repeat(changed, hold), dead_time)
        if score < best:
            best, knots = score, changed
    directions = np.repeat(knots, hold)
    deviations = _deviations(setup, directions, dead_time)
    n = len(setup.names)
    return Design(
        directions=directions,
        period_s=period,
        dead_time_std=float(deviations[0]),
        a_std=deviations[1 : 1 + n],
        heading_bias_std=deviations[1 + n :],
        clearance=_room(setup, _path(setup, directions, period)),
    )


def sequence_spec(spec: LoadedSpec, directions: Floats) -> LoadedSpec:
    """Return a spec whose controller sends `directions` [rad], one per control period.

    The robots stand still until the first direction, and arrival does not end the trial.
    """
    controller = SequenceSection(
        period=spec.experiment.controller.period,
        dead_time=spec.experiment.controller.dead_time,
        time_limit=(len(directions) + 1) * spec.experiment.controller.period,
        directions=tuple(directions.tolist()),
    )
    experiment = spec.experiment.model_copy(update={"controller": controller})
    text = resolved_yaml(experiment)
    made = parse_spec(text, spec.name, written=True)
    return replace(spec, experiment=made.experiment, text=text, path=None)


def _room(setup: Setup, path: Floats) -> float:
    """Return the least distance of poses (..., N, 3) from the edge or an obstacle, or half the
    least distance between two robots if that is smaller.
    """
    x, y, _ = path.reshape(-1, *path.shape[-2:]).transpose(2, 0, 1)
    apart = separations(x.T, y.T) / 2
    return min(float(clearance(setup, x, y, walls=True).min()), float(apart.min()))


def _random_sequence(
    rng: np.random.Generator, count: int, setup: Setup, margin: float, seconds: float
) -> Floats | None:
    """Return `count` random directions, each held for `seconds`, that keep the robots at least
    `margin` from everything; None if none were found.

    Each direction differs by at most TURN from the one before, the first one from the robots' mean
    start heading. If no next direction is possible, the last few are drawn again.
    """
    knots: list[float] = []
    states = [setup.starts]
    for _ in range(TRIES * count):
        last = knots[-1] if knots else _ahead(setup)
        u = float(wrap(np.array(last + rng.uniform(-TURN, TURN))))
        path = _drive(setup, states[-1], u, seconds)
        if _room(setup, path) >= margin:
            knots.append(u)
            states.append(Poses.of(path[-1]))
            if len(knots) == count:
                return np.array(knots)
        elif rng.uniform() < GIVE_UP:
            kept = max(0, len(knots) - GIVEN_UP)
            del knots[kept:], states[kept + 1 :]
    return None


def _ahead(setup: Setup) -> float:
    """Return the mean start heading [rad]."""
    heading = setup.starts.heading
    return float(np.arctan2(np.sin(heading).mean(), np.cos(heading).mean()))


def _path(setup: Setup, directions: Floats, period: float) -> Floats:
    """Return x, y, heading of N robots under C directions, in M frames each: (C, M, N, 3)."""
    poses, rows = setup.starts, []
    for u in directions:
        rows.append(_drive(setup, poses, float(u), period))
        poses = Poses.of(rows[-1][-1])
    return np.array(rows)


def _drive(setup: Setup, poses: Poses, u: float, seconds: float) -> Floats:
    """Return x, y, heading (M, N, 3) under direction `u`: in the middle of each of M - 1 equal
    parts of `seconds`, which last at least SHORTEST_S, and at the end.
    """
    count = max(1, int(seconds / SHORTEST_S))
    t = np.append((np.arange(count) + 0.5) / count, 1.0)[:, None] * seconds
    moved = step(poses.x, poses.y, poses.heading, np.array(u), setup.a, setup.speed, t)
    return np.stack(moved, axis=-1)


def _score(setup: Setup, directions: Floats, dead_time: float) -> float:
    return float(np.log(_deviations(setup, directions, dead_time)).sum())


def _deviations(setup: Setup, directions: Floats, dead_time: float) -> Floats:
    """Return predicted standard deviations (1 + 2 N,): of dead time, log turning rates, biases."""
    n = len(setup.names)
    mean = np.column_stack([np.log(setup.a), np.log(setup.speed), np.zeros(n)])
    noise, walk = (np.column_stack([one * setup.speed, np.full(n, two)]) for one, two in NOISE)
    belief = Belief(mean, np.broadcast_to(WEAK, mean.shape), noise, walk)
    frames = TrackFrames.of(_driven(setup, directions, dead_time))
    _, tau_std, _, std, _ = marginal([frames], belief, dead_time, APART_S)
    return np.concatenate([[tau_std], std[:, 0], std[:, 2]])


def _driven(setup: Setup, directions: Floats, dead_time: float) -> Track:
    """Return the track of robots that move under the directions exactly as the spec expects."""
    seen = _path(setup, directions, setup.period_s)[:, :-1]
    per, n = seen.shape[1:3]
    begin = np.arange(len(directions), dtype=np.float64) * setup.period_s
    return Track(
        source="the design",
        origin="predicted",
        unit=setup.unit,
        names=setup.names,
        time=(begin[:, None] + (np.arange(per) + 0.5) / per * setup.period_s).ravel(),
        poses=seen.reshape(-1, n, 3),
        valid=np.ones((seen.size // (3 * n), n), dtype=np.bool_),
        sent=begin - dead_time,
        u=directions,
        until=len(directions) * setup.period_s,
    )
