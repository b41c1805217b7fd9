"""Estimates the robots' poses and motion from the camera's frames and all directions sent.

Each robot i has a state that a Kalman filter follows from frame to frame: the position (x, y) and
the heading theta of its course, its turning rate a and speed v, a turn bias beta, a marker bias m
that is added to the measured heading, the flow (f_x, f_y) that carries the robot, or with which it
slides, and, for a cell that swims on a helix of angular frequency w, its sideways swing as sine p
and cosine q. Under a direction u

    dx/dt = v cos theta + f_x,  dy/dt = v sin theta + f_y,  dtheta/dt = a sin(u + beta - theta),
    dp/dt = w q,  dq/dt = -w p,

and a camera measures, each with its noise,

    x - p sin theta,  y + p cos theta,  theta + m + atan(w q / v).

The state has the logarithms of a, v and w, and all parameters drift as random walks, so that old
measurements lose their weight.

A robot may not follow the latest direction. Its hypotheses, each with a filter and a weight, are
that it follows the latest direction, that it follows one of the two directions before, because
later ones were lost, and that it is stuck and stands still. A pose that fits no hypothesis is an
outlier; after some time without a fit, the filter restarts from the camera's pose.

Each robot has a bank of filters, one for each dead time tau of a grid, from the sending of a
direction to the moment when it acts, weighted by its likelihood; the grid is refined around likely
values. Most probably all robots have the same dead time, so that each robot's frames tell that of
the others too (`_share`). For cells, the bank also has several frequencies w to start from. The
filter uses frames about 30 ms apart, and each control step's newest frame: wheels whose lag is not
given respond over tens of milliseconds, and at shorter intervals the start of the response would
bias dead time and turning rate to smaller values. If the lag T is given, turning rate and speed
approach the commanded ones with the time constant T, and the direction acts on the heading
theta + T dtheta/dt, in which the robot would come to rest.

If the model is right, what a frame shows beyond the prediction is independent of the frames before.
Sums over blocks of frames test this, and standard deviations grow by what they are found to be.

A prior without uncertainty identifies nothing: each frame's poses are taken as they are, and only
the prediction over the dead time remains.
"""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tetractl.control.kernels.filter_state import (
    BIAS,
    COSINE,
    FLOW_X,
    FLOW_Y,
    GRID,
    LN_A,
    LN_V,
    LN_W,
    MARKER,
    SINE,
    SIZE,
    STATE,
    Bank,
    FilterModel,
)
from tetractl.control.prior import Prior
from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, FieldOff, Stop, Turn
from tetractl.core.plan import Estimate
from tetractl.core.poses import Floats, Observation, Poses

Ints = NDArray[np.int64]

PITCHES = np.array([0.5, 0.75, 1.0, 1.4])
"""Frequencies of the helix to start from, over the usual one."""
KEPT_COMMANDS = 32  # least number of commands kept after they acted: filters may restart
SPACING_S = 0.03  # least time between two frames used [s]
LEAST_BLOCKS = 10  # number of blocks for which those that are missing count as empty
SURE = 3.09  # standard normal quantile of 0.999: a limit of chi-square is by Wilson and Hilferty


class Usual(NamedTuple):
    """The usual noise of a camera, and the random walks of a robot's states, per sqrt(s)."""

    position_noise_s: float = 0.005  # deviation of a measured position, over the speed [s]
    heading_noise: float = 0.01  # deviation of a measured heading [rad]
    slip: float = 0.02  # of the position, over the speed [s]
    walk: float = 0.1  # of the heading at first [rad]
    ln_a: float = 0.01
    ln_speed: float = 0.005
    turn_bias: float = 0.005
    marker_bias: float = 0.002
    flow: float = 0.05  # over its prior deviation
    helix: float = 0.1  # of the helix's sine and cosine, over its radius
    pitch: float = 0.01  # of ln of the helix's frequency
    pitch_std: float = 0.15  # prior deviation of ln of each of PITCHES


USUAL = Usual()


class Ahead(NamedTuple):
    """N robots at the moments when the next command acts on each: their poses, turning rates a,
    speeds and turn biases (N,), flow (N, 2), and the directions that they follow (N,) [rad], NaN
    for a robot that stands."""

    poses: Poses
    a: Floats
    speed: Floats
    bias: Floats
    flow: Floats
    held: Floats


