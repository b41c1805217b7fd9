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
from tetractl_identify.fit import compute_block_widening
from tetractl_identify.pose_steps import STD_OF_MEDIAN, Complex, fit_robust_gains

SPEED_RATIO_MIN = 0.2
"""Minimum speed v in w / v, relative to the median speed.

Slow steps contain little information about the angle.
"""
CLIP_STDS = 3.0
"""Deviation beyond which an angle has less weight [standard deviations].

A larger deviation counts as much as this deviation.
"""


@dataclass(frozen=True, slots=True)
class DrivenSteps:
    """The steps of a robot, with the distances and turns commanded in them.

    Attributes:
        displacement: Complex distances along and across the heading, shape (M,), as in `PoseSteps`
            [length unit].
        duration_s: Durations, shape (M,) [s].
        distance_sent: Commanded distances, shape (M,) [length unit]. Negative if backwards.
        turn_sent: Commanded turns, shape (M,) [rad].
        block: Index of the block that contains each step, shape (M,).
    """

    displacement: Complex
    duration_s: Floats
    distance_sent: Floats
    turn_sent: Floats
    block: Integers


def fit_heading_offset(steps: DrivenSteps, in_one_ratio: bool) -> SampleInterval:
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
    travel_sign = np.sign(steps.distance_sent)
    motion = travel_sign * steps.displacement
    mean_angle_rad = float(np.angle(motion.sum()))
    if in_one_ratio or not motion.any():
        return SampleInterval(mean_angle_rad, -math.pi, math.pi)
    length = np.abs(motion)
    weighted_angle = length * np.angle(motion * np.exp(-1j * mean_angle_rad))
    sent_length = np.abs(steps.distance_sent)
    sent_length = np.maximum(sent_length, SPEED_RATIO_MIN * float(np.median(sent_length)) + 1e-12)
    lever_term = travel_sign * length * steps.turn_sent / sent_length
    slip_term = length * sent_length * steps.turn_sent / steps.duration_s**2
    offset_rad, offset_std_rad = _fit_first_gain(
        np.column_stack([length, lever_term, slip_term]), weighted_angle, steps.block
    )
    half_width_rad = min(Z_95 * offset_std_rad, math.pi)
    return SampleInterval(
        mean_angle_rad + offset_rad,
        mean_angle_rad + offset_rad - half_width_rad,
        mean_angle_rad + offset_rad + half_width_rad,
    )


def _fit_first_gain(causes: Floats, effect: Floats, block: Integers) -> tuple[float, float]:
    """Fit an effect as a sum of causes, and return the gain of the first cause.

    Args:
        causes: Causes, shape (M, K).
        effect: Their common effect, shape (M,).
        block: Index of the block that contains each row, shape (M,).

    Returns:
        The gain, and its standard deviation by the jackknife over blocks. The deviation is scaled
        so that NORMAL times its value gives a 95 % interval.
    """
    cause_scale = np.linalg.norm(causes, axis=0) + 1e-300
    scaled_causes = causes / cause_scale
    deviations = np.abs(effect - scaled_causes @ fit_robust_gains(effect, scaled_causes))
    deviation_limit = CLIP_STDS * STD_OF_MEDIAN * float(np.median(deviations)) + 1e-300
    weight = np.minimum(1.0, deviation_limit / np.maximum(deviations, 1e-300))

    block_count = int(block.max()) + 1
    normal_matrices = np.zeros((block_count, *scaled_causes.shape[1:], *scaled_causes.shape[1:]))
    normal_vectors = np.zeros((block_count, *scaled_causes.shape[1:]))
    np.add.at(
        normal_matrices,
        block,
        weight[:, None, None] * scaled_causes[:, :, None] * scaled_causes[:, None, :],
    )
    np.add.at(normal_vectors, block, (weight * effect)[:, None] * scaled_causes)
    normal_matrix = normal_matrices.sum(axis=0)
    normal_vector = normal_vectors.sum(axis=0)
    gain = float(np.linalg.lstsq(normal_matrix, normal_vector)[0][0])
    leave_one_out_gains = [
        np.linalg.lstsq(normal_matrix - block_matrix, normal_vector - block_vector)[0][0]
        for block_matrix, block_vector in zip(normal_matrices, normal_vectors, strict=True)
    ]
    jackknife_variance = (block_count - 1) * float(np.var(leave_one_out_gains))
    widening = float(compute_block_widening(normal_matrices[:, :1, 0])[0])
    return gain / float(cause_scale[0]), widening * math.sqrt(jackknife_variance) / float(
        cause_scale[0]
    )
