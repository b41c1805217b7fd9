"""Follow each robot from frame to frame with filters that allow for missed commands.

This is the compiled part of `tetractl.control.estimation.filter`. Commands reach robots by radio.
They act after a dead time, a robot may miss one, and a robot may be stuck.

A *filter* follows one robot and assumes one dead time tau. Since the filter cannot know what the
robot is doing, it keeps several *hypotheses*, each in a slot of its arrays
(`filter_state.Hypotheses`). A hypothesis consists of a state z with its covariance, of the
direction u that the robot would follow, and, as `ln_weight`, of

    w = ln P(hypothesis is true),    -inf for a slot without a hypothesis.

In the last slot, the robot is stuck: it stands still whatever it is sent. In all other slots, it
drives, or stands still because it was commanded to.

`place` starts filters from the poses of a frame. `follow` continues from there: for each frame,
each robot and each filter, it calls

    _predict         moves each hypothesis to the time of the frame, by the equations of motion.
                     When a command acts in between, hypotheses *branch* (`_branch`): the robot
                     received the command, and follows its direction from that moment; or it missed
                     the command, with the probability `LOSS_PROBABILITY`
    _update          compares each hypothesis with the pose in the frame, by Bayes' rule:
                     w_s <- w_s + ln p(pose | s) - ln L,    L = sum_s exp(w_s) p(pose | s)
    _exchange_stuck  moves some probability from driving to being stuck, and back

and adds ln L to the filter's score, which measures how well its dead time explains the frames.

Symbols: b is a filter, i a robot, s a slot, and f a frame. u is a direction [rad], NaN if the robot
is to stand still. Names that end in `_s` are times in seconds on the common clock of frames and
commands, which come in the order of their times. The arrays of the bank and of its hypotheses are
changed in place. Shapes and units are explained in `filter_state`.
"""

import math

import numpy as np

from tetractl.control.estimation.kernels.filter_measure import measure
from tetractl.control.estimation.kernels.filter_motion import (
    advance,
    parameters_of,
    stands,
    turn_rate,
)
from tetractl.control.estimation.kernels.filter_state import (
    ACROSS,
    ALONG,
    GATE,
    HEADING,
    HEADINGS,
    LOSS_PROBABILITY,
    MARKER_BIAS,
    POSITIONS,
    TURN_BIAS,
    Bank,
    FilterModel,
    FilterScratch,
    Hypotheses,
    PoseFrames,
    SentCommands,
    X,
    Y,
)
from tetractl.control.search.kernels.elementary import cos, exp, log, sin
from tetractl.core import elementary
from tetractl.core.poses import Floats
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import ENTRY_FAST, INLINE_FAST

ALIKE = 0.1
"""Maximum of (difference of headings)^2 / variance at which two hypotheses are merged into one."""
LEAST_LN_WEIGHT = -25.0
"""Minimum ln of the probability of a hypothesis.

A hypothesis at the minimum stays in its slot.
"""
LOST_TRACK_S = 0.3
"""Time for which no pose has fitted, after which a filter restarts from the measured pose [s]."""
SCALE_MEMORY = 400.0
"""Number of frames over which the ratio of observed to expected variances is averaged."""
SCALE_LEAST = 1e-3
"""Minimum ratio of observed to expected variances."""
SCALE_MOST = 10.0
"""Maximum ratio of observed to expected variances."""
CAPPED_SQUARE = 4.0
"""Maximum of the squared innovation that enters the average of the noise, against outliers."""
MEAN_CAPPED = 0.8
"""Mean of the square of a standard normal number, if it is limited to CAPPED_SQUARE; rounded."""
BLOCK_FRAMES = 8
"""Number of frames whose innovations are added up to one block, for the test of the model."""
MOST_SQUARE = 25.0
"""Maximum mean square of a block that enters the test of the model: five standard deviations."""
LN_HEARD = elementary.log(1 - LOSS_PROBABILITY)
"""ln of the assumed probability that a robot receives a command."""
LN_MISSED = elementary.log(LOSS_PROBABILITY)
"""ln of the assumed probability that a robot misses a command."""
HEARD = 0
"""Row of the branches in which the robot received a command."""
MISSED = 1
"""Row of the branches in which the robot missed a command."""
NO_SLOT = -1
"""Stands for "no slot", where the index of a slot is expected."""


