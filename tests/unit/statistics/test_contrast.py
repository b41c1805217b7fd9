"""Tests of which of two batches is better, and of when no verdict is allowed.

A difference is the first group's mean total error minus the second's, so negative means "lower".
"""

from dataclasses import replace

import numpy as np
import pytest
import scipy
from testkit.batches import DISTURBED, batch, experiment, group

from tetractl.core.errors import UsageError
from tetractl.log.read.trial_log import Origin
from tetractl.statistics.as_json import contrast_items
from tetractl.statistics.describe import contrast
from tetractl.statistics.tables import summary, texts_by_label

TRIALS = 20
ERRORS = np.random.default_rng(8).gamma(4, 50, (TRIALS, 3))  # of three robots [mm]
TOTALS = ERRORS.sum(axis=1)
EXACT = {"motion": "exact"}


def arm(name, errors, origin=None, seed=1, **fields):
    """A group with these errors, one trial a row, disturbed unless `fields` name a plant."""
    spec = experiment(**({"plant": DISTURBED} | fields))
    trials = batch(np.asarray(errors).tolist(), spec)
    trials = [replace(trial, origin=origin or trial.origin, seed=seed) for trial in trials]
    return group(trials, name=name)


def contrast_of(*groups):
    """The one contrast of two groups."""
    (only_contrast,) = contrast(groups).contrasts
    return only_contrast


def comparison_of_three():
    """Groups a, b and c with the same seeds and three controllers; c has the greatest errors."""
    a = arm("a", ERRORS)
    b = arm("b", ERRORS + 30, controller=EXACT)
    c = arm("c", ERRORS[::-1] * 3, controller={"horizon_max": 9})
    return contrast([a, b, c])


def test_every_two_groups_are_compared_by_pairs():
    contrasts = comparison_of_three().contrasts
    assert [contrast.name for contrast in contrasts] == ["a - b", "a - c", "b - c"]
    assert all(contrast.same_origin and contrast.pairs == TRIALS for contrast in contrasts)
    b_less_c = contrasts[2]
    differences = (ERRORS + 30).sum(axis=1) - (ERRORS[::-1] * 3).sum(axis=1)
    signed_rank = scipy.stats.wilcoxon(differences, method="exact")
    assert b_less_c.tests == "paired t, signed rank"
    assert b_less_c.rank_p == pytest.approx(signed_rank.pvalue)
    assert b_less_c.difference.value == pytest.approx(differences.mean())
    assert b_less_c.verdict == "lower"


def test_the_p_of_several_contrasts_are_corrected_for_their_number():
    """Holm multiplies the least of n p-values by n."""
    contrasts = comparison_of_three().contrasts
    least_p = min(contrast.difference.p_value for contrast in contrasts)
    assert min(contrast.p_holm for contrast in contrasts) == pytest.approx(3 * least_p)
    least_rank_p = min(contrast.rank_p for contrast in contrasts)
    assert min(contrast.rank_p_holm for contrast in contrasts) == pytest.approx(3 * least_rank_p)


def test_with_a_baseline_each_group_is_compared_with_that_alone():
    a, b, baseline = comparison_of_three().groups
    comparison = contrast([a, b], baseline=baseline)
    assert [group.name for group in comparison.groups] == ["a", "b", "c"]
    assert [contrast.name for contrast in comparison.contrasts] == ["a - c", "b - c"]
    least_p = min(contrast.difference.p_value for contrast in comparison.contrasts)
    assert min(contrast.p_holm for contrast in comparison.contrasts) == pytest.approx(2 * least_p)


def test_trials_of_the_same_world_are_paired_whatever_their_order():
    plain_spec = experiment(plant=DISTURBED)
    exact_spec = experiment(plant=DISTURBED, controller=EXACT, name="other", error_bound=50)
    plain = batch(ERRORS.tolist(), plain_spec)
    tenth_less = batch((0.9 * ERRORS).tolist(), exact_spec)
    paired = contrast_of(group(tenth_less[::-1]), group(plain[3:]))
    assert paired.pairs == TRIALS - 3
    totals = TOTALS[3:]
    paired_t = scipy.stats.ttest_rel(0.9 * totals, totals)
    assert paired.difference.value == pytest.approx(-0.1 * totals.mean())
    assert paired.difference.p_value == pytest.approx(paired_t.pvalue)
    # by pairs the difference is significant, by the two intervals alone it is not
    assert paired.difference.ci95.high < 0 < paired.from_both_means.high
    assert paired.verdict == "lower"


@pytest.mark.parametrize(
    ("fields", "why"),
    [
        ({"plant": DISTURBED | {"dead_time": 0.1}}, "differ in more than the controller"),
        ({"seed": 2}, "no seed and trial in common"),
        ({"origin": Origin.LAB}, "no two trials in a lab have the same disturbances"),
    ],
)
def test_other_worlds_are_not_paired(fields, why):
    unpaired = contrast_of(arm("a", ERRORS, **fields), arm("b", ERRORS))
    assert unpaired.pairs == 0
    assert unpaired.tests == "Welch's t, rank sum"
    assert why in unpaired.why_unpaired
    assert (unpaired.detects > 0) == unpaired.same_origin
    assert unpaired.difference.ci95.known


