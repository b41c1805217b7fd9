"""Estimates the robots' poses and motion from the camera's frames and all directions sent.

A controller calls this once a control step, with what has become known since the last one, and asks
where the robots will be when its next command acts:

    filters.add_frames(newest, earlier)
    forecast = filters.forecast(now_ns)
    filters.add_command(command)

**State.** Each robot has a state that a Kalman filter follows from frame to frame: the position
(x, y) and the heading theta in which it travels, its turning rate a and speed v, a turn bias beta,
a marker bias m that is added to the measured heading, and the flow (f_x, f_y) that carries the
robot, or with which it slides. Under a direction u

    dx/dt = v cos theta + f_x,   dy/dt = v sin theta + f_y,   dtheta/dt = a sin(u + beta - theta).

A cell also swims on a helix of the angular frequency w, with a sideways swing of sine p and cosine
q. (Robots on wheels have none: p = q = 0.)

    dp/dt = w q,   dq/dt = -w p.

A camera measures, each with its noise,

    x - p sin theta,   y + p cos theta,   theta + m + atan(w q / v).

The filter has ln a, ln v and ln w, and all parameters drift as random walks, so that old
measurements lose their weight. Robots may turn faster to one side, and motors of wheels may
saturate: they turn no faster than at some rate (`tetractl.model.motion.turn_rate`). If the lag T of
the wheels is given, turning rate and speed approach the commanded ones with the time constant T,
and the direction acts on the heading theta + T dtheta/dt, in which the robot would come to rest.

**Hypothesis, filter, bank.** One Kalman filter is not enough, as it is not known what robots do:

    hypothesis  a state with its covariance, the direction that the robot follows, and how likely
                this is: a robot follows the last command, or one of the two before, because it
                missed the later ones, or it is stuck and stands (`kernels.filter`)
    filter      the hypotheses of one robot for one *dead time*, from the sending of a command to
                the moment when it acts. Its score is the ln of the likelihood of the robot's frames
    group       the filters of one robot for a grid of dead times; for what cannot be found from
                any start, such as the frequency of a helix, there is one group for each of some
                values to start from (`bank_start`)
    bank        all filters of all robots

Most probably all robots have the same dead time, so that each robot's frames say something of that
of the others. By all of them, filters that are unlikely end, and the grid is refined around those
that are likely (`kernels.bank`). A *forecast* is by each robot's likeliest hypothesis.

**What happens next, if**

    a pose jumps                  it is an outlier beyond the gate: hypotheses are predicted on
                                  without it; if none fits for ASSUMED.lost_track_s, the robot is
                                  placed at the camera's pose
    a frame is missing            robots are predicted on to the next one
    a command is missed           a hypothesis that follows the command before becomes the likeliest
    a robot sticks                the stuck hypothesis becomes the likeliest
    the camera freezes            its frames are not used
    the model does not fit        standard deviations grow; the bank of wheels is opened again
    a robot is replaced           `restart`: it begins with first filters

**Frames** are used if they are 30 ms apart, and each control step's newest one: wheels whose lag is
not given respond over tens of milliseconds, and at shorter intervals the start of the response
would bias dead time and turning rate to smaller values.

**Misfit.** If the model is right, what a frame shows beyond the prediction, the *innovation*, is
independent of those before. Sums over blocks of frames test this, and standard deviations grow by
what they are found to be. While the model does not fit robots on wheels, the bank is *opened
again*: their dead time may have changed, so that its filter is gone, and if it is the heading that
does not fit, their motors may saturate.

A prior without uncertainty identifies nothing: each frame's poses are taken as they are, and only
the prediction over the dead time remains.

Units are seconds, radians and the spec's length unit; N is the number of robots. What is assumed of
robots and camera is in `body_model`, and the arrays are in `kernels.filter_state`.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tetractl.control.bank_start import bank_with_replaced, first_bank, reopened_bank
from tetractl.control.body_model import body_model, filter_model, with_saturation
from tetractl.control.kernels.filter_state import (
    ASSUMED,
    GRID,
    Bank,
    CommonTimes,
    NextFilters,
    Outlook,
    PoseFrames,
    SentCommands,
    SharedScores,
    largest_square_sum,
)
from tetractl.control.prior import Prior
from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, FieldOff, Stop, Turn
from tetractl.core.plan import INNOVATIONS, Estimate
from tetractl.core.poses import Bools, Floats, Integers, Observation, Poses

SPACING_S = 0.03
"""Least time between two frames used [s]; docs/decisions/filter.md has errors with others."""
REOPEN_S = 4.0
"""Least time from the start of a trial, or from opening the bank again, to doing so again [s]:
until then too few blocks of frames test the model. Chosen, not measured."""
HEADING_MISFIT = INNOVATIONS.index("heading")
"""Column of a misfit that is about the heading."""
COMMANDS_AT_FIRST = 64
"""Number of commands for which there is room; it is doubled when they are more."""


class Forecast(NamedTuple):
    """What N robots do at the moment when the next command acts on each, if it does nothing else
    before than what it was sent."""

    poses: Poses
    turn_bias: Floats
    """(N,) difference of the directions that robots turn to from those sent [rad]."""
    flow: Floats
    """(N, 2) [length unit/s]."""
    directions: Floats
    """(N,) directions that the robots follow [rad], NaN for a robot that stands."""
    estimate: Estimate
    """What is known of the robots' motion."""