# ---- the start: from the poses of a frame ----


@compiled(**ENTRY_FAST)
def place(bank, model, commands, time_s, poses, placed):
    """Restart the robots `placed` from the poses of a frame.

    Every hypothesis gets the measured pose, and the last command that took effect at or before the
    time of this pose.

    Args:
        bank: The filters.
        model: The assumptions about the robots.
        commands: The commands that were sent.
        time_s: The time of each robot's pose (N,) [s].
        poses: The measured poses (N, 3).
        placed: Whether each robot is restarted (N,).
    """
    for i in range(placed.size):
        if not placed[i]:
            continue
        for b in range(bank.dead_time_s.shape[0]):
            _set_pose(bank, model, b, i, poses[i])
            _follow_last(bank, model, commands, b, i, time_s[i])


@compiled(**INLINE_FAST)
def _set_pose(bank, model, b, i, pose):
    """Set a robot's pose to a measured pose (3,), in every hypothesis of one of its filters.

    Its standard deviation becomes twice the camera's noise, and it no longer correlates with the
    other states.
    """
    bank.unfit_s[b, i] = 0.0
    for s in range(bank.ln_weight.shape[2]):
        z = bank.state[b, i, s]
        cov = bank.cov[b, i, s]
        z[X] = pose[X]
        z[Y] = pose[Y]
        z[HEADING] = pose[HEADING] - z[MARKER_BIAS]
        for row in (X, Y, HEADING):
            for column in range(cov.shape[0]):
                cov[row, column] = 0.0
                cov[column, row] = 0.0
            cov[row, row] = 4 * np.square(model.noise[row, i])


@compiled(**INLINE_FAST)
def _follow_last(bank, model, commands, b, i, time_s):
    """Let all hypotheses except the stuck one follow the last command acting at a time.

    If no command had acted by then, nothing changes.
    """
    dead_time_s = bank.dead_time_s[b, i]
    number = _number_sent_by(commands, time_s - dead_time_s)
    if number == 0:
        return
    bank.next_command[b, i] = number
    for s in range(bank.ln_weight.shape[2] - 1):
        bank.direction[b, i, s] = commands.directions[number - 1]
        bank.until_s[b, i, s] = commands.sent_s[number - 1] + model.watchdog_s + dead_time_s


@compiled(**INLINE_FAST)
def _number_sent_by(commands, time_s):
    """Count the commands that were sent at or before a time."""
    number = commands.sent_s.size
    while number > 0 and commands.sent_s[number - 1] > time_s:
        number -= 1
    return number


# ---- from frame to frame ----


def follow(
    bank: Bank,
    model: FilterModel,
    commands: SentCommands,
    frames: PoseFrames,
    noisy: bool,
    step_s: float,
) -> Floats:
    """Advance every filter through some frames.

    The filters start at the first frame, whose poses they already know. A pose is used for an
    update if it is valid and new. A camera may repeat old poses as if they were new. Two rules find
    them: if measurements are noisy, a pose that equals the previous one is old, unless the camera
    is so coarse that poses may repeat; and all poses of a frame that `_is_frozen` are old.

    Args:
        bank: The filters.
        model: The assumptions about the robots.
        commands: The commands that were sent.
        frames: The frames, as `PoseFrames`.
        noisy: Whether measurements have noise.
        step_s: The distance between the dead times of a robot [s].

    Returns:
        The ln of the likelihood of each robot's poses by each of its filters (B, N).
    """
    ln_likelihoods = np.zeros(bank.dead_time_s.shape)
    scratch = FilterScratch.room_for(bank)
    _follow(bank, model, commands, frames, noisy, step_s, scratch, ln_likelihoods)
    return ln_likelihoods


