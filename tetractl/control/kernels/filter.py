"""How the filters of `tetractl.control.filter` follow robots from frame to frame.

Each filter b of robot i has a dead time tau and some hypotheses, which are the slots of its arrays:
in each slot but the last, the robot follows one of the latest commands; in the last, it is stuck.
A hypothesis has a weight, the ln of its probability, -inf if there is none. `follow` goes from each
frame to the next, and for each robot and each of its filters

    _predict    predicts all hypotheses to the next frame; when a command acts on the way, sent
                tau before, each robot hears it with the probability 1 - lost: `_switch`, `_branch`
    _update     updates all hypotheses by the pose: weight <- weight + ln of its likelihood, less
                the ln of their sum; this sum adds to the filter's `score`
    _stick      lets probability pass from driving to being stuck, and back

A weight that falls below `ASSUMED.least_weight` stays there. Commands and frames are in the order
of their times. Numbers and shapes are those of `filter_state`; the readable twin is
`tests/oracles/filter.py`.
"""

import math

import numpy as np

from tetractl.control.kernels.filter_measure import DEPENDS_ON, measure
from tetractl.control.kernels.filter_motion import advance, parameters_of, turn_rate
from tetractl.control.kernels.filter_state import (
    ASSUMED,
    FOLLOWS,
    HEADING,
    MARKER_BIAS,
    TURN_BIAS,
    FilterScratch,
    X,
    Y,
)
from tetractl.core.kernels.kernel_cache import compiled
from tetractl.core.kernels.kernel_options import ENTRY_FAST, INLINE_FAST, inlined
from tetractl.model.motion import exact

_rates = inlined(exact.rates)

LN_HEARD = math.log(1 - ASSUMED.lost)
"""ln of the probability that a robot hears a command."""
LN_LOST = math.log(ASSUMED.lost)
"""ln of the probability that it does not."""


@compiled(**ENTRY_FAST)
def place(bank, model, commands, time_s, poses, placed):
    """Set the poses of the robots `placed` (N,) to those of a frame, poses (N, 3), and let them
    follow the last command that acts at or before the time (N,) of each robot's pose [s]."""
    for i in range(placed.size):
        if not placed[i]:
            continue
        for b in range(bank.dead_time_s.shape[0]):
            _set_pose(bank, model, b, i, poses[i])
            _follow_last(bank, model, commands, b, i, time_s[i])


@compiled(**INLINE_FAST)
def _set_pose(bank, model, b, i, pose):
    """Set the pose of every hypothesis to a measured pose (3,), with twice its deviation."""
    bank.unfit_s[b, i] = 0.0
    for slot in range(bank.weight.shape[2]):
        z = bank.state[b, i, slot]
        cov = bank.cov[b, i, slot]
        z[X] = pose[0]
        z[Y] = pose[1]
        z[HEADING] = pose[2] - z[MARKER_BIAS]
        for j in (X, Y, HEADING):
            for k in range(cov.shape[0]):
                cov[j, k] = 0.0
                cov[k, j] = 0.0
            cov[j, j] = 4 * model.noise[j, i] ** 2


@compiled(**INLINE_FAST)
def _follow_last(bank, model, commands, b, i, time_s):
    """Let every hypothesis but the stuck one follow the last command that acts by a time [s]."""
    dead_time_s = bank.dead_time_s[b, i]
    acting = commands.sent_s.size
    while acting > 0 and commands.sent_s[acting - 1] > time_s - dead_time_s:
        acting -= 1
    if acting == 0:
        return
    bank.coming[b, i] = acting
    for slot in range(bank.weight.shape[2] - 1):
        bank.direction[b, i, slot] = commands.directions[acting - 1]
        bank.until_s[b, i, slot] = commands.sent_s[acting - 1] + model.watchdog_s + dead_time_s


