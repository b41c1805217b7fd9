"""How the filters of `tetractl.control.estimation.filter` follow robots from frame to frame.

Commands reach robots by radio: they act after a dead time, and a robot may miss one, or be stuck.

A *filter* follows one robot and assumes one dead time tau. As it cannot know what the robot is
doing, it keeps some *hypotheses*, each in a slot of its arrays (`filter_state.Hypotheses`): a state
z with its covariance, the direction u that the robot would follow, and, as `ln_weight`,

    w = ln P(hypothesis is true),    -inf for a slot without a hypothesis.

In the last slot, the robot is stuck: it stands whatever it is sent. In all others it drives, or
stands because it was commanded to.

`place` starts filters from the poses of a frame. `follow` takes them on from there: for each frame,
each robot and each filter it calls

    _predict         moves each hypothesis on to the time of the frame, by the motion's equations.
                     When a command acts on the way, hypotheses *branch* (`_branch`): the robot
                     heard it, and follows its direction from then on, or missed it, with the
                     probability `LOSS_PROBABILITY`
    _update          compares each hypothesis with the pose in the frame, by Bayes' rule:
                     w_s <- w_s + ln p(pose | s) - ln L,    L = sum_s exp(w_s) p(pose | s)
    _exchange_stuck  lets some probability pass from driving to being stuck, and back

and adds ln L to the filter's score, which is how well its tau does.

Symbols: b is a filter, i a robot, s a slot, and f a frame; u is a direction [rad], NaN to stand. A
time ends with `_s`: seconds on the clock of frames and commands, whose orders are those of their
times. The arrays of the bank and its hypotheses are changed in place. Shapes and units are those of
`filter_state`.
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
    FilterScratch,
    Hypotheses,
    X,
    Y,
)
from tetractl.control.search.kernels.elementary import cos, exp, log, sin
from tetractl.core import elementary
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import ENTRY_FAST, INLINE_FAST

ALIKE = 0.1
"""Squared difference of the headings of two hypotheses that are one, over the variance."""
LEAST_LN_WEIGHT = -25.0
"""Minimum ln of the probability of a hypothesis: its slot is not freed."""
LOST_TRACK_S = 0.3
"""Time without a fit after which the camera's pose is used [s]."""
SCALE_MEMORY = 400.0
"""Number of frames over which the noise is averaged."""
SCALE_LEAST = 1e-3
"""Minimum ratio of observed to expected variances."""
SCALE_MOST = 10.0
"""Greatest ratio of observed to expected variances."""
CAPPED_SQUARE = 4.0
"""Greatest square of a deviation that the average of the noise takes."""
MEAN_CAPPED = 0.8
"""Mean of such a square of a standard normal number, rounded."""
BLOCK_FRAMES = 8
"""Number of frames of a block of innovations."""
MOST_SQUARE = 25.0
"""Largest mean square of a block, five standard deviations."""
LN_HEARD = elementary.log(1 - LOSS_PROBABILITY)
"""ln of the probability that a robot hears a command."""
LN_MISSED = elementary.log(LOSS_PROBABILITY)
"""ln of the probability that it does not."""
HEARD = 0
"""Row of the branches in which the robot heard a command."""
MISSED = 1
"""Row of those in which it did not."""
NO_SLOT = -1
"""Stands for a slot where there is none."""


# ---- the start: from the poses of a frame ----


@compiled(**ENTRY_FAST)
def place(bank, model, commands, time_s, poses, placed):
    """Restart the robots `placed` from the poses of a frame.

    In every hypothesis, a robot gets the pose that was measured, and drives by the last command
    that takes effect at or before the time of its pose.

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
    """Set the pose of every hypothesis to a measured one (3,).

    It is as uncertain as two deviations of the camera's noise, and does not correlate with the
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
    """Let every hypothesis but the stuck one follow the last command that acts by a time."""
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
    """Return how many commands were sent at or before a time."""
    number = commands.sent_s.size
    while number > 0 and commands.sent_s[number - 1] > time_s:
        number -= 1
    return number