@compiled(**ENTRY_FAST)
def _follow(bank, model, commands, frames, noisy, step_s, scratch, ln_likelihoods):
    """Advance every filter through some frames; see `follow`.

    The ln of the likelihoods is added to `ln_likelihoods`, shape (B, N).
    """
    filters, robots = bank.dead_time_s.shape
    for f in range(1, frames.time_s.shape[0]):
        frozen = _is_frozen(bank, model, commands, frames, f)
        for i in range(robots):
            before_s = frames.time_s[f - 1, i]
            now_s = frames.time_s[f, i]
            if now_s <= before_s:
                continue  # this robot's pose is no newer than in the frame before
            seconds = now_s - before_s
            pose = frames.poses[f, i]
            repeated = noisy and not model.coarse and _equal(pose, frames.poses[f - 1, i])
            used = frames.valid[f, i] and not frozen and not repeated
            for b in range(filters):
                if is_none(bank.score[b, i]):
                    continue  # there is no filter in this row
                _predict(bank, model, commands, b, i, before_s, now_s, step_s, scratch)
                if used:
                    ln_likelihood = _update(bank, model, b, i, pose, seconds, scratch)
                    ln_likelihoods[b, i] += ln_likelihood
                    bank.score[b, i] += ln_likelihood
                _exchange_stuck(_hypotheses(bank, b, i), model, seconds, now_s)
            _relate_scores(bank, i)


@compiled(**INLINE_FAST)
def _equal(pose, before):
    """Check whether two poses (3,) are equal to the last bit."""
    return pose[X] == before[X] and pose[Y] == before[Y] and pose[HEADING] == before[HEADING]


@compiled(**INLINE_FAST)
def _is_frozen(bank, model, commands, frames, f):
    """Check whether the camera has repeated the previous frame: all poses of the two are equal.

    Poses may also be equal because nothing moved, and then the frame counts as new. This is the
    case in three situations: there is a single robot, measured without noise, which may be stuck;
    the camera is too coarse to resolve the motion; or all robots stand still, because the last
    command that has acted for every possible dead time was a stop.
    """
    robots = len(model.parameters)
    if robots == 1 or model.coarse:
        return False
    for i in range(robots):
        if not _equal(frames.poses[f, i], frames.poses[f - 1, i]):
            return False
    first_s = frames.time_s[f - 1, 0]  # the earliest pose of the frame before
    for i in range(1, robots):
        first_s = min(first_s, frames.time_s[f - 1, i])
    longest_s = 0.0  # the longest dead time
    for b in range(bank.dead_time_s.shape[0]):
        for i in range(robots):
            longest_s = max(longest_s, bank.dead_time_s[b, i])
    number = _number_sent_by(commands, first_s - longest_s)
    stopped = number > 0 and stands(commands.directions[number - 1])
    return not stopped


# ---- predict ----


@compiled(**INLINE_FAST)
def _predict(bank, model, commands, b, i, begin_s, end_s, step_s, scratch):
    """Predict, under each hypothesis of a filter, how its robot moves from one time to another.

    Hypotheses branch at each command that takes effect in between: it was received, or missed.
    """
    hypotheses = _hypotheses(bank, b, i)
    noise_scale = bank.noise_scale[b, i]
    now_s = begin_s
    while now_s < end_s:
        acts_s = _next_acts_s(bank, commands, b, i)
        acts = acts_s <= end_s  # false for NaN, too
        next_s = max(now_s, acts_s) if acts else end_s
        for s in range(hypotheses.ln_weight.size):
            if not is_none(hypotheses.ln_weight[s]):
                _predict_one(hypotheses, s, model, i, noise_scale, now_s, next_s, scratch)
        now_s = next_s
        if acts:
            u = commands.directions[bank.next_command[b, i]]
            _branch(hypotheses, model, i, u, now_s, step_s, scratch)
            bank.next_command[b, i] += 1