@compiled(**ENTRY_FAST)
def follow(bank, model, commands, frames, noisy, step_s):
    """Predict every filter from frame to frame, and update it by the poses of each but the first.

    A pose is used if it is valid, newer than that in the frame before, and no repeated one. If the
    camera is not coarse, that is one that equals the pose before, if measurements are `noisy`; and
    every pose of a frame that `_is_frozen`. The dead times are uncertain by `step_s` [s]. Returns
    ln of the likelihoods of the poses (B, N).
    """
    filters, robots = bank.dead_time_s.shape
    likelihood = np.zeros((filters, robots))
    scratch = _scratch(bank.cov.shape[4])
    for f in range(1, frames.time_s.shape[0]):
        frozen = _is_frozen(bank, model, commands, frames, f)
        for i in range(robots):
            since_s = frames.time_s[f - 1, i]
            until_s = frames.time_s[f, i]
            if until_s <= since_s:
                continue
            pose = frames.poses[f, i]
            repeated = noisy and not model.coarse and _equal(pose, frames.poses[f - 1, i])
            used = frames.valid[f, i] and not frozen and not repeated
            for b in range(filters):
                if bank.score[b, i] == -math.inf:
                    continue
                _predict(bank, model, commands, b, i, since_s, until_s, step_s, scratch)
                if used:
                    ln = _update(bank, model, b, i, pose, until_s - since_s, scratch)
                    likelihood[b, i] += ln
                    bank.score[b, i] += ln
                _stick(bank, model, b, i, until_s - since_s, until_s)
            _forget(bank, i, until_s - since_s)
    return likelihood


@compiled(**INLINE_FAST)
def _scratch(states):
    """Return room for predictions and updates, in the order of the fields."""
    return FilterScratch(
        np.empty((3, states)),
        np.empty(states),
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.zeros(DEPENDS_ON.shape),
        np.zeros(3),
        np.zeros(3),
    )


@compiled(**INLINE_FAST)
def _equal(pose, other):
    """Return whether two poses (3,) are equal."""
    return pose[0] == other[0] and pose[1] == other[1] and pose[2] == other[2]


@compiled(**INLINE_FAST)
def _is_frozen(bank, model, commands, frames, f):
    """Return whether the camera has repeated a frame: all poses are those of the frame before.

    One robot may stand, and its pose be measured without noise. So may robots that were commanded
    to stand, by any of the dead times; and a coarse camera may measure equal poses.
    """
    robots = len(model.parameters)
    if robots == 1 or model.coarse:
        return False
    for i in range(robots):
        if not _equal(frames.poses[f, i], frames.poses[f - 1, i]):
            return False
    first_s = frames.time_s[f - 1, 0]
    for i in range(1, robots):
        first_s = min(first_s, frames.time_s[f - 1, i])
    latest_s = 0.0
    for b in range(bank.dead_time_s.shape[0]):
        for i in range(robots):
            latest_s = max(latest_s, bank.dead_time_s[b, i])
    acting = commands.sent_s.size - 1
    while acting >= 0 and commands.sent_s[acting] > first_s - latest_s:
        acting -= 1
    return not (acting >= 0 and math.isnan(commands.directions[acting]))


@compiled(**INLINE_FAST)
def _predict(bank, model, commands, b, i, since_s, until_s, step_s, scratch):
    """Predict all hypotheses between two times [s], and let commands act on the way."""
    t = since_s
    while t < until_s:
        coming = bank.coming[b, i]
        acts_s = math.inf
        if coming < commands.sent_s.size:
            acts_s = commands.sent_s[coming] + bank.dead_time_s[b, i]
        acts = acts_s <= until_s  # false for NaN, too
        end_s = max(t, acts_s) if acts else until_s
        for slot in range(bank.weight.shape[2]):
            if bank.weight[b, i, slot] > -math.inf:
                _predict_one(bank, model, b, i, slot, t, end_s, scratch)
        t = end_s
        if acts:
            if bank.weight.shape[2] > FOLLOWS + 1:
                _branch(bank, model, b, i, commands.directions[coming], step_s, t)
            else:
                _switch(bank, model, b, i, commands.directions[coming], step_s, t)
            bank.coming[b, i] += 1