class RunningFilters(NamedTuple):
    """A bank, and what fits only this bank."""

    bank: Bank
    step_s: Floats
    """(N,) how far each robot's dead times are apart [s]."""
    common: CommonTimes
    """Dead times that its robots may have in common."""
    shared: SharedScores
    """What its filters say together, after the last frame."""


class CommandRecord:
    """The directions and stops that were sent."""

    def __init__(self) -> None:
        self._sent_s = np.empty(COMMANDS_AT_FIRST)
        self._directions = np.empty(COMMANDS_AT_FIRST)
        self.number = 0
        """How many there are."""
        self.first_ns: int | None = None
        """The time at which the first one was sent [ns]."""
        self.turning = False
        """Whether robots were sent to turn on the spot since the last direction."""

    @property
    def all(self) -> SentCommands:
        """All of them, in the order of their times."""
        return SentCommands(self._sent_s[: self.number], self._directions[: self.number])

    def add(self, command: Command) -> None:
        """Add a direction or a stop."""
        if self.first_ns is None:
            self.first_ns = command.sent_ns
        if not isinstance(command.action, Stop):
            self.turning = isinstance(command.action, Turn)
        if self.number == len(self._sent_s):
            self._sent_s = np.append(self._sent_s, np.empty_like(self._sent_s))
            self._directions = np.append(self._directions, np.empty_like(self._directions))
        self._sent_s[self.number] = command.sent_ns / SECOND
        self._directions[self.number] = np.nan if command.direction is None else command.direction
        self.number += 1