@compiled(**INLINE_FAST)
def _next_acts_s(bank, commands, b, i):
    """Return when the next command takes effect in a filter [s]. Infinity if there is none.

    This is the time at which the command was sent, plus the filter's dead time.
    """
    command = bank.next_command[b, i]
    if command < commands.sent_s.size:
        return commands.sent_s[command] + bank.dead_time_s[b, i]
    return math.inf


@compiled(**INLINE_FAST)
def _predict_one(hypotheses, s, model, i, noise_scale, begin_s, end_s, scratch):
    """Predict a robot under one hypothesis: it drives until its watchdog stops it."""
    z = hypotheses.state[s]
    cov = hypotheses.cov[s]
    stops_s = min(max(hypotheses.until_s[s], begin_s), end_s)
    driving = (hypotheses.direction[s], stops_s - begin_s)
    standing = (math.nan, end_s - stops_s)
    for u, seconds in (driving, standing):
        if seconds > 0:
            advance(model, i, z, cov, u, noise_scale, seconds, scratch)


# ---- a command acts: hypotheses branch ----


@compiled(**INLINE_FAST)
def _branch(hypotheses, model, i, u, now_s, step_s, scratch):
    """Split hypotheses when a command to follow u acts: the robot received it, or missed it.

    A controller has little time, and a command is rarely missed, so it branches only the likeliest
    hypothesis. The evaluation of a log branches all of them, because the commands in a log may act
    so soon after each other that no frame in between shows which of them the robot received.
    """
    if model.branch_all:
        _branch_all(hypotheses, model, i, u, now_s, step_s, scratch)
    else:
        _branch_likeliest(hypotheses, model, i, u, now_s, step_s)


@compiled(**INLINE_FAST)
def _branch_likeliest(hypotheses, model, i, u, now_s, step_s):
    """Split only the likeliest hypothesis, when a command to follow u acts.

    The branch in which the robot received the command takes the slot of the least likely
    hypothesis,

        w_heard = w_likeliest + ln(1 - lost).

    In all other hypotheses, including the likeliest one, the robot missed it: w <- w + ln(lost).
    If some hypothesis already follows u, a robot that receives the command continues as that
    hypothesis. If that hypothesis is less likely than w_heard, it takes the state of the likeliest
    one and w_heard. In both cases its watchdog starts again, and the other hypotheses stay as they
    are.
    """
    driving = hypotheses.ln_weight.size - 1
    best = likeliest(hypotheses.ln_weight, driving)
    ln_heard_weight = hypotheses.ln_weight[best] + LN_HEARD
    follower = _slot_that_follows(hypotheses, u)
    if follower != NO_SLOT:
        if hypotheses.ln_weight[follower] < ln_heard_weight:
            _copy_state(hypotheses, best, hypotheses, follower)
            hypotheses.ln_weight[follower] = ln_heard_weight
        hypotheses.until_s[follower] = now_s + model.watchdog_s
        return
    u_before = _followed(hypotheses, best, now_s)
    least = _least_likely(hypotheses.ln_weight, driving)
    for s in range(driving):
        hypotheses.ln_weight[s] += LN_MISSED
    _copy_state(hypotheses, best, hypotheses, least)
    _hear(hypotheses, least, model, i, u_before, u, now_s, step_s)
    hypotheses.ln_weight[least] = ln_heard_weight


