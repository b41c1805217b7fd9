"""Banks with one filter of one robot, to test single steps of the filters."""

import math
from typing import NamedTuple

import numpy as np

from tetractl.control.estimation.kernels.filter import follow
from tetractl.control.estimation.kernels.filter_state import (
    FLOW_X,
    FLOW_Y,
    FOLLOWS,
    HEADING,
    HELIX_COSINE,
    HELIX_SINE,
    HOST_SWING,
    LAG,
    LN_A,
    LN_FREQUENCY,
    LN_SATURATION,
    LN_SPEED,
    MARKER_BIAS,
    PACE,
    SIDE,
    STATES,
    STATES_OF_CELLS,
    STATES_OF_WHEELS,
    SWING,
    TURN_BIAS,
    Bank,
    FilterModel,
    PoseFrames,
    SentCommands,
    X,
    Y,
)
from tetractl.control.estimation.prior import Sticks

A = 4.0
SPEED = 300.0
HELIX_RAD_S = 9.0
NOISE = np.array([[5.0], [5.0], [0.05]])
STICKS = Sticks(every_s=6.0, for_s=2.0, strays=60.0, turns=1.0)
STUCK = -1
"""The slot of the stuck robot."""
NO_COMMANDS = SentCommands(np.empty(0), np.empty(0))
STANDS = math.nan


class Case(NamedTuple):
    """A kind of robot, with the state in which its motion is compared."""

    states: int
    helix_rad_s: float
    host_lag_s: float
    values: dict[int, float]


POSE = {X: 10.0, Y: 20.0, HEADING: 0.7, TURN_BIAS: 0.1, MARKER_BIAS: -0.2, FLOW_X: 7, FLOW_Y: -4}
WHEELS = POSE | {LN_A: 0.2, LN_SPEED: -0.1, SIDE: 0.15}
HELIX = {HELIX_SINE: 6.0, HELIX_COSINE: -5.0, LN_FREQUENCY: 0.1}
SWINGS = {SWING: 0.3, HOST_SWING: 0.3, PACE: 0.6}
CASES = {
    "wheels": Case(STATES_OF_WHEELS, 0.0, 0.0, WHEELS),
    "saturated": Case(STATES_OF_WHEELS, 0.0, 0.0, WHEELS | {LN_SATURATION: math.log(0.4)}),
    "lagging": Case(STATES_OF_WHEELS, 0.0, 0.06, WHEELS | SWINGS | {LAG: 0.06}),
    "lag unknown to the host": Case(STATES_OF_WHEELS, 0.0, 0.0, WHEELS | SWINGS | {LAG: 0.1}),
    "longer lag": Case(STATES_OF_WHEELS, 0.0, 0.04, WHEELS | SWINGS | {LAG: 0.133}),
    "shorter lag": Case(STATES_OF_WHEELS, 0.0, 0.133, WHEELS | SWINGS | {LAG: 0.04}),
    "no lag": Case(STATES_OF_WHEELS, 0.0, 0.06, WHEELS | SWINGS),
    "cell": Case(STATES_OF_CELLS, HELIX_RAD_S, 0.0, WHEELS | HELIX),
}


def model_of(case, walk=0.0, watchdog_s=math.inf, branch_all=False):
    """What is assumed of one robot; all states walk by `walk` per root of a second."""
    return FilterModel(
        parameters=np.array([[A, SPEED]]),
        noise=NOISE,
        walk=np.full((case.states, 1), walk),
        helix_rad_s=case.helix_rad_s,
        host_lag_s=case.host_lag_s,
        watchdog_s=watchdog_s,
        sticks=STICKS,
        branch_all=branch_all,
    )


def bank_of(case, direction, cov=None, dead_time_s=0.0, follows=FOLLOWS):
    """One filter of one robot, with a hypothesis in slot 0 that follows a direction [rad]."""
    mean = np.zeros((1, 1, STATES))
    for state, value in case.values.items():
        mean[..., state] = value
    start = np.array([dead_time_s]), mean, np.zeros((1, case.states)), np.zeros(1, dtype=np.int64)
    bank = Bank.start(*start, follows)
    bank.direction[..., 0] = direction
    if cov is not None:
        bank.cov[:] = cov
    return bank


def go_on(bank, model, seconds, pose=None, commands=NO_COMMANDS, step_s=0.0):
    """Follow the robot for some time, at whose end `pose` is seen, None for no pose; return the ln
    of its likelihood."""
    seen = np.zeros(3) if pose is None else pose
    frames = PoseFrames(
        time_s=np.array([[0.0], [seconds]]),
        poses=np.stack([0 * seen, seen])[:, None],
        valid=np.array([[False], [pose is not None]]),
    )
    return float(follow(bank, model, commands, frames, False, step_s)[0, 0])


def predicted(case, values, u, seconds):
    """The state (STATES,) after some time in which the robot followed u, from the states given."""
    bank = bank_of(case._replace(values=values), u)
    go_on(bank, model_of(case), seconds)
    return bank.state[0, 0, 0]


def some_covariance(states, seed=1):
    """A covariance of which all states depend on each other, in the units of each."""
    rng = np.random.default_rng(seed)
    sizes = np.full(states, 0.05)
    sizes[[X, Y, FLOW_X, FLOW_Y]] = 3.0
    if states == STATES_OF_CELLS:
        sizes[[HELIX_SINE, HELIX_COSINE]] = 2.0
    factor = sizes[:, None] * rng.normal(size=(states, states)) / math.sqrt(states)
    return factor @ factor.T


def expected_pose(case, z):
    """h(z), what a camera would measure (3,)."""
    w_over_v = case.helix_rad_s * math.exp(z[LN_FREQUENCY]) / (SPEED * math.exp(z[LN_SPEED]))
    c = math.cos(z[HEADING])
    s = math.sin(z[HEADING])
    tilt = math.atan(w_over_v * z[HELIX_COSINE])
    heading = z[HEADING] + z[MARKER_BIAS] + tilt
    return np.array([z[X] - s * z[HELIX_SINE], z[Y] + c * z[HELIX_SINE], heading])