@pytest.mark.long
@pytest.mark.parametrize("paired", [True, False])
def test_the_p_of_a_table_and_its_interval_are_of_one_test(paired):
    """With equal means and unequal spread ranks differ, the means do not.

    Both gamma distributions have mean 1; 10 of 80 is far above the 5 % of false alarms.
    """
    rng = np.random.default_rng(3)
    significant_means = 0
    significant_ranks = 0
    for _ in range(80):
        narrow = rng.gamma(16, 1 / 16, (TRIALS, 1))
        wide = rng.gamma(1, 1, (TRIALS, 1))
        narrow_arm = arm("a", narrow, robots=1)
        wide_arm = arm("b", wide, robots=1, seed=1 if paired else 2, controller=EXACT)
        result = contrast_of(narrow_arm, wide_arm)
        interval = result.difference.ci95
        assert (result.p_holm < 0.05) == (interval.high < 0 or interval.low > 0)
        if result.p_holm < 0.05:
            significant_means += 1
        if result.rank_p_holm < 0.05:
            significant_ranks += 1
    assert significant_means < 10
    assert significant_ranks > significant_means


def assert_not_tested(contrast):
    tested = (contrast.rank_p, contrast.p_holm, contrast.difference.p_value, contrast.detects)
    assert np.isnan(tested).all()


def test_unlike_plants_have_a_difference_but_no_test_and_no_verdict():
    a = arm("a", ERRORS)
    undisturbed = arm("b", ERRORS * 4, plant={"type": "sim"})
    c = arm("c", ERRORS * 2)
    unlike, alike, _ = contrast([a, undisturbed, c]).contrasts
    assert unlike.same_origin is False
    assert unlike.verdict is None
    assert unlike.reason == "the plants differ"
    means = a.total.mean - undisturbed.total.mean
    assert unlike.difference.value == pytest.approx(means)
    assert_not_tested(unlike)
    assert alike.p_holm == alike.difference.p_value  # nothing else is tested
    items = contrast_items(unlike)
    assert items["comparable"] is False
    assert items["verdict_reason"] == unlike.reason


def test_seven_pairs_carry_no_verdict():
    lower = arm("a", ERRORS[:7])
    higher = arm("b", ERRORS[:7] + 50, controller=EXACT)
    few_pairs = contrast_of(lower, higher)
    assert few_pairs.verdict is None
    assert few_pairs.reason == "a verdict needs at least 8 pairs of trials"
    (table,) = summary(contrast([lower, higher]))
    assert table.note.startswith("a - b: no verdict (a verdict needs at least 8 pairs of trials), ")


def test_groups_of_other_units_are_refused():
    with pytest.raises(UsageError, match="b has errors in um, but a in mm"):
        contrast([arm("a", ERRORS), arm("b", ERRORS, units={"length": "um"})])


def test_two_groups_compare_either_way():
    quarter = arm("a", ERRORS / 4, controller=EXACT)
    full = arm("b", ERRORS)
    quarter_less_full = contrast_of(quarter, full)
    assert quarter_less_full.verdict == "lower"
    means = quarter.total.mean - full.total.mean
    assert quarter_less_full.difference.value == pytest.approx(means)
    assert quarter_less_full.from_both_means.high < 0
    assert quarter_less_full.differs == ("controller.motion: exact != euler",)
    assert contrast_of(full, quarter).verdict == "higher"


def test_given_directions_have_no_rank_among_controllers():
    """Hindsight finds directions that no controller could."""
    directions = {"type": "sequence", "period": 0.2, "directions": [0.1]}
    hindsight = arm("given", ERRORS / 100, controller=directions)
    mpc = arm("mpc", ERRORS)
    unranked = contrast_of(hindsight, mpc)
    assert unranked.no_controller is True
    assert unranked.verdict is None
    assert unranked.reason == "the directions were given, so there was no controller to compare"
    assert_not_tested(unranked)
    assert texts_by_label(hindsight)["given directions"].startswith("no controller was used")
    (table,) = summary(contrast([hindsight, mpc]))
    assert "no verdict (the directions were given" in table.note


def test_what_is_not_tested_is_not_counted_as_a_test():
    """Else more seems to be needed to detect a difference of the two that are tested."""
    directions = {"type": "sequence", "period": 0.2, "directions": [0.1]}
    mpc, exact = arm("mpc", ERRORS), arm("exact", ERRORS * 2, controller=EXACT)
    hindsight = arm("given", ERRORS / 100, controller=directions)
    alone = contrast_of(mpc, exact)
    first, *_ = contrast([mpc, exact, hindsight]).contrasts
    assert first.detects == alone.detects > 0


def test_trials_with_directions_of_their_own_are_one_batch():
    def trials_steered_by(direction):
        sequence = {"type": "sequence", "period": 0.2, "directions": [direction]}
        return batch(ERRORS.tolist(), experiment(plant=DISTURBED, controller=sequence))

    mixed = [trials_steered_by(0.1 * k)[k] for k in range(TRIALS)]
    assert group(mixed, name="given").counted == TRIALS


def test_seven_trials_on_one_side_carry_no_verdict():
    unpaired = contrast_of(arm("a", ERRORS[:7]), arm("b", ERRORS + 50, seed=2))
    assert unpaired.verdict is None
    assert unpaired.reason == "a verdict needs at least 8 complete trials in each batch"


def test_a_verdict_needs_the_corrected_p_too():
    """Five of 15 comparisons have an interval off 0, and differ by no more than chance would."""
    shift = np.zeros((TRIALS, 3))
    shift[:, 0] = np.linspace(-1.9, 1.9, TRIALS) + 0.64
    errors = [ERRORS] * 5 + [ERRORS + shift]
    arms = [
        arm(str(i), errors[i], controller={"time_limit": 20.2 + i})  # six controllers
        for i in range(6)
    ]
    last = contrast(arms).contrasts[-1]
    assert last.difference.ci95.high < 0
    assert last.p_holm > 0.05
    assert last.verdict == "undecided"
