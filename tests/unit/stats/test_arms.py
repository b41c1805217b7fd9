import math

import numpy as np
import pytest
from scipy import optimize, stats
from support.batches import DISTURBED, batch, experiment

from tetractl.core.errors import UsageError
from tetractl.stats.arms import RANK_SUM, SIGNED_RANK, Arm, Contrast, NotCompared, compare_arms
from tetractl.stats.arms_export import arms_csv, arms_json
from tetractl.stats.arms_rows import arms_grids, detects
from tetractl.stats.effects import (
    detectable,
    detectable_between,
    deviation_ratio,
    standardised,
)
from tetractl.stats.summary import summarise

RNG = np.random.default_rng(8)
ERRORS = RNG.gamma(4, 50, (20, 3))


def arm(name, errors, **fields):
    fields = {"plant": DISTURBED} | fields
    return Arm(name, summarise(batch(np.asarray(errors).tolist(), experiment(**fields))))


def three():
    return compare_arms(
        [
            arm("a", ERRORS),
            arm("b", ERRORS + 30, controller={"type": "mpc", "motion": "exact"}),
            arm("c", ERRORS[::-1] * 3, controller={"type": "mpc", "motion": "arc"}),
        ]
    )


def test_every_two_arms_are_compared_by_pairs_and_corrected_for_their_number():
    found = three().contrasts
    assert [(one.one.name, one.other.name) for one in found] == [("a", "b"), ("a", "c"), ("b", "c")]
    assert all(isinstance(one, Contrast) and one.pairs == 20 for one in found)
    last = found[2]
    ours, theirs = (ERRORS + 30).sum(axis=1), (ERRORS[::-1] * 3).sum(axis=1)
    test = stats.wilcoxon(ours - theirs, method="exact")
    assert (last.test, last.p_value) == (SIGNED_RANK, pytest.approx(test.pvalue))
    assert last.difference.value == pytest.approx((ours - theirs).mean())
    corrected = sorted(one.p_holm for one in found)
    assert corrected[0] == pytest.approx(3 * min(one.p_value for one in found))
    assert last.verdict == "lower"


def test_worlds_that_differ_are_not_paired():
    one = arm("a", ERRORS)
    other = arm("b", ERRORS[:9] * 2, plant=DISTURBED | {"dead_time": 0.1})
    (found,) = compare_arms([one, other]).contrasts
    assert isinstance(found, Contrast)
    assert (found.pairs, found.test) == (0, RANK_SUM)
    assert found.why_unpaired == "the batches differ in more than the controller"
    test = stats.mannwhitneyu(ERRORS.sum(axis=1), 2 * ERRORS[:9].sum(axis=1), method="exact")
    assert found.p_value == pytest.approx(test.pvalue)
    assert detects(found).startswith("20 and 9 trials detect ")


def test_what_is_not_alike_is_not_compared():
    found = compare_arms([arm("a", ERRORS), arm("b", ERRORS, plant={"type": "sim"})])
    (only,) = found.contrasts
    assert isinstance(only, NotCompared)
    assert only.reason == "disturbed simulation and undisturbed simulation"
    assert arms_json(found)["comparisons"] == [
        {"one": "a", "other": "b", "comparable": False, "reason": only.reason}
    ]
    assert "False" in arms_csv(found)
    assert arms_grids(found)[-1].title == "Not compared, since they are not alike"


def test_few_trials_carry_no_verdict():
    (found,) = compare_arms(
        [arm("a", ERRORS[:7]), arm("b", ERRORS[:7] + 50, controller={"motion": "exact"})]
    ).contrasts
    assert isinstance(found, Contrast)
    assert (found.verdict, found.reason) == (None, "a verdict needs 8 pairs")


