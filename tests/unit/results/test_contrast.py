import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from support.batches import DISTURBED, batch, experiment, group

from tetractl.core.errors import UsageError
from tetractl.log.read.trial_log import Origin
from tetractl.results.as_json import contrast_items
from tetractl.results.batch_rows import texts_by_label
from tetractl.results.contrast import contrast
from tetractl.results.tables import summary

ERRORS = np.random.default_rng(8).gamma(4, 50, (20, 3))
EXACT = {"motion": "exact"}


def arm(name, errors, origin=None, seed=1, **fields):
    fields = {"plant": DISTURBED} | fields
    trials = batch(np.asarray(errors).tolist(), experiment(**fields))
    trials = [replace(one, origin=origin or one.origin, seed=seed) for one in trials]
    return group(trials, name=name)


def only(*groups):
    """The one contrast of two groups."""
    (found,) = contrast(groups).contrasts
    return found


def three():
    return contrast(
        [
            arm("a", ERRORS),
            arm("b", ERRORS + 30, controller=EXACT),
            arm("c", ERRORS[::-1] * 3, controller={"motion": "arc"}),
        ]
    )


def test_every_two_groups_are_compared_by_pairs_and_corrected_for_their_number():
    found = three().contrasts
    assert [one.name for one in found] == ["a - b", "a - c", "b - c"]
    assert all(one.alike and one.pairs == 20 for one in found)
    last = found[2]
    ours, theirs = (ERRORS + 30).sum(axis=1), (ERRORS[::-1] * 3).sum(axis=1)
    test = stats.wilcoxon(ours - theirs, method="exact")
    assert (last.tests, last.rank_p) == ("paired t, signed rank", pytest.approx(test.pvalue))
    assert last.difference.value == pytest.approx((ours - theirs).mean())
    for corrected, plain in (
        ([one.p_holm for one in found], [one.difference.p_value for one in found]),
        ([one.rank_p_holm for one in found], [one.rank_p for one in found]),
    ):
        assert min(corrected) == pytest.approx(3 * min(plain))
    assert last.verdict == "lower"


def test_with_a_baseline_each_group_is_compared_with_that_alone():
    a, b, c = three().groups
    found = contrast([a, b], baseline=c)
    assert [group.name for group in found.groups] == ["a", "b", "c"]
    assert [one.name for one in found.contrasts] == ["a - c", "b - c"]
    plain = min(one.difference.p_value for one in found.contrasts)
    assert min(one.p_holm for one in found.contrasts) == pytest.approx(2 * plain)


def test_two_groups_compare_either_way():
    ours, theirs = arm("a", ERRORS / 4, controller=EXACT), arm("b", ERRORS)
    found = only(ours, theirs)
    assert found.verdict == "lower"
    assert found.difference.value == pytest.approx(ours.total.mean - theirs.total.mean)
    assert found.both.high < 0
    assert found.differs == ("controller.motion: exact != euler",)
    assert only(theirs, ours).verdict == "higher"


def test_trials_of_the_same_world_are_paired_whatever_their_order():
    spec = experiment(plant=DISTURBED)
    other = experiment(plant=DISTURBED, controller=EXACT, name="other")
    ours, theirs = batch((0.9 * ERRORS).tolist(), other), batch(ERRORS.tolist(), spec)
    found = only(group(ours[::-1]), group(theirs[3:]))
    assert found.pairs == 17
    totals = ERRORS[3:].sum(axis=1)
    test = stats.ttest_rel(0.9 * totals, totals)
    assert found.difference.value == pytest.approx(-0.1 * totals.mean())
    assert found.difference.p_value == pytest.approx(test.pvalue)
    assert found.both.high > 0 > found.difference.ci95.high
    assert found.verdict == "lower"


@pytest.mark.parametrize(
    ("fields", "why"),
    [
        ({"plant": DISTURBED | {"dead_time": 0.1}}, "differ in more than the controller"),
        ({"seed": 2}, "no seed and trial in common"),
        ({"origin": Origin.LAB}, "no two trials in a lab have the same disturbances"),
    ],
)
def test_other_worlds_are_not_paired(fields, why):
    found = only(arm("a", ERRORS, **fields), arm("b", ERRORS))
    assert (found.pairs, found.tests) == (0, "Welch's t, rank sum")
    assert why in found.why_unpaired
    assert (found.detects > 0) == found.alike
    assert found.difference.ci95.known


