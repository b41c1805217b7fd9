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
measurements lose their weight. Robots on wheels have no helix, but a `side` and a `saturation`, by
which they turn with another a than (3) says (`tetractl.model.motion.turn_rate`).

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
While the model does not fit robots on wheels, what it may be is laid out again: another dead time,
and, if the heading does not fit, motors that saturate.

A prior without uncertainty identifies nothing: each frame's poses are taken as they are, and only
the prediction over the dead time remains.
"""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from tetractl.control.kernels import filter_state as at
from tetractl.control.kernels.filter_state import (
    DRIFT,
    FOUND,
    GRID,
    MISFIT,
    STANDS,
    TURNS,
    Bank,
    FilterModel,
    Shared,
)
from tetractl.control.prior import Prior
from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, FieldOff, Stop, Turn
from tetractl.core.plan import INNOVATIONS, Estimate
from tetractl.core.poses import Bools, Floats, Observation, Poses
from tetractl.model.motion.motion import PARAMETERS, in_rows
from tetractl.model.motion.turn_rate import TURNING

PITCHES = np.array([0.5, 0.75, 1.0, 1.4])
"""Frequencies of the helix to start from, over the usual one."""
KEPT_COMMANDS = 32  # least number of commands kept after they acted: filters may restart
SPACING_S = 0.03  # least time between two frames used [s]
SATURATIONS = 0.8, 0.4
"""Saturations of motors to try where the heading does not fit."""
SATURATION_STD = 0.3  # prior standard deviation of ln of each of them
SATURATED = -3.0  # ln of the probability of motors that saturate, at first
REOPEN_STD_S = 0.05  # standard deviation of a dead time's change [s]
REOPEN_S = 4.0  # least time from laying out dead times to laying them out again [s]


class Usual(NamedTuple):
    """The usual noise of a camera, and the random walks of a robot's states, per sqrt(s)."""

    position_noise_s: float = 0.005  # deviation of a measured position, over the speed [s]
    heading_noise: float = 0.01  # deviation of a measured heading [rad]
    slip: float = 0.02  # of the position, over the speed [s]
    walk: float = 0.1  # of the heading at first [rad]
    turn_bias: float = 0.005
    marker_bias: float = 0.002
    flow: float = 0.05  # over its prior deviation
    helix: float = 0.1  # of the helix's sine and cosine, over its radius
    pitch: float = 0.01  # of ln of the helix's frequency
    pitch_std: float = 0.15  # prior deviation of ln of each of PITCHES


USUAL = Usual()