@compiled(**INLINE_FAST)
def _branch_all(hypotheses, model, i, u, now_s, step_s, scratch):
    """Split each hypothesis when a command to follow u acts, and keep the likeliest ones.

    Each hypothesis so far is the *parent* of two branches: command received, command missed. The
    branches take the slots in the order of their probabilities. If an equivalent branch, the
    *twin*, already has a slot, the probability is added to the twin's instead. When no slot is
    left, the remaining branches are dropped.
    """
    driving = hypotheses.ln_weight.size - 1
    parents = scratch.parents
    for s in range(driving):
        _copy_state(hypotheses, s, parents, s)
        parents.direction[s] = hypotheses.direction[s]
        parents.until_s[s] = hypotheses.until_s[s]
        parents.ln_weight[s] = hypotheses.ln_weight[s]
    ln_branches = scratch.ln_branches
    _fill_ln_branches(parents, u, ln_branches)
    parent_of = scratch.parent_of
    for s in range(driving):
        hypotheses.ln_weight[s] = -math.inf
    taken = 0  # number of slots taken, from the first on
    for _ in range(ln_branches.size):
        row, parent = _likeliest_branch(ln_branches)
        ln_weight = ln_branches[row, parent]
        ln_branches[row, parent] = -math.inf  # it is not the likeliest again
        if is_none(ln_weight):
            continue
        u_of_branch = u if row == HEARD else parents.direction[parent]
        twin = _find_twin(parents, parent, u_of_branch, hypotheses, parent_of[:taken])
        if twin != NO_SLOT:
            # ln(exp(w_twin) + exp(w))
            gap = ln_weight - hypotheses.ln_weight[twin]
            hypotheses.ln_weight[twin] += log(1 + exp(gap))
        elif taken < driving:
            _copy_state(parents, parent, hypotheses, taken)
            hypotheses.ln_weight[taken] = ln_weight
            if row == HEARD:
                u_before = _followed(parents, parent, now_s)
                _hear(hypotheses, taken, model, i, u_before, u, now_s, step_s)
            else:
                hypotheses.direction[taken] = parents.direction[parent]
                hypotheses.until_s[taken] = parents.until_s[parent]
            parent_of[taken] = parent
            taken += 1


@compiled(**INLINE_FAST)
def _fill_ln_branches(parents, u, ln_branches):
    """Fill the ln of the probabilities of each parent's branches: (2, S), rows HEARD and MISSED.

        w_heard = w + ln(1 - lost),    w_missed = w + ln(lost).

    For a parent that already follows u, both branches are the same. It continues as HEARD, with its
    whole probability.
    """
    for s in range(parents.ln_weight.size):
        if parents.direction[s] == u:
            ln_branches[HEARD, s] = parents.ln_weight[s]
            ln_branches[MISSED, s] = -math.inf
        else:
            ln_branches[HEARD, s] = parents.ln_weight[s] + LN_HEARD
            ln_branches[MISSED, s] = parents.ln_weight[s] + LN_MISSED


@compiled(**INLINE_FAST)
def _likeliest_branch(ln_branches):
    """Return row and column of the likeliest branch, the outcome of one command.

    If branches are equal, HEARD (the robot received the command) comes first.
    """
    best_row = 0
    best_s = 0
    for row in range(ln_branches.shape[0]):
        for s in range(ln_branches.shape[1]):
            if ln_branches[row, s] > ln_branches[best_row, best_s]:
                best_row = row
                best_s = s
    return best_row, best_s


@compiled(**INLINE_FAST)
def _find_twin(parents, parent, u, hypotheses, parent_of):
    """Find the slot of an equivalent branch that also follows u. NO_SLOT if there is none.

    Two branches are twins if they follow the same direction, and if the headings of their parents
    differ little compared with their uncertainty. Then the robot moves in the same way from now on,
    whichever of the two is true. `parent_of` contains the parent of the branch in each slot that is
    taken. If there are several twins, the first one counts.
    """
    variance = parents.cov[parent, HEADING, HEADING]
    for slot in range(parent_of.size):
        gap = parents.state[parent_of[slot], HEADING] - parents.state[parent, HEADING]
        if gap * gap < ALIKE * variance and hypotheses.direction[slot] == u:
            return slot
    return NO_SLOT


@compiled(**INLINE_FAST)
def _slot_that_follows(hypotheses, u):
    """Return the first slot, except the stuck one, of a hypothesis that follows u.

    The result is NO_SLOT if there is none.
    """
    for s in range(hypotheses.ln_weight.size - 1):
        if hypotheses.direction[s] == u and not is_none(hypotheses.ln_weight[s]):
            return s
    return NO_SLOT


