"""Kalman filters that learn how each robot moves, and predict where it will be.

A camera shows the robots late and with noise. A command acts even later, or gets lost. And no two
robots turn and drive in the same way. These filters use all frames seen and all commands sent to
learn, while the robots drive, how each of them moves. A controller calls the filters once a control
step:

    filters.add_frames(newest, earlier)       the frames since the previous step
    forecast = filters.forecast(sent_ns)      the robots when a command sent at that time acts
    filters.add_command(command)              the command that was sent

**Terms.** One Kalman filter for each robot is not enough, because nobody knows which command the
robot is following:

    prior       the assumptions about the robots before they move, and how certain these are
    state       pose and parameters of motion of one robot (`kernels.filter_state`)
    dead time   the time from the sending of a command to the moment when it acts
    hypothesis  one answer to the question what a robot is doing: a state with its covariance, the
                direction that the robot follows, and the probability of this answer. A robot may
                follow the last command; it may follow one of the two before, because it missed the
                later ones; or it may be stuck and stand still
    filter      the hypotheses of one robot, for one assumed dead time. A filter's score is the
                logarithm of the likelihood of the robot's frames
    bank        all filters of all robots. For each robot, there is one filter for each dead time of
                a grid. The whole grid is repeated for each value that is tried for some other
                state, such as the lag of the wheels (`filter_start`)
    innovation  measured pose minus predicted pose, divided by its standard deviation
    misfit      a robot whose motion the model does not explain. If the model is right, innovations
                are independent from frame to frame. The filter tests this with sums over blocks of
                frames. If a sum is too large to be chance, the robot is a misfit. In any case, the
                standard deviations of the estimate grow by the factor that is found

**What happens to a frame**, in `add_frames`:

 1. A frame is left out if it comes less than 30 ms after the last one used and is not the newest of
    several. The reason: wheels whose lag is not given respond over tens of milliseconds. At shorter
    intervals, the start of this response would bias the dead time and the turning rate downwards.
 2. Each filter predicts its hypotheses to the time of the frame, compares them with the measured
    poses, and adds to its score how well they fit (`kernels.filter`).
 3. After the newest frame, the filters of all robots are compared. Most probably, all robots have
    the same dead time, so the frames of one robot also carry information about the others. Unlikely
    filters are dropped, and the grid of dead times is refined around the likely ones
    (`kernels.bank`).
 4. If the model does not fit robots on wheels, the bank is *reopened*: it gets all dead times of
    the start again, because the dead time may have changed after its filter was dropped. If the
    heading is the part that does not fit, the new bank also tries motors that saturate. The bank is
    also reopened if robots on wheels seem to miss most directions, because these may in fact only
    act later (`reception`).

If the prior is certain, there is nothing to identify, and `known_motion` predicts the robots
instead.

**What happens to a command.** `add_command` only records the command and its time. In each filter,
the command acts one dead time later. At that moment, hypotheses branch: the robot received the
command, or missed it. A *forecast* uses each robot's likeliest hypothesis, and assumes that the
robot receives the commands that have not acted yet. `kernels.bank.forecast` fills the fields of
`Estimate`, the part of a forecast that is published.

**What happens next, if**

    a pose jumps                  it is an outlier beyond the gate: hypotheses are predicted further
                                  without it. If no pose fits for LOST_TRACK_S, the filter takes
                                  the camera's pose as the robot's new position
    a frame is missing            robots are predicted to the next frame
    a command is missed           a hypothesis that follows the previous command becomes likeliest
    all robots miss most commands step 4. If this continues, `reception.is_sparse`
    a robot gets stuck            the stuck hypothesis becomes the likeliest
    the camera freezes            its frames are not used
    the model does not fit        standard deviations grow, and step 4
    a robot is replaced           `restart`: the new robot begins with the filters of a start

Units are seconds, radians and the spec's length unit. N is the number of robots. Compiled kernels
are imported only where they are called, because checking a spec needs no compiler.
"""

from collections.abc import Sequence

import numpy as np

from tetractl.control.estimation.filter_start import (
    GROUPS_MAX,
    LAG_STEP_S,
    SATURATION_WALK,
    TRIED_SATURATIONS,
    bank_with_replaced,
    filter_model,
    first_bank,
    first_tried_state,
    reopened_bank,
)
from tetractl.control.estimation.kernels.filter_state import (
    LAG,
    LEAST_BLOCKS,
    LN_SATURATION,
    REFINED,
    Bank,
    CommonTimes,
    Forecast,
    NextFilters,
    PoseFrames,
    SentCommands,
    largest_square_sum,
)
from tetractl.control.estimation.prior import Prior
from tetractl.control.estimation.reception import Reception
from tetractl.core import elementwise
from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, FieldOff, Steer, Stop, Turn
from tetractl.core.motion_estimate import INNOVATIONS
from tetractl.core.poses import Bools, Floats, Integers, Observation, Poses