class FilterBank:
    """The banks of filters that identify N robots during one trial.

    With `drive_first`, robots drive a square before the first plan, and the filters start when the
    first direction acts.
    """

    def __init__(self, prior: Prior, drive_first: bool = False) -> None:
        self.prior = prior
        count, helix = len(prior.a), prior.helix_radius > 0
        noise = np.empty((3, count))
        noise[:2] = prior.position_noise or USUAL.position_noise_s * np.maximum(prior.speed, 1e-9)
        noise[2] = prior.heading_noise or USUAL.heading_noise
        self._std, walk = np.zeros((2, SIZE, count))
        walk[:2], walk[2] = USUAL.slip * prior.speed, USUAL.walk
        for k, std, drift in (
            (LN_A, prior.a_std, USUAL.ln_a),
            (LN_V, prior.speed_std, USUAL.ln_speed),
            (BIAS, prior.heading_bias_std, USUAL.turn_bias),
            (MARKER, prior.marker_bias_std, USUAL.marker_bias),
            (FLOW_X, prior.flow_std, USUAL.flow * prior.flow_std),
            (FLOW_Y, prior.flow_std, USUAL.flow * prior.flow_std),
            (SINE, prior.helix_radius / math.sqrt(2), USUAL.helix * prior.helix_radius),
            (COSINE, prior.helix_radius / math.sqrt(2), USUAL.helix * prior.helix_radius),
            (LN_W, USUAL.pitch_std * helix, USUAL.pitch),
        ):
            self._std[k], walk[k] = std, drift * (std > 0)
        turns = 2 * math.pi * prior.helix_frequency * helix
        times = turns, prior.lag, prior.watchdog
        self._model = FilterModel(prior.a, prior.speed, noise, walk, *times)
        self._when, self._u = np.empty(0), np.empty(0)  # send times [s], directions [rad]
        self._last: Observation | None = None  # the last frame used
        # time at which the filters start [ns]; None if it depends on the first direction
        self._from_ns: int | None = None if drive_first else 0
        self._turning = False  # whether robots have turned on the spot since the last direction
        self._noisy = False  # whether standing robots were measured at different poses
        reach = GRID.reach * prior.dead_time_std
        low, high = max(0.0, prior.dead_time - reach), prior.dead_time + reach
        self._tau = np.arange(low, high + 1e-9, GRID.step_s)  # dead times to start from [s]
        self._steps = np.full(count, GRID.step_s)  # spacing of each robot's dead times [s]
        self._bank = self._first_bank()
        self._share()

    def _first_bank(self) -> Bank:
        tau, count = self._tau, len(self.prior.a)
        pitches = np.log(PITCHES) if self._model.helix > 0 else np.zeros(1)
        pitch = np.repeat(np.arange(len(pitches)), len(tau))
        mean = np.zeros((len(pitch), count, STATE))
        mean[..., LN_W] = pitches[pitch, None]
        return Bank.start(np.tile(tau, len(pitches)), mean, self._std.T, pitch)

    def sent(self, command: Command) -> None:
        """Add a direction or a stop with the time at which it was sent."""
        if isinstance(command.action, FieldOff):
            return
        if not isinstance(command.action, Stop):
            self._turning = isinstance(command.action, Turn)
        when = command.sent_ns / SECOND
        if self._from_ns is None:
            settled = self.prior.dead_time + GRID.reach * self.prior.dead_time_std
            self._from_ns = command.sent_ns + round(settled * SECOND)
        self._when = np.append(self._when, when)
        self._u = np.append(self._u, np.nan if command.direction is None else command.direction)
        done = int(self._bank.next.min()) - KEPT_COMMANDS
        if done > KEPT_COMMANDS:
            self._when, self._u = self._when[done:].copy(), self._u[done:].copy()
            self._bank.next[:] -= done

    def seen(self, observation: Observation, earlier: Sequence[Observation] = ()) -> None:
        """Update the filters by those `earlier` frames that are at least SPACING_S apart, and by
        the frame `observation`."""
        certain = self.prior.certain
        for frame in (*earlier, observation):
            least = 1 if earlier and frame is observation else round(SPACING_S * SECOND)
            if self._last and not certain and frame.sampled_ns < self._last.sampled_ns + least:
                continue
            since = None if self._turning or certain else self._from_ns
            if self._last is None or since is None or frame.sampled_ns < since:
                self._place(frame)
            else:
                self._follow(frame)
            self._last = frame
        if not certain:
            self._select()

    def restart(self, robots: Iterable[int]) -> None:
        """Reset the filters of replaced robots to the new robots' poses in the last frame."""
        if replaced := sorted(set(robots)):
            assert self._last is not None, "a robot can be replaced only after a frame"
            fresh, (count, all_robots) = self._first_bank(), self._bank.tau.shape
            rows = np.arange(max(count, len(fresh.tau)))[:, None].repeat(all_robots, axis=1)
            self._bank = self._bank.part(np.minimum(rows, count - 1))
            self._bank.score[count:] = -np.inf
            first = fresh.part(np.minimum(rows, len(fresh.tau) - 1))
            first.score[len(fresh.tau) :] = -np.inf
            for column, new in zip(self._bank, first, strict=True):
                column[:, replaced] = new[:, replaced]
            self._steps[replaced] = GRID.step_s
            self._place(self._last, replaced)
            self._share()

    def _place(self, frame: Observation, robots: Iterable[int] | None = None) -> None:
        """Set the poses to those of a frame, and let robots follow the last command that acts at
        or before the frame's exposure.
        """
        from tetractl.control.kernels.filter import place  # late: checking a spec needs no compiler

        bank, poses = self._bank, frame.poses.array()
        acting = np.searchsorted(self._when, frame.sampled_ns / SECOND - bank.tau, "right")
        for i in range(len(poses)) if robots is None else robots:
            for b in range(len(bank.tau)):
                place(bank, b, i, self._model, poses[i])
                if acting[b, i]:
                    bank.next[b, i] = acting[b, i]
                    bank.u[b, i] = self._u[acting[b, i] - 1]
                    stops = self._when[acting[b, i] - 1] + self._model.watchdog
                    bank.until[b, i] = stops + bank.tau[b, i]

    def _follow(self, frame: Observation) -> None:
        from tetractl.control.kernels.filter import follow

        assert self._last is not None
        last, now = self._last.poses.array(), frame.poses.array()
        same = (last == now).all(axis=1)
        if not len(self._when) and frame.valid.any() and not same.all():
            self._noisy = True
        frozen = len(same) > 1 and same.all()  # the camera has repeated its last frame
        # measurements with noise differ, so an equal pose is a repeated one
        seen = frame.valid & ~(same & (self._noisy | frozen))
        since, until = self._last.sampled_ns / SECOND, frame.sampled_ns / SECOND
        step = float(self._steps.max())
        commands = self._when, self._u
        follow(self._bank, self._model, step, since, until, *commands, now, seen)

    def _share(self) -> None:
        """Compute the ln of each filter's probability (B, N), up to a constant, by its own frames
        and by what those of the other robots tell of the common dead time."""
        bank, prior, finest = self._bank, self.prior, GRID.finest_s
        times = np.arange(0, float(bank.tau.max()) + finest, finest / 2)
        gaps, width = times[:, None, None] - bank.tau, np.maximum(self._steps, finest) / 2
        near = (1 - GRID.own) * np.exp(-((gaps / width) ** 2) / 2) / width
        near += GRID.own * np.exp(-((gaps / GRID.own_s) ** 2) / 2) / GRID.own_s
        ln = np.log((near * np.exp(bank.score)).sum(axis=1) + 1e-300)  # of each robot's frames
        every = ln.sum(axis=1)
        every -= ((times - prior.dead_time) / (prior.dead_time_std or 1.0)) ** 2 / 2
        others = every[:, None] - ln
        told = (near * np.exp(others - others.max(axis=0))[:, None]).sum(axis=0)
        self._score = bank.score + np.log(told + 1e-300)
        weight = np.exp(self._score - self._score.max(axis=0))
        weight /= weight.sum(axis=0)
        mean = (weight * bank.tau).sum(axis=0)
        spread = (weight * (bank.tau - mean) ** 2).sum(axis=0)
        self._dead_times = mean, np.sqrt(spread + (self._steps / 4) ** 2)

    def _select(self) -> None:
        """Drop filters that are unlikely, and refine each robot's grid around likely dead times."""
        from tetractl.control.kernels.bank import select

        self._share()
        size = max(len(self._bank.tau), 3 * len(PITCHES)), len(self.prior.a)
        which, tau, own = np.empty(size, np.int64), np.empty(size), np.empty(size)
        begun = self._when.size > 0
        if select(self._bank, self._score, self._steps, begun, which, tau, own):
            there, robots = which >= 0, np.arange(size[1])
            last = there.sum(axis=0) - 1
            rows = np.minimum(np.arange(last.max() + 1)[:, None], last)  # the last fills the rest
            self._bank = self._bank.part(which[rows, robots])
            self._bank.tau[:] = tau[rows, robots]
            self._bank.score[:] = np.where(there[: len(rows)], own[rows, robots], -np.inf)
            self._share()

    def dead_times(self) -> tuple[Floats, Floats]:
        """Return each robot's dead time and its standard deviation, (N,) each [s]."""
        if self.prior.certain:
            return self._bank.tau[0], np.zeros(len(self.prior.a))
        return self._dead_times

    def _likely(self) -> tuple[tuple[Ints, Ints], tuple[Ints, Ints, Ints]]:
        """Return the indices of each robot's likeliest filter, and of its likeliest hypothesis."""
        best = np.argmax(self._score, axis=0), np.arange(len(self.prior.a))
        return best, (*best, np.argmax(self._bank.weight[best], axis=1))

    def estimate(self) -> Estimate:
        """Return the parameters of the robots and their standard deviations, which grow by what the
        test of the innovations finds."""
        best, each = self._likely()
        z, cov = self._bank.state[each], self._bank.cov[each]
        blocks, squares = self._bank.white[best][:, 1, 3], self._bank.white[best][:, 1, :3]
        more = np.sqrt(np.maximum(1, squares / np.maximum(blocks, LEAST_BLOCKS)[:, None]))
        var = np.maximum(np.diagonal(cov, axis1=1, axis2=2), 0.0)
        std = np.sqrt(var) * more.max(axis=1)[:, None]
        a, speed = self.prior.a * np.exp(z[:, LN_A]), self.prior.speed * np.exp(z[:, LN_V])
        tau, tau_std = self.dead_times()
        of_bias = (cov[:, BIAS] + cov[:, MARKER])[:, [BIAS, MARKER]].sum(axis=1)
        part = 2 / (9 * np.maximum(blocks, LEAST_BLOCKS))
        limit = np.maximum(blocks, LEAST_BLOCKS) * (1 - part + SURE * np.sqrt(part)) ** 3
        return Estimate(
            a=a,
            a_std=a * std[:, LN_A],
            speed=speed,
            speed_std=speed * std[:, LN_V],
            heading_bias=z[:, BIAS] + z[:, MARKER],
            heading_bias_std=np.sqrt(np.maximum(of_bias, 0.0)) * more.max(axis=1),
            dead_time=float(tau.mean()),
            dead_time_std=math.sqrt(np.mean((tau_std * more.max(axis=1)) ** 2) + np.var(tau)),
            misfit=squares / limit[:, None],
        )

    def course(self) -> tuple[Poses, Floats, Floats]:
        """Return position and heading of each robot's course at the last frame, the turn biases
        (N,) [rad] and the flow (N, 2) [length unit/s]."""
        z = self._bank.state[self._likely()[1]]
        return Poses.of(z[:, :3]), z[:, BIAS], z[:, [FLOW_X, FLOW_Y]]

    def ahead(self, sent: int) -> Ahead:
        """Return the robots as each will be when a command sent at `sent` [ns] acts on it."""
        from tetractl.control.kernels import bank as kernel

        assert self._last is not None
        _, (best, _, slots) = self._likely()
        z, held = np.empty((len(best), STATE)), np.empty(len(best))
        begin, tau = self._last.sampled_ns / SECOND, self.dead_times()[0]
        moments = tau, begin, sent / SECOND
        commands = self._when, self._u
        kernel.ahead(self._bank, self._model, best, slots, *commands, *moments, z, held)
        a, speed = self.prior.a * np.exp(z[:, LN_A]), self.prior.speed * np.exp(z[:, LN_V])
        return Ahead(Poses.of(z[:, :3]), a, speed, z[:, BIAS], z[:, [FLOW_X, FLOW_Y]], held)


def warm_up(prior: Prior, starts: Poses) -> None:
    """Compile the functions of a filter bank, or load them from the cache."""
    bank, valid = FilterBank(prior), np.ones(len(prior.a), dtype=np.bool_)
    for k, now in enumerate((0, round(SPACING_S * SECOND))):
        bank.seen(Observation(k, now, now, starts, valid))
        bank.ahead(now)
