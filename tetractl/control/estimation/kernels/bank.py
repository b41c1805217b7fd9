"""Combine what the filters of all robots have learnt: which are likely, and what they predict.

Each robot has several filters, which differ in the dead time that they assume
(`tetractl.control.estimation.kernels.filter`). `share` computes how likely each filter is. `select`
decides which filters continue, and with which dead times. `forecast` predicts each robot with its
likeliest filter, and fills the estimate of its motion. Numbers and shapes are explained in
`filter_state`. `tests/testkit/references/bank.py` is a readable reference implementation.

Most probably, all robots have the same dead time t. So each robot's frames also carry information
about the dead times of the others. Let l(b, i) = exp(score) be the likelihood of filter b of robot
i, given the robot's own frames. Let n(t, b, i) be the density of the common dead time t if this
filter is right. Then the likelihood of t, given the frames of robot i, is

    L_i(t) = sum_b n(t, b, i) l(b, i).

The probability of filter b of robot i combines its own frames with those of the other robots:

    P(b, i) ~ l(b, i) sum_t n(t, b, i) prior(t) prod_(k != i) L_k(t).
"""

import math

import numpy as np

from tetractl.control.estimation.kernels.filter import is_none, likeliest
from tetractl.control.estimation.kernels.filter_motion import (
    advance,
    arc_displacement,
    parameters_of,
)
from tetractl.control.estimation.kernels.filter_state import (
    FINEST_STEP_S,
    FLOW_X,
    FLOW_Y,
    HEADING,
    LAG,
    LEAST_BLOCKS,
    LN_A,
    LN_SPEED,
    MARKER_BIAS,
    PACE,
    REFINED,
    SIDE,
    SWING,
    TURN_BIAS,
    Bank,
    CommonTimes,
    FilterModel,
    Forecast,
    NextFilters,
    SentCommands,
    X,
    Y,
    largest_square_sum,
)
from tetractl.control.search.kernels.elementary import exp, log
from tetractl.core.poses import Floats
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import ENTRY_FAST, INLINE_FAST, inlined

ALL_GROUPS = -1
"""Stands for every group, where the index of one group is expected."""
UNLIKELY = 25.0
"""Maximum difference of a filter's ln probability from the likeliest filter's.

A filter that is less likely than this is dropped.
"""
LEAST = 1e-300
"""Small number added to densities before their logarithm is taken, because they may be 0."""

_largest_square_sum = inlined(largest_square_sum)


def share(bank: Bank, common: CommonTimes) -> None:
    """Compute the shared score of each filter: its ln probability given all robots' frames.

    Args:
        bank: The filters. Its `shared_score` is filled, from its `score`.
        common: The `CommonTimes`: the dead times that all robots may have in common.
    """
    filters, robots = bank.score.shape
    _share(bank, common, np.empty((common.ln_prior.size, robots)), np.empty(filters))


@compiled(**ENTRY_FAST)
def _share(bank, common, ln_of_others, density):
    """Compute the shared scores; see `share`.

    Args:
        bank: The filters.
        common: The `CommonTimes`.
        ln_of_others: A working array for the ln likelihood of each dead time, given the frames of
            the other robots, shape (T, N).
        density: A working array, shape (B,).
    """
    filters, robots = bank.score.shape
    times = common.ln_prior.size
    for i in range(robots):
        for b in range(filters):
            density[b] = exp(bank.score[b, i])
        for t in range(times):
            total = 0.0
            for b in range(filters):
                total += common.near[t, b, i] * density[b]
            ln_of_others[t, i] = log(total + LEAST)
    for t in range(times):
        ln_of_all = common.ln_prior[t]
        for i in range(robots):
            ln_of_all += ln_of_others[t, i]
        for i in range(robots):
            ln_of_others[t, i] = ln_of_all - ln_of_others[t, i]
    for i in range(robots):
        _multiply(bank, common, ln_of_others, i, density)


@compiled(**INLINE_FAST)
def _multiply(bank, common, ln_of_others, i, density):
    """Combine robot i's scores with what other robots' frames show of the dead time.

    The result is written to the shared score of each filter. `density` (B,) is a working array.
    """
    filters = density.size
    times = common.ln_prior.size
    most = -math.inf
    for t in range(times):
        most = max(most, ln_of_others[t, i])
    for b in range(filters):
        density[b] = 0.0
    for t in range(times):
        others = exp(ln_of_others[t, i] - most)
        for b in range(filters):
            density[b] += common.near[t, b, i] * others
    for b in range(filters):
        bank.shared_score[b, i] = bank.score[b, i] + log(density[b] + LEAST)


