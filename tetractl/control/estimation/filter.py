"""Where robots are, how they move, and where they will be when the next command acts.

A camera shows the robots late and with noise; a command acts later still, or gets lost; and no two
robots turn and drive alike. From all frames seen and all commands sent, these filters find out how
each robot moves while it drives. A controller calls them once a control step:

    filters.add_frames(newest, earlier)       what was seen since the step before
    forecast = filters.forecast(sent_ns)      the robots when a command sent at that time acts
    filters.add_command(command)              what was sent

**Terms.** One Kalman filter a robot is not enough, as it is not known what the robot does:

    prior       what is assumed of the robots before they move, and how certain that is
    state       of a robot: its pose and motion (`kernels.filter_state`)
    dead time   from the sending of a command to the moment when it acts
    hypothesis  a state with its covariance, the direction that the robot follows, and how likely
                this is: a robot follows the last command, or one of the two before, because it
                missed the later ones, or it is stuck and stands
    filter      the hypotheses of one robot for one dead time. Its score is the ln of the likelihood
                of the robot's frames
    bank        all filters of all robots: for each robot, those of a grid of dead times, and this
                grid again for each value of a state that is tried (`filter_start`)
    misfit      what frames show beyond the predictions is independent from frame to frame if the
                model is right. Sums over blocks of frames test this: standard deviations grow by
                what they are found to be, and a robot is a misfit if chance hardly explains them

**What happens to a frame**, in `add_frames`:

 1. It is left out if it comes less than 30 ms after the last one used and is not the newest of
    several: wheels whose lag is not given respond over tens of milliseconds, and at shorter
    intervals the start of the response would bias dead time and turning rate to smaller values.
 2. Each filter predicts its hypotheses to the frame's time, compares them with the measured poses,
    and adds to its score how well they fit (`kernels.filter`).
 3. After the newest frame, the filters of all robots are compared: most probably all robots have
    the same dead time, so that each robot's frames say something of that of the others. Filters
    that are unlikely end, and the grid is refined around those that are likely (`kernels.bank`).
 4. If the model has not fitted robots on wheels, the bank is *opened again*: it begins with the
    first dead times, as theirs may have changed so that its filter is gone, and with motors that
    may saturate, if it is the heading that does not fit. With all dead times it also begins if
    robots on wheels seem to miss most directions, as these may only act later (`reception`).

If the prior is certain, there is nothing to identify: then `known_motion` predicts the robots.

**What happens to a command.** `add_command` only records it, with its time. It acts in each filter
at another time, one dead time later, and hypotheses branch then: the robot heard it, or missed it.
A *forecast* is by each robot's likeliest hypothesis, which takes the commands that are still to act
to be heard. `kernels.bank.forecast` fills what of it is published, the fields of `Estimate`.

**What happens next, if**

    a pose jumps                  it is an outlier beyond the gate: hypotheses are predicted on
                                  without it; if none fits for LOST_TRACK_S, the robot is
                                  placed at the camera's pose
    a frame is missing            robots are predicted on to the next one
    a command is missed           a hypothesis that follows the command before becomes the likeliest
    most are missed by all        step 4; then, if they are missed still, `reception.is_sparse`
    a robot sticks                the stuck hypothesis becomes the likeliest
    the camera freezes            its frames are not used
    the model does not fit        standard deviations grow, and step 4
    a robot is replaced           `restart`: it begins with first filters

Units are seconds, radians and the spec's length unit; N is the number of robots. Kernels are
imported where they are called, as checking a spec needs no compiler.
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
    first_tried,
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
"""Minimum time between two frames used [ns]; docs/decisions/filter.md has errors with others."""
REOPEN_S = 4.0
"""Minimum time before the bank is opened again [s].

