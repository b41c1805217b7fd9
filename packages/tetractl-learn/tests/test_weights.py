"""Tests of weights: from a file to the layers of a spec and back, and what is refused."""

import json
from base64 import b64decode, b64encode

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from tetractl_learn.weights import WIDTH_MAX, Layer, read_weights

from tetractl.spec.yaml.problems import InvalidSpecError


def packed(folder, *layers):
    """The layers of a file in the form of a spec."""
    path = folder / "weights.json"
    path.write_text(json.dumps({"layers": list(layers)}))
    layers, text = read_weights(path)
    assert text == path.read_text()
    return [Layer(**layer) for layer in layers]


def test_weights_of_a_file_are_those_of_its_layers(tmp_path):
    first = {"weights": [[1, 2, 3], [4, 5.5, -6]], "bias": [7, 8]}
    second = {"weights": [[0.1, -0.2]], "bias": [1e-300]}
    one, two = packed(tmp_path, first, second)
    assert (one.inputs, one.outputs, two.inputs, two.outputs) == (3, 2, 2, 1)
    for layer, written in ((one, first), (two, second)):
        weights, bias = layer.arrays()
        assert weights.tolist() == written["weights"]
        assert bias.tolist() == written["bias"]


@given(st.integers(1, 5), st.integers(1, 5), st.integers(0, 999))
def test_numbers_are_little_endian_row_by_row_and_then_the_bias(outputs, inputs, seed):
    rng = np.random.default_rng(seed)
    weights = rng.normal(size=(outputs, inputs))
    bias = rng.normal(size=outputs)
    numbers = b64encode(np.concatenate([weights.ravel(), bias]).astype("<f8").tobytes()).decode()
    layer = Layer(inputs=inputs, outputs=outputs, numbers=numbers)
    again = layer.arrays()
    assert (again[0] == weights).all()
    assert (again[1] == bias).all()
    assert len(b64decode(layer.numbers)) == 8 * outputs * (inputs + 1)


def encoded(*numbers):
    return b64encode(np.array(numbers, dtype="<f8").tobytes()).decode()


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"numbers": encoded(1, 2)}, "must contain 3 numbers of 8 bytes, but has 16 bytes"),
        ({"numbers": encoded(1, 2, 3, 4)}, "must contain 3 numbers of 8 bytes, but has 32"),
        ({"numbers": "!"}, "must be base64"),
        ({"numbers": encoded(1, 2, np.inf)}, "must be finite"),
        ({"numbers": encoded(np.nan, 2, 3)}, "must be finite"),
        ({"inputs": 0}, "greater than or equal to 1"),
        ({"outputs": WIDTH_MAX + 1}, f"less than or equal to {WIDTH_MAX}"),
    ],
)
def test_a_layer_that_is_none_is_refused(fields, says):
    good = {"inputs": 2, "outputs": 1, "numbers": encoded(1, 2, 3)}
    assert Layer(**good).arrays()[0].tolist() == [[1, 2]]
    with pytest.raises(ValidationError, match=says):
        Layer(**(good | fields))


LAYER = {"weights": [[1, 2], [3, 4]], "bias": [5, 6]}
WRONG = {
    "rows of different lengths": {"weights": [[1, 2], [3]], "bias": [0, 0]},
    "a bias for each input": {"weights": [[1, 2, 3], [4, 5, 6]], "bias": [0, 0, 0]},
    "a bias that is a number": {"weights": [[1, 2]], "bias": 0},
    "a bias in rows": {"weights": [[1, 2]], "bias": [[0]]},
    "weights in one row": {"weights": [1, 2], "bias": [0, 0]},
    "no bias": {"weights": [[1, 2]]},
    "no weights": {"bias": [1, 2]},
    "words": {"weights": [["a", "b"]], "bias": [0]},
    "a list": [[1, 2]],
    "a number beyond floats": {"weights": [[10**400, 1]], "bias": [0]},
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_layer_is_named_by_its_number(tmp_path, case):
    path = tmp_path / "weights.json"
    path.write_text(json.dumps({"layers": [LAYER, WRONG[case]]}))
    with pytest.raises(InvalidSpecError) as caught:
        read_weights(path)
    assert f"{path}: layers.1: weights must be a list of rows" in caught.value.message


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[]", 'must be {"layers"'),
        ('{"layers": []}', 'must be {"layers"'),
        ('{"layers": {}}', 'must be {"layers"'),
        ("{}", 'must be {"layers"'),
        ("3", 'must be {"layers"'),
        ("{", "is not JSON"),
        ("", "is not JSON"),
    ],
)
def test_a_file_without_layers_is_refused(tmp_path, text, says):
    path = tmp_path / "weights.json"
    path.write_text(text)
    with pytest.raises(InvalidSpecError) as caught:
        read_weights(path)
    assert says in caught.value.message