@compiled(**INLINE_FAST)
def _dead_time(bank, i, best, density):
    """Compute the mean and standard deviation of robot i's dead time.

    Only the filters with the same lag as the robot's likeliest filter, `best`, count. The dead time
    lies between those of the grid, so its deviation is at least a quarter of their step. `density`
    (B,) is a working array.
    """
    filters = density.size
    total = 0.0
    mean_s = 0.0
    for b in range(filters):
        density[b] = exp(bank.shared_score[b, i] - bank.shared_score[best, i])
        if bank.state[b, i, 0, LAG] != bank.state[best, i, 0, LAG]:
            density[b] = 0.0
        total += density[b]
        mean_s += density[b] * bank.dead_time_s[b, i]
    mean_s /= total
    variance = 0.0
    for b in range(filters):
        variance += density[b] / total * np.square(bank.dead_time_s[b, i] - mean_s)
    return mean_s, math.sqrt(variance + np.square(bank.step_s[0, i] / 4))


def select(bank: Bank, tried: int, same: float, commanded: bool, going_on: NextFilters) -> bool:
    """Choose the filters that continue, by their shared scores.

    In each group of a robot's filters, three kinds continue: filters that are not much less likely
    than the best one, the filters between them, and the neighbours of the likeliest one. If the
    states `tried` of two groups have come closer than `same`, the less likely group is dropped.
    Once robots were commanded, a grid of three dead times halves its step, and a grid whose best
    dead time is at its end moves in that direction. Each lag has a grid of its own, because a
    longer lag goes with a shorter dead time.

    Args:
        bank: The filters.
        tried: Index of the state for which each group started from a different value.
        same: Difference of this state below which two groups count as one.
        commanded: Whether the robots were sent commands.
        going_on: A `NextFilters`, filled with the filters that continue.

    Returns:
        Whether the filters differ from those of the bank.
    """
    chosen = np.empty(going_on.rows.shape[0], np.int64)
    return _select(bank, tried, same, commanded, going_on, chosen)


@compiled(**ENTRY_FAST)
def _select(bank, tried, same, commanded, going_on, chosen):
    """Choose the filters that continue; see `select`.

    `chosen` is a working array for the indices of one robot's filters.
    """
    robots = going_on.step_s.size
    changed = False
    for i in range(robots):
        count = _count(bank, i)
        best = likeliest(bank.shared_score[:, i], count)
        number = _choose(bank, i, count, best, tried, same, chosen)
        _take(bank, i, chosen[:number], going_on)
        if number < count:
            changed = True
        group = bank.group[best, i] if tried == LAG else ALL_GROUPS
        dead_times = _number_of_dead_times(bank, i, chosen[:number], group)
        if dead_times > REFINED or not commanded:
            continue
        if going_on.step_s[i] > FINEST_STEP_S and dead_times == REFINED:
            going_on.step_s[i] /= 2
        elif _is_inside(bank, i, chosen[:number], best, group):
            continue
        _lay_around(bank, i, chosen[:number], best, group, going_on)
        changed = True
    return changed


@compiled(**INLINE_FAST)
def _count(bank, i):
    """Return how many filters robot i has. Rows of the arrays beyond this number are unused."""
    count = 0
    while count < bank.score.shape[0] and not is_none(bank.score[count, i]):
        count += 1
    return count


@compiled(**INLINE_FAST)
def _choose(bank, i, count, best, tried, same, chosen):
    """Choose which of robot i's first `count` filters continue, and return their number.

    Their indices are written to the first entries of `chosen`. The filters of one group follow
    each other, in the order of their dead times.
    """
    score = bank.shared_score
    least = score[best, i] - UNLIKELY
    number = 0
    end = 0
    while end < count:
        begin = end
        top = begin  # the likeliest filter of the group
        first = -1  # the first and the last likely one
        last = -1
        while end < count and bank.group[end, i] == bank.group[begin, i]:
            if score[end, i] > score[top, i]:
                top = end
            if score[end, i] >= least:
                if first < 0:
                    first = end
                last = end
            end += 1
        same_group = bank.group[top, i] == bank.group[best, i]
        gap = _reached(bank, top, i, tried) - _reached(bank, best, i, tried)
        stays_apart = same_group or not abs(gap) < same
        if first >= 0 and stays_apart:
            from_filter = max(begin, min(first, top - 1))
            to_filter = min(end - 1, max(last, top + 1))
            for b in range(from_filter, to_filter + 1):
                chosen[number] = b
                number += 1
    return number


