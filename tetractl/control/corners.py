"""Ways out of a corner, for standing robots of which no plan keeps clear of everything: they drive
along a way with more room, or turn on the spot first if that gives such a way.
"""

from typing import NamedTuple

import numpy as np

from tetractl.control.evaluate import compiled_branches
from tetractl.control.margins import Margins
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats, wrap
from tetractl.model.motion.exact import step as exact

OUT_STARTS = np.linspace(-np.pi, np.pi, 48, endpoint=False)  # first directions tried [rad]
OUT_RATES = np.linspace(-6.0, 6.0, 13)  # rates of change of the direction tried [rad/s]
TURN_TO = np.linspace(-np.pi, np.pi, 24, endpoint=False)  # directions tried for a turn [rad]


class WayOut(NamedTuple):
    """What is tried and asked of a way out of a corner."""

    signals: int = 8
    room_s: float = 0.1  # clearance kept, as a time of driving, see `way_out`
    share: float = 0.8  # and at most as a fraction of the present clearance
    turn_s: float = 1.5  # time of turning after which robots must have a way out
    turns: int = 4  # control steps for which a direction to turn to is kept
    vain: int = 12  # number of turns that may lead nowhere, one after the other
    every: int = 7  # of these, every other is to the 7th next direction of TURN_TO
    parts: int = 4  # number of moments of a signal at which the clearance is computed
    final: float = 0.2  # weight of the final clearance relative to the least on the path


OUT = WayOut()


def way_out(
    problem: Problem, margins: Margins, apart: float, keep_s: float = OUT.room_s
) -> Floats | None:
    """Return signals (OUT.signals,) that lead standing robots away from obstacles and walls, with
    at least the distance `apart` between two robots; None if none was found.

    Sequences whose direction changes at a constant rate are tried; targets are ignored. The
    clearance is at least the way that the fastest robot drives in `keep_s` [s], or the fraction
    OUT.share of the present clearance if that is less.
    """
    signals, safe, _ = _roomiest(problem, problem.poses.array(), margins, apart, keep_s)
    return signals if safe else None


class Turning(NamedTuple):
    """The direction [rad] to which standing robots turn, None if they do not, and in how many
    control steps they have turned, to it and to others before."""

    facing: float | None = None
    steps: int = 0

    def then(self, facing: float | None) -> "Turning":
        """Return what it is after a step in which the robots turn to `facing` [rad]."""
        return STILL if facing is None else Turning(facing, self.steps + 1)


STILL = Turning()


def away(
    problem: Problem, margins: Margins, apart: float, turning: Turning = STILL
) -> tuple[Floats | None, float | None]:
    """Return a way out for standing robots or, if none keeps clear, the direction [rad] to which
    they turn first; if no turn helps, the best way out that enters nothing.

    Robots that are `turning` to a direction keep it for OUT.turns steps, in which all reach it: one
    that stands nearly opposite to it hardly turns at first, and another direction might be opposite
    again. After that the turn has led nowhere: then the best way out that enters nothing comes
    before another turn. If nothing is predicted to help, or every other turn leads nowhere, robots
    turn to any direction, since their headings decide what is possible next; after OUT.vain turns,
    nothing helps.
    """
    out = way_out(problem, margins, apart)
    if out is not None:
        return out, None
    vain, kept = divmod(turning.steps, OUT.turns)
    if kept:
        return None, turning.facing
    facing = None if vain else turn_away(problem, margins, apart)
    if facing is None:
        out = way_out(problem, margins, apart, 0.0)
    if vain % 2 and out is None:
        facing = turn_away(problem, margins, apart)
    if not vain and out is facing is None:
        facing = turn_away(problem, margins, apart, 0.0)
    if out is facing is None and vain < OUT.vain:
        facing = float(TURN_TO[OUT.every * vain % len(TURN_TO)])
    return out, facing


def turn_away(
    problem: Problem, margins: Margins, apart: float, keep_s: float = OUT.room_s
) -> float | None:
    """Return the direction [rad] towards which standing robots turn on the spot so that they have a
    way out after OUT.turn_s, with the clearance of `way_out`; None if no direction gives one.
    """
    x, y, heading = problem.poses.x, problem.poses.y, problem.poses.heading
    bias = 0.0 if problem.bias is None else problem.bias
    for every in (2, 1):  # where robots stand side by side, ways out are narrow
        found = []
        for facing in TURN_TO.tolist():
            towards = facing + bias + np.zeros_like(heading)
            turned = exact(x, y, heading, towards, problem.a, problem.speed, OUT.turn_s)[2]
            start = np.column_stack([x, y, turned])
            _, safe, room = _roomiest(problem, start, margins, apart, keep_s, every)
            found.append((safe, *room, facing))
        safe, *_, facing = max(found)
        if safe:
            return facing
    return None


def _roomiest(
    problem: Problem,
    start: Floats,
    margins: Margins,
    apart: float,
    keep_s: float,
    every: int = 1,
) -> tuple[Floats, bool, tuple[float, float]]:
    """Return the best signals for `way_out` from start (N, 3), of `every` second, third, ... first
    direction and rate; whether their path is safe; its least clearance [length unit], and that
    plus OUT.final times the clearance at its end."""
    starts, rates = OUT_STARTS[::every], OUT_RATES[::every]
    turns = problem.period * rates[:, None] * np.arange(OUT.signals)
    part = problem.period / OUT.parts  # a robot that turns comes nearest within a signal
    stand = start[None].repeat(len(starts), axis=0)
    rooms = []
    for each in np.repeat(turns, OUT.parts, axis=1):
        path = compiled_branches(problem, stand, starts, each, part)
        rooms.append(margins.room(path[..., 0], path[..., 1], apart))
    room = np.concatenate(rooms, axis=1)  # (OUT.parts OUT.signals + 1, B)
    signals = wrap(turns[:, None] + starts[:, None]).reshape(-1, OUT.signals)
    least = room.min(axis=0)
    total = least + OUT.final * room[-1]
    best = int(np.argmax(total))
    now = float(room[0, best])  # below 0 inside an obstacle: robots must not go deeper
    safe = least[best] >= (min(keep_s * problem.speed.max(), OUT.share * now) if now > 0 else now)
    return signals[best], bool(safe), (float(least[best]), float(total[best]))
