"""Way-points, a hold at the targets, and measures of how accurately robots kept to them.

All robots pass their M way-points together: leg j = 0, ..., M - 1 ends when the robots are nearest
to their way-points j + 1, leg M at the targets, and leg M + 1 is the hold.

A robot is lost if it was not tracked for too long, as one that swam away, or if it has wheels and
stands while others drive, as one whose battery is empty. Who stands is decided here for all plants.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.poses import Bools, Floats, Integers, Observation, Sample

LOSS_LOOK_NS = SECOND // 10  # time between two frames in which standing robots are looked for
STRIDE_S = 0.05  # least way by which a robot has moved, as a time of driving
STRIDE_MOST_S = 0.2  # greatest way that counts between two such frames: a pose may jump
DEAD_S = 5.0  # way, as a time of driving, that one robot drives until another one counts as dead


@dataclass(frozen=True, slots=True)
class LossRule:
    """A robot that was not tracked for `after_s` is lost, and the trial goes on without it.

    If `replaced`, a body that is tracked again under the robot's name counts as another robot,
    which takes over the lost robot's target. If `dead`, a robot that is seen but dead (see
    `Standing`) is lost too; a trial that `ends` ends then, and its robots are never lost.
    """

    after_s: float
    replaced: bool
    dead: bool = False
    ends: bool = False


class Standing:
    """Which of N robots stand while another one drives.

    All robots receive the same commands, so that one that stands for long while another drives is
    dead. The frames alone tell: if all robots stand, commanded or not, none is dead. Way is counted
    in seconds of driving at the spec's speed; a robot of speed 0 drives nowhere and is never dead.
    """

    def __init__(self, speed: Floats) -> None:
        self._drives = speed > 0
        self._speed = np.where(self._drives, speed, np.inf)
        self.due_ns = 0
        self._at = np.full((len(speed), 2), np.nan)  # where each robot was when it last moved
        self._driven = np.zeros(len(speed))  # way of each robot [s]
        self._then = np.zeros((len(speed), len(speed)))  # row i: that of all when i last moved

    def dead(self, frame: Observation) -> Bools | None:
        """Return which robots (N,) have stood while one drove for DEAD_S, None if none moved, and
        set `due_ns` to the time of the next frame to look at."""
        self.due_ns = (frame.sampled_ns // LOSS_LOOK_NS + 1) * LOSS_LOOK_NS
        xy = frame.poses.xy
        way = np.hypot(*(xy - self._at).T) / self._speed
        moves = frame.valid & ~(way < STRIDE_S)  # one seen for the first time moves
        if not moves.any():
            return None
        self._driven[moves] += np.fmin(way, STRIDE_MOST_S)[moves]
        self._at[moves] = xy[moves]
        self._then[moves | ~frame.valid] = self._driven
        return self._drives & ((self._driven - self._then).max(axis=1) >= DEAD_S)


class Losses:
    """Which of N robots of the given speeds (N,) are `lost` (N,) or `left` (N,), and the number of
    `changes` of that; how often each has been lost, `times` (N,), and which are `dead` (N,).

    The controller, the log's reader and `verify` all pass every camera frame to `see`, in order,
    and so get the same result. Without a rule no robot is ever lost; which
    are dead is found all the same.
    """

    def __init__(self, rule: LossRule | None, speed: Floats) -> None:
        self._rule = rule
        count = len(speed)
        self._standing = Standing(speed)
        self.dead: Bools = np.zeros(count, dtype=np.bool_)
        self.lost: Bools = np.zeros(count, dtype=np.bool_)
        self.changes = 0
        self.times: Integers = np.zeros(count, dtype=np.int64)
        self._seen_ns: Integers | None = None
        self._waiting = list[Observation]()  # frames that are not yet counted
        self._due_ns = 0  # the earliest time at which a robot can be lost or back

    @property
    def left(self) -> Bools:
        """Which robots (N,) are not lost."""
        return ~self.lost

    def see(self, frame: Observation) -> list[int]:
        """Update the losses by the next frame; return the indices of robots replaced in it."""
        if frame.sampled_ns >= self._standing.due_ns:
            dead = self._standing.dead(frame)
            if dead is not None and (dead & ~self.dead).any():
                self.dead = self.dead | dead
                if self._rule and self._rule.dead and not self._rule.ends:
                    gone = dead & self.left
                    self._change(gone, self.lost | gone)
        if self._rule is None or self._rule.ends:
            return []
        self._waiting.append(frame)
        if frame.sampled_ns < self._due_ns:
            return []
        after_ns = round(self._rule.after_s * SECOND)
        back = np.zeros_like(self.lost)
        seen_ns = np.full(len(back), frame.sampled_ns) if self._seen_ns is None else self._seen_ns
        for waiting in self._waiting:
            gone = self.left & (waiting.sampled_ns - seen_ns >= after_ns)
            seen_ns[waiting.valid] = waiting.sampled_ns
            lost = self.lost | gone
            back = lost & waiting.valid & self._rule.replaced
            if gone.any() or back.any():
                self._change(gone, lost & ~back)
        self._seen_ns = seen_ns
        self._due_ns = int(seen_ns.min()) + after_ns if self.left.all() else 0
        self._waiting.clear()
        return np.flatnonzero(back).tolist()

    def _change(self, gone: Bools, lost: Bools) -> None:
        """Count the robots `gone` now (N,), and take which are `lost` from now on (N,)."""
        self.times = self.times + gone
        self.lost = lost
        self.changes += 1


STOOD = "while others drive", "though commanded to move"
"""How the reason in the result of a trial ends in which a robot stood: now, and in earlier logs."""


def told_dead(names: Sequence[str], dead: Bools) -> str:
    """Return the text that some of the robots `names` are dead, "" for none."""
    who = [name for name, is_dead in zip(names, dead.tolist(), strict=True) if is_dead]
    if not who:
        return ""
    return f"{', '.join(who)} {'do' if len(who) > 1 else 'does'} not move {STOOD[0]}"


@dataclass(frozen=True, slots=True)
class HoldTask:
    """The task to stay within `radius` [length unit] of the targets for `seconds`."""

    radius: float
    seconds: float


class TourMeasure:
    """Measures how accurately N robots passed their way-points and held at their targets.

    `legs` (M + 1, N, 2) are the M way-points of each robot and then its target [length unit].

    For each control step, call `step` with its leg and observation, then `add` with its frames;
    frames after `until_ns` are ignored. `loss` is the rule by which one of the robots, of the given
    speeds (N,), is lost.
    """

    def __init__(
        self, legs: Floats, hold: HoldTask | None, loss: LossRule | None, speed: Floats
    ) -> None:
        self._legs = legs
        self._hold = hold
        self._leg = 0
        self._began_ns: int | None = None
        self._inside = np.zeros(legs.shape[1], dtype=np.int64)
        self._frames = 0
        self._passed: list[float] = []
        self.losses = Losses(loss, speed)
        """Which robots were lost, or do not move while others drive."""

    def step(self, leg: int, observation: Observation) -> str:
        """Set the leg of a control step; return a message if a new leg begins, otherwise ""."""
        for past in self._legs[self._leg : min(leg, len(self._legs) - 1)]:
            distances = observation.poses.distances(past)
            self._passed.append(float(distances.sum()))
        begins = leg > self._leg
        self._leg = leg
        if leg == len(self._legs) and self._began_ns is None:
            self._began_ns = observation.sampled_ns
            return "the robots have arrived and hold"
        return f"way-point {leg} of {len(self._legs) - 1} is passed" if begins else ""

    def add(self, samples: Iterable[Sample], until_ns: int | None = None) -> None:
        """Count how often robots are lost and, for each robot, in how many frames of the hold it
        is within the hold's radius of its target, by its true pose if that is known; otherwise a
        robot that is not tracked counts as outside."""
        for sample in samples:
            observation = sample.observation
            if until_ns and observation.sampled_ns > until_ns:
                continue
            self.losses.see(observation)
            if (
                self._hold is None
                or self._began_ns is None
                or observation.sampled_ns < self._began_ns
            ):
                continue
            near = (sample.truth or observation.poses).distances(
                self._legs[-1]
            ) <= self._hold.radius
            self._inside += near if sample.truth else near & observation.valid
            self._frames += 1

    @property
    def passed(self) -> tuple[float, ...]:
        """The sum of the robots' observed distances to each way-point, at the control step in which
        the way-point counts as passed [length unit]."""
        return tuple(self._passed)

    @property
    def stood(self) -> Bools:
        """Which robots (N,) are dead and were not lost for it."""
        return self.losses.dead & self.losses.left

    @property
    def gone(self) -> tuple[bool, ...]:
        """Whether each robot is lost at the end, (N,)."""
        return tuple(self.losses.lost.tolist())

    @property
    def lost(self) -> tuple[int, ...]:
        """How often each robot was lost, (N,); empty if none ever was."""
        times = self.losses.times
        return tuple(times.tolist()) if times.any() else ()

    @property
    def inside(self) -> tuple[float, ...]:
        """Fraction of the hold's frames in which each robot was within the hold's radius of its
        target, (N,); empty without a hold."""
        return tuple((self._inside / self._frames).tolist()) if self._frames else ()
