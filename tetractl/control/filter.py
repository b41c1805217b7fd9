"""Estimates the robots' poses and motion from the camera's frames and all directions sent.

**The model.** Each robot has a state that a Kalman filter follows from frame to frame: the position
(x, y) and the heading theta of its course, its turning rate a and speed v, a turn bias beta, a
marker bias m that is added to the measured heading, and the flow (f_x, f_y) that carries the robot,
or with which it slides. Under a direction u

    dx/dt = v cos theta + f_x,   dy/dt = v sin theta + f_y,   dtheta/dt = a sin(u + beta - theta).

A cell also swims on a helix of the angular frequency w, with a sideways swing of sine p and cosine
q. A robot on wheels has motors that may saturate, and may lag behind its commands.

    dp/dt = w q,   dq/dt = -w p.

A camera measures, each with its noise,

    x - p sin theta,   y + p cos theta,   theta + m + atan(w q / v).

The state has the logarithms of a, v and w, and all parameters drift as random walks, so that old
measurements lose their weight (`kernels.filter_state`; what is assumed: `body_model`). Every robot
turns with another a to the left than to the right (`tetractl.model.motion.turn_rate`). If the lag T
of the wheels is given, turning rate and speed approach the commanded ones with the time constant T,
and the direction acts on the heading theta + T dtheta/dt, in which the robot would come to rest.

**Hypotheses.** A robot may not follow the latest direction. Its hypotheses, each with a state, a
covariance and a weight, are that it follows the latest direction, that it follows one of the two
directions before, because later ones were lost, and that it is stuck and stands still. A pose that
fits no hypothesis is an outlier; after some time without a fit, the filter restarts from the
camera's pose (`kernels.filter`).

**Banks.** Each robot has a bank of filters, one for each dead time of a grid, from the sending of a
direction to the moment when it acts, weighted by its likelihood; the grid is refined around likely
values. Most probably all robots have the same dead time, so that each robot's frames tell that of
the others too (`kernels.bank`). For cells, the bank also has several frequencies w to start from.

**Frames.** The filter uses frames about 30 ms apart, and each control step's newest frame: wheels
whose lag is not given respond over tens of milliseconds, and at shorter intervals the start of the
response would bias dead time and turning rate to smaller values.

**Misfit.** If the model is right, what a frame shows beyond the prediction, the innovation, is
independent of those before. Sums over blocks of frames test this, and standard deviations grow by
what they are found to be. While the model does not fit robots on wheels, what it may be is laid out
again: another dead time, and, if the heading does not fit, motors that saturate.

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

COMMANDS_KEPT = 32
"""Least number of commands kept after they acted: robots that are placed follow one of them."""
SPACING_S = 0.03
"""Least time between two frames used [s]; docs/decisions/filter.md has errors with others."""
SATURATED = -3.0
"""ln of the probability of motors that saturate, at first: 5 %."""
HEADING_MISFIT = INNOVATIONS.index("heading")
"""Column of a misfit that is about the heading."""
REOPEN_STD_S = 0.05
"""Standard deviation of a dead time's change [s]."""
REOPEN_S = 4.0
"""Least time from laying out dead times to laying them out again [s]."""


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


class Laid(NamedTuple):
    """The filters that follow the robots, and room for what is computed of them."""

    bank: Bank
    shared: SharedTimes
    step_s: Floats
    """(N,) spacing of each robot's dead times [s]."""
    going_on: NextFilters


class CommandRecord:
    """The directions and stops that were sent, without those that acted long ago."""

    def __init__(self) -> None:
        self._room = np.empty((2, 3 * COMMANDS_KEPT))
        self.latest = SentCommands(*self._room[:, :0])
        """The commands kept, in the order of their times."""
        self.first_ns: int | None = None
        """The time at which the first one was sent [ns]."""
        self.turning = False
        """Whether robots have turned on the spot since the last direction."""

    @property
    def full(self) -> bool:
        """Whether there is no room for another command."""
        return len(self.latest.sent_s) == self._room.shape[1]

    def add(self, command: Command) -> None:
        """Add a direction or a stop."""
        if self.first_ns is None:
            self.first_ns = command.sent_ns
        if not isinstance(command.action, Stop):
            self.turning = isinstance(command.action, Turn)
        number = len(self.latest.sent_s)
        self._room[0, number] = command.sent_ns / SECOND
        self._room[1, number] = np.nan if command.direction is None else command.direction
        self.latest = SentCommands(*self._room[:, : number + 1])

    def make_room(self, acted: int) -> int:
        """Forget all but the last COMMANDS_KEPT of the `acted` commands, the first ones, or make
        room for more if there are none to forget; return how many were forgotten."""
        forgotten = max(0, acted - COMMANDS_KEPT)
        number = len(self.latest.sent_s)
        added = number if forgotten == 0 else forgotten
        self._room = np.append(self._room[:, forgotten:], np.empty((2, added)), axis=1)
        self.latest = SentCommands(*self._room[:, : number - forgotten])
        return forgotten