@compiled(**INLINE_FAST)
def _predict_one(bank, model, b, i, slot, since_s, until_s, scratch):
    """Predict one hypothesis: the robot follows its direction until its watchdog stops it."""
    z = bank.state[b, i, slot]
    cov = bank.cov[b, i, slot]
    noise_scale = bank.noise_scale[b, i]
    stops_s = min(max(bank.until_s[b, i, slot], since_s), until_s)
    driving = (bank.direction[b, i, slot], stops_s - since_s)
    standing = (math.nan, until_s - stops_s)
    for u, seconds in (driving, standing):
        if seconds > 0:
            advance(model, i, z, cov, u, noise_scale, seconds, scratch.products)


@compiled(**INLINE_FAST)
def likeliest(weight, count):
    """Return the index of the largest of the first `count` weights."""
    best = 0
    for slot in range(1, count):
        if weight[slot] > weight[best]:
            best = slot
    return best


@compiled(**INLINE_FAST)
def _switch(bank, model, b, i, u, step_s, now_s):
    """Let a command act: add the hypothesis that the robot, in its likeliest state, heard it and
    follows u [rad] from now on [s], in the slot of the least weight; the others did not hear it.

    If a hypothesis follows u already, it has the weight of one that heard it, and the rest stays.
    """
    weight = bank.weight[b, i]
    direction = bank.direction[b, i]
    until_s = bank.until_s[b, i]
    follows = weight.size - 1
    best = likeliest(weight, follows)
    heard = weight[best] + LN_HEARD
    for slot in range(follows):
        if direction[slot] == u and weight[slot] > -math.inf:
            if weight[slot] < heard:
                _copy(bank, b, i, best, slot)
                weight[slot] = heard
            until_s[slot] = now_s + model.watchdog_s
            return
    least = best
    for slot in range(follows):
        if weight[slot] < weight[least]:
            least = slot
    _copy(bank, b, i, best, least)
    for slot in range(follows):
        weight[slot] += LN_LOST
    before = direction[best] if now_s < until_s[best] else math.nan
    _blur(model, i, bank.state[b, i, least], bank.cov[b, i, least], before, u, step_s)
    direction[least] = u
    until_s[least] = now_s + model.watchdog_s
    weight[least] = heard


@compiled(**INLINE_FAST)
def _branch(bank, model, b, i, u, step_s, now_s):
    """Let a command act, for logs: each hypothesis becomes two, that the robot heard it and follows
    u [rad] from now on [s], and that it did not; the likeliest that find a slot stay.

    Two that follow one direction at like headings are one, with the sum of their probabilities.
    """
    weight = bank.weight[b, i]
    direction = bank.direction[b, i]
    until_s = bank.until_s[b, i]
    follows = weight.size - 1
    old_state = bank.state[b, i, :follows].copy()
    old_cov = bank.cov[b, i, :follows].copy()
    old_direction = direction[:follows].copy()
    old_until_s = until_s[:follows].copy()
    # entry s: hypothesis s heard the command; entry follows + s: it did not
    new_weight = np.empty(2 * follows)
    for s in range(follows):
        if old_direction[s] == u:
            new_weight[s] = weight[s]
            new_weight[follows + s] = -math.inf
        else:
            new_weight[s] = weight[s] + LN_HEARD
            new_weight[follows + s] = weight[s] + LN_LOST
        weight[s] = -math.inf
    source = np.empty(follows, np.int64)  # the old hypothesis in each slot filled
    filled = 0
    for _ in range(2 * follows):
        best = likeliest(new_weight, 2 * follows)
        best_weight = new_weight[best]
        new_weight[best] = -math.inf
        if not best_weight > -math.inf:  # there is none, or it is no number
            continue
        s = best % follows
        hears = best < follows
        follows_now = u if hears else old_direction[s]
        twin = _find_twin(old_state, old_cov, direction, source, filled, s, follows_now)
        if twin >= 0:
            weight[twin] += math.log(1 + math.exp(best_weight - weight[twin]))
        elif filled < follows:
            z = bank.state[b, i, filled]
            cov = bank.cov[b, i, filled]
            _copy_state(old_state[s], old_cov[s], z, cov)
            source[filled] = s
            weight[filled] = best_weight
            direction[filled] = follows_now
            until_s[filled] = old_until_s[s]
            if hears:
                until_s[filled] = now_s + model.watchdog_s
                before = old_direction[s] if now_s < old_until_s[s] else math.nan
                _blur(model, i, z, cov, before, u, step_s)
            filled += 1