@pytest.mark.parametrize("paired", [True, False])
def test_the_p_of_a_table_and_its_interval_are_of_one_test(paired):
    """With equal means and unequal spread ranks differ, the means do not."""
    rng = np.random.default_rng(3)
    off = ranks = 0
    for _ in range(80):
        ours, theirs = rng.gamma(16, 1 / 16, (20, 1)), rng.gamma(1, 1, (20, 1))
        fields = {"seed": 1 if paired else 2, "controller": EXACT}
        found = only(arm("a", ours, robots=1), arm("b", theirs, robots=1, **fields))
        interval = found.difference.ci95
        assert (found.p_holm < 0.05) == (interval.high < 0 or interval.low > 0)
        off += found.p_holm < 0.05
        ranks += found.rank_p_holm < 0.05
    assert off < 10
    assert ranks > off


def test_unlike_plants_have_a_difference_but_no_test_and_no_verdict():
    a, b, c = arm("a", ERRORS), arm("b", ERRORS * 4, plant={"type": "sim"}), arm("c", ERRORS * 2)
    found = contrast([a, b, c])
    first, tested, _ = found.contrasts
    assert (first.alike, first.verdict) == (False, None)
    assert first.reason == "plants are not alike"
    assert first.difference.value == pytest.approx(a.total.mean - b.total.mean)
    unknown = (first.rank_p, first.p_holm, first.difference.p_value)
    assert all(map(math.isnan, (*unknown, first.detects)))
    assert tested.p_holm == tested.difference.p_value  # nothing else is tested
    items = contrast_items(first)
    assert (items["comparable"], items["verdict_reason"]) == (False, first.reason)


def test_given_directions_have_no_rank_among_controllers():
    """Hindsight finds directions that no controller could."""
    given = {"type": "sequence", "period": 0.2, "directions": [0.1]}
    hindsight = arm("given", ERRORS / 100, controller=given)
    found = only(hindsight, arm("mpc", ERRORS))
    assert (found.no_controller, found.verdict) == (True, None)
    assert found.reason == "directions were given: no controller decided"
    assert all(map(math.isnan, (found.rank_p, found.p_holm, found.detects)))
    assert texts_by_label(hindsight)["given directions"].startswith("no controller decided")
    (table,) = summary(contrast([hindsight, arm("mpc", ERRORS)]))
    assert "no verdict (directions were given" in table.note


def test_trials_with_directions_of_their_own_are_one_batch():
    def trials(direction):
        given = {"type": "sequence", "period": 0.2, "directions": [direction]}
        return batch(ERRORS.tolist(), experiment(plant=DISTURBED, controller=given))

    mixed = [trials(0.1 * k)[k] for k in range(20)]
    assert group(mixed, name="given").counted == 20


def test_few_trials_carry_no_verdict():
    few = arm("a", ERRORS[:7]), arm("b", ERRORS[:7] + 50, controller=EXACT)
    found = only(*few)
    assert (found.verdict, found.reason) == (None, "a verdict needs 8 pairs")
    (table,) = summary(contrast(few))
    said = "a - b: no verdict (a verdict needs 8 pairs), "
    assert table.note.startswith(said)
    found = only(arm("a", ERRORS[:7]), arm("b", ERRORS + 50, seed=2))
    reason = "a verdict needs 8 complete trials on each side"
    assert (found.verdict, found.reason) == (None, reason)


def test_a_verdict_needs_the_corrected_p_too():
    """Five of 15 comparisons have an interval off 0, and differ by no more than chance would."""
    off = np.zeros((20, 3))
    off[:, 0] = np.linspace(-1.9, 1.9, 20) + 0.64
    arms = [
        arm(str(i), ERRORS + (off if i == 5 else 0.0), controller={"time_limit": 20.2 + i})
        for i in range(6)
    ]
    last = contrast(arms).contrasts[-1]
    assert last.difference.ci95.high < 0
    assert (last.p_holm > 0.05, last.verdict) == (True, "undecided")


def test_groups_of_other_units_are_refused():
    with pytest.raises(UsageError, match="b has errors in um, a in mm"):
        contrast([arm("a", ERRORS), arm("b", ERRORS, units={"length": "um"})])