# ---- from frame to frame ----


@compiled(**ENTRY_FAST)
def follow(bank, model, commands, frames, noisy, step_s):
    """Take every filter through some frames.

    The filters are at the first frame, whose poses they know already. A pose is used for an update
    if it is valid and new. A camera may show old poses as new ones: if measurements are noisy, a
    pose equal to the one before is old, unless the camera is so coarse that poses repeat; and all
    poses of a frame that `_is_frozen` are old.

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
    filters, robots = bank.dead_time_s.shape
    ln_likelihoods = np.zeros((filters, robots))
    scratch = _scratch(bank.cov.shape[4])
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
    return ln_likelihoods


@compiled(**INLINE_FAST)
def _equal(pose, before):
    """Return whether two poses (3,) are equal."""
    return pose[X] == before[X] and pose[Y] == before[Y] and pose[HEADING] == before[HEADING]


@compiled(**INLINE_FAST)
def _is_frozen(bank, model, commands, frames, f):
    """Return whether the camera has shown the frame before again: all its poses are equal.

    They may also be equal because nothing moved, and then they count: a single robot may be stuck,
    and measured without noise; a coarse camera may not resolve the motion; and all robots may
    stand, if the last command that has acted by then, whatever the dead time, was a stop.
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
    """Predict the hypotheses of a filter from one time to another.

    They branch at each command that takes effect on the way.
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
            _branch(hypotheses, model, i, u, now_s, step_s)
            bank.next_command[b, i] += 1


@compiled(**INLINE_FAST)
def _next_acts_s(bank, commands, b, i):
    """Return when the next command takes effect in a filter [s]; infinity if there is none.

    That is its dead time after the command was sent.
    """
    command = bank.next_command[b, i]
    if command < commands.sent_s.size:
        return commands.sent_s[command] + bank.dead_time_s[b, i]
    return math.inf


@compiled(**INLINE_FAST)
def _predict_one(hypotheses, s, model, i, noise_scale, begin_s, end_s, scratch):
    """Predict one hypothesis: the robot drives until its watchdog stops it, then stands still."""
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
def _branch(hypotheses, model, i, u, now_s, step_s):
    """Branch hypotheses when a command to follow u acts: a robot heard it, or missed it.

    The controller has little time, and a command is rarely missed: it branches the likeliest
    hypothesis only. Logs have all branched, as their commands may act so soon after each other that
    frames do not show in between which of them was heard.
    """
    if model.branch_all:
        _branch_all(hypotheses, model, i, u, now_s, step_s)
    else:
        _branch_likeliest(hypotheses, model, i, u, now_s, step_s)


@compiled(**INLINE_FAST)
def _branch_likeliest(hypotheses, model, i, u, now_s, step_s):
    """Branch the likeliest hypothesis when a command to follow u acts.

    The branch that heard the command takes the slot of the least likely hypothesis,

        w_heard = w_likeliest + ln(1 - lost),

    and all others, the likeliest too, missed it: w <- w + ln(lost).

    If one of them follows u already, a robot that hears the command becomes that one. It then has
    the likeliest one's state with w_heard, if it was less likely than that; its watchdog starts
    again; and the others stay as they are.
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
def _branch_all(hypotheses, model, i, u, now_s, step_s):
    """Branch each hypothesis when a command to follow u acts, and keep the likeliest branches.

    Each hypothesis so far is the *parent* of two branches. From the likeliest on, each branch takes
    the next slot; but if its *twin* has one already, its probability is added to the twin's. When
    no slot is left, the other branches are dropped.
    """
    driving = hypotheses.ln_weight.size - 1
    parents = Hypotheses(
        state=hypotheses.state[:driving].copy(),
        cov=hypotheses.cov[:driving].copy(),
        direction=hypotheses.direction[:driving].copy(),
        until_s=hypotheses.until_s[:driving].copy(),
        ln_weight=hypotheses.ln_weight[:driving].copy(),
    )
    ln_branches = _ln_branches(parents, u)
    parent_of = np.empty(driving, np.int64)  # the parent of the branch in each slot taken
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
def _ln_branches(parents, u):
    """Return ln of the probabilities of the branches of each parent: (2, S), rows HEARD and MISSED.

        w_heard = w + ln(1 - lost),    w_missed = w + ln(lost).

    For a parent that follows u already, both are the same: it continues as HEARD, with all its
    probability.
    """
    number = parents.ln_weight.size
    ln_branches = np.empty((2, number))
    for s in range(number):
        if parents.direction[s] == u:
            ln_branches[HEARD, s] = parents.ln_weight[s]
            ln_branches[MISSED, s] = -math.inf
        else:
            ln_branches[HEARD, s] = parents.ln_weight[s] + LN_HEARD
            ln_branches[MISSED, s] = parents.ln_weight[s] + LN_MISSED
    return ln_branches