@compiled(**INLINE_FAST)
def _reached(bank, b, i, tried):
    """Return the present value of the state `tried`, under a filter's likeliest hypothesis."""
    slot = likeliest(bank.ln_weight[b, i], bank.ln_weight.shape[2])
    return bank.state[b, i, slot, tried]


@compiled(**INLINE_FAST)
def _take(bank, i, chosen, going_on):
    """Copy the filters `chosen` (their indices) to `going_on`, with their dead times unchanged.

    The remaining rows of `going_on` are marked as unused.
    """
    for row in range(chosen.size):
        b = chosen[row]
        going_on.rows[row, i] = b
        going_on.dead_time_s[row, i] = bank.dead_time_s[b, i]
        going_on.score[row, i] = bank.score[b, i]
    for row in range(chosen.size, going_on.rows.shape[0]):
        going_on.rows[row, i] = -1


@compiled(**INLINE_FAST)
def _is_in(bank, b, i, group):
    """Check whether a filter is in a group. Every filter is in ALL_GROUPS."""
    return group == ALL_GROUPS or bank.group[b, i] == group


@compiled(**INLINE_FAST)
def _number_of_dead_times(bank, i, chosen, group):
    """Count the different dead times of the filters `chosen` in a group."""
    number = 0
    for row in range(chosen.size):
        if not _is_in(bank, chosen[row], i, group):
            continue
        number += 1
        for before in range(row):
            if not _is_in(bank, chosen[before], i, group):
                continue
            if bank.dead_time_s[chosen[before], i] == bank.dead_time_s[chosen[row], i]:
                number -= 1
                break
    return number


@compiled(**INLINE_FAST)
def _is_inside(bank, i, chosen, best, group):
    """Check whether the best dead time is inside the grid of a group, not at its end.

    A dead time of 0 counts as inside if there is a longer one.
    """
    best_s = bank.dead_time_s[best, i]
    shorter = best_s == 0
    longer = False
    for b in chosen:
        if not _is_in(bank, b, i, group):
            continue
        if bank.dead_time_s[b, i] < best_s:
            shorter = True
        if bank.dead_time_s[b, i] > best_s:
            longer = True
    return shorter and longer


@compiled(**INLINE_FAST)
def _lay_around(bank, i, chosen, best, best_group, going_on):
    """Lay a new grid around the best dead time of each group: three values, or two starting with 0.

    Each dead time of the new grid takes the filter with the nearest dead time so far. Unless
    `best_group` is ALL_GROUPS, each group has a best dead time of its own. Groups that the poses
    cannot distinguish stay as they are.
    """
    best_s = bank.dead_time_s[best, i]
    last_group = 0
    for b in chosen:
        last_group = max(last_group, bank.group[b, i])
    row = 0
    for group in range(last_group + 1):
        if best_group != ALL_GROUPS:
            best_s = _best_dead_time(bank, i, chosen, group)
        for k in range(-1, 2):
            time_s = max(best_s + going_on.step_s[i] * k, 0.0)
            nearest, score = _between(bank, i, chosen, group, time_s)
            twice = k == 0 and best_s == 0  # 0 has been laid already
            if nearest >= 0 and not twice:
                going_on.rows[row, i] = nearest
                going_on.dead_time_s[row, i] = time_s
                going_on.score[row, i] = score
                row += 1
    for after in range(row, going_on.rows.shape[0]):
        going_on.rows[after, i] = -1


@compiled(**INLINE_FAST)
def _best_dead_time(bank, i, chosen, group):
    """Return the likeliest dead time [s] among the filters `chosen` of a group.

    The result is 0 if the group has none.
    """
    best = -1
    for b in chosen:
        in_group = bank.group[b, i] == group
        if in_group and (best < 0 or bank.shared_score[b, i] > bank.shared_score[best, i]):
            best = b
    return bank.dead_time_s[best, i] if best >= 0 else 0.0