class Ahead(NamedTuple):
    """N robots at the moments when the next command acts on each: their poses, turn biases (N,),
    flow (N, 2), and the directions `held` (N,) [rad] that they follow, NaN for a robot that stands;
    and what is `known` of them."""

    poses: Poses
    bias: Floats
    flow: Floats
    held: Floats
    known: Estimate


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
        noise = np.hypot(noise, np.array([prior.spread]).T)
        self._std, walk = np.zeros((2, at.SIZE, count))
        walk[:2], walk[2] = USUAL.slip * prior.speed, USUAL.walk
        parameters, (side, saturation) = enumerate(PARAMETERS), TURNING
        for k, std, drift in (
            *((at.LN_A + k, getattr(prior, f"{p.name}_std"), p.drift) for k, p in parameters),
            (at.BIAS, prior.heading_bias_std, USUAL.turn_bias),
            (at.MARKER, prior.marker_bias_std, USUAL.marker_bias),
            (at.FLOW_X, prior.flow_std, USUAL.flow * prior.flow_std),
            (at.FLOW_Y, prior.flow_std, USUAL.flow * prior.flow_std),
            (at.SINE, prior.helix_radius / math.sqrt(2), USUAL.helix * prior.helix_radius),
            (at.COSINE, prior.helix_radius / math.sqrt(2), USUAL.helix * prior.helix_radius),
            (at.SIDE, prior.side_std, side.drift),
            (at.LN_W, USUAL.pitch_std * helix, USUAL.pitch if helix else saturation.drift),
        ):
            self._std[k], walk[k] = std, drift * (std > 0)
        turns = 2 * math.pi * prior.helix_frequency * helix
        self._model = FilterModel(
            parameters=in_rows(prior),
            noise=noise,
            walk=walk,
            helix=turns,
            lag=prior.lag,
            watchdog=prior.watchdog,
            sticks=prior.sticks,
            coarse=prior.coarse,
        )
        self._sent = np.empty((2, 3 * KEPT_COMMANDS))  # send times [s], and directions [rad]
        self._when, self._u = self._sent[:, :0]
        self._last: Observation | None = None  # the last frame used
        self._all = np.ones(count, dtype=np.bool_)
        # those of the last frame used and of the new ones
        self._poses, self._seen = np.empty((1, count, 3)), np.empty((1, count), dtype=np.bool_)
        # time at which the filters start [ns]; None if it depends on the first direction
        self._from_ns: int | None = None if drive_first else 0
        self._turning = False  # whether robots have turned on the spot since the last direction
        self._noisy = False  # whether standing robots were measured at different poses
        reach = GRID.reach * prior.dead_time_std
        low, high = max(0.0, prior.dead_time - reach), prior.dead_time + reach
        self._tau = np.arange(low, high + 1e-9, GRID.step_s)  # dead times to start from [s]
        self._steps = np.full(count, GRID.step_s)  # spacing of each robot's dead times [s]
        self._misfit, self._laid_out_ns = np.zeros((3, count)), 0
        self._lay_out(self._first_bank())

    def _first_bank(self) -> Bank:
        tau, count = self._tau, len(self.prior.a)
        pitches = np.log(PITCHES) if self._model.helix > 0 else np.zeros(1)
        pitch = np.repeat(np.arange(len(pitches)), len(tau))
        mean = np.zeros((len(pitch), count, at.STATE))
        mean[..., at.LN_W] = pitches[pitch, None]
        return Bank.start(np.tile(tau, len(pitches)), mean, self._std.T, pitch)

    def _lay_out(self, bank: Bank) -> None:
        """Go on with other filters, and lay out what robots tell each other of these."""
        self._bank, prior, finest = bank, self.prior, GRID.finest_s
        size = max(len(bank.tau), 3 * max(len(PITCHES), 1 + len(SATURATIONS))), len(prior.a)
        self._chosen = np.empty(size, np.int64), np.empty(size), np.empty(size)
        times = np.arange(0, float(bank.tau.max()) + finest, finest / 2)
        gaps, width = times[:, None, None] - bank.tau, np.maximum(self._steps, finest) / 2
        near = (1 - GRID.own) * np.exp(-((gaps / width) ** 2) / 2) / width
        near += GRID.own * np.exp(-((gaps / GRID.own_s) ** 2) / 2) / GRID.own_s
        of_time = -(((times - prior.dead_time) / (prior.dead_time_std or 1.0)) ** 2) / 2
        dead_times = np.array([bank.tau[0], np.zeros(size[1])])
        room = np.empty((len(times), size[1]))
        self._shared = Shared(near, of_time, room, bank.score.copy(), dead_times)
        self._step = float(self._steps.max())
        self._select(changes=False)

    def sent(self, command: Command) -> None:
        """Add a direction or a stop with the time at which it was sent."""
        if isinstance(command.action, FieldOff):
            return
        if not isinstance(command.action, Stop):
            self._turning = isinstance(command.action, Turn)
        if self._from_ns is None:
            settled = self.prior.dead_time + GRID.reach * self.prior.dead_time_std
            self._from_ns = command.sent_ns + round(settled * SECOND)
        count = len(self._when)
        if count == self._sent.shape[1]:
            done = max(0, int(self._bank.next.min()) - KEPT_COMMANDS)
            self._sent = np.append(self._sent[:, done:], np.empty((2, done or count)), axis=1)
            self._bank.next[:] -= done
            count -= done
        direction = command.direction
        self._sent[:, count] = command.sent_ns / SECOND, np.nan if direction is None else direction
        self._when, self._u = self._sent[:, : count + 1]

    def seen(self, observation: Observation, earlier: Sequence[Observation] = ()) -> None:
        """Update the filters by those `earlier` frames that are at least SPACING_S apart, and by
        the frame `observation`."""
        certain, last, frames = self.prior.certain, self._last, list[Observation]()
        since = None if self._turning or certain else self._from_ns
        placed = False
        for frame in (*earlier, observation):
            least = 1 if earlier and frame is observation else round(SPACING_S * SECOND)
            if last and not certain and frame.sampled_ns < last.sampled_ns + least:
                continue
            if last is None or since is None or frame.sampled_ns < since:
                placed = True
                frames.clear()  # of what came before nothing is left
            frames.append(frame)
            last = frame
        if placed:
            self._place(frames[0], self._all)
        elif self._last:
            frames.insert(0, self._last)
        if len(frames) > 1:
            self._follow(frames)
        self._last = last
        self._select()
        due = observation.sampled_ns >= self._laid_out_ns + REOPEN_S * SECOND
        unfit = (self._misfit > 1).any() and not self._model.helix  # cells turn by themselves
        if due and unfit:
            self._reopen(observation)

    def restart(self, robots: Iterable[int]) -> None:
        """Reset the filters of replaced robots to the new robots' poses in the last frame."""
        if replaced := sorted({*robots}):
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
            self._place(self._last, np.isin(np.arange(all_robots), replaced))
            self._lay_out(self._bank)

    def _reopen(self, frame: Observation) -> None:
        """Lay out the first dead times again, each in the state of the robot's likeliest filter,
        and, for robots whose heading does not fit, SATURATIONS of their motors.

        The dead time may have changed, and the others are gone by then. The likeliest one stays so
        until frames tell otherwise; how well the model fits is tested again.
        """
        old, robots = self._bank, np.arange(len(self.prior.a))
        best = self._shared.score.argmax(axis=0)
        chosen = best, robots, old.weight[best, robots].argmax(axis=1)
        tried, times = [None, *np.log(SATURATIONS)], len(self._tau)
        group = np.repeat(np.arange(len(tried)), times)
        mean = np.repeat(old.state[chosen][None], len(group), axis=0)
        bank = Bank.start(np.tile(self._tau, len(tried)), mean, self._std.T, group)
        bank.cov[:, :, 0], bank.scale[:] = old.cov[chosen], old.scale[best, robots]
        bank.score[:] = -(((bank.tau - old.tau[best, robots]) / REOPEN_STD_S) ** 2) / 2
        turns = self._misfit[INNOVATIONS.index("heading")] > 1
        for k, of in enumerate(tried[1:], 1):
            rows = group == k
            cov = bank.cov[rows]
            # the filter without a limit has explained the turns by a small a, and is sure of it
            for state, std in ((at.LN_A, self._std[at.LN_A]), (at.LN_W, SATURATION_STD)):
                cov[..., state, :] = 0.0
                cov[..., state] = 0.0
                cov[:, :, 0, state, state] = std**2
            bank.cov[rows] = cov
            bank.state[rows, :, :, at.LN_W] = of
            bank.score[rows] += np.where(turns, SATURATED, -np.inf)
        self._model.walk[at.LN_W] = TURNING[1].drift
        self._bank, self._steps[:], self._misfit = bank, GRID.step_s, 0 * self._misfit
        self._laid_out_ns = frame.sampled_ns
        self._place(frame, self._all)
        self._lay_out(bank)

    def _place(self, frame: Observation, robots: Bools) -> None:
        """Set the poses of some `robots` (N,) to those of a frame, and let them follow the last
        command that acts at or before the frame's exposure.
        """
        from tetractl.control.kernels.filter import place  # late: checking a spec needs no compiler

        given = self._when, self._u, frame.seconds, frame.poses.array(), robots
        place(self._bank, self._model, *given)

    def _follow(self, frames: Sequence[Observation]) -> None:
        """Follow the robots from the first to the last of some frames."""
        from tetractl.control.kernels.filter import follow

        if len(frames) > len(self._poses):
            self._poses = np.empty((len(frames), *self._poses.shape[1:]))
            self._seen = np.empty(self._poses.shape[:2], dtype=np.bool_)
        poses, seen = self._poses[: len(frames)], self._seen[: len(frames)]
        for pose, valid, frame in zip(poses, seen, frames, strict=True):
            pose[:, 0], pose[:, 1], pose[:, 2] = frame.poses.x, frame.poses.y, frame.poses.heading
            valid[:] = frame.valid
        if not len(self._when):
            moved = (poses[1:] != poses[:-1]).any(axis=(1, 2))
            self._noisy |= bool((moved & seen[1:].any(axis=1)).any())
        time = np.array([frame.seconds for frame in frames])
        given = self._when, self._u, time, poses, seen, self._noisy
        follow(self._bank, self._model, self._step, *given)

    def _select(self, changes: bool = True) -> None:
        """Compute how likely filters are; if the bank `changes`, drop filters that are unlikely,
        and refine each robot's grid around likely dead times."""
        from tetractl.control.kernels.bank import select

        if self.prior.certain:
            return
        begun, (which, tau, own) = len(self._when) > 0, self._chosen
        if select(self._bank, self._shared, self._steps, begun, changes, which, tau, own):
            there, robots = which >= 0, np.arange(which.shape[1])
            last = there.sum(axis=0) - 1
            rows = np.minimum(np.arange(last.max() + 1)[:, None], last)  # the last fills the rest
            bank = self._bank.part(which[rows, robots])
            bank.tau[:] = tau[rows, robots]
            bank.score[:] = np.where(there[: len(rows)], own[rows, robots], -np.inf)
            self._lay_out(bank)

    def ahead(self, sent: int) -> Ahead:
        """Return the robots as each will be when a command sent at `sent` [ns] acts on it."""
        from tetractl.control.kernels.bank import forecast

        assert self._last is not None
        found = np.empty((FOUND, len(self.prior.a)))
        given = self._when, self._u, self._last.seconds, sent / SECOND
        dead_time, std = forecast(self._bank, self._model, self._shared, *given, found)
        x, y, heading, *motion, turn, held = found[: DRIFT.start]
        self._misfit = found[MISFIT]
        side, side_std, saturation = found[TURNS]
        more = {"dead_time": dead_time, "dead_time_std": std, "misfit": found[MISFIT].T}
        more |= {"side": side, "side_std": side_std, "saturation": saturation}
        more |= {"stands": found[STANDS]}
        known = Estimate(*motion, **more)
        return Ahead(Poses(x, y, heading), turn, found[DRIFT].T, held, known)


def warm_up(prior: Prior, starts: Poses) -> None:
    """Compile the functions of a filter bank, or load them from the cache."""
    bank, valid = FilterBank(prior), np.ones(len(prior.a), dtype=np.bool_)
    for k, now in enumerate((0, round(SPACING_S * SECOND))):
        bank.seen(Observation(k, now, now, starts, valid))
        bank.ahead(now)
