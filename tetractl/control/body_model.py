"""What a filter assumes of robots on wheels, and of cells: from a prior to a `FilterModel`.

Both kinds are a `BodyModel`. A kind has states of its own, in addition to those of all robots, and
one state that cannot be found from any start: filters are laid out in groups, which start from
different values of this `tried` state. Cells have a helix, whose frequency is tried from the start.
Robots on wheels have motors that may saturate, which is tried where the heading does not fit.
"""

import math
from typing import NamedTuple

import numpy as np

from tetractl.control.kernels.filter_state import (
    FLOW_X,
    FLOW_Y,
    HEADING,
    HELIX_COSINE,
    HELIX_SINE,
    LN_A,
    LN_FREQUENCY,
    LN_SATURATION,
    LN_SPEED,
    MARKER_BIAS,
    SIDE,
    STATES_OF_CELLS,
    STATES_OF_WHEELS,
    TURN_BIAS,
    FilterModel,
    X,
    Y,
)
from tetractl.control.prior import Prior
from tetractl.core.poses import Floats
from tetractl.model.motion.motion import PARAMETERS, in_rows
from tetractl.model.motion.turn_rate import TURNING


class Usual(NamedTuple):
    """The usual noise of a camera, and the random walks of a robot's states, per sqrt(s). Chosen
    once by trials; docs/decisions/filter.md has the errors measured with them."""

    position_noise_s: float = 0.005
    """Deviation of a measured position, over the robot's speed [s]."""
    heading_noise: float = 0.01
    """Deviation of a measured heading [rad]."""
    slip: float = 0.02
    """Walk of the position, over the robot's speed [s]."""
    walk: float = 0.1
    """Walk of the heading, at first [rad]."""
    turn_bias: float = 0.005
    """Walk of the turn bias [rad]."""
    marker_bias: float = 0.002
    """Walk of the marker bias [rad]."""
    flow: float = 0.05
    """Walk of the flow, over its prior deviation."""
    helix: float = 0.1
    """Walk of the helix's sine and cosine, over its radius."""
    frequency: float = 0.01
    """Walk of ln of the helix's frequency."""
    frequency_std: float = 0.15
    """Prior deviation of ln of each of FREQUENCIES."""


USUAL = Usual()
"""The values of all robots of which a spec says nothing else."""
LEAST_SPEED = 1e-9
"""Least speed that a noise is taken over [length unit/s]: a robot may have none."""
FREQUENCIES = 0.5, 0.75, 1.0, 1.4
"""Frequencies of the helix to start from, over the usual one; their ratios are below 1.5."""
SATURATIONS = 0.8, 0.4
"""Saturations of motors to try where the heading does not fit."""
SATURATION_STD = 0.3
"""Prior standard deviation of ln of each of SATURATIONS."""
SATURATION_DRIFT = TURNING[1].drift
"""Random walk of ln of a saturation that has been tried [1/sqrt(s)]."""


class Uncertain(NamedTuple):
    """The deviation of a state at first, and that of its random walk [1/sqrt(s)]; per robot or for
    all."""

    std: Floats | float
    walk: Floats | float


class BodyModel(NamedTuple):
    """A kind of robot: what the filters assume of it beyond the states of all robots."""

    states: int
    """Number of states with a variance."""
    helix_rad_s: float
    """Usual angular frequency of the helix [rad/s], 0 if there is none."""
    own_states: dict[int, Uncertain]
    """The states that only this kind has."""
    tried: int
    """The state that groups of filters start from different values of."""
    first_tried: tuple[float, ...]
    """Its values in the first groups."""
    later_tried: tuple[float, ...]
    """Its values to try where the heading does not fit. There are none for cells, which are left
    alone when the model does not fit: what they do by themselves is no other dead time."""

    @property
    def groups_max(self) -> int:
        """Greatest number of groups of filters; of one, nothing is tried."""
        return max(len(self.first_tried), 1 + len(self.later_tried))


def wheels() -> BodyModel:
    """Return the model of robots on wheels. Their motors do not saturate until that is tried."""
    return BodyModel(
        states=STATES_OF_WHEELS,
        helix_rad_s=0.0,
        own_states={LN_SATURATION: Uncertain(0.0, 0.0)},
        tried=LN_SATURATION,
        first_tried=(0.0,),
        later_tried=tuple(math.log(saturation) for saturation in SATURATIONS),
    )


