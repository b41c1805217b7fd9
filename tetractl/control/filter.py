"""Estimates the robots' poses and motion from the camera's frames and all directions sent.

**The model.** Each robot has a state that a Kalman filter follows from frame to frame: the position
(x, y) and the heading theta of its course, its turning rate a and speed v, a turn bias beta, a
marker bias m that is added to the measured heading, and the flow (f_x, f_y) that carries the robot,
or with which it slides. Under a direction u

    dx/dt = v cos theta + f_x,   dy/dt = v sin theta + f_y,   dtheta/dt = a sin(u + beta - theta).

A cell also swims on a helix of the angular frequency w, with a sideways swing of sine p and cosine
q. (Robots on wheels have none: p = q = 0.)

    dp/dt = w q,   dq/dt = -w p.

A camera measures, each with its noise,

    x - p sin theta,   y + p cos theta,   theta + m + atan(w q / v).

The state has the logarithms of a, v and w, and all parameters drift as random walks, so that old
measurements lose their weight. Robots may turn faster to one side, and motors of wheels may
saturate (`tetractl.model.motion.turn_rate`). If the lag T of the wheels is given, turning rate and
speed approach the commanded ones with the time constant T, and the direction acts on the heading
theta + T dtheta/dt, in which the robot would come to rest. The states are in
`kernels.filter_state`, and what is assumed of them in `body_model`.

**A hypothesis** is a state with its covariance, what the robot may be doing, and a weight. A robot
may not follow the latest direction: its hypotheses are that it does, that it follows one of the two
before, because later ones were lost, and that it is stuck and stands still. A pose that fits no
hypothesis is an outlier; after some time without a fit, all start from the camera's pose
(`kernels.filter`).

**A filter** has these hypotheses, and a dead time: the time from the sending of a direction to the
moment when it acts. Its score is the ln of the likelihood of the robot's frames.

**A bank** is the filters of a robot, one for each dead time of a grid, which is refined around
likely values. Most probably all robots have the same dead time, so that each robot's frames say
something of that of the others (`kernels.bank`). A cell has such a grid for each of some
frequencies w to start from: the filters of one frequency are a group.

**Frames** are used if they are 30 ms apart, and each control step's newest one: wheels whose lag is
not given respond over tens of milliseconds, and at shorter intervals the start of the response
would bias dead time and turning rate to smaller values.

**Misfit.** If the model is right, what a frame shows beyond the prediction, the innovation, is
independent of those before. Sums over blocks of frames test this, and standard deviations grow by
what they are found to be. While the model does not fit robots on wheels, the bank is opened again:
with another dead time, and, if the heading does not fit, with motors that saturate.

A prior without uncertainty identifies nothing: each frame's poses are taken as they are, and only
the prediction over the dead time remains.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tetractl.control.body_model import (
    SATURATION_DRIFT,
    SATURATION_STD,
    body_model,
    filter_model,
    first_std,
)
from tetractl.control.kernels.filter_state import (
    ASSUMED,
    GRID,
    LN_A,
    LN_SATURATION,
    STATES,
    Bank,
    NextFilters,
    Outlook,
    PoseFrames,
    SentCommands,
    SharedTimes,
    largest_square_sum,
)
from tetractl.control.prior import Prior
from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, FieldOff, Stop, Turn
from tetractl.core.plan import INNOVATIONS, Estimate
from tetractl.core.poses import Bools, Floats, Integers, Observation, Poses

SPACING_S = 0.03
"""Least time between two frames used [s]; docs/decisions/filter.md has errors with others."""
SATURATED = -3.0
"""ln of the probability of motors that saturate, at first: 5 %."""
HEADING_MISFIT = INNOVATIONS.index("heading")
"""Column of a misfit that is about the heading."""
REOPEN_STD_S = 0.05
"""Standard deviation of a dead time's change [s]."""
REOPEN_S = 4.0
"""Least time from the start of a trial, or from opening the bank again, to doing so again [s]."""


