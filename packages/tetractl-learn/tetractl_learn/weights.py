"""Reads a policy's weights from a file, and packs them as layers into a spec.

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
"""Maximum number of inputs or outputs of a layer."""
FILE_MAX_BYTES = 16 << 20
"""Maximum size of a file of weights [bytes].

Two hidden layers of 400 in plain digits are 4 MB.
"""
LITTLE_ENDIAN = "<f8"
"""Format of the numbers of a layer in a spec: 64-bit floats, the same bytes on every computer."""


class Layer(Model):
    """One layer of a network: y = W x + b."""

    inputs: int = Field(ge=1, le=WIDTH_MAX)
    """Length of x."""
    outputs: int = Field(ge=1, le=WIDTH_MAX)
    """Length of y."""
    numbers: str = Field(max_length=FILE_MAX_BYTES, repr=False)
    """W (outputs, inputs) row by row, then b (outputs,): base64 of little-endian 64-bit floats."""

    @field_validator("numbers")
    @classmethod
    def _are_finite_numbers(cls, text: str, info: Any) -> str:
        try:
            data = base64.b64decode(text, validate=True)
        except binascii.Error:
            raise ValueError("must be base64") from None
        outputs = info.data.get("outputs", 0)
        expected = outputs * (info.data.get("inputs", 0) + 1)
        if len(data) != 8 * expected:
            raise ValueError(
                f"must contain {expected} numbers of 8 bytes, but has {len(data)} bytes"
            )
        if not np.isfinite(np.frombuffer(data, LITTLE_ENDIAN)).all():
            raise ValueError("must be finite")
        return text

    def arrays(self) -> tuple[Floats, Floats]:
        """Decode the weights W, shape (outputs, inputs), and the bias b, shape (outputs,)."""
        data = base64.b64decode(self.numbers)
        numbers = np.frombuffer(data, LITTLE_ENDIAN).astype(np.float64)
        split = self.outputs * self.inputs
        return numbers[:split].reshape(self.outputs, self.inputs), numbers[split:]


def read_weights(path: Path) -> tuple[list[dict[str, Any]], str]:
    """Read the layers of a network from a file.

    Returns:
        The layers in the form of a spec, and the text of the file.

    Raises:
        InvalidSpecError: If the file is invalid. The message names the wrong layer.
    """
    text = read_text(path, FILE_MAX_BYTES)

    def refusal(message: str) -> InvalidSpecError:
        problem = SpecProblem(printable(str(path)), message)
        return InvalidSpecError([problem])

    try:
        contents = json.loads(text)
    except ValueError as error:
        raise refusal(f"is not JSON: {printable(str(error), 200)}") from None
    except RecursionError:
        raise refusal("is not a file of weights, because its lists are nested too deeply") from None
    layers = contents.get("layers") if isinstance(contents, dict) else None
    if not isinstance(layers, list) or not layers:
        raise refusal('must be {"layers": [{"weights": [[...], ...], "bias": [...]}, ...]}')
    packed = []
    for number, layer in enumerate(layers):
        try:
            packed.append(_packed(layer))
        except (KeyError, TypeError, ValueError, OverflowError):
            raise refusal(
                f"layers.{number}: weights must be a list of rows of equal length, and bias a "
                "list with one number for each row"
            ) from None
    return packed, text


def _packed(layer: Any) -> dict[str, Any]:
    """Convert a layer of a file, with the keys `weights` and `bias`, to the form of a spec.

    Raises:
        ValueError: If its shapes do not fit.
    """
    weights = np.array(layer["weights"], dtype=LITTLE_ENDIAN)
    bias = np.array(layer["bias"], dtype=LITTLE_ENDIAN)
    outputs, inputs = weights.shape
    if bias.shape != (outputs,):
        raise ValueError
    numbers = base64.b64encode(weights.tobytes() + bias.tobytes())
    return {"inputs": inputs, "outputs": outputs, "numbers": numbers.decode()}
