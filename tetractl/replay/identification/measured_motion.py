"""What poses show by themselves: which are no measurement, and whether robots move along their
headings.

**No measurement.** A tracker that has lost a robot repeats its last pose, states zeros, or takes it
for another or for itself turned. `measured` leaves out repeats after which the robot is suddenly
far away, and stretches of poses that jump away and back: of all chains of poses it keeps that with
most poses, less `JUMP_S` of poses for each jump.

**The angle.** Over a step a robot moves by m = dx + i dy, in the frame of its mean heading. With c,
the way that it was sent or that its speed makes (below 0 backwards), and its turn, by which a point
ahead of the wheels' axle moves across,

    m = g c + d turn,    g and d complex,

is fitted by least absolute deviations. The angle of g is 0 if it moves along its heading; if x or y
is reversed, the conjugate of dx + i dy fits instead.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d

from tetractl.core.errors import UsageError
from tetractl.core.poses import Bools, Floats, Integers, wrap

REPEATS_MIN = 2
"""Least number of repeats in a row that are no measurement."""
RELEASE = 2.5
"""Usual ways or turns between two poses, above which a robot has moved while its pose repeated."""
LEAP = 10.0
"""Usual speeds, above which a way between two poses is a jump."""
TURN = 0.5
TURN_RATE = 4.0
TURN_MOST = 2.2
"""A turn between two poses is a jump above TURN [rad] + TURN_RATE [rad/s] or thrice the usual rate
times their time, at most TURN_MOST [rad]."""
TURNS_S = 0.5
"""Time after which a robot may have turned by any angle [s]."""
JUMP_S = 1.0
"""Duration of poses that a jump outweighs: stretches of twice as long are left out [s]."""
USUAL = 0.6
FAST = 0.9
"""Quantiles of turns and of ways that count as usual: two in five turns may be to and from a
flipped heading."""
OFF_RAD = 0.15
"""Angle between motion and heading from which it is refused: a speed 1.1 % low [rad]."""
MIRRORED = 0.2
"""Share of the way by which the mirrored motion fits better."""
ACROSS = 0.2
"""Share of the way across the heading from which a robot is not one on two wheels."""
SURE = 3.0
"""Standard deviations of the angle by which it is more."""
ALONG = 0.5
"""Share of the way, at the begin and at the end, that an angle explains if headings drift."""
NO_ANGLE = 0.2
"""Share of the way below which what was sent does not explain it, at any angle: others tell why."""
LEAST_WAY = 1e-9
DEVIATIONS_ROUNDS = 20
LEAST_DEVIATION = 1e-4

Complex = NDArray[np.complex128]


def measured(times: Floats, poses: Floats) -> Bools:
    """Return which poses (M, 3) of a robot at `times` (M,) [s] are measurements."""
    if not len(times):
        return np.zeros(0, dtype=np.bool_)
    kept = np.flatnonzero(~_repeats(poses))
    chain = _longest_chain(times[kept], poses[kept])
    is_measured = np.zeros(len(times), dtype=np.bool_)
    is_measured[kept[chain]] = True
    return is_measured


def jumps_of(times: Floats, poses: Floats) -> Integers:
    """Return the measurements (K,) of those (M, 3) at `times` (M,) [s] after which a robot is
    suddenly elsewhere, and stays there."""
    if len(times) < 2:
        return np.arange(0)
    before = np.arange(len(times) - 1)
    return np.flatnonzero(_Jumps.of(times, poses).between(before, before + 1))


def _repeats(poses: Floats) -> Bools:
    """Return which poses (M, 3) repeat the one before them, or its heading, until the robot is
    suddenly far away, or until the end."""
    moved = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    turned = np.abs(wrap(np.diff(poses[:, 2])))
    is_turned = turned == 0
    is_same = is_turned & (moved == 0)
    turns_far = turned > RELEASE * _fast(turned)
    moves_far = moved > RELEASE * _fast(moved)
    poses_frozen = _frozen(is_same, np.append(turns_far | moves_far, True))
    # a robot that drives straight on until the end keeps its heading
    return poses_frozen | _frozen(is_turned & ~is_same, np.append(turns_far, False))


def _fast(steps: Floats) -> float:
    """Return the quantile FAST of ways or turns (M - 1,) that are not 0."""
    changes = steps[steps > 0]
    return float(np.quantile(changes, FAST)) if changes.size else 0.0


def _frozen(is_same: Bools, is_release: Bools) -> Bools:
    """Return which poses (M,) end one of REPEATS_MIN or more steps (M - 1,) in a row that are the
    same and have a release (M,) behind them; the last release is the end of the track."""
    frozen = np.zeros(len(is_same) + 1, dtype=np.bool_)
    if not is_same.any() or is_same.all():
        return frozen
    edges = np.diff(is_same.astype(np.int64), prepend=0, append=0)
    begins = np.flatnonzero(edges == 1)
    ends = np.flatnonzero(edges == -1)
    for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
        if end - begin >= REPEATS_MIN and is_release[end]:
            is_jump = begin > 0 and is_release[begin - 1]  # to 0, as of a robot that is lost
            frozen[begin if is_jump else begin + 1 : end + 1] = True
    return frozen


@dataclass(frozen=True, slots=True)
class _Jumps:
    """What is too far for a robot's motion: from one to another of its `poses` (M, 3) at `times`
    (M,) [s], by its usual `speed` [length unit/s] and turning `rate` [rad/s].
    """

    times: Floats
    poses: Floats
    speed: float
    rate: float

    @classmethod
    def of(cls, times: Floats, poses: Floats) -> "_Jumps":
        """Return the jumps of a robot with two or more poses."""
        apart_s = np.diff(times)
        ways = np.hypot(*np.diff(poses[:, :2], axis=0).T) / apart_s
        rates = np.abs(wrap(np.diff(poses[:, 2]))) / apart_s
        # a single pose at a wrong place makes two long ways, and no three
        driven = minimum_filter1d(ways[ways > 0], 3)
        speed = np.quantile(driven, FAST) if len(driven) else 0.0
        rate = max(TURN_RATE, 3 * np.quantile(rates, USUAL))
        return cls(times, poses, float(speed), float(rate))

    def between(self, first: Integers, second: Integers) -> Bools:
        """Return whether from the first to the second pose of each of K pairs is a jump (K,)."""
        apart_s = self.times[second] - self.times[first]
        moved = self.poses[second] - self.poses[first]
        way = np.hypot(moved[:, 0], moved[:, 1])
        turn = np.abs(wrap(moved[:, 2]))
        most_turn = np.minimum(TURN + self.rate * apart_s, TURN_MOST)
        turns_away = (turn > most_turn) & (apart_s <= TURNS_S)
        return turns_away | (way > LEAP * self.speed * apart_s + LEAST_WAY)


def _longest_chain(times: Floats, poses: Floats) -> Integers:
    """Return the poses (K,) of those (M, 3) at `times` (M,) [s] that are in the longest chain.

    Poses without a jump between them are one stretch; a chain has whole stretches. Its length is
    the number of its poses less that of JUMP_S for each jump, and it leaves out at most twice that
    number of poses at once.
    """
    count = len(times)
    if count < 3:
        return np.arange(count)
    jumps = _Jumps.of(times, poses)
    cuts = np.flatnonzero(jumps.between(np.arange(count - 1), np.arange(1, count))) + 1
    begins = np.concatenate([[0], cuts])
    ends = np.concatenate([cuts, [count]])
    cost = max(1.0, JUMP_S / float(np.median(np.diff(times))))
    length = (ends - begins).astype(np.float64)
    before = np.full(len(begins), -1)
    for stretch in range(1, len(begins)):
        earliest = np.searchsorted(ends, begins[stretch] - 2 * cost)
        earlier = np.arange(earliest, stretch)
        is_jump = jumps.between(ends[earlier] - 1, np.full(len(earlier), begins[stretch]))
        chains = length[earlier] - cost * is_jump
        if chains.max() > 0:
            before[stretch] = earlier[chains.argmax()]
            length[stretch] += chains.max()
    chain: list[Integers] = []
    stretch = int(length.argmax())
    while stretch >= 0:
        chain.append(np.arange(begins[stretch], ends[stretch]))
        stretch = int(before[stretch])
    return np.concatenate(chain[::-1])


# ---- The angle between motion and heading ----


@dataclass(frozen=True, slots=True)
class PoseSteps:
    """Steps between poses: duration [s], way dx + i dy [length unit], mean heading [rad] and turn
    [rad] of each (S,)."""

    duration_s: Floats
    way: Complex
    heading: Floats
    turned: Floats

    @classmethod
    def of(cls, times: Floats, poses: Floats) -> "PoseSteps":
        """Return the steps from one to the next of poses (S + 1, 3) at times (S + 1,)."""
        x, y, heading = poses.T
        turned = np.asarray(wrap(np.diff(heading)), dtype=np.float64)
        return cls(np.diff(times), np.diff(x + 1j * y), heading[:-1] + turned / 2, turned)

    @classmethod
    def together(cls, parts: Sequence["PoseSteps"]) -> "PoseSteps":
        """Return the steps of several tracks, one after another."""
        return cls(
            np.concatenate([part.duration_s for part in parts]),
            np.concatenate([part.way for part in parts]),
            np.concatenate([part.heading for part in parts]),
            np.concatenate([part.turned for part in parts]),
        )

    def at(self, rows: Bools) -> "PoseSteps":
        """Return some of the steps (S,)."""
        return PoseSteps(
            self.duration_s[rows], self.way[rows], self.heading[rows], self.turned[rows]
        )

    @property
    def moved(self) -> Complex:
        """The ways in the frame of the heading (S,)."""
        return self.way * np.exp(-1j * self.heading)

    @property
    def mirrored(self) -> Complex:
        """The ways in the frame of the heading, if y is reversed (S,)."""
        return self.way.conj() * np.exp(-1j * self.heading)


def robust_gains(measured: NDArray[np.inexact], causes: Floats) -> NDArray[np.inexact]:
    """Return the gains (K,) by which measured (S,) is a sum of causes (S, K), with the least sum of
    absolute deviations: by least squares, weighted again and again."""
    scale = np.abs(causes).sum(axis=0) + 1e-300
    scaled = causes / scale
    least = LEAST_DEVIATION * np.abs(measured).mean() + 1e-300
    gains = np.linalg.lstsq(scaled, measured)[0]
    for _ in range(DEVIATIONS_ROUNDS):
        weight = np.maximum(np.abs(measured - scaled @ gains), least) ** -0.5
        gains = np.linalg.lstsq(scaled * weight[:, None], measured * weight)[0]
    return gains / scale


@dataclass(frozen=True, slots=True)
class _MotionAngle:
    """The `angle` [rad] from heading to motion with its standard deviation `std`, the share of the
    way that it explains, and that which remains across the motion, beyond what remains along it.
    """

    angle: float
    std: float
    explained: float
    across: float

    @classmethod
    def of(cls, moved: Complex, sent: Floats, turned: Floats) -> "_MotionAngle":
        """Return the angle of ways (S,) in the frame of the heading, by ways sent and turns."""
        causes = np.column_stack([sent, turned])
        gains = robust_gains(moved, causes)
        rest = (moved - causes @ gains) * np.exp(-1j * np.angle(gains[0]))
        total = np.abs(moved).sum()
        reach = np.abs(gains[0]) * np.linalg.norm(sent) + 1e-300
        return cls(
            angle=float(np.angle(gains[0])),
            std=float(np.abs(rest).mean() / reach),
            explained=float(1 - np.abs(rest).sum() / total),
            across=float((np.abs(rest.imag).sum() - np.abs(rest.real).sum()) / total),
        )


def check_angle(source: str, name: str, steps: PoseSteps, sent: Floats) -> None:
    """Raise UsageError if a robot does not move along its heading in some steps, in which it was
    sent ways (S,), below 0 backwards."""
    if not steps.way.any() or not sent.any():
        return
    straight = _MotionAngle.of(steps.moved, sent, steps.turned)
    mirrored = _MotionAngle.of(steps.mirrored, sent, steps.turned)
    if mirrored.explained > straight.explained + MIRRORED:
        if abs(mirrored.angle + math.pi / 2) < math.pi / 4:
            raise UsageError(
                f"{source}: {name} moves along its heading only with x and y exchanged",
                "are headings clockwise from +y, as a compass's? take them from a quarter turn; "
                "or exchange x and y",
            )
        axis = "y" if abs(mirrored.angle) < math.pi / 2 else "x"
        raise UsageError(
            f"{source}: {name} moves along its heading only with {axis} reversed",
            f"is the picture mirrored, or y downwards? reverse {axis}, or the headings",
        )
    off = abs(straight.angle)
    if off < OFF_RAD + SURE * straight.std and straight.across <= ACROSS:
        return
    _refuse_drift(source, name, steps, sent)
    if straight.across > ACROSS:
        raise UsageError(
            f"{source}: {name} moves across its heading in {straight.across:.0%} of its way",
            "robots on two wheels cannot: identify one that moves along its heading",
        )
    if straight.explained < NO_ANGLE:
        return
    if off > math.pi - OFF_RAD:
        raise UsageError(
            f"{source}: {name} moves against its heading",
            "add half a turn to the headings; or reverse v, if it is below 0 ahead; or the times, "
            "if they run backwards",
        )
    side = "left" if straight.angle > 0 else "right"
    remedy = "add {} to" if straight.angle > 0 else "take {} off"
    raise UsageError(
        f"{source}: {name} moves {math.degrees(off):.0f} degrees to the {side} of its heading",
        f"{remedy.format(f'{off:.3f} rad')} the headings",
    )


def _refuse_drift(source: str, name: str, steps: PoseSteps, sent: Floats) -> None:
    """Raise UsageError if the angle from heading to motion changes from the first third of the
    steps to the last by more than either may be off."""
    third = len(sent) // 3
    moved = steps.moved
    first = _MotionAngle.of(moved[:third], sent[:third], steps.turned[:third])
    last = _MotionAngle.of(moved[-third:], sent[-third:], steps.turned[-third:])
    change = float(np.angle(np.exp(1j * (last.angle - first.angle))))
    are_along = min(first.explained, last.explained) > ALONG
    if are_along and abs(change) > OFF_RAD + SURE * (first.std + last.std):
        raise UsageError(
            f"{source}: the angle from the heading of {name} to its motion changes by "
            f"{math.degrees(change):.0f} degrees",
            "do its headings drift, as of a gyroscope? they must not",
        )