It counts from the start of a trial, or from the last time that the bank was opened: until then, too
few blocks of frames test the model. Chosen, not measured.
"""
TRIAL_STARTS_NS = 0
"""Time at which a trial starts [ns]: its clock begins then."""
HEADING_MISFIT = INNOVATIONS.index("heading")
"""Column of a misfit that is about the heading."""


class FilterBank:
    """The filters that identify N robots during one trial.

    `add_frames` and `add_command` are called in the order in which frames and commands become
    known; a command counts from its own time on. `forecast` changes nothing: it can be called after
    the first frame, any number of times. `restart` is for robots that were replaced by others,
    after the frames in which these are seen first.
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
        """Whether robots were sent to turn on the spot since the last direction."""
        self.reception = Reception()
        """Whether few of the directions sent are received."""
        self.last_frame: Observation | None = None
        """The last frame used: the filters are at its time. None before the first."""
        self.reopened_ns: int | None = None
        """Time at which the bank was last opened again [ns], None if it never was."""
        self._is_noisy = False
        """Whether robots that were not sent anything were measured at different poses."""
        self.bank = first_bank(prior)
        """The filters, B of each robot. Frames change its arrays in place."""
        self._common_times = CommonTimes.of(self.bank, prior)
        """Dead times that the robots of this bank may have in common."""
        self._tried = first_tried(prior)
        self._share_scores()

    # ---- what a controller calls ----

    def add_frames(self, newest: Observation, earlier: Sequence[Observation] = ()) -> None:
        """Bring the filters to the newest frame of a control step, and reopen the bank if needed.

        Whether the model fits is decided before the frames are added, because what the last
        forecast said about it counts.

        Args:
            newest: The newest frame.
            earlier: Frames since the newest of the previous step, oldest first.
        """
        misfits = self._misfits()
        times_sparse_before = self.reception.times_shown
        self._follow_frames(self._frames_used(newest, earlier))
        self._share_scores()
        self._select_filters()
        first_seems_sparse = times_sparse_before == 0 and self.reception.times_shown == 1
        if first_seems_sparse:
            self._reopen(newest, heading_fits=True)
        elif misfits.any() and self._may_reopen(newest):
            self._reopen(newest, heading_fits=not misfits[:, HEADING_MISFIT].any())

    def forecast(self, sent_ns: int) -> Forecast:
        """Return the robots as each will be when a command sent at `sent_ns` [ns] acts on it."""
        from tetractl.control.estimation.kernels.bank import forecast as fill

        assert self.last_frame is not None, "poses are predicted from those of a frame"
        forecast = Forecast.room_for(len(self.prior.a))
        dead_time_s, dead_time_std_s = fill(
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
        """Add a command with the time at which it was sent.

        It is a direction, or a stop or a turn on the spot, which have none. A direction may state
        the lag of the wheels that the host assumes, starting with this command.
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
        """Let replaced robots begin with first filters, in their poses of the last frame."""
        if not robots:
            return
        assert self.last_frame is not None, "a robot can be replaced only after a frame"
        replaced = np.zeros(len(self.prior.a), dtype=np.bool_)
        replaced[robots] = True
        self._tried = first_tried(self.prior)
        self._go_on_with(bank_with_replaced(self.bank, self.prior, replaced))
        self._place(self.last_frame, replaced)

    # ---- what the filters say ----

    def likeliest(self) -> tuple[Integers, Integers, Integers]:
        """Return where the likeliest hypothesis of each robot is in the arrays of the bank.

        Returns:
            The indices of its filter, robot and slot, (N,) each, so that `bank.state[likeliest]`
            (N, STATES) are the states of these hypotheses.
        """
        filters = self._likeliest_filters()
        robots = np.arange(len(self.prior.a))
        slots = self.bank.ln_weight[filters, robots].argmax(axis=1)
        return filters, robots, slots

    def _lags(self) -> tuple[Floats, Floats]:
        """Return the lag of each robot's wheels and its standard deviation [s], (N,) each.

        It is the lag of the likeliest filter. The true lag lies between the lags that are tried, so
        the deviation is at least a quarter of their distance.
        """
        score = self.bank.shared_score
        probability = elementwise.exp(score - score.max(axis=0))
        probability /= probability.sum(axis=0)
        lags_s = self.bank.state[:, :, 0, LAG]
        lag_s = lags_s[self._likeliest_filters(), np.arange(len(self.prior.a))]
        variance = (probability * np.square(lags_s - lag_s)).sum(axis=0)
        return lag_s, np.sqrt(variance + np.square(LAG_STEP_S / 4))

    def _likeliest_filters(self) -> Integers:
        """Return each robot's likeliest filter (N,)."""
        return self.bank.shared_score.argmax(axis=0)

    def _misfits(self) -> Bools:
        """Return (N, 3) whether each robot fails to fit the model, in each of INNOVATIONS.

        A robot fails if, by its likeliest filter, the sum over blocks is so large that chance
        exceeds it only once in a thousand times.
        """
        filters = self._likeliest_filters()
        robots = np.arange(len(filters))
        blocks = np.maximum(self.bank.blocks[filters, robots], LEAST_BLOCKS)
        limits = np.array([largest_square_sum(number) for number in blocks.tolist()])
        return self.bank.square_sum[filters, robots] > limits[:, None]

    # ---- steps 1 and 2: filters follow the frames that are used ----

    def _frames_used(
        self, newest: Observation, earlier: Sequence[Observation]
    ) -> list[Observation]:
        """Return the frames that the filters use, in the order of time.

        They are those at least SPACING_NS after the one used before. If there are earlier frames,
        the newest is used at any distance: one more per control step does no harm.
        """
        used = list[Observation]()
        last = self.last_frame
        for frame in (*earlier, newest):
            least_gap_ns = 1 if earlier and frame is newest else SPACING_NS
            if last is None or frame.sampled_ns >= last.sampled_ns + least_gap_ns:
                used.append(frame)
                last = frame
        return used

    def _follow_frames(self, frames: Sequence[Observation]) -> None:
        """Follow the robots from the last frame used before through some more.

        There are three cases. While robots turn on the spot, of which the filters have no model,
        the poses of the newest frame are taken as they are. In the first frames of a trial, those
        of the first one are, and the others are followed. Usually all are followed.
        """
        if not frames:
            return
        if self.turns_on_the_spot:
            self._place(frames[-1], self._all_robots())
        elif self.last_frame is None:
            self._place(frames[0], self._all_robots())
            if len(frames) > 1:
                self._follow(frames)
        else:
            self._follow([self.last_frame, *frames])
        self.last_frame = frames[-1]

    def _place(self, frame: Observation, placed: Bools) -> None:
        """Place the robots `placed` (N,) at their poses of a frame, in all their filters.

        They follow the last command that has taken effect by then.
        """
        from tetractl.control.estimation.kernels.filter import place

        poses = frame.poses.array()
        place(self.bank, self.model, self.commands, frame.seconds, poses, placed)

    def _follow(self, frames: Sequence[Observation]) -> None:
        """Follow the robots from the first to the last of some frames, by all their filters."""
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
            pair = measured.part(frame - 1, frame + 1)
            follow(self.bank, self.model, self.commands, pair, self._is_noisy, step_s)
            self.reception.add_frame(self.bank, likeliest, self.commands)

    @property
    def tests_radio(self) -> bool:
        """Whether frames have yet to show if only few directions reach the robots.

        That is the case for robots on wheels until the answer is known.
        """
        return not (self.prior.swims or self.reception.is_sparse)

    # ---- step 3: the filters of all robots are compared ----

    def _share_scores(self) -> None:
        """Compute how likely each filter is by the frames of all robots so far."""
        from tetractl.control.estimation.kernels.bank import share

        share(self.bank, self._common_times)

    def _select_filters(self) -> None:
        """Let unlikely filters end, and refine each robot's grid around its likely dead times."""
        from tetractl.control.estimation.kernels.bank import select

        most = max(len(self.bank.score), REFINED * GROUPS_MAX)
        going_on = NextFilters.room_for(most, self.bank)  # filled by `select`
        commanded = len(self.commands.sent_s) > 0
        if select(self.bank, *self._tried, commanded, going_on):
            self._go_on_with(going_on.taken_from(self.bank))

    def _go_on_with(self, bank: Bank) -> None:
        """Go on with the filters of another bank."""
        self.bank = bank
        self._common_times = CommonTimes.of(bank, self.prior)
        self._share_scores()

    # ---- step 4: the bank is opened again ----

    def _may_reopen(self, newest: Observation) -> bool:
        """Return whether the bank may be opened again if the model does not fit.

        It is not for cells, whose own moves do not mean a different dead time, nor soon after the
        last time.
        """
        opened_ns = TRIAL_STARTS_NS if self.reopened_ns is None else self.reopened_ns
        is_due = newest.sampled_ns >= opened_ns + REOPEN_S * SECOND
        return not self.prior.swims and is_due

    def _reopen(self, frame: Observation, heading_fits: bool) -> None:
        """Open the bank again at a frame, with the first dead times.

        Unless `heading_fits` for every robot, some filters assume motors that saturate. Until now
        the saturation was taken to be absent; from now on it drifts from the values that are tried.
        """
        bank = reopened_bank(self.bank, self.likeliest(), heading_fits, self.prior)
        walk = self.model.walk.copy()
        walk[LN_SATURATION] = SATURATION_WALK
        self.model = self.model._replace(walk=walk)
        self.reopened_ns = frame.sampled_ns
        if not heading_fits:
            self._tried = TRIED_SATURATIONS
        self._go_on_with(bank)
        self._place(frame, self._all_robots())

    def _all_robots(self) -> Bools:
        """Return that all robots are meant (N,)."""
        return np.ones(len(self.prior.a), dtype=np.bool_)


def warm_up(prior: Prior, starts: Poses) -> None:
    """Compile the functions of a filter bank, or load them from the cache."""
    filters = FilterBank(prior)
    valid = np.ones(len(prior.a), dtype=np.bool_)
    first = Observation(0, 0, 0, starts, valid)
    second = Observation(1, SPACING_NS, SPACING_NS, starts, valid)
    filters.add_frames(first)
    filters.forecast(0)
    filters.add_frames(second)
    filters.forecast(SPACING_NS)