class Ahead(NamedTuple):
    """N robots at the moments when the next command acts on each."""

    poses: Poses
    bias: Floats
    """(N,) turn biases [rad]."""
    flow: Floats
    """(N, 2) [length unit/s]."""
    held: Floats
    """(N,) directions that the robots follow [rad], NaN for a robot that stands."""
    estimate: Estimate
    """What is known of the robots' motion."""


class RunningFilters(NamedTuple):
    """The filters that follow the robots, and what they say together."""

    bank: Bank
    shared: SharedTimes
    step_s: Floats
    """(N,) spacing of each robot's dead times [s]."""


class CommandRecord:
    """The directions and stops that were sent."""

    def __init__(self) -> None:
        self._room = np.empty((2, 64))
        self.all = SentCommands(*self._room[:, :0])
        """All of them, in the order of their times."""
        self.first_ns: int | None = None
        """The time at which the first one was sent [ns]."""
        self.turning = False
        """Whether robots have turned on the spot since the last direction."""

    def add(self, command: Command) -> None:
        """Add a direction or a stop."""
        if self.first_ns is None:
            self.first_ns = command.sent_ns
        if not isinstance(command.action, Stop):
            self.turning = isinstance(command.action, Turn)
        number = len(self.all.sent_s)
        if number == self._room.shape[1]:
            self._room = np.append(self._room, np.empty_like(self._room), axis=1)  # twice as much
        self._room[0, number] = command.sent_ns / SECOND
        self._room[1, number] = np.nan if command.direction is None else command.direction
        self.all = SentCommands(*self._room[:, : number + 1])