class FilterBank:
    """The banks of filters that identify N robots during one trial.

    `sent` adds a command and `seen` adds frames, in the order in which they become known; a command
    counts from its time on. `ahead` says where the robots will be, and changes nothing: it can be
    asked after the first frame, any number of times. `restart` is for robots that were replaced by
    others, after the frame in which they were seen first.

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
        self.laid_out_ns = 0
        """Time at which dead times were laid out again, for robots that the model did not fit; 0 if
        they never were [ns]."""
        self._drive_first = drive_first
        self._noisy = False
        """Whether robots were measured at different poses before the first command."""
        self._laid = self._lay_out(self._first_bank(), np.full(len(prior.a), GRID.step_s))

    @property
    def bank(self) -> Bank:
        """The filters, B of each robot."""
        return self._laid.bank

    @property
    def shared(self) -> SharedTimes:
        """What the filters say of the robots' dead times, after the last frame."""
        return self._laid.shared

    @property
    def step_s(self) -> Floats:
        """(N,) spacing of each robot's dead times [s]."""
        return self._laid.step_s

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
        if self.commands.full:
            self.bank.coming[:] -= self.commands.make_room(int(self.bank.coming.min()))
        self.commands.add(command)

    def seen(self, newest: Observation, earlier: Sequence[Observation] = ()) -> None:
        """Update the filters by those `earlier` frames that are at least SPACING_S apart, and by
        the `newest` frame; then lay other filters out where the present ones do not fit."""
        misfits = self._misfits() if self._may_lay_out_again(newest) else None
        frames = self._spaced(newest, earlier)
        starts = [k for k, frame in enumerate(frames) if self._starts_at(frame, k)]
        if starts:
            frames = frames[starts[-1] :]
            self._place(frames[0], np.ones(len(self.prior.a), dtype=np.bool_))
        elif self.last is not None:
            frames = [self.last, *frames]
        if len(frames) > 1:
            self._follow(frames)
        self.last = frames[-1]
        if not self.prior.certain:
            self._select()
        if misfits is not None and misfits.any():
            self._lay_out_again(newest, misfits[:, HEADING_MISFIT])

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
        self._laid = self._lay_out(bank, step_s)
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
            self.commands.latest,
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

    def _starts_at(self, frame: Observation, k: int) -> bool:
        """Return whether the filters take the poses of frame k of those used as they are: it is the
        first one of the trial, or robots are not followed yet, or turn on the spot."""
        if (self.last is None and k == 0) or self.prior.certain or self.commands.turning:
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
        place(self.bank, self.model, self.commands.latest, frame.seconds, poses, placed)

    def _follow(self, frames: Sequence[Observation]) -> None:
        """Follow the robots from the first to the last of some frames."""
        from tetractl.control.kernels.filter import follow

        measured = PoseFrames(
            time_s=np.array([frame.seconds for frame in frames]),
            poses=np.array([frame.poses.array() for frame in frames]),
            valid=np.array([frame.valid for frame in frames]),
        )
        if not len(self.commands.latest.sent_s) and not self._noisy:
            moved = (measured.poses[1:] != measured.poses[:-1]).any(axis=(1, 2))
            seen = measured.valid[1:].any(axis=1)
            self._noisy = bool((moved & seen).any())
        step_s = float(self.step_s.max())
        follow(self.bank, self.model, self.commands.latest, measured, self._noisy, step_s)

    def _select(self) -> None:
        """Drop filters that are unlikely, and refine each robot's grid around likely dead times."""
        from tetractl.control.kernels.bank import select, share

        bank, shared, step_s, going_on = self._laid
        share(bank, shared, step_s)
        commanded = len(self.commands.latest.sent_s) > 0
        if not select(bank, shared, step_s, self.body.tried, commanded, going_on):
            return
        goes_on = going_on.rows >= 0
        number = goes_on.sum(axis=0)
        rows = np.minimum(np.arange(number.max())[:, None], number - 1)  # the last fills the rest
        robots = np.arange(rows.shape[1])
        chosen = bank.part(going_on.rows[rows, robots])
        chosen.dead_time_s[:] = going_on.dead_time_s[rows, robots]
        chosen.score[:] = going_on.score[rows, robots]
        chosen.score[~goes_on[: len(rows)]] = -np.inf
        self._laid = self._lay_out(chosen, step_s)

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

    def _may_lay_out_again(self, newest: Observation) -> bool:
        """Return whether other filters are laid out if the present ones do not fit."""
        due_ns = self.laid_out_ns + REOPEN_S * SECOND
        return bool(self.body.later_tried) and newest.sampled_ns >= due_ns

    def _lay_out_again(self, frame: Observation, heading_misfits: Bools) -> None:
        """Lay out the first dead times again, each in the state of the robot's likeliest filter,
        and, for robots whose heading does not fit, SATURATIONS of their motors.

        The dead time may have changed, and the others are gone by then. The likeliest one stays so
        until frames show otherwise; how well the model fits is tested again.
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
        self.laid_out_ns = frame.sampled_ns
        self._laid = self._lay_out(bank, np.full(len(robots), GRID.step_s))
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

    def _lay_out(self, bank: Bank, step_s: Floats) -> Laid:
        """Return filters with what they say of the robots' dead times, which are `step_s` (N,)
        apart [s].

        A robot's dead time is that of a filter up to half of the step; that of another robot is
        the same with the probability 1 - GRID.own, else it differs by GRID.own_s.
        """
        from tetractl.control.kernels.bank import share

        filters, robots = bank.score.shape
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
            scratch=np.empty((len(times_s), robots)),
            score=bank.score.copy(),
            mean_s=bank.dead_time_s[0].copy(),
            std_s=np.zeros(robots),
        )
        size = max(filters, 3 * self.body.groups_max)
        going_on = NextFilters(
            rows=np.empty((size, robots), np.int64),
            dead_time_s=np.empty((size, robots)),
            score=np.empty((size, robots)),
        )
        if not self.prior.certain:
            share(bank, shared, step_s)
        return Laid(bank, shared, step_s, going_on)


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