def cells(frequency_hz: float, radius: float) -> BodyModel:
    """Return the model of cells that swim on a helix, with its usual frequency and its radius
    [length unit]: sine and cosine of a random phase deviate by radius / sqrt(2)."""
    swing = Uncertain(radius / math.sqrt(2), USUAL.helix * radius)
    return BodyModel(
        states=STATES_OF_CELLS,
        helix_rad_s=2 * math.pi * frequency_hz,
        own_states={
            HELIX_SINE: swing,
            HELIX_COSINE: swing,
            LN_FREQUENCY: Uncertain(USUAL.frequency_std, USUAL.frequency),
        },
        tried=LN_FREQUENCY,
        first_tried=tuple(math.log(frequency) for frequency in FREQUENCIES),
        later_tried=(),
    )


def body_model(prior: Prior) -> BodyModel:
    """Return the model of the robots of a prior: cells if there is a helix."""
    if prior.helix_radius > 0 and prior.helix_frequency > 0:
        return cells(prior.helix_frequency, prior.helix_radius)
    return wheels()


def filter_model(prior: Prior, body: BodyModel) -> FilterModel:
    """Return what the filters assume of the robots of a prior."""
    walk = np.zeros((body.states, len(prior.a)))
    for state, uncertain in (_states_of_all(prior) | body.own_states).items():
        walk[state] = uncertain.walk
    walk[X] = USUAL.slip * prior.speed
    walk[Y] = USUAL.slip * prior.speed
    walk[HEADING] = USUAL.walk
    return FilterModel(
        parameters=in_rows(prior),
        noise=_noise(prior),
        walk=walk,
        helix_rad_s=body.helix_rad_s,
        lag_s=prior.lag,
        watchdog_s=prior.watchdog,
        sticks=prior.sticks,
        coarse=prior.coarse,
    )


def with_saturation(model: FilterModel) -> FilterModel:
    """Return the model of robots on wheels whose motors may saturate: the saturation, which was
    taken for none until now, drifts from that which is tried."""
    walk = model.walk.copy()
    walk[LN_SATURATION] = SATURATION_DRIFT
    return model._replace(walk=walk)


def first_std(prior: Prior, body: BodyModel) -> Floats:
    """Return the standard deviations (N, n) from which the n states with a variance start; those of
    the pose are 0 until it is that of a frame."""
    std = np.zeros((len(prior.a), body.states))
    for state, uncertain in (_states_of_all(prior) | body.own_states).items():
        std[:, state] = uncertain.std
    return std


def _states_of_all(prior: Prior) -> dict[int, Uncertain]:
    """Return the states that all robots have, but their poses: these start from a frame."""
    a, speed = PARAMETERS
    side, _ = TURNING
    flow = Uncertain(prior.flow_std, USUAL.flow * prior.flow_std)
    return {
        LN_A: _walking(prior.a_std, a.drift),
        LN_SPEED: _walking(prior.speed_std, speed.drift),
        SIDE: _walking(prior.side_std, side.drift),
        TURN_BIAS: _walking(prior.heading_bias_std, USUAL.turn_bias),
        MARKER_BIAS: _walking(prior.marker_bias_std, USUAL.marker_bias),
        FLOW_X: flow,
        FLOW_Y: flow,
    }


def _walking(std: float, walk: float) -> Uncertain:
    """Return how uncertain a state is that drifts by a random walk, unless it is known."""
    return Uncertain(std, walk if std > 0 else 0.0)


def _noise(prior: Prior) -> Floats:
    """Return the standard deviations (3, N) of measured x, y and heading: the camera's noise, the
    usual one if it is not known, and what its grid adds."""
    noise = np.empty((3, len(prior.a)))
    position = prior.position_noise
    noise[:2] = position or USUAL.position_noise_s * np.maximum(prior.speed, LEAST_SPEED)
    noise[2] = prior.heading_noise or USUAL.heading_noise
    spread = np.array(prior.spread)
    return np.hypot(noise, spread[:, None])