class FilterBank:
    """The filters that identify N robots during one trial.

    `sent` adds a command and `seen` adds frames, in the order in which they become known; a command
    counts from its time on. `ahead` says where the robots will be, and changes nothing: it can be
    called after the first frame, any number of times. `restart` is for robots that were replaced by
    others, after the frame in which they were seen first. A control step is

        filters.seen(newest, earlier)
            _spaced, _use   follow the robots through the frames, or start at a frame's poses
            _select         find how likely each filter is, drop and refine
            _reopen         where the model does not fit
        ahead = filters.ahead(now_ns)
        filters.sent(command)

    With `drive_first`, robots drive a square before the first plan, and the filters start when the
    first direction acts.
    """

    def __init__(self, prior: Prior, drive_first: bool = False) -> None:
        self.prior = prior
        self.body = body_model(prior)
        self.model = filter_model(prior, self.body)
        self.commands = CommandRecord()
        self.last: Observation | None = None
        """The last frame used."""
        self.reopened_ns = 0
        """Time at which the bank was opened again, 0 if it never was [ns]."""
        self._drive_first = drive_first
        self._noisy = False
        """Whether robots were measured at different poses before the first command."""
        first_step_s = np.full(len(prior.a), GRID.step_s)
        self._running = self._run(self._first_bank(), first_step_s)

    @property
    def bank(self) -> Bank:
        """The filters, B of each robot."""
        return self._running.bank

    @property
    def shared(self) -> SharedTimes:
        """What the filters say of the robots' dead times, after the last frame."""
        return self._running.shared

    @property
    def step_s(self) -> Floats:
        """(N,) spacing of each robot's dead times [s]."""
        return self._running.step_s

    def likeliest(self) -> tuple[Integers, Integers, Integers]:
        """Return the index of each robot's likeliest hypothesis in the bank: its filter, robot and
        slot, (N,) each."""
        robots = np.arange(len(self.prior.a))
        filters = self.shared.score.argmax(axis=0)
        slots = self.bank.weight[filters, robots].argmax(axis=1)
        return filters, robots, slots

    def sent(self, command: Command) -> None:
        """Add a direction or a stop with the time at which it was sent."""
        if isinstance(command.action, FieldOff):
            return
        self.commands.add(command)

    def seen(self, newest: Observation, earlier: Sequence[Observation] = ()) -> None:
        """Update the filters by those `earlier` frames that are at least SPACING_S apart, and by
        the `newest` frame."""
        misfits = self._misfits() if self._may_reopen(newest) else None  # as `ahead` said it last
        self._use(self._spaced(newest, earlier))
        if not self.prior.certain:
            self._select()
        if misfits is not None and misfits.any():
            self._reopen(newest, misfits[:, HEADING_MISFIT])

    def restart(self, robots: Sequence[int]) -> None:
        """Reset the filters of replaced robots to the new robots' poses in the last frame."""
        if not robots:
            return
        replaced = np.zeros(len(self.prior.a), dtype=np.bool_)
        replaced[robots] = True
        assert self.last is not None, "a robot can be replaced only after a frame"
        first = self._first_bank()
        size = max(len(self.bank.score), len(first.score))
        bank = self.bank.padded(size)
        for column, new in zip(bank, first.padded(size), strict=True):
            column[:, replaced] = new[:, replaced]
        step_s = np.where(replaced, GRID.step_s, self.step_s)
        self._running = self._run(bank, step_s)
        self._place(self.last, replaced)

    def ahead(self, sent_ns: int) -> Ahead:
        """Return the robots as each will be when a command sent at `sent_ns` [ns] acts on it."""
        from tetractl.control.kernels.bank import forecast

        assert self.last is not None, "poses are predicted from those of a frame"
        outlook = Outlook.empty(len(self.prior.a))
        dead_time_s, dead_time_std_s = forecast(
            self.bank,
            self.model,
            self.shared,
            self.commands.all,
            self.last.seconds,
            sent_ns / SECOND,
            outlook,
        )
        estimate = Estimate(
            a=outlook.a,
            a_std=outlook.a_std,
            speed=outlook.speed,
            speed_std=outlook.speed_std,
            heading_bias=outlook.heading_bias,
            heading_bias_std=outlook.heading_bias_std,
            dead_time=dead_time_s,
            dead_time_std=dead_time_std_s,
            misfit=outlook.misfit,
            side=outlook.side,
            side_std=outlook.side_std,
            saturation=outlook.saturation,
            stands=outlook.stands,
        )
        return Ahead(
            poses=Poses(outlook.x, outlook.y, outlook.heading),
            bias=outlook.turn_bias,
            flow=outlook.flow,
            held=outlook.held_direction,
            estimate=estimate,
        )

    def _may_reopen(self, newest: Observation) -> bool:
        """Return whether the bank is opened again if the model does not fit."""
        due_ns = self.reopened_ns + REOPEN_S * SECOND
        return bool(self.body.later_tried) and newest.sampled_ns >= due_ns

    def _misfits(self) -> Bools:
        """Return for each robot which of INNOVATIONS the model does not fit, (N, 3)."""
        robots = np.arange(len(self.prior.a))
        filters = self.shared.score.argmax(axis=0)
        blocks = np.maximum(self.bank.blocks[filters, robots], ASSUMED.least_blocks)
        limits = np.array([largest_square_sum(number) for number in blocks.tolist()])
        return self.bank.square_sum[filters, robots] > limits[:, None]

    def _spaced(self, newest: Observation, earlier: Sequence[Observation]) -> list[Observation]:
        """Return the frames that are far enough from those used before, in the order of time.

        The newest one needs no distance if others come with it. A prior without uncertainty uses
        all frames.
        """
        if self.prior.certain:
            return [*earlier, newest]
        used = list[Observation]()
        last = self.last
        for frame in (*earlier, newest):
            apart_ns = 1 if earlier and frame is newest else round(SPACING_S * SECOND)
            if last is None or frame.sampled_ns >= last.sampled_ns + apart_ns:
                used.append(frame)
                last = frame
        return used

    def _use(self, frames: Sequence[Observation]) -> None:
        """Follow the robots through some frames, from the last one used before on; or from the last
        one whose poses are taken as they are, which the first one of a trial is."""
        taken = [k for k, frame in enumerate(frames) if self._takes_poses(frame)]
        if self.last is None and not taken:
            taken = [0]
        if taken:
            frames = frames[taken[-1] :]
            self._place(frames[0], np.ones(len(self.prior.a), dtype=np.bool_))
        else:
            assert self.last is not None
            frames = [self.last, *frames]
        if len(frames) > 1:
            self._follow(frames)
        self.last = frames[-1]

    def _takes_poses(self, frame: Observation) -> bool:
        """Return whether a frame's poses are taken as they are: there is nothing to identify, or
        the filters cannot follow the robots yet, or robots turn on the spot."""
        if self.prior.certain or self.commands.turning:
            return True
        if not self._drive_first:
            return False
        if self.commands.first_ns is None:
            return True
        settled_s = self.prior.dead_time + GRID.reach * self.prior.dead_time_std
        return frame.sampled_ns < self.commands.first_ns + round(settled_s * SECOND)

    def _place(self, frame: Observation, placed: Bools) -> None:
        """Set the poses of the robots `placed` (N,) to those of a frame, and let them follow the
        last command that acts at or before the frame's exposure."""
        from tetractl.control.kernels.filter import place  # late: checking a spec needs no compiler

        poses = frame.poses.array()
        place(self.bank, self.model, self.commands.all, frame.seconds, poses, placed)

    def _follow(self, frames: Sequence[Observation]) -> None:
        """Follow the robots from the first to the last of some frames."""
        from tetractl.control.kernels.filter import follow

        measured = PoseFrames(
            time_s=np.array([frame.seconds for frame in frames]),
            poses=np.array([frame.poses.array() for frame in frames]),
            valid=np.array([frame.valid for frame in frames]),
        )
        if not len(self.commands.all.sent_s) and not self._noisy:
            moved = (measured.poses[1:] != measured.poses[:-1]).any(axis=(1, 2))
            seen = measured.valid[1:].any(axis=1)
            self._noisy = bool((moved & seen).any())
        step_s = float(self.step_s.max())
        follow(self.bank, self.model, self.commands.all, measured, self._noisy, step_s)

    def _select(self) -> None:
        """Drop filters that are unlikely, and refine each robot's grid around likely dead times."""
        from tetractl.control.kernels.bank import select, share

        bank, shared, step_s = self._running
        share(bank, shared, step_s)
        filters, robots = bank.score.shape
        going_on = NextFilters.empty(max(filters, 3 * self.body.groups_max), robots)
        commanded = len(self.commands.all.sent_s) > 0
        if not select(bank, shared, step_s, self.body.tried, commanded, going_on):
            return
        goes_on = going_on.rows >= 0
        number = goes_on.sum(axis=0)
        rows = np.minimum(np.arange(number.max())[:, None], number - 1)  # the last fills the rest
        chosen = bank.part(np.take_along_axis(going_on.rows, rows, axis=0))
        chosen.dead_time_s[:] = np.take_along_axis(going_on.dead_time_s, rows, axis=0)
        chosen.score[:] = np.take_along_axis(going_on.score, rows, axis=0)
        chosen.score[~goes_on[: len(rows)]] = -np.inf
        self._running = self._run(chosen, step_s)

    def _first_bank(self) -> Bank:
        """Return filters for the dead times of the prior, in the first groups."""
        dead_times_s = self._first_dead_times()
        values = self.body.first_tried
        group = np.repeat(np.arange(len(values)), len(dead_times_s))
        mean = np.zeros((len(group), len(self.prior.a), STATES))
        mean[..., self.body.tried] = np.array(values)[group, None]
        std = first_std(self.prior, self.body)
        return Bank.start(np.tile(dead_times_s, len(values)), mean, std, group)

    def _first_dead_times(self) -> Floats:
        """Return the dead times to start from [s]: a grid around that of the prior."""
        reach_s = GRID.reach * self.prior.dead_time_std
        least_s = max(0.0, self.prior.dead_time - reach_s)
        return np.arange(least_s, self.prior.dead_time + reach_s + 1e-9, GRID.step_s)

    def _reopen(self, frame: Observation, heading_misfits: Bools) -> None:
        """Open the bank again: with the first dead times, each in the state of the robot's
        likeliest filter, and, for robots whose heading does not fit, SATURATIONS of their motors.

        The dead time may have changed, and filters of others are gone by then. The likeliest one
        stays so until frames show otherwise; how well the model fits is tested again.
        """
        filters, robots, slots = self.likeliest()
        old = self.bank
        dead_times_s = self._first_dead_times()
        groups = 1 + len(self.body.later_tried)  # the first one tries no saturation
        group = np.repeat(np.arange(groups), len(dead_times_s))
        mean = np.repeat(old.state[filters, robots, slots][None], len(group), axis=0)
        std = first_std(self.prior, self.body)
        bank = Bank.start(np.tile(dead_times_s, groups), mean, std, group)
        bank.cov[:, :, 0] = old.cov[filters, robots, slots]
        bank.noise_scale[:] = old.noise_scale[filters, robots]
        later_s = bank.dead_time_s - old.dead_time_s[filters, robots]
        bank.score[:] = -((later_s / REOPEN_STD_S) ** 2) / 2
        for k, ln_saturation in enumerate(self.body.later_tried, 1):
            rows = group == k
            # the filter without a limit has explained the turns by a small a, and is sure of it
            self._forget(bank, rows, LN_A, std[:, LN_A])
            self._forget(bank, rows, LN_SATURATION, SATURATION_STD)
            bank.state[rows, :, :, LN_SATURATION] = ln_saturation
            bank.score[rows] += np.where(heading_misfits, SATURATED, -np.inf)
        self.model.walk[LN_SATURATION] = SATURATION_DRIFT
        self.reopened_ns = frame.sampled_ns
        self._running = self._run(bank, np.full(len(robots), GRID.step_s))
        self._place(frame, np.ones(len(robots), dtype=np.bool_))

    @staticmethod
    def _forget(bank: Bank, rows: Bools, state: int, std: Floats | float) -> None:
        """Let the filters `rows` (B,) know of a state no more than its deviation, (N,) or that of
        all."""
        cov = bank.cov[rows]
        cov[..., state, :] = 0.0
        cov[..., state] = 0.0
        cov[:, :, 0, state, state] = std**2
        bank.cov[rows] = cov

    def _run(self, bank: Bank, step_s: Floats) -> RunningFilters:
        """Return filters with what they say together; dead times are `step_s` (N,) apart [s].

        If a filter is right, the robot's dead time is that of the filter, give or take half a step;
        that of another robot is the same with the probability 1 - GRID.own, else it differs by
        GRID.own_s.
        """
        from tetractl.control.kernels.bank import share

        half_step_s = GRID.finest_s / 2
        times_s = np.arange(0, float(bank.dead_time_s.max()) + GRID.finest_s, half_step_s)
        gaps_s = times_s[:, None, None] - bank.dead_time_s
        width_s = np.maximum(step_s, GRID.finest_s) / 2
        near = (1 - GRID.own) * np.exp(-((gaps_s / width_s) ** 2) / 2) / width_s
        near += GRID.own * np.exp(-((gaps_s / GRID.own_s) ** 2) / 2) / GRID.own_s
        deviations = (times_s - self.prior.dead_time) / (self.prior.dead_time_std or 1.0)
        shared = SharedTimes(
            near=near,
            prior=-(deviations**2) / 2,
            scratch=np.empty((len(times_s), len(step_s))),
            score=bank.score.copy(),
            mean_s=bank.dead_time_s[0].copy(),
            std_s=np.zeros(len(step_s)),
        )
        if not self.prior.certain:
            share(bank, shared, step_s)
        return RunningFilters(bank, shared, step_s)


def warm_up(prior: Prior, starts: Poses) -> None:
    """Compile the functions of a filter bank, or load them from the cache."""
    filters = FilterBank(prior)
    valid = np.ones(len(prior.a), dtype=np.bool_)
    first = Observation(0, 0, 0, starts, valid)
    second_ns = round(SPACING_S * SECOND)
    second = Observation(1, second_ns, second_ns, starts, valid)
    filters.seen(first)
    filters.ahead(0)
    filters.seen(second)
    filters.ahead(second_ns)