@compiled(**INLINE_FAST)
def _followed(hypotheses, s, now_s):
    """Return the direction [rad] that a robot follows now, under the hypothesis in slot s.

    NaN if the robot stands still, because it was commanded to or because its watchdog has stopped
    it.
    """
    if now_s < hypotheses.until_s[s]:
        return hypotheses.direction[s]
    return math.nan


@compiled(**INLINE_FAST)
def _hear(hypotheses, s, model, i, u_before, u, now_s, step_s):
    """Let the robot follow u instead of `u_before`, in a hypothesis that it received u.

    The moment at which this happened is uncertain, because the true dead time is anywhere within a
    step of the grid. A time that is uniform over step_s has the variance step_s^2 / 12. During this
    time, the robot turns at the old rate or at the new one; if it starts or stops, it drives or
    stands still. Heading and position therefore become more uncertain.
    """
    hypotheses.direction[s] = u
    hypotheses.until_s[s] = now_s + model.watchdog_s
    z = hypotheses.state[s]
    cov = hypotheses.cov[s]
    rate_change = _turning_rate(model, i, z, u) - _turning_rate(model, i, z, u_before)
    cov[HEADING, HEADING] += np.square(step_s * rate_change) / 12
    if stands(u_before) != stands(u):
        speed = parameters_of(model, i, z)[1]
        cov[X, X] += np.square(step_s * speed) / 12
        cov[Y, Y] += np.square(step_s * speed) / 12


@compiled(**INLINE_FAST)
def _turning_rate(model, i, z, u):
    """Compute dtheta/dt of a robot that follows u [rad/s].

    It is 0 if u is NaN, because the robot then stands still.
    """
    if stands(u):
        return 0.0
    parameters = parameters_of(model, i, z)
    goal = u + z[TURN_BIAS]
    cosine = cos(z[HEADING])
    sine = sin(z[HEADING])
    a = turn_rate(cosine, sine, cos(goal), sin(goal), parameters, 0.0)[0]
    return a * sin(goal - z[HEADING])  # (3)


# ---- update ----


@compiled(**INLINE_FAST)
def _update(bank, model, b, i, pose, seconds, scratch):
    """Update a filter by a measured pose, and return the logarithm of the pose's likelihood.

    The innovation nu is the measured minus the expected pose, divided by its standard deviation.
    The innovation of the likeliest hypothesis shows how well the filter fits. If |nu|^2 is within
    the gate, the pose fits, and it contributes to the estimate of the noise and to the test of the
    model. Otherwise, the pose is an outlier. If outliers last longer than any fault of a camera,
    the filter has lost the robot, and restarts from the pose.

    Args:
        bank: The filters.
        model: The assumptions about the robots.
        b: The index of the filter.
        i: The index of the robot.
        pose: The measured pose (3,).
        seconds: The time since the previous pose [s].
        scratch: Arrays to work in.
    """
    noise_scale = bank.noise_scale[b, i]
    innovation = scratch.likeliest_innovation
    hypotheses = _hypotheses(bank, b, i)
    ln_likelihood = _update_hypotheses(hypotheses, model, i, noise_scale, pose, scratch, innovation)
    square_xy = np.square(innovation[ALONG]) + np.square(innovation[ACROSS])
    square_heading = np.square(innovation[HEADING])
    if square_xy + square_heading <= GATE:
        bank.unfit_s[b, i] = 0.0
        noise_scale[POSITIONS] = _scale_after(noise_scale[POSITIONS], 0.5 * square_xy)
        noise_scale[HEADINGS] = _scale_after(noise_scale[HEADINGS], square_heading)
        _add_to_block(bank, b, i, innovation)
    else:
        bank.unfit_s[b, i] += seconds
        if bank.unfit_s[b, i] > LOST_TRACK_S:
            _set_pose(bank, model, b, i, pose)
    return ln_likelihood


