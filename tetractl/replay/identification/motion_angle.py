"""Whether robots move along their headings.

Over a step a robot moves by m = dx + i dy, in the frame of its mean heading. With c, the way that
it was sent or that its speed makes (below 0 backwards), and its turn, by which a point ahead of the
wheels' axle moves across,

    m = g c + d turn,    g and d complex,

is fitted by least absolute deviations. The angle of g is 0 if it moves along its heading; if x or y
is reversed, the conjugate of dx + i dy fits instead. `check_angle` asks in this order whether the
motion is mirrored, is along the heading, drifts off it, goes across it, or is at an angle to it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tetractl.core.errors import UsageError
from tetractl.core.poses import Bools, Floats, wrap

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
DEVIATIONS_ROUNDS = 20
LEAST_DEVIATION = 1e-4
"""Rounds of `robust_gains`, and the least deviation in them, over the mean of what is measured."""

Complex = NDArray[np.complex128]


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
        along = np.abs(rest.real).sum()
        across = np.abs(rest.imag).sum()
        reach = np.abs(gains[0]) * np.linalg.norm(sent) + 1e-300
        return cls(
            angle=float(np.angle(gains[0])),
            std=float(np.abs(rest).mean() / reach),
            explained=float(1 - np.abs(rest).sum() / total),
            across=float((across - along) / total),
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
    if third == 0:
        return
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