@compiled(**INLINE_FAST)
def _find_twin(old_state, old_cov, direction, source, filled, s, follows_now):
    """Return the first of the slots `filled` whose hypothesis follows the same direction as the old
    one s now does, from a like heading; -1 if there is none."""
    for slot in range(filled):
        gap = old_state[source[slot], HEADING] - old_state[s, HEADING]
        alike = gap**2 < ASSUMED.alike * old_cov[s, HEADING, HEADING]
        if alike and direction[slot] == follows_now:
            return slot
    return -1


@compiled(**INLINE_FAST)
def _blur(model, i, z, cov, before, u, step_s):
    """Add the uncertainty of the pose because the time at which u replaces the direction `before`
    is uncertain: it is spread evenly over `step_s` [s], whose variance is step_s^2 / 12."""
    change = _turning(model, i, z, u) - _turning(model, i, z, before)
    cov[HEADING, HEADING] += (step_s * change) ** 2 / 12
    if math.isnan(before) != math.isnan(u):  # the robot starts or stops
        speed = parameters_of(model, i, z)[1]
        cov[X, X] += (step_s * speed) ** 2 / 12
        cov[Y, Y] += (step_s * speed) ** 2 / 12


@compiled(**INLINE_FAST)
def _turning(model, i, z, u):
    """Return how fast a robot turns under the direction u [rad/s], (3); 0 if it stands, NaN."""
    if math.isnan(u):
        return 0.0
    parameters = parameters_of(model, i, z)
    goal = u + z[TURN_BIAS]
    c = math.cos(z[HEADING])
    s = math.sin(z[HEADING])
    a = turn_rate(c, s, math.cos(goal), math.sin(goal), parameters, 0.0)[0]
    return _rates(z[HEADING], goal, a, parameters[1])[2]


@compiled(**INLINE_FAST)
def _copy(bank, b, i, source, slot):
    """Copy the state and covariance of one hypothesis to another."""
    z = bank.state[b, i, source]
    cov = bank.cov[b, i, source]
    _copy_state(z, cov, bank.state[b, i, slot], bank.cov[b, i, slot])


@compiled(**INLINE_FAST)
def _copy_state(z, cov, z_copy, cov_copy):
    """Copy a state and its covariance; arrays that are assigned whole take seconds to compile."""
    for k in range(z.size):
        z_copy[k] = z[k]
    for k in range(cov.shape[0]):
        for m in range(cov.shape[0]):
            cov_copy[k, m] = cov[k, m]


@compiled(**INLINE_FAST)
def _update(bank, model, b, i, pose, seconds, scratch):
    """Update all hypotheses by a pose `seconds` after the one before; return the ln of the pose's
    likelihood.

    If the pose fits the likeliest hypothesis, its innovations tell how large the noise is, and
    whether the model is right. If for some time none fits, all start from the pose.
    """
    innovation = scratch.likeliest_innovation
    ln_likelihood = _update_weights(bank, model, b, i, pose, scratch)
    square_xy = innovation[0] ** 2 + innovation[1] ** 2
    square_heading = innovation[2] ** 2
    if square_xy + square_heading <= ASSUMED.gate:
        bank.unfit_s[b, i] = 0.0
        noise_scale = bank.noise_scale[b, i]
        noise_scale[0] = _averaged(noise_scale[0], 0.5 * square_xy)
        noise_scale[1] = _averaged(noise_scale[1], square_heading)
        _add_innovation(bank, b, i, innovation)
    else:
        bank.unfit_s[b, i] += seconds
        if bank.unfit_s[b, i] > ASSUMED.lost_track_s:
            _set_pose(bank, model, b, i, pose)
    return ln_likelihood