@compiled(**INLINE_FAST)
def _between(bank, i, chosen, group, time_s):
    """Find the filter of a group nearest to a dead time, and compute a score for that time.

    Only the `chosen` filters count. The score is interpolated between the neighbours, and beyond
    the ends of the grid it equals the score of the end. The returned filter is -1 if the group has
    none.
    """
    nearest = -1
    before = -1
    score = 0.0
    for b in chosen:
        if bank.group[b, i] != group:
            continue
        later_s = bank.dead_time_s[b, i]
        if nearest < 0 or abs(later_s - time_s) < abs(bank.dead_time_s[nearest, i] - time_s):
            nearest = b
        score = bank.score[b, i]
        if time_s < later_s:
            if before >= 0:
                earlier_s = bank.dead_time_s[before, i]
                rise = bank.score[b, i] - bank.score[before, i]
                share_of_rise = (time_s - earlier_s) / (later_s - earlier_s)
                score = bank.score[before, i] + share_of_rise * rise
            break
        before = b
    return nearest, score


def forecast(
    bank: Bank,
    model: FilterModel,
    commands: SentCommands,
    frame_s: Floats,
    sent_s: float,
    room: Forecast,
) -> tuple[float, float]:
    """Predict where each robot will be, from its most probable filter, into a `Forecast`.

    Poses are predicted from the last frame, through all commands, to the moment when a command that
    is sent at `sent_s` takes effect on each robot. If wheels lag, the predicted poses are the ones
    at which the robots would come to a standstill if they stopped then. Standard deviations grow if
    the model does not fit.

    Args:
        bank: The filters.
        model: The assumptions about the robots.
        commands: The commands that were sent.
        frame_s: The times of the robots' poses in the last frame (N,) [s].
        sent_s: The time at which the next command is sent [s].
        room: The `Forecast` that is filled.

    Returns:
        The mean of the dead times [s] and their standard deviation [s].
    """
    density = np.empty(len(bank.shared_score))
    z = np.empty(bank.state.shape[3])
    return _forecast(bank, model, commands, frame_s, sent_s, room, density, z)


@compiled(**ENTRY_FAST)
def _forecast(bank, model, commands, frame_s, sent_s, room, density, z):
    """Predict where each robot will be; see `forecast`.

    `density` (B,) and `z` (STATES,) are working arrays.
    """
    filters, robots = bank.shared_score.shape
    mean_s = 0.0
    variance = 0.0
    for i in range(robots):
        b = likeliest(bank.shared_score[:, i], filters)
        slot = likeliest(bank.ln_weight[b, i], bank.ln_weight.shape[2])
        for k in range(z.size):
            z[k] = bank.state[b, i, slot, k]
        growth = _misfit(bank, b, i, room)
        _describe(bank, model, b, i, slot, z, growth, room)
        dead_time_s, dead_time_std_s = _dead_time(bank, i, b, density)
        room.own_dead_time[i] = dead_time_s
        room.own_dead_time_std[i] = dead_time_std_s
        std_s = growth * dead_time_std_s
        mean_s += dead_time_s
        variance += std_s * std_s
        begin_s = frame_s[i]
        acts_s = max(sent_s + dead_time_s, begin_s)
        room.turn_bias[i] = z[TURN_BIAS]
        room.flow[i, 0] = z[FLOW_X]
        room.flow[i, 1] = z[FLOW_Y]
        room.directions[i] = _predict(
            bank, model, commands, b, i, slot, z, dead_time_s, begin_s, acts_s
        )
        _come_to_rest(model, i, z)
        room.x[i] = z[X]
        room.y[i] = z[Y]
        room.heading[i] = z[HEADING]
    mean_s /= robots
    for i in range(robots):
        variance += np.square(room.own_dead_time[i] - mean_s)
    return mean_s, math.sqrt(variance / robots)


@compiled(**INLINE_FAST)
def _misfit(bank, b, i, room):
    """Compute how badly the model fits a robot, from the sums of innovations over blocks of frames.

    An innovation is the measured minus the predicted pose, divided by its standard deviation.

    Returns:
        The factor by which standard deviations grow: the root of the largest mean square, and at
        least 1.
    """
    blocks = max(bank.blocks[b, i], LEAST_BLOCKS)
    limit = _largest_square_sum(blocks)
    growth2 = 1.0
    for k in range(3):
        growth2 = max(growth2, bank.square_sum[b, i, k] / blocks)
        room.misfit[i, k] = bank.square_sum[b, i, k] / limit
    return math.sqrt(growth2)