@compiled(**INLINE_FAST)
def _likeliest_branch(ln_branches):
    """Return row and column of the likeliest branch; of equals, HEARD comes first."""
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
    """Return the slot of the twin of a branch that follows u, NO_SLOT if there is none.

    A twin follows the same direction, and the headings of their parents differ little compared with
    their uncertainty: whichever of the two is true, the robot moves in the same way from now on.
    The branches in the slots taken come from the parents `parent_of`; the first twin counts.
    """
    variance = parents.cov[parent, HEADING, HEADING]
    for slot in range(parent_of.size):
        gap = parents.state[parent_of[slot], HEADING] - parents.state[parent, HEADING]
        if gap * gap < ALIKE * variance and hypotheses.direction[slot] == u:
            return slot
    return NO_SLOT


@compiled(**INLINE_FAST)
def _slot_that_follows(hypotheses, u):
    """Return the first hypothesis that follows u, the stuck one aside; NO_SLOT if there is none."""
    for s in range(hypotheses.ln_weight.size - 1):
        if hypotheses.direction[s] == u and not is_none(hypotheses.ln_weight[s]):
            return s
    return NO_SLOT


@compiled(**INLINE_FAST)
def _followed(hypotheses, s, now_s):
    """Return the direction that a robot follows now: NaN once its watchdog has stopped it."""
    if now_s < hypotheses.until_s[s]:
        return hypotheses.direction[s]
    return math.nan


@compiled(**INLINE_FAST)
def _hear(hypotheses, s, model, i, u_before, u, now_s, step_s):
    """Let the robot of one hypothesis hear the command to follow u, instead of `u_before`.

    When it did so is as uncertain as the dead time, which is anywhere within a step of the grid. A
    time that is spread evenly over step_s has the variance step_s^2 / 12; in that time, the robot
    turns at the one rate or at the other, and if it starts or stops, drives or stands.
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
    """Return dtheta/dt of a robot that follows u [rad/s]; 0 if it stands, u = NaN."""
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
    """Update the hypotheses of a filter by a pose, and return ln of the pose's likelihood.

    The innovation nu of the likeliest hypothesis, which is the measured minus the expected pose
    over its deviation, then says how well the filter does. If |nu|^2 is within the gate, the pose
    fits: it tells how large the noise is, and whether the model is right. Otherwise it is an
    outlier. If outliers last longer than any fault of a camera, the filter has lost the robot, and
    restarts from the pose.

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

    Then the sum of the probabilities is 1. After that, a w below `LEAST_LN_WEIGHT` is raised to it:
    what the robot does not do now may become true again. The `innovation` (3,) of the likeliest
    hypothesis is filled.
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
    """Return the ratio r of observed to expected variances after one more squared innovation q.

        r <- r (1 + (min(q, q_max) / E - 1) / n),    E = E[min(q, q_max)], if the noise is right.

    It is an average over some n frames, in which outliers count no more than q_max.
    """
    change = min(square, CAPPED_SQUARE) / MEAN_CAPPED - 1
    scale = scale * (1 + change / SCALE_MEMORY)
    return min(max(scale, SCALE_LEAST), SCALE_MOST)


