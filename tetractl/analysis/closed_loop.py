"""Predicts the final positions of robots under an assumed noise: the linearised closed loop.

The deviation e (2N,) of the final positions from the plan, and the relative errors of turning rate
a and speed, are normal variables with a joint covariance. For each signal, from first to last,

1. the controller measures the deviation, with noise propagated to the end, and corrects it by the
   remaining signals: for a deviation of covariance P, measured with noise M, the correction is the
   fraction C = R (R + P + M)^-1. R is the covariance of the final positions if every remaining
   signal varies with the standard deviation TURN, and the stop comes a signal earlier or later;
2. the robots move: errors of turning rate and speed act, and the heading makes its random walk.

A controller that identifies turning rate and speed plans with its estimates, which improve with
every measurement. Without `corrects` there is no feedback.

The derivatives of the final positions: a step moves robot i by d(heading, u) and turns it by
w(heading, u). Let g_j be the derivative of the robot's final position with respect to its heading
before signal j, with g_L = 0. The chain rule backwards in time gives

    d end / d u_j = dd/du + g_{j+1} dw/du,      g_j = dd/dheading + g_{j+1} (1 + dw/dheading)

and likewise the derivatives with respect to the robot's turning rate a and speed.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ellipe

from tetractl.control.cost import predict
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats
from tetractl.core.registries import MOTIONS
from tetractl.experiment.plant import PlantSection
from tetractl.experiment.section_abilities import Noisy
from tetractl.model.motion.motion import in_rows


@dataclass(frozen=True, slots=True)
class Linear:
    """A plan of L signals for N robots, linearised; lengths in the spec's unit.

    `miss` (N,) is the planned distance of each robot's end to its target. Derivatives of the ends
    are `by_signal` (2N, L), of x_1, y_1, x_2, ... with respect to the signals [1/rad]; `by_heading`
    (L + 1, N, 2), with respect to the heading before each signal and at the end [1/rad]; `by_a` and
    `by_speed` (L, N, 2), with respect to the logarithms of turning rate and speed during one signal
    alone. `turn_by_a` (L, N) is the derivative of one signal's turn with respect to ln a [rad].
    `onward` (2N, 1) is the displacement of the ends by one more signal of straight motion, and
    `seconds` (L,) the duration of each signal [s].
    """

    miss: Floats
    by_signal: Floats
    by_heading: Floats
    by_a: Floats
    by_speed: Floats
    turn_by_a: Floats
    onward: Floats
    seconds: Floats


def linearise(problem: Problem, signals: Floats) -> Linear:
    """Linearise the robots' paths under a sequence of signals (L,) [rad]."""
    count, length = len(problem.a), len(signals)
    path = predict(problem, signals)
    heading = path[:-1, :, 2]
    seconds = np.full(length, problem.period)
    seconds[0] = problem.first_period
    by_heading, by_u, of_a, of_speed = _derivatives(problem, heading, signals, seconds)
    g = np.zeros((length + 1, count, 2))
    for j in reversed(range(length)):
        g[j] = by_heading[j, :, :2] + g[j + 1] * by_heading[j, :, 2:]
    later = g[1:]
    by_signal = by_u[..., :2] + later * by_u[..., 2:]  # (L, N, 2)
    end = path[-1]
    onward = (
        problem.period
        * problem.speed[:, None]
        * np.stack([np.cos(end[:, 2]), np.sin(end[:, 2])], axis=-1)
    )
    return Linear(
        miss=np.hypot(*(end[:, :2] - problem.targets).T),
        by_signal=by_signal.transpose(1, 2, 0).reshape(2 * count, length),
        by_heading=g,
        by_a=of_a[..., :2] + later * of_a[..., 2:],
        by_speed=of_speed[..., :2] + later * of_speed[..., 2:],
        turn_by_a=of_a[..., 2],
        onward=onward.reshape(2 * count, 1),
        seconds=seconds,
    )


def _derivatives(
    problem: Problem, heading: Floats, signals: Floats, seconds: Floats
) -> tuple[Floats, ...]:
    """Return the derivatives of each step's x, y and next heading, (L, N, 3) each, with respect to
    the heading, the signal, ln a and ln speed."""
    lanes, robots = MOTIONS.load(problem.motion).lanes, in_rows(problem)
    steps = [
        lanes.differentiate(np.cos(at), np.sin(at), np.cos(u), np.sin(u), own, t)
        for u, t, row in zip(signals, seconds, heading, strict=True)
        for at, own in zip(row, robots, strict=True)
    ]
    found = np.array([(by_heading, by_u, *more) for _, by_heading, by_u, more in steps])
    return tuple(found.reshape(*heading.shape, -1, 3).transpose(2, 0, 1, 3))