@compiled(**INLINE_FAST)
def _describe(bank, model, b, i, slot, z, growth, room):
    """Write the estimate of robot i's motion, with standard deviations, from one hypothesis.

    The state contains the logarithms of a and v, so their deviations are relative.
    """
    cov = bank.cov[b, i, slot]
    a, speed, side, saturation = parameters_of(model, i, z)
    room.a[i] = a
    room.a_std[i] = growth * a * math.sqrt(max(cov[LN_A, LN_A], 0.0))
    room.speed[i] = speed
    room.speed_std[i] = growth * speed * math.sqrt(max(cov[LN_SPEED, LN_SPEED], 0.0))
    room.heading_bias[i] = z[TURN_BIAS] + z[MARKER_BIAS]
    variance = cov[TURN_BIAS, TURN_BIAS] + cov[MARKER_BIAS, MARKER_BIAS]
    variance += 2 * cov[TURN_BIAS, MARKER_BIAS]
    room.heading_bias_std[i] = growth * math.sqrt(max(variance, 0.0))
    room.side[i] = side
    room.side_std[i] = growth * math.sqrt(max(cov[SIDE, SIDE], 0.0))
    room.saturation[i] = saturation
    room.stands[i] = _probability_of_stuck(bank.ln_weight[b, i], slot)


@compiled(**INLINE_FAST)
def _probability_of_stuck(ln_weight, slot):
    """Return the probability that a robot is stuck, from its hypotheses' ln probabilities (S,).

    `slot` is the most probable hypothesis. The last slot is the one of a stuck robot.
    """
    total = 0.0
    for s in range(ln_weight.size):
        total += exp(ln_weight[s] - ln_weight[slot])
    return exp(ln_weight[ln_weight.size - 1] - ln_weight[slot]) / total


@compiled(**INLINE_FAST)
def _predict(bank, model, commands, b, i, slot, z, dead_time_s, begin_s, end_s):
    """Predict a robot's state z from `begin_s` to `end_s` [s], in place, with all commands between.

    A stuck robot follows no command. A command that takes effect within 1 ns of the end already
    counts. Commands that took effect before the beginning are contained in the state.

    Returns:
        The direction followed at the end [rad], NaN for a robot that stands still.
    """
    stuck = slot == bank.ln_weight.shape[2] - 1
    number = commands.sent_s.size
    direction = bank.direction[b, i, slot]
    stops_s = bank.until_s[b, i, slot]
    at_end = direction if stops_s > end_s else math.nan
    first = number
    while first > 0 and commands.sent_s[first - 1] + dead_time_s > begin_s:
        first -= 1
    t = begin_s
    for c in range(first, number + 1):  # to each command, and from the last one to the end
        acts_s = commands.sent_s[c] + dead_time_s if c < number else end_s
        leg_end_s = min(max(acts_s, t), end_s)
        drives_s = min(max(stops_s, t), leg_end_s) - t
        driving = (direction, drives_s)
        standing = (math.nan, leg_end_s - t - drives_s)
        for u, seconds in (driving, standing):
            if seconds > 0:
                advance(model, i, z, None, u, None, seconds, None)
        t = leg_end_s
        if c < number and not stuck:
            direction = commands.directions[c]
            stops_s = acts_s + model.watchdog_s
            if acts_s <= end_s + 1e-9:
                at_end = direction if stops_s > end_s else math.nan
    return at_end


@compiled(**INLINE_FAST)
def _come_to_rest(model, i, z):
    """Advance the state z of a robot to the pose at which its lagging wheels stand still.

    From now on, their turning rate and speed decay to zero with the time constant of the lag.
    Without a lag, nothing changes.
    """
    a, speed, _, _ = parameters_of(model, i, z)
    turn = z[LAG] * a * z[SWING]
    way = z[LAG] * speed * z[PACE]
    dx, dy = arc_displacement(z[HEADING], turn, way)
    z[X] += dx
    z[Y] += dy
    z[HEADING] += turn