SPACING_NS = round(0.03 * SECOND)
"""Minimum time between two frames that the filters use [ns].

docs/decisions/filter.md lists the errors that other values give.
"""
REOPEN_S = 4.0
"""Minimum time before the bank is opened again [s].

It counts from the start of a trial, or from the last time that the bank was opened: until then, too
few blocks of frames test the model. Chosen, not measured.
"""
TRIAL_STARTS_NS = 0
"""Time at which a trial starts [ns]: the trial's clock begins at 0."""
HEADING_MISFIT = INNOVATIONS.index("heading")
"""Column of the heading in the array of misfits, which has one column for each innovation."""


class FilterBank:
    """The filters that identify the motion of N robots during one trial.

    Call `add_frames` and `add_command` in the order in which frames and commands become known. A
    command counts from its own time. `forecast` changes nothing, and can be called any number of
    times after the first frame. If robots were replaced by others, call `restart` after the first
    frames that show the new robots.
    """

    def __init__(self, prior: Prior) -> None:
        self.prior = prior
        self.model = filter_model(prior)
        """The assumptions about the robots.

        Once the bank has been opened again, they allow motors to saturate; in which filters they do
        depends on the states of these filters.
        """
        self.commands = SentCommands(np.empty(0), np.empty(0))
        """The commands that were sent, each as the direction that robots shall follow."""
        self.turns_on_the_spot = False
        """Whether the last command that moved robots was a turn on the spot.

        Stops do not count.
        """
        self.reception = Reception()
        """The running test whether most of the directions sent are lost on the radio."""
        self.last_frame: Observation | None = None
        """The last frame used. All filters are at its time. None before the first frame."""
        self.reopened_ns: int | None = None
        """Time of the trial at which the bank was last opened again [ns].

        None if it never was.
        """
        self._is_noisy = False
        """Whether measured poses changed before anything was sent, so that the camera is noisy."""
        self.bank = first_bank(prior)
        """The filters: B for each of the N robots.

        Adding frames changes its arrays in place.
        """
        self._common_times = CommonTimes.of(self.bank, prior)
        """Dead times that all robots of this bank may have in common."""
        self._tried_state = first_tried_state(prior)
        self._share_scores()

    # ---- what a controller calls ----

    def add_frames(self, newest: Observation, earlier: Sequence[Observation] = ()) -> None:
        """Update all filters with new camera frames; restart them if none explains the motion.

        Whether the model fits is decided before the frames are added, because the decision has to
        concern the last forecast that was used.

        Args:
            newest: The newest frame.
            earlier: Frames since the newest of the previous step, oldest first.
        """
        misfits = self._misfits()
        times_sparse_before = self.reception.times_detected
        self._follow_frames(self._select_frames(newest, earlier))
        self._share_scores()
        self._select_filters()
        first_seems_sparse = times_sparse_before == 0 and self.reception.times_detected == 1
        if first_seems_sparse:
            self._reopen(newest, heading_fits=True)
        elif misfits.any() and self._may_reopen(newest):
            self._reopen(newest, heading_fits=not misfits[:, HEADING_MISFIT].any())

    def forecast(self, sent_ns: int) -> Forecast:
        """Predict each robot to the moment when a command sent at `sent_ns` [ns] acts on it.

        The forecast follows each robot's likeliest hypothesis, and assumes that the robot receives
        all commands that have not acted yet. It changes no filter. At least one frame must have
        been added before.
        """
        from tetractl.control.estimation.kernels.bank import forecast as fill_forecast

        assert self.last_frame is not None, "poses are predicted from those of a frame"
        forecast = Forecast.room_for(len(self.prior.a))
        dead_time_s, dead_time_std_s = fill_forecast(
            self.bank,
            self.model,
            self.commands,
            self.last_frame.seconds,
            sent_ns / SECOND,
            forecast,
        )
        lag_s, lag_std_s = self._lags() if self.prior.lag_is_learnt else (None, None)
        return forecast._replace(
            dead_time_s=dead_time_s,
            dead_time_std_s=dead_time_std_s,
            lag=lag_s,
            lag_std=lag_std_s,
        )

    def add_command(self, command: Command) -> None:
        """Record a command with the time at which it was sent.

        A command is a direction, a stop, or a turn on the spot; switching the field off is
        ignored. A direction can contain the lag of the wheels that the host assumes, starting with
        this command.
        """
        if isinstance(command.action, FieldOff):
            return  # it turns no robot
        if not isinstance(command.action, Stop):
            self.turns_on_the_spot = isinstance(command.action, Turn)
        if isinstance(command.action, Steer) and command.action.lag_s is not None:
            self.model = self.model._replace(host_lag_s=command.action.lag_s)
        direction = np.nan if command.direction is None else command.direction
        self.commands = SentCommands(
            sent_s=np.append(self.commands.sent_s, command.sent_ns / SECOND),
            directions=np.append(self.commands.directions, direction),
        )

    def restart(self, robots: Sequence[int]) -> None:
        """Restart the filters of replaced robots, at their poses in the last frame.

        Does nothing if `robots`, the indices of the replaced robots, is empty.
        """
        if not robots:
            return
        assert self.last_frame is not None, "a robot can be replaced only after a frame"
        replaced = np.zeros(len(self.prior.a), dtype=np.bool_)
        replaced[robots] = True
        self._tried_state = first_tried_state(self.prior)
        self._replace_bank(bank_with_replaced(self.bank, self.prior, replaced))
        self._set_poses(self.last_frame, replaced)

    # ---- estimates of the filters ----

    def likeliest(self) -> tuple[Integers, Integers, Integers]:
        """Locate the most probable hypothesis of each robot in the arrays of the bank.

        Returns:
            The index of the filter, of the robot, and of the hypothesis's slot, each of shape
            (N,).
        """
        filters = self._likeliest_filters()
        robots = np.arange(len(self.prior.a))
        slots = self.bank.ln_weight[filters, robots].argmax(axis=1)
        return filters, robots, slots

    def _lags(self) -> tuple[Floats, Floats]:
        """Return the lag of each robot's wheels and its standard deviation [s], (N,) each.

        The lag is the one of the robot's likeliest filter. The true lag lies between the lags that
        are tried, so the deviation is at least a quarter of their distance.
        """
        score = self.bank.shared_score
        probability = elementwise.exp(score - score.max(axis=0))
        probability /= probability.sum(axis=0)
        lags_s = self.bank.state[:, :, 0, LAG]
        lag_s = lags_s[self._likeliest_filters(), np.arange(len(self.prior.a))]
        variance = (probability * np.square(lags_s - lag_s)).sum(axis=0)
        return lag_s, np.sqrt(variance + np.square(LAG_STEP_S / 4))

    def _likeliest_filters(self) -> Integers:
        """Find the index of each robot's likeliest filter, shape (N,)."""
        return self.bank.shared_score.argmax(axis=0)

    def _misfits(self) -> Bools:
        """Find the robots whose motion the model does not explain.

        A robot counts as a misfit if the sum over blocks of its likeliest filter is so large that
        chance exceeds this value only once in a thousand times.

        Returns:
            True for a misfit, shape (N, 3): for each robot, one column for each of INNOVATIONS.
        """
        filters = self._likeliest_filters()
        robots = np.arange(len(filters))
        blocks = np.maximum(self.bank.blocks[filters, robots], LEAST_BLOCKS)
        limits = np.array([largest_square_sum(number) for number in blocks.tolist()])
        return self.bank.square_sum[filters, robots] > limits[:, None]

    # ---- steps 1 and 2: filters follow the frames that are used ----

    def _select_frames(
        self, newest: Observation, earlier: Sequence[Observation]
    ) -> list[Observation]:
        """Select the frames that the filters use, in the order of time.

        Frames are used if they come at least SPACING_NS after the one used before. If there are
        earlier frames, the newest one is always used, because one more frame per control step does
        no harm.
        """
        selected = list[Observation]()
        last_selected = self.last_frame
        for frame in (*earlier, newest):
            gap_min_ns = 1 if earlier and frame is newest else SPACING_NS
            if last_selected is None or frame.sampled_ns >= last_selected.sampled_ns + gap_min_ns:
                selected.append(frame)
                last_selected = frame
        return selected

    def _follow_frames(self, frames: Sequence[Observation]) -> None:
        """Follow the robots from the last frame used through some more frames.

        There are three cases. Usually the filters follow all frames. While robots turn on the spot,
        the filters take the poses of the newest frame as they are, because they have no model of
        such turns. At the start of a trial, they take the poses of the first frame as they are, and
        follow the others.
        """
        if not frames:
            return
        if self.turns_on_the_spot:
            self._set_poses(frames[-1], self._all_robots())
        elif self.last_frame is None:
            self._set_poses(frames[0], self._all_robots())
            if len(frames) > 1:
                self._follow(frames)
        else:
            self._follow([self.last_frame, *frames])
        self.last_frame = frames[-1]

    def _set_poses(self, frame: Observation, is_set: Bools) -> None:
        """Set some robots to their poses in a frame, in all their filters.

        Starting with this frame, these robots follow the last command that had taken effect at the
        time of the frame.

        Args:
            frame: The camera frame.
            is_set: Whether to set each robot, shape (N,).
        """
        from tetractl.control.estimation.kernels.filter import place

        poses = frame.poses.array()
        place(self.bank, self.model, self.commands, frame.seconds, poses, is_set)

    def _follow(self, frames: Sequence[Observation]) -> None:
        """Advance all filters of all robots from the first of the given frames to the last."""
        from tetractl.control.estimation.kernels.filter import follow

        measured = PoseFrames(
            time_s=np.array([frame.seconds for frame in frames]),
            poses=np.array([frame.poses.array() for frame in frames]),
            valid=np.array([frame.valid for frame in frames]),
        )
        if len(self.commands.sent_s) == 0:  # poses that differ though nothing was sent are noisy
            differ = (measured.poses[1:] != measured.poses[:-1]).any(axis=(1, 2))
            self._is_noisy |= bool((differ & measured.valid[1:].any(axis=1)).any())
        # by how much a dead time may be wrong: the step of the coarsest grid, for all robots
        step_s = float(self.bank.step_s.max())
        if not self.tests_radio:
            follow(self.bank, self.model, self.commands, measured, self._is_noisy, step_s)
            return
        likeliest = self._likeliest_filters()
        for frame in range(1, len(frames)):
            frame_pair = measured.part(frame - 1, frame + 1)
            follow(self.bank, self.model, self.commands, frame_pair, self._is_noisy, step_s)
            self.reception.add_frame(self.bank, likeliest, self.commands)

    @property
    def tests_radio(self) -> bool:
        """Whether the test for a sparse radio is still running.

        The test applies to robots on wheels. It asks whether only a few directions reach the
        robots, and stops when the answer is known.
        """
        return not (self.prior.swims or self.reception.is_sparse)

    # ---- step 3: the filters of all robots are compared ----

    def _share_scores(self) -> None:
        """Compute how likely each filter is, given the frames of all robots so far.

        The robots probably have the same dead time, so the frames of one robot also count for the
        filters of the others.
        """
        from tetractl.control.estimation.kernels.bank import share

        share(self.bank, self._common_times)

    def _select_filters(self) -> None:
        """Drop unlikely filters, and refine each robot's grid around its likely dead times."""
        from tetractl.control.estimation.kernels.bank import select

        n_filters_max = max(len(self.bank.score), REFINED * GROUPS_MAX)
        next_filters = NextFilters.room_for(n_filters_max, self.bank)  # filled by `select`
        has_commands = len(self.commands.sent_s) > 0
        if select(self.bank, *self._tried_state, has_commands, next_filters):
            self._replace_bank(next_filters.taken_from(self.bank))

    def _replace_bank(self, bank: Bank) -> None:
        """Replace all filters by those of another bank, and compare their scores again."""
        self.bank = bank
        self._common_times = CommonTimes.of(bank, self.prior)
        self._share_scores()

    # ---- step 4: the bank is opened again ----

    def _may_reopen(self, newest: Observation) -> bool:
        """Check whether the filters may restart from all dead times if their model does not fit.

        The bank of cells is never reopened, because cells also move on their own, which does not
        mean that the dead time has changed. A bank is also not reopened soon after the last time.
        """
        opened_ns = TRIAL_STARTS_NS if self.reopened_ns is None else self.reopened_ns
        is_due = newest.sampled_ns >= opened_ns + REOPEN_S * SECOND
        return not self.prior.swims and is_due

    def _reopen(self, frame: Observation, heading_fits: bool) -> None:
        """Restart the filters at a camera frame, with all dead times that the trial began with.

        Unless `heading_fits` for every robot, some filters also assume motors that saturate. Until
        then, saturation was taken to be absent; starting with this frame, it drifts from the values
        that are tried.
        """
        bank = reopened_bank(self.bank, self.likeliest(), heading_fits, self.prior)
        walk = self.model.walk.copy()
        walk[LN_SATURATION] = SATURATION_WALK
        self.model = self.model._replace(walk=walk)
        self.reopened_ns = frame.sampled_ns
        if not heading_fits:
            self._tried_state = TRIED_SATURATIONS
        self._replace_bank(bank)
        self._set_poses(frame, self._all_robots())

    def _all_robots(self) -> Bools:
        """Return an array of True, shape (N,), which selects every robot."""
        return np.ones(len(self.prior.a), dtype=np.bool_)


def warm_up(prior: Prior, starts: Poses) -> None:
    """Compile the functions of a filter bank before a trial, or load them from the cache.

    Otherwise, the first control step would wait for the compiler. The filters that are run for
    this are discarded.

    Args:
        prior: The prior of the N robots.
        starts: Any poses of the robots; two frames with these poses are filtered.
    """
    filters = FilterBank(prior)
    valid = np.ones(len(prior.a), dtype=np.bool_)
    first = Observation(0, 0, 0, starts, valid)
    second = Observation(1, SPACING_NS, SPACING_NS, starts, valid)
    filters.add_frames(first)
    filters.forecast(0)
    filters.add_frames(second)
    filters.forecast(SPACING_NS)
