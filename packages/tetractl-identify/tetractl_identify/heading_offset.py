"""Finds the angle from a robot's heading to its motion when it drives straight ahead.

The camera software may define a tracked body rotated. The heading then differs from the direction
of motion, always by the same angle. A robot that turns also moves sideways although its heading is
right, for two reasons. A tracked point that is l ahead of the axle moves sideways by l times the
turn. A car slips by an angle that grows with its speed v times its turning rate w. The angle of the
motion is therefore fitted as

    offset + l w / v + slip v w,

where v and w are the commanded values, and each step is weighted by its length. The angle of a step
is measured from the mean angle, so that no angle is near half a turn.
"""

import math
from dataclasses import dataclass

import numpy as np

from tetractl.core.poses import Floats, Integers
from tetractl.tools.likelihood import Z_95, SampleInterval
from tetractl_identify.fit import widening_from_blocks
from tetractl_identify.pose_steps import STD_OF_MEDIAN, Complex, robust_gains

SLOWEST = 0.2
"""Minimum speed in w / v, relative to the median speed: slow steps say little of the angle."""
CLIP = 3.0
"""Number of standard deviations beyond which an angle has less weight.

It counts as much as an angle that is so far off.
"""


@dataclass(frozen=True, slots=True)
class DrivenSteps:
    """The steps of a robot, with the distances and turns commanded in them.

    Attributes:
        moved: Distances along and across the heading, shape (M,), as in `PoseSteps` [length unit].
        duration_s: Durations, shape (M,) [s].
        way_sent: Commanded distances, shape (M,) [length unit]. Negative if backwards.
        turn_sent: Commanded turns, shape (M,) [rad].
        block: Index of the block that contains each step, shape (M,).
    """

    moved: Complex
    duration_s: Floats
    way_sent: Floats
    turn_sent: Floats
    block: Integers


def heading_offset(steps: DrivenSteps, in_one_ratio: bool) -> SampleInterval:
    """Fit the angle from the heading to the motion of a robot that drives straight ahead [rad].

    Args:
        steps: The steps of one robot.
        in_one_ratio: Whether speed and turning rate were always sent in the same ratio, as on a
            circle. The data then do not show how the robot moves when it drives straight ahead.

    Returns:
        The angle, anticlockwise from the heading, with the 95 % interval that the differences
        between blocks require. If the robot does not move, or if speed and turning rate were sent
        in one ratio, the result is the mean angle with an interval from -pi to pi.
    """
    sense = np.sign(steps.way_sent)
    motion = sense * steps.moved
    mean = float(np.angle(motion.sum()))
    if in_one_ratio or not motion.any():
        return SampleInterval(mean, -math.pi, math.pi)
    length = np.abs(motion)
    aside = length * np.angle(motion * np.exp(-1j * mean))
    way = np.abs(steps.way_sent)
    way = np.maximum(way, SLOWEST * float(np.median(way)) + 1e-12)
    ahead = sense * length * steps.turn_sent / way
    slip = length * way * steps.turn_sent / steps.duration_s**2
    gain, std = _first_gain(np.column_stack([length, ahead, slip]), aside, steps.block)
    reach = min(Z_95 * std, math.pi)
    return SampleInterval(mean + gain, mean + gain - reach, mean + gain + reach)


def _first_gain(causes: Floats, effect: Floats, block: Integers) -> tuple[float, float]:
    """Fit an effect as a sum of causes, and return the gain of the first cause.

    Args:
        causes: Causes, shape (M, K).
        effect: Their common effect, shape (M,).
        block: Index of the block that contains each row, shape (M,).

    Returns:
        The gain, and its standard deviation by the jackknife over blocks. The deviation is scaled
        so that NORMAL times its value gives a 95 % interval.
    """
    scale = np.linalg.norm(causes, axis=0) + 1e-300
    scaled = causes / scale
    deviations = np.abs(effect - scaled @ robust_gains(effect, scaled))
    usual = CLIP * STD_OF_MEDIAN * float(np.median(deviations)) + 1e-300
    weight = np.minimum(1.0, usual / np.maximum(deviations, 1e-300))

    count = int(block.max()) + 1
    squares = np.zeros((count, *scaled.shape[1:], *scaled.shape[1:]))
    products = np.zeros((count, *scaled.shape[1:]))
    np.add.at(squares, block, weight[:, None, None] * scaled[:, :, None] * scaled[:, None, :])
    np.add.at(products, block, (weight * effect)[:, None] * scaled)
    all_squares = squares.sum(axis=0)
    all_products = products.sum(axis=0)
    gain = float(np.linalg.lstsq(all_squares, all_products)[0][0])
    without_one = [
        np.linalg.lstsq(all_squares - square, all_products - product)[0][0]
        for square, product in zip(squares, products, strict=True)
    ]
    spread = (count - 1) * float(np.var(without_one))
    wider = float(widening_from_blocks(squares[:, :1, 0])[0])
    return gain / float(scale[0]), wider * math.sqrt(spread) / float(scale[0])