@compiled(**INLINE_FAST)
def _update_hypotheses(hypotheses, model, i, noise_scale, pose, scratch, innovation):
    """Update states and probabilities by a pose, and return ln L, the ln of the pose's likelihood.

        w_s <- w_s + ln p(pose | s) - ln L,    ln L = ln sum_s exp(w_s) p(pose | s)

    The sum of the probabilities is then 1. After that, a w below `LEAST_LN_WEIGHT` is raised to
    this value, so that a hypothesis that is improbable now can become probable again. The
    `innovation` (3,) of the likeliest hypothesis is filled.
    """
    ln_weight = hypotheses.ln_weight
    largest = -math.inf
    for s in range(ln_weight.size):
        if not is_none(ln_weight[s]):
            z = hypotheses.state[s]
            cov = hypotheses.cov[s]
            ln_weight[s] += measure(model, i, z, cov, noise_scale, pose, scratch)
            if ln_weight[s] > largest:
                largest = ln_weight[s]
                for j in range(3):
                    innovation[j] = scratch.innovation[j]
    total = 0.0
    for s in range(ln_weight.size):
        total += exp(ln_weight[s] - largest)  # none is above 1: no sum overflows
    ln_likelihood = largest + log(total)
    for s in range(ln_weight.size):
        if not is_none(ln_weight[s]):
            ln_weight[s] = max(ln_weight[s] - ln_likelihood, LEAST_LN_WEIGHT)
    return ln_likelihood


@compiled(**INLINE_FAST)
def _scale_after(scale, square):
    """Update the ratio r of observed to expected variances by one more squared innovation q.

        r <- r (1 + (min(q, q_max) / E - 1) / n),    E = E[min(q, q_max)], if the noise is right.

    The ratio is an average over about n frames, in which an outlier counts no more than q_max. It
    stays between SCALE_LEAST and SCALE_MOST.
    """
    change = min(square, CAPPED_SQUARE) / MEAN_CAPPED - 1
    scale = scale * (1 + change / SCALE_MEMORY)
    return min(max(scale, SCALE_LEAST), SCALE_MOST)


@compiled(**INLINE_FAST)
def _add_to_block(bank, b, i, innovation):
    """Add an innovation nu (3,), measured minus expected pose, to the present block of K frames.

    When a block is full, its square is added to the sum that tests the model:

        square_sum <- square_sum + min((sum_block nu)^2 / K, most_square).

    If the model is right, innovations are independent, and the square is 1 on average. If the model
    is wrong, the innovations of a block have the same sign, and the square is larger.
    """
    block_sum = bank.block_sum[b, i]
    for j in range(3):
        block_sum[j] += innovation[j]
    bank.block_frames[b, i] += 1
    if bank.block_frames[b, i] < BLOCK_FRAMES:
        return
    for j in range(3):
        mean_square = np.square(block_sum[j]) / BLOCK_FRAMES
        bank.square_sum[b, i, j] += min(mean_square, MOST_SQUARE)
        block_sum[j] = 0.0
    bank.blocks[b, i] += 1
    bank.block_frames[b, i] = 0.0


# ---- stuck or driving ----