TURN = float(np.pi / np.sqrt(3))  # rad; standard deviation of a signal uniform in [-pi, pi]
SURE = 1e-8  # least variance of a measured turn [rad^2] and of a relative path length


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviations of a simulated plant's disturbances.

    `a` and `speed` are relative errors; `position` [length unit] and `heading` [rad] are errors of
    one measurement, `walk` [rad/sqrt(s)] is the random walk of the heading.
    """

    a: float
    speed: float
    walk: float
    position: float
    heading: float

    @classmethod
    def of(cls, plant: PlantSection) -> "Noise":
        """Return the noise of a simulated plant; 0 for a lab, whose section states no noise.

        An error uniform in [-e, e] has the standard deviation e / sqrt(3).
        """
        if not isinstance(plant, Noisy):
            return cls(a=0.0, speed=0.0, walk=0.0, position=0.0, heading=0.0)
        a, speed = plant.a_error / np.sqrt(3), plant.speed_error / np.sqrt(3)
        measured = plant.measurement_noise
        return cls(a, speed, plant.heading_noise, measured.position, measured.heading)

    @property
    def any(self) -> bool:
        """Whether any standard deviation is above 0."""
        return any((self.a, self.speed, self.walk, self.position, self.heading))


def left_out(plant: PlantSection) -> tuple[str, ...]:
    """Return the names of a plant's disturbances that `Noise` does not contain."""
    names = ("dead_time", "lost_commands", "drive", "cells", "disturbances")
    return tuple(name for name, value in plant if name in names and value)


def end_covariance(
    plan: Linear, noise: Noise, corrects: bool = True, identifies: bool = False
) -> Floats:
    """Return the covariance (2N, 2N) of the ends x_1, y_1, x_2, ... [length unit^2].

    `corrects` is whether the controller corrects deviations during the plan, and `identifies`
    whether the controller identifies turning rate a and speed.
    """
    count, length = len(plan.miss), len(plan.seconds)
    size = 2 * count
    p, cross = np.zeros((size, size)), np.zeros((size, size))
    known = np.repeat([noise.a**2, noise.speed**2], count)  # variances of ln a, then ln speed
    for k in range(length):
        if corrects:
            rows = np.hstack([TURN * plan.by_signal[:, k:], plan.onward])
            reach = rows @ rows.T
            eye = np.eye(size)
            m = noise.position**2 * eye + noise.heading**2 * _blocks(plan.by_heading[k])
            most = np.trace(reach) + np.trace(p) + np.trace(m)
            regular = max(1e-12 * most, 1e-30) * eye  # for robots that stand
            left = eye - np.linalg.solve(reach + p + m + regular, reach).T
            p = left @ p @ left.T + (eye - left) @ m @ (eye - left).T
            cross = left @ cross
        moved = np.hstack([_columns(plan.by_a[k]), _columns(plan.by_speed[k])])
        p = p + moved @ (known[:, None] * moved.T) + moved @ cross.T + cross @ moved.T
        cross = cross + moved * known
        middle = (plan.by_heading[k] + plan.by_heading[k + 1]) / 2
        p = p + noise.walk**2 * plan.seconds[k] * _blocks(middle)
        if identifies:
            left_over = 1 / (1 + known * _information(plan, noise, k))
            cross = cross * np.sqrt(left_over)
            known = known * left_over
    return p


def _information(plan: Linear, noise: Noise, k: int) -> Floats:
    """Return 1/variance of ln a, then of ln speed, (2N,), as estimated from the headings and
    positions measured before and after signal k.
    """
    turned = 2 * noise.heading**2 + noise.walk**2 * plan.seconds[k] + SURE
    ways = np.square(plan.by_speed[k]).sum(axis=1)  # a path is proportional to the speed
    went = np.maximum(2 * noise.position**2, SURE * ways)
    told = np.divide(ways, went, out=np.zeros_like(ways), where=went > 0)
    return np.concatenate([plan.turn_by_a[k] ** 2 / turned, told])


def mean_errors(covariance: Floats, miss: Floats) -> Floats:
    """Return the robots' mean distances to their targets (N,), for plans that end at the distances
    `miss` (N,) from the targets.

    The mean length m of a normal vector with standard deviations s1 >= s2 is
    sqrt(2/pi) s1 E(1 - s2^2/s1^2), with the complete elliptic integral E; the result is
    sqrt(m^2 + miss^2).
    """
    small, large = np.maximum(np.linalg.eigvalsh(of_each(covariance)), 0.0).T
    share = np.divide(small, large, out=np.ones_like(miss), where=large > 0)
    length = np.sqrt(2 / np.pi * large) * ellipe(1 - share)
    return np.hypot(length, miss)


def of_each(covariance: Floats) -> Floats:
    """Return the covariance of each robot's end (N, 2, 2) from the joint covariance (2N, 2N)."""
    count = len(covariance) // 2
    robots = np.arange(count)
    return covariance.reshape(count, 2, count, 2)[robots, :, robots, :]


def _columns(each: Floats) -> Floats:
    """Return (2N, N): column i holds the vector (2,) of robot i in rows 2i and 2i + 1."""
    count = len(each)
    placed = np.zeros((count, 2, count))
    placed[np.arange(count), :, np.arange(count)] = each
    return placed.reshape(2 * count, count)


def _blocks(each: Floats) -> Floats:
    """Return the block-diagonal matrix (2N, 2N) of each robot's vector (2,) times its transpose."""
    columns = _columns(each)
    return columns @ columns.T
