"""Tests of a learnt policy: its weights, from file to log, its decisions, and its refusals."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from tetractl_learn.policy import ACTIVATIONS, compute_features, compute_outputs

import tetractl
from tetractl.core.poses import Observation, Poses
from tetractl.spec.yaml.problems import InvalidSpecError

SPEC = {
    "name": "policy",
    "units": {"length": "um"},
    "arena": {"left": 0, "bottom": 0, "width": 4000, "height": 2000},
    "robots": [
        {
            "name": "cell",
            "start": [1000, 1000],
            "heading": 0.0,
            "target": [3000, 1000],
            "a": 4,
            "speed": 300,
        }
    ],
    "controller": {
        "type": "policy",
        "weights": "weights.json",
        "time_limit": 20,
        "arrival_tolerance": 50,
    },
    "trials": {"count": 1, "seed": 1},
}
TOWARDS_TARGET = {"weights": [[1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0]], "bias": [0, 0]}
"""The direction is that of the gap, the first two of the six features of one robot."""


def spec_file(folder: Path, layers: list[dict], **controller: object) -> Path:
    """Write a spec and its file of weights; return the path of the spec."""
    weights = folder / "weights.json"
    weights.write_text(json.dumps({"layers": layers}))
    path = folder / "spec.yaml"
    path.write_text(yaml.safe_dump(SPEC | {"controller": SPEC["controller"] | controller}))
    return path


def test_a_policy_along_the_gap_arrives_and_is_verified_from_the_log_alone(tmp_path):
    path = spec_file(tmp_path, [TOWARDS_TARGET])
    trial = tetractl.run_trial(path, folder=tmp_path / "logs")
    (tmp_path / "weights.json").unlink()
    assert trial.result.outcome == "arrived"
    assert trial.result.total_error <= 50  # the spec's arrival_tolerance
    assert all(step.plan.direction == pytest.approx(0.0, abs=1e-9) for step in trial.steps)
    verification = tetractl.verify(tmp_path / "logs" / "trial-000.mcap")
    assert not verification.problems
    assert verification.checked == len(trial.steps)


def test_features_are_gaps_headings_and_the_last_direction(tmp_path):
    setup = tetractl.load_spec(spec_file(tmp_path, [TOWARDS_TARGET])).experiment.setup
    poses = Poses.from_array(np.array([[2000.0, 1500.0, math.pi / 2]]))
    observation = Observation(1, 0, 0, poses, np.array([True]))
    gap = [1000 / 4000, -500 / 4000]  # of the arena's longer side, 4000 um
    expected = [*gap, 0.0, 1.0, 0.0, 0.0]
    np.testing.assert_allclose(compute_features(setup, observation, None), expected, atol=1e-15)
    expected = [*gap, 0.0, 1.0, -1.0, 0.0]
    np.testing.assert_allclose(compute_features(setup, observation, math.pi), expected, atol=1e-15)


@pytest.mark.parametrize(("activation", "hidden"), [("tanh", math.tanh(-2.0)), ("relu", 0.0)])
def test_the_activation_stands_between_the_layers_alone(activation, hidden):
    first = (np.array([[1.0]]), np.array([-3.0]))  # 1 - 3 = -2
    second = (np.array([[2.0], [0.0]]), np.array([0.5, -7.0]))
    outputs = compute_outputs([first, second], ACTIVATIONS[activation], np.array([1.0]))
    np.testing.assert_allclose(outputs, [2 * hidden + 0.5, -7.0])


@pytest.mark.parametrize(
    ("layers", "words"),
    [
        ([{"weights": [[1, 2]], "bias": [0]}], "has 2 inputs, but the spec's robots need 6"),
        ([{"weights": [[0] * 6] * 3, "bias": [0] * 3}], "has 3 outputs, but a direction has 2"),
        (
            [{"weights": [[0] * 6] * 3, "bias": [0] * 3}, TOWARDS_TARGET],
            "layers.1: has 6 inputs, but the previous layer gives 3",
        ),
        ([{"weights": [[1, 2], [3]], "bias": [0, 0]}], "layers.0: weights must be a list of rows"),
        ([{"weights": [[1, 2]], "bias": [0, 0]}], "layers.0: weights must be a list of rows"),
        ([{"weights": [[math.inf] * 6] * 2, "bias": [0, 0]}], "must be finite"),
        ([], 'must be {"layers"'),
    ],
)
def test_layers_that_do_not_fit_are_refused_by_name(layers, words, tmp_path):
    path = spec_file(tmp_path, layers)
    with pytest.raises(InvalidSpecError) as refused:
        tetractl.load_spec(path)
    assert words in str(refused.value)


@pytest.mark.parametrize(
    ("text", "words"), [("layers: []", "is not JSON"), ("[" * 100_000, ".* nested too deep")]
)
def test_a_file_that_holds_no_weights_is_refused_by_name(text, words, tmp_path):
    path = spec_file(tmp_path, [TOWARDS_TARGET])
    (tmp_path / "weights.json").write_text(text)
    with pytest.raises(InvalidSpecError, match=rf"weights.json: {words}"):
        tetractl.load_spec(path)