@compiled(**INLINE_FAST)
def _update_weights(bank, model, b, i, pose, scratch):
    """Update the hypotheses and their weights, whose probabilities have the sum 1; return the ln of
    the pose's likelihood. The likeliest one's innovation is in `scratch.likeliest_innovation`."""
    weight = bank.weight[b, i]
    most = -math.inf
    for slot in range(weight.size):
        if weight[slot] > -math.inf:
            z = bank.state[b, i, slot]
            cov = bank.cov[b, i, slot]
            weight[slot] += measure(model, i, z, cov, bank.noise_scale[b, i], pose, scratch)
            if weight[slot] > most:
                most = weight[slot]
                for k in range(3):
                    scratch.likeliest_innovation[k] = scratch.innovation[k]
    total = 0.0
    for slot in range(weight.size):
        total += math.exp(weight[slot] - most)
    ln_likelihood = most + math.log(total)
    for slot in range(weight.size):
        if weight[slot] > -math.inf:
            weight[slot] = max(weight[slot] - ln_likelihood, ASSUMED.least_weight)
    return ln_likelihood


@compiled(**INLINE_FAST)
def _averaged(scale, square):
    """Return the ratio of observed to expected variances after one more squared deviation."""
    change = min(square, ASSUMED.capped_square) / ASSUMED.mean_capped - 1
    scale = scale * (1 + change / ASSUMED.scale_memory)
    return min(max(scale, ASSUMED.scale_least), ASSUMED.scale_most)


@compiled(**INLINE_FAST)
def _add_innovation(bank, b, i, innovation):
    """Add a frame's innovations (3,) to the present block; add a whole block to those before.

    If the model is right, innovations are independent, so that the squared sum of a block's
    innovations over their number is 1 in the mean, and chi-square over all blocks.
    """
    block_sum = bank.block_sum[b, i]
    for j in range(3):
        block_sum[j] += innovation[j]
    bank.block_frames[b, i] += 1
    if bank.block_frames[b, i] < ASSUMED.block:
        return
    for j in range(3):
        mean_square = block_sum[j] ** 2 / ASSUMED.block
        bank.square_sum[b, i, j] += min(mean_square, ASSUMED.most_square)
        block_sum[j] = 0.0
    bank.blocks[b, i] += 1
    bank.block_frames[b, i] = 0.0


@compiled(**INLINE_FAST)
def _stick(bank, model, b, i, seconds, now_s):
    """Exchange probability between the likeliest driving hypothesis and the stuck one, for the
    `seconds` before now, in which a stuck robot may have strayed.

    A robot gets stuck once in `every_s` on average and stays so for `for_s`. Of two hypotheses that
    become one, the likelier keeps its state. A robot that is not to drive cannot be stuck.
    """
    weight = bank.weight[b, i]
    stuck = weight.size - 1
    best = likeliest(weight, stuck)
    if math.isnan(bank.direction[b, i, best]) or bank.until_s[b, i, best] <= now_s:
        weight[stuck] = -math.inf
        return
    strays2 = model.sticks.strays * model.sticks.strays
    turns2 = model.sticks.turns * model.sticks.turns
    cov = bank.cov[b, i, stuck]
    cov[X, X] += strays2 * seconds
    cov[Y, Y] += strays2 * seconds
    cov[HEADING, HEADING] += turns2 * seconds
    p_free = min(0.5, seconds / model.sticks.for_s)
    p_stick = min(0.5, seconds / model.sticks.every_s)
    stays = weight[stuck] + math.log(1 - p_free)
    comes_free = weight[stuck] + math.log(p_free)
    gets_stuck = weight[best] + math.log(p_stick)
    if comes_free > weight[best]:
        _copy(bank, b, i, stuck, best)
        weight[best] = comes_free
    elif gets_stuck > stays:
        _copy(bank, b, i, best, stuck)
        stays = gets_stuck
    weight[stuck] = stays


@compiled(**INLINE_FAST)
def _forget(bank, i, seconds):
    """Scale a robot's scores to the best one, 0, and let their differences decay with time."""
    filters = bank.score.shape[0]
    most = -math.inf
    for b in range(filters):
        most = max(most, bank.score[b, i])
    decay = math.exp(-seconds / ASSUMED.forget_s)
    for b in range(filters):
        bank.score[b, i] = (bank.score[b, i] - most) * decay