@compiled(**INLINE_FAST)
def _add_to_block(bank, b, i, innovation):
    """Add an innovation nu (3,) to the present block of K frames.

    When a block is full, it is added to the sum over blocks that tests the model:

        square_sum <- square_sum + min((sum_block nu)^2 / K, most_square).

    If the model is right, innovations are independent, and the square is 1 on average. If it is
    wrong, those of a block have the same sign, and the square is larger.
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
    """Exchange probability between the likeliest driving hypothesis and the stuck one.

    A robot that drives gets stuck once in `every_s`, and a stuck one comes free after `for_s`, both
    on average. In the `seconds` until now, this happens with the probabilities

        p_stick = seconds / every_s,    p_free = seconds / for_s,    at most 1/2 each.

    Where two hypotheses become one, the state and w of the likelier one count. One of three things
    is done:

        it comes free   if w_stuck + ln p_free > w_likeliest, the likeliest takes the stuck state:
                        w_likeliest <- w_stuck + ln p_free,    w_stuck <- w_stuck + ln(1 - p_free)
        it gets stuck   else if w_likeliest + ln p_stick > w_stuck + ln(1 - p_free), the stuck one
                        takes the likeliest state: w_stuck <- w_likeliest + ln p_stick
        neither         w_stuck <- w_stuck + ln(1 - p_free)

    If the likeliest hypothesis does not drive, being stuck and standing still are the same, and no
    robot is stuck.
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
    """Let the pose of a stuck robot become more uncertain: it may stray, and turn (`Sticks`)."""
    strays2 = sticks.strays * sticks.strays
    turns2 = sticks.turns * sticks.turns
    cov[X, X] += strays2 * seconds
    cov[Y, Y] += strays2 * seconds
    cov[HEADING, HEADING] += turns2 * seconds


# ---- scores ----


@compiled(**INLINE_FAST)
def _relate_scores(bank, i):
    """Let a robot's scores be 0 for its best filter, so that their exponentials are numbers."""
    filters = bank.score.shape[0]
    largest = -math.inf
    for b in range(filters):
        largest = max(largest, bank.score[b, i])
    for b in range(filters):
        bank.score[b, i] -= largest


# ---- hypotheses in arrays ----


@compiled(**INLINE_FAST)
def is_none(ln_probability):
    """Return whether a slot with this ln of a probability has no hypothesis, or a row no filter.

    That is so for minus infinity and for NaN.
    """
    return not ln_probability > -math.inf


@compiled(**INLINE_FAST)
def _hypotheses(bank, b, i):
    """Return the hypotheses of one filter of a robot, to be read and changed in place."""
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

    They are copied number by number: arrays that are assigned whole take seconds to compile.
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
    """Return the index of the largest of the first `count` logarithms, the first one of equals."""
    best = 0
    for s in range(1, count):
        if ln[s] > ln[best]:
            best = s
    return best


@compiled(**INLINE_FAST)
def _least_likely(ln, count):
    """Return the index of the smallest of the first `count` logarithms, the first one of equals."""
    least = 0
    for s in range(1, count):
        if ln[s] < ln[least]:
            least = s
    return least


@compiled(**INLINE_FAST)
def _scratch(states):
    """Return room for predictions and updates of hypotheses with some number of states."""
    return FilterScratch(
        jacobian=np.eye(states),
        product=np.empty((states, states)),
        p_h=np.empty(states),
        expected=np.empty(3),
        off=np.empty(3),
        variance=np.empty(3),
        slopes=np.zeros((3, states)),
        innovation=np.zeros(3),
        likeliest_innovation=np.zeros(3),
    )