@compiled(**INLINE_FAST)
def _exchange_stuck(hypotheses, model, seconds, now_s):
    """Move probability between two hypotheses: that a robot drives, and that it is stuck.

    On average, a robot that drives gets stuck once in `every_s`, and a stuck robot comes free after
    `for_s`. In the `seconds` until now, this happens with the probabilities

        p_stick = seconds / every_s,    p_free = seconds / for_s,    at most 1/2 each.

    When two hypotheses are merged into one, it gets the state and w of the likelier one. There are
    three cases:

        it comes free   if w_stuck + ln p_free > w_likeliest, the likeliest takes the stuck state:
                        w_likeliest <- w_stuck + ln p_free,    w_stuck <- w_stuck + ln(1 - p_free)
        it gets stuck   else if w_likeliest + ln p_stick > w_stuck + ln(1 - p_free), the stuck one
                        takes the likeliest state: w_stuck <- w_likeliest + ln p_stick
        neither         w_stuck <- w_stuck + ln(1 - p_free)

    If the robot of the likeliest hypothesis stands still anyway, being stuck makes no difference,
    and no robot is stuck.
    """
    ln_weight = hypotheses.ln_weight
    stuck = ln_weight.size - 1
    best = likeliest(ln_weight, stuck)
    if stands(hypotheses.direction[best]) or hypotheses.until_s[best] <= now_s:
        ln_weight[stuck] = -math.inf
        return
    _stray(hypotheses.cov[stuck], model.sticks, seconds)
    p_free = min(0.5, seconds / model.sticks.for_s)
    p_stick = min(0.5, seconds / model.sticks.every_s)
    ln_comes_free = ln_weight[stuck] + log(p_free)
    ln_stays_stuck = ln_weight[stuck] + log(1 - p_free)
    ln_gets_stuck = ln_weight[best] + log(p_stick)
    if ln_comes_free > ln_weight[best]:
        _copy_state(hypotheses, stuck, hypotheses, best)
        ln_weight[best] = ln_comes_free
        ln_weight[stuck] = ln_stays_stuck
    elif ln_gets_stuck > ln_stays_stuck:
        _copy_state(hypotheses, best, hypotheses, stuck)
        ln_weight[stuck] = ln_gets_stuck
    else:
        ln_weight[stuck] = ln_stays_stuck


@compiled(**INLINE_FAST)
def _stray(cov, sticks, seconds):
    """Increase the uncertainty of a stuck robot's pose, as it may drift and turn (`Sticks`)."""
    strays2 = sticks.strays * sticks.strays
    turns2 = sticks.turns * sticks.turns
    cov[X, X] += strays2 * seconds
    cov[Y, Y] += strays2 * seconds
    cov[HEADING, HEADING] += turns2 * seconds


# ---- scores ----


@compiled(**INLINE_FAST)
def _relate_scores(bank, i):
    """Subtract the best score from all scores of a robot: their exponentials cannot underflow."""
    filters = bank.score.shape[0]
    largest = -math.inf
    for b in range(filters):
        largest = max(largest, bank.score[b, i])
    for b in range(filters):
        bank.score[b, i] -= largest


# ---- hypotheses in arrays ----


@compiled(**INLINE_FAST)
def is_none(ln_probability):
    """Check whether a slot is empty, given its ln of a probability: minus infinity or NaN.

    The same test shows whether a row of the bank has no filter.
    """
    return not ln_probability > -math.inf


@compiled(**INLINE_FAST)
def _hypotheses(bank, b, i):
    """Return a view of a filter's hypotheses about its robot, which can be changed in place."""
    return Hypotheses(
        state=bank.state[b, i],
        cov=bank.cov[b, i],
        direction=bank.direction[b, i],
        until_s=bank.until_s[b, i],
        ln_weight=bank.ln_weight[b, i],
    )


@compiled(**INLINE_FAST)
def _copy_state(source, from_slot, target, to_slot):
    """Copy the state and covariance of a hypothesis of `source` to a slot of `target`.

    The copy is made number by number, because the assignment of whole arrays takes seconds to
    compile.
    """
    z = source.state[from_slot]
    cov = source.cov[from_slot]
    z_copy = target.state[to_slot]
    cov_copy = target.cov[to_slot]
    for k in range(z.size):
        z_copy[k] = z[k]
    for row in range(cov.shape[0]):
        for column in range(cov.shape[0]):
            cov_copy[row, column] = cov[row, column]


@compiled(**INLINE_FAST)
def likeliest(ln, count):
    """Return the index of the largest of the first `count` logarithms. The first one wins a tie."""
    best = 0
    for s in range(1, count):
        if ln[s] > ln[best]:
            best = s
    return best


@compiled(**INLINE_FAST)
def _least_likely(ln, count):
    """Return the index of the smallest of the first `count` logarithms.

    The first one wins a tie.
    """
    least = 0
    for s in range(1, count):
        if ln[s] < ln[least]:
            least = s
    return least
