"""Reads the weights of a policy's network from a file, and packs them into a spec.

The file is JSON, as `json.dump` writes it: {"layers": [{"weights": W, "bias": b}, ...]}. W is a
list of rows, shape (outputs, inputs), and b is a list, shape (outputs,). A spec names the file with
`controller.weights: FILE`. When the spec is read, the layers, packed as text, replace the name.
Therefore a log needs no other file.
"""

import base64
import binascii
import json
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field, field_validator

from tetractl.core.errors import printable
from tetractl.core.poses import Floats
from tetractl.spec.base import Model
from tetractl.spec.yaml.problems import InvalidSpecError, SpecProblem
from tetractl.spec.yaml.spec_files import read_text

WIDTH_MAX = 1000
"""Maximum number of inputs or outputs of a layer of a network."""
FILE_MAX_BYTES = 16 << 20
"""Maximum size of a file of weights [bytes].

Two hidden layers of 400 neurons, written in plain digits, take 4 MB.
"""
NUMBER_FORMAT = "<f8"
"""NumPy format of a layer's numbers in a spec: little-endian 64-bit floats on every computer."""


class Layer(Model):
    """One layer of a neural network in a spec: y = W x + b."""

    inputs: int = Field(ge=1, le=WIDTH_MAX)
    """Number of inputs: the length of x."""
    outputs: int = Field(ge=1, le=WIDTH_MAX)
    """Number of outputs: the length of y."""
    numbers: str = Field(max_length=FILE_MAX_BYTES, repr=False)
    """W (outputs, inputs) row by row, then b (outputs,): base64 of little-endian 64-bit floats."""

    @field_validator("numbers")
    @classmethod
    def _are_finite_numbers(cls, encoded: str, info: Any) -> str:
        """Check that the text contains the right number of finite numbers."""
        try:
            data = base64.b64decode(encoded, validate=True)
        except binascii.Error:
            raise ValueError("must be base64") from None
        outputs = info.data.get("outputs", 0)
        n_expected = outputs * (info.data.get("inputs", 0) + 1)
        if len(data) != 8 * n_expected:
            raise ValueError(
                f"must contain {n_expected} numbers of 8 bytes, but has {len(data)} bytes"
            )
        if not np.isfinite(np.frombuffer(data, NUMBER_FORMAT)).all():
            raise ValueError("must be finite")
        return encoded

    def arrays(self) -> tuple[Floats, Floats]:
        """Decode the weights W, shape (outputs, inputs), and the bias b, shape (outputs,)."""
        data = base64.b64decode(self.numbers)
        numbers = np.frombuffer(data, NUMBER_FORMAT).astype(np.float64)
        n_weights = self.outputs * self.inputs
        return numbers[:n_weights].reshape(self.outputs, self.inputs), numbers[n_weights:]


def read_weights(path: Path) -> tuple[list[dict[str, Any]], str]:
    """Read the layers of a network from a JSON file of weights.

    Returns:
        The layers in the form of a spec, and the contents of the file.

    Raises:
        InvalidSpecError: If the file is invalid. The message names the wrong layer.
    """
    text = read_text(path, FILE_MAX_BYTES)

    def create_error(message: str) -> InvalidSpecError:
        problem = SpecProblem(printable(str(path)), message)
        return InvalidSpecError([problem])

    try:
        contents = json.loads(text)
    except ValueError as error:
        raise create_error(f"is not JSON: {printable(str(error), 200)}") from None
    except RecursionError:
        raise create_error(
            "is not a file of weights, because its lists are nested too deeply"
        ) from None
    layers = contents.get("layers") if isinstance(contents, dict) else None
    if not isinstance(layers, list) or not layers:
        raise create_error('must be {"layers": [{"weights": [[...], ...], "bias": [...]}, ...]}')
    packed_layers = []
    for number, layer in enumerate(layers):
        try:
            packed_layers.append(_pack_layer(layer))
        except (KeyError, TypeError, ValueError, OverflowError):
            raise create_error(
                f"layers.{number}: weights must be a list of rows of equal length, and bias a "
                "list with one number for each row"
            ) from None
    return packed_layers, text


def _pack_layer(layer: Any) -> dict[str, Any]:
    """Convert a layer of a weights file to the form of a spec.

    The layer has the keys "weights" and "bias".

    Raises:
        ValueError: If the shapes of the weights and the bias do not fit.
    """
    weights = np.array(layer["weights"], dtype=NUMBER_FORMAT)
    bias = np.array(layer["bias"], dtype=NUMBER_FORMAT)
    outputs, inputs = weights.shape
    if bias.shape != (outputs,):
        raise ValueError
    numbers = base64.b64encode(weights.tobytes() + bias.tobytes())
    return {"inputs": inputs, "outputs": outputs, "numbers": numbers.decode()}
