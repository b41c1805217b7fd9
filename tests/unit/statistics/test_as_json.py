"""Tests of what JSON and CSV hold of one batch and of the comparison of several."""

import math
from dataclasses import replace

import numpy as np
import pytest
from testkit.batches import DISTURBED, REFERENCE, batch, experiment, group

from tetractl.log.read.trial_log import Origin
from tetractl.statistics.as_json import batch_items, comparison_items, contrast_items, data_table
from tetractl.statistics.describe import contrast

ERRORS = np.random.default_rng(11).gamma(4, 50, (12, 2)).tolist()
SPEC = experiment(2, plant=DISTURBED)


def described(factor=1.0, name="", spec=SPEC, origin=None):
    trials = batch([[factor * error for error in errors] for errors in ERRORS], spec)
    if origin is not None:
        trials = [replace(trial, origin=origin, digest=trial.log) for trial in trials]
    return group(trials, name=name)


def test_one_batch_is_an_object_of_its_own_and_several_are_groups_and_comparisons():
    one = described()
    assert comparison_items(contrast([one])).keys() == batch_items(one).keys()
    both = comparison_items(contrast([described(name="a"), described(0.5, "b")]))
    assert both.keys() == {"unit", "groups", "comparisons"}
    assert [part["name"] for part in both["groups"]] == ["a", "b"]
    (pair,) = both["comparisons"]
    assert (pair["one"], pair["other"]) == ("a", "b")


@pytest.mark.parametrize(
    ("origin", "kind", "disturbed"),
    [
        (Origin.UNDISTURBED, "simulated", False),
        (Origin.DISTURBED, "simulated", True),
        (Origin.EMULATED, "emulated", True),
        (Origin.LAB, "lab", True),
    ],
)
def test_only_an_undisturbed_simulation_is_not_disturbed(origin, kind, disturbed):
    items = batch_items(described(origin=origin))
    assert items["origin"] == origin.value
    assert (items["kind"], items["disturbed"]) == (kind, disturbed)


@pytest.mark.parametrize("radius", [0, 47])
def test_the_radius_of_bodies_is_null_without_one(radius):
    control = {"type": "mpc", "collision": {"radius": radius}}
    items = batch_items(described(spec=experiment(2, controller=control)))
    assert items["body_radius"] == (radius or None)


def test_a_published_result_has_its_numbers_and_the_difference_only_from_a_lab():
    assert batch_items(described())["reference"] is None
    spec = experiment(2, reference=REFERENCE)
    lab = batch_items(described(spec=spec, origin=Origin.LAB))["reference"]
    for key in ("source", "n", "mean", "std"):
        assert lab[key] == REFERENCE[key]
    mean = np.sum(ERRORS, axis=1).mean()
    assert lab["difference"] == pytest.approx(mean - REFERENCE["mean"])
    simulated = batch_items(described(spec=spec))["reference"]
    assert math.isnan(simulated["difference"])
    assert simulated["comparable"] is False


def test_a_comparison_has_both_sides_in_their_order_and_its_tests():
    pair = contrast([described(name="a"), described(0.5, "b")]).contrasts[0]
    items = contrast_items(pair)
    sums = np.sum(ERRORS, axis=1)
    assert items["one_mean"] == pytest.approx(sums.mean())
    assert items["other_mean"] == pytest.approx(sums.mean() / 2)
    assert items["one_std"] == pytest.approx(sums.std(ddof=1))
    assert items["difference"] == pytest.approx(sums.mean() / 2)
    assert (items["one_n"], items["other_n"], items["pairs"]) == (12, 12, 12)
    assert items["unpaired_reason"] is None
    assert items["verdict"] == "higher"
    assert items["verdict_reason"] is None
    assert items["tests"] == "paired t, signed rank"
    unpaired = contrast([described(name="a"), described(0.5, "b", origin=Origin.LAB)])
    items = contrast_items(unpaired.contrasts[0])
    assert "no two trials in a lab" in items["unpaired_reason"]
    assert items["verdict"] is None
    assert items["comparable"] is False


def test_csv_has_a_row_for_each_trial_of_one_batch_and_for_each_comparison_of_several():
    one = data_table(contrast([described()]))
    assert len(one) == len(ERRORS)
    assert "total_error_mm" in one.as_dict()
    three = [described(factor, name) for factor, name in ((1.0, "a"), (0.5, "b"), (2.0, "c"))]
    several = data_table(contrast(three)).as_dict()
    assert several["one"] == ["a", "a", "b"]
    assert several["other"] == ["b", "c", "c"]
    against = data_table(contrast(three[:2], baseline=three[2])).as_dict()
    assert (against["one"], against["other"]) == (["a", "b"], ["c", "c"])