class FilterBank:
    """The filters that identify N robots during one trial.

    `add_frames` and `add_command` are called in the order in which frames and commands become
    known; a command counts from its own time on. `forecast` changes nothing: it can be called after
    the first frame, any number of times. `restart` is for robots that were replaced by others,
    after the frames in which these are seen first.

    With `drive_first`, robots drive a square before the first plan, and the filters start when the
    first direction acts.
    """

    def __init__(self, prior: Prior, drive_first: bool = False) -> None:
        self.prior = prior
        self.body = body_model(prior)
        self.model = filter_model(prior, self.body)
        self.commands = CommandRecord()
        self.last_frame: Observation | None = None
        """The last frame used: the filters are at its time."""
        self.reopened_ns = 0
        """Time at which the bank was opened again, 0 if it never was [ns]."""
        self._drive_first = drive_first
        self._noisy = False
        """Whether robots that were not sent anything were measured at different poses."""
        self._running = self._running_filters(first_bank(prior, self.body), self._first_steps())

    @property
    def bank(self) -> Bank:
        """The filters, B of each robot."""
        return self._running.bank

    @property
    def shared(self) -> SharedScores:
        """What the filters say of the robots' dead times, after the last frame."""
        return self._running.shared

    @property
    def step_s(self) -> Floats:
        """(N,) how far each robot's dead times are apart [s]."""
        return self._running.step_s

    def likeliest(self) -> tuple[Integers, Integers, Integers]:
        """Return the index of each robot's likeliest hypothesis in arrays of the bank: its filter,
        robot and slot, (N,) each."""
        filters = self._likeliest_filters()
        robots = np.arange(len(self.prior.a))
        slots = self.bank.ln_weight[filters, robots].argmax(axis=1)
        return filters, robots, slots

    # ---- what becomes known ----

    def add_command(self, command: Command) -> None:
        """Add a command with the time at which it was sent."""
        if isinstance(command.action, FieldOff):
            return  # it turns no robot
        self.commands.add(command)

    def add_frames(self, newest: Observation, earlier: Sequence[Observation] = ()) -> None:
        """Bring the filters to the `newest` frame of a control step, by way of the `earlier` frames
        since the newest of the step before.

        Whether the bank is opened again is decided by the misfit that the last forecast reported,
        before these frames.
        """
        misfits = self._misfits()
        self._follow_frames(self._frames_used(newest, earlier))
        if not self.prior.certain:
            self._running = self._with_shared_scores(self._running)
            self._running = self._with_likely_filters(self._running)
        if misfits.any() and self._may_reopen(newest):
            self._reopen(newest, misfits[:, HEADING_MISFIT])

    def restart(self, robots: Sequence[int]) -> None:
        """Let replaced robots begin with first filters, in their poses of the last frame."""
        if not robots:
            return
        assert self.last_frame is not None, "a robot can be replaced only after a frame"
        replaced = np.zeros(len(self.prior.a), dtype=np.bool_)
        replaced[robots] = True
        bank = bank_with_replaced(self.bank, first_bank(self.prior, self.body), replaced)
        step_s = np.where(replaced, self._first_steps(), self.step_s)
        self._running = self._running_filters(bank, step_s)
        self._place(self.last_frame, replaced)

    # ---- what is known ----

    def forecast(self, sent_ns: int) -> Forecast:
        """Return the robots as each will be when a command sent at `sent_ns` [ns] acts on it."""
        from tetractl.control.kernels.bank import forecast

        assert self.last_frame is not None, "poses are predicted from those of a frame"
        outlook = Outlook.empty(len(self.prior.a))
        dead_time_s, dead_time_std_s = forecast(
            self.bank,
            self.model,
            self.shared,
            self.commands.all,
            self.last_frame.seconds,
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
        return Forecast(
            poses=Poses(outlook.x, outlook.y, outlook.heading),
            turn_bias=outlook.turn_bias,
            flow=outlook.flow,
            directions=outlook.held_direction,
            estimate=estimate,
        )

    def _likeliest_filters(self) -> Integers:
        """Return each robot's likeliest filter (N,)."""
        return self.shared.score.argmax(axis=0)

    def _misfits(self) -> Bools:
        """Return which of INNOVATIONS each robot's likeliest filter does not fit, (N, 3): the sum
        over blocks is larger than chance makes it once in a thousand times."""
        filters = self._likeliest_filters()
        robots = np.arange(len(filters))
        blocks = np.maximum(self.bank.blocks[filters, robots], ASSUMED.least_blocks)
        limits = np.array([largest_square_sum(number) for number in blocks.tolist()])
        return self.bank.square_sum[filters, robots] > limits[:, None]

    # ---- frames ----

    def _frames_used(
        self, newest: Observation, earlier: Sequence[Observation]
    ) -> list[Observation]:
        """Return the frames that are used, in the order of time: those SPACING_S after the one used
        before. The newest one needs no such distance if others come with it: one per control step
        does no harm. A prior without uncertainty uses all."""
        if self.prior.certain:
            return [*earlier, newest]
        used = list[Observation]()
        last = self.last_frame
        for frame in (*earlier, newest):
            closes_step = bool(earlier) and frame is newest
            apart_ns = 1 if closes_step else round(SPACING_S * SECOND)
            if last is None or frame.sampled_ns >= last.sampled_ns + apart_ns:
                used.append(frame)
                last = frame
        return used

    def _follow_frames(self, frames: Sequence[Observation]) -> None:
        """Follow the robots from the last frame used before through some more.

        If the poses of one of them are taken as they are, what was before does not matter: the
        robots are placed there, and followed from there on.
        """
        first = self._last_taken_as_is(frames)
        if first is None:
            assert self.last_frame is not None
            to_follow = [self.last_frame, *frames]
        else:
            to_follow = frames[first:]
            self._place(to_follow[0], self._all_robots())
        if len(to_follow) > 1:
            self._follow(to_follow)
        self.last_frame = to_follow[-1]

    def _last_taken_as_is(self, frames: Sequence[Observation]) -> int | None:
        """Return the index of the last frame whose poses are taken as they are, None if there is
        none. The first frame of a trial is such a frame."""
        for index in reversed(range(len(frames))):
            if self._is_taken_as_is(frames[index]):
                return index
        return 0 if self.last_frame is None else None

    def _is_taken_as_is(self, frame: Observation) -> bool:
        """Return whether a frame's poses are taken as they are: there is nothing to identify, or
        robots turn on the spot, of which the filters have no model, or robots do not yet drive the
        first square for certain."""
        if self.prior.certain or self.commands.turning:
            return True
        if not self._drive_first:
            return False
        if self.commands.first_ns is None:
            return True
        longest_s = self.prior.dead_time + GRID.reach * self.prior.dead_time_std
        return frame.sampled_ns < self.commands.first_ns + round(longest_s * SECOND)

    def _place(self, frame: Observation, placed: Bools) -> None:
        """Place the robots `placed` (N,) at their poses of a frame, in all their filters; they
        follow the last command that acts by then."""
        from tetractl.control.kernels.filter import place  # late: checking a spec needs no compiler

        poses = frame.poses.array()
        place(self.bank, self.model, self.commands.all, frame.seconds, poses, placed)

    def _follow(self, frames: Sequence[Observation]) -> None:
        """Follow the robots from the first to the last of some frames, by all their filters."""
        from tetractl.control.kernels.filter import follow

        measured = PoseFrames(
            time_s=np.array([frame.seconds for frame in frames]),
            poses=np.array([frame.poses.array() for frame in frames]),
            valid=np.array([frame.valid for frame in frames]),
        )
        self._note_noise(measured)
        step_s = float(self.step_s.max())
        follow(self.bank, self.model, self.commands.all, measured, self._noisy, step_s)

    def _note_noise(self, measured: PoseFrames) -> None:
        """Note whether measurements are noisy: poses differ though nothing was sent yet. Then equal
        poses are no new measurements."""
        if self.commands.number > 0 or self._noisy:
            return
        differ = (measured.poses[1:] != measured.poses[:-1]).any(axis=(1, 2))
        is_seen = measured.valid[1:].any(axis=1)
        self._noisy = bool((differ & is_seen).any())

    # ---- the bank changes ----

    def _with_shared_scores(self, running: RunningFilters) -> RunningFilters:
        """Return the filters with how likely each is by the frames of all robots so far."""
        from tetractl.control.kernels.bank import share

        return running._replace(shared=share(running.bank, running.common, running.step_s))

    def _with_likely_filters(self, running: RunningFilters) -> RunningFilters:
        """Return the filters without those that are unlikely, and with each robot's grid refined
        around its likely dead times."""
        from tetractl.control.kernels.bank import select

        most = max(len(running.bank.score), GRID.refined * self.body.groups_max)
        going_on = NextFilters.room_for(most, running.step_s)  # filled by `select`
        commanded = self.commands.number > 0
        differ = select(running.bank, running.shared, self.body.tried, commanded, going_on)
        if not differ:
            return running
        return self._running_filters(going_on.taken_from(running.bank), going_on.step_s)

    def _may_reopen(self, newest: Observation) -> bool:
        """Return whether the bank is opened again if the model does not fit: not for cells, whose
        own doings are no other dead time, nor too soon."""
        due_ns = self.reopened_ns + REOPEN_S * SECOND
        return bool(self.body.later_tried) and newest.sampled_ns >= due_ns

    def _reopen(self, frame: Observation, heading_misfits: Bools) -> None:
        """Open the bank again at a frame: begin with the first dead times, and with motors that may
        saturate for robots with `heading_misfits` (N,)."""
        bank = reopened_bank(self.bank, self.likeliest(), heading_misfits, self.prior, self.body)
        self.model = with_saturation(self.model)
        self.reopened_ns = frame.sampled_ns
        self._running = self._running_filters(bank, self._first_steps())
        self._place(frame, self._all_robots())

    def _all_robots(self) -> Bools:
        """Return that all robots are meant (N,)."""
        return np.ones(len(self.prior.a), dtype=np.bool_)

    def _first_steps(self) -> Floats:
        """Return how far the dead times of each robot are apart at first (N,) [s]."""
        return np.full(len(self.prior.a), GRID.step_s)

    def _running_filters(self, bank: Bank, step_s: Floats) -> RunningFilters:
        """Return a bank, whose dead times are `step_s` (N,) apart [s], with what its filters say
        together."""
        common = CommonTimes.of(bank, step_s, self.prior)
        running = RunningFilters(bank, step_s, common, SharedScores.of_prior(bank))
        return running if self.prior.certain else self._with_shared_scores(running)


def warm_up(prior: Prior, starts: Poses) -> None:
    """Compile the functions of a filter bank, or load them from the cache."""
    filters = FilterBank(prior)
    valid = np.ones(len(prior.a), dtype=np.bool_)
    first = Observation(0, 0, 0, starts, valid)
    second_ns = round(SPACING_S * SECOND)
    second = Observation(1, second_ns, second_ns, starts, valid)
    filters.add_frames(first)
    filters.forecast(0)
    filters.add_frames(second)
    filters.forecast(second_ns)