def test_a_verdict_needs_the_corrected_p_too():
    """Five of 15 comparisons have an interval off 0, and differ by no more than chance would."""
    off = np.zeros((20, 3))
    off[:, 0] = np.linspace(-1.9, 1.9, 20) + 0.64
    arms = [
        arm(str(i), ERRORS + (off if i == 5 else 0.0), controller={"steps_max": 100 + i})
        for i in range(6)
    ]
    last = compare_arms(arms).contrasts[-1]
    assert isinstance(last, Contrast)
    assert last.difference.ci95.high < 0
    assert (last.p_holm > 0.05, last.verdict) == (True, "undecided")


def test_arms_of_other_units_are_refused():
    with pytest.raises(UsageError, match="b has errors in um, a in mm"):
        compare_arms([arm("a", ERRORS), arm("b", ERRORS, units={"length": "um"})])


def test_the_tables_hold_what_the_json_holds():
    found = three()
    first = arms_json(found)["comparisons"][0]
    grid = next(one for one in arms_grids(found) if one.title == "Every two arms")
    assert grid.rows[0][:2] == ("a - b", "20 pairs")
    assert grid.rows[0][-1] == first["verdict"] or first["verdict"] is None
    assert len(arms_csv(found).splitlines()) == 4
    assert {len(row) for row in grid.rows} == {len(grid.header)}


@pytest.mark.parametrize(("n", "size"), [(8, 1.16), (20, 0.66), (100, 0.283)])
def test_what_pairs_detect_is_what_the_noncentral_t_says(n, size):
    assert detectable(n) == pytest.approx(size, abs=0.005)
    found, bound = detectable(n), stats.t.ppf(0.975, n - 1)
    power = stats.nct.sf(bound, n - 1, found * math.sqrt(n))
    assert power == pytest.approx(0.8, abs=1e-3)
    assert detectable(n, tests=10) > found


def test_two_batches_detect_less_than_pairs():
    assert detectable_between(20, 20) == pytest.approx(0.91, abs=0.005)
    assert detectable_between(64, 64) == pytest.approx(0.5, abs=0.005)  # Cohen's table
    assert math.isnan(detectable(1)) and math.isnan(detectable_between(1, 9))


def test_a_ratio_of_deviations_is_by_the_jackknife():
    one, other = RNG.normal(0, 1, 12), RNG.gamma(2, 3, 20)

    def pseudo(values):
        n, every = len(values), math.log(values.var(ddof=1))
        return [n * every - (n - 1) * math.log(np.delete(values, i).var(ddof=1)) for i in range(n)]

    found = deviation_ratio(one, other)
    test = stats.ttest_ind(pseudo(one), pseudo(other), equal_var=False)
    ends = test.confidence_interval()
    assert found.value == pytest.approx(one.std(ddof=1) / other.std(ddof=1))
    assert found.p_value == pytest.approx(test.pvalue)
    expected = (math.exp(ends.low / 2), math.exp(ends.high / 2))
    assert (found.ci95.low, found.ci95.high) == pytest.approx(expected)


def test_deviations_turn_with_the_sides():
    one, other = RNG.gamma(3, 1, 15), RNG.gamma(3, 4, 30)
    found, back = deviation_ratio(one, other), deviation_ratio(other, one)
    assert found.value * back.value == pytest.approx(1)
    assert found.ci95.low * back.ci95.high == pytest.approx(1)
    assert "needs 5 values" in (deviation_ratio(one[:4], other).ci95.reason or "")
    assert "are equal" in (deviation_ratio(np.ones(9), other).ci95.reason or "")


def test_a_standardised_difference_is_in_deviations_of_the_pairs():
    differences = RNG.normal(2, 4, 30)
    found = standardised(differences)
    assert found.value == pytest.approx(differences.mean() / differences.std(ddof=1))
    t = found.value * math.sqrt(30)
    exact = [
        optimize.brentq(lambda nc, share=share: stats.nct.cdf(t, 29, nc) - share, -3, 9) / 30**0.5
        for share in (0.975, 0.025)
    ]
    assert (found.ci95.low, found.ci95.high) == pytest.approx(exact, abs=0.05)
    assert not standardised(np.full(9, 2.0)).ci95.known
