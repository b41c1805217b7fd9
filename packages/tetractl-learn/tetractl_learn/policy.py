"""A controller with a learnt policy: a small neural network whose weights are in the spec.

The function `compute_features` computes the input of the network from an observation. For N robots,
it has 4 N + 2 numbers:

    gaps to the targets / the arena's longer side   x_1, y_1, ..., x_N, y_N
    headings                                        cos theta_1, sin theta_1, ..., cos theta_N, ...
    last direction sent                             cos u, sin u (0, 0 if there was none)

Each layer is y = W x + b. The `activation` follows each layer except the last. The two outputs are
clipped to [-1, 1], because learners clip an action to this range. They point in the direction that
is sent: u = atan2(y_2, y_1). No random numbers are used, so `verify` can repeat each decision, to
the bit on one computer.

The policy does not use the true poses. It uses the poses that the camera measured, and for an
untracked robot its last measured pose.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from tetractl.control.methods.fixed_sequence import given_plan
from tetractl.control.methods.plain import PlainController, PlainSection
from tetractl.core import elementwise
from tetractl.core.commands import Command
from tetractl.core.elementary import atan2, cos, sin
from tetractl.core.errors import ControlError
from tetractl.core.plan import Decision, Plan, Problem
from tetractl.core.poses import Floats, Observation
from tetractl.core.setup import Setup
from tetractl.spec.controller import ALONE, Host, NamedFile
from tetractl.spec.yaml.problems import Loc
from tetractl_learn.weights import Layer, read_weights

N_OUTPUTS = 2
"""Number of outputs of a policy: the components of the direction along x and y."""


def count_features(n_robots: int) -> int:
    """Compute the number of input features of a policy for a number of robots."""
    return 4 * n_robots + 2


def compute_features(
    setup: Setup, observation: Observation, last_direction: float | None
) -> Floats:
    """Compute the input of a policy for N robots: gaps to targets, headings and the last direction.

    The result has the shape (4 N + 2,), in the order of the module's docstring.

    Args:
        setup: The constants of the experiment.
        observation: The newest camera frame.
        last_direction: The direction that was sent last [rad]. None if none was sent yet.
    """
    arena_side = max(setup.arena.width, setup.arena.height)
    gaps = (setup.targets - observation.poses.xy) / arena_side
    heading = observation.poses.heading
    heading_vectors = np.stack([elementwise.cos(heading), elementwise.sin(heading)], axis=1)
    last_vector = [0.0, 0.0]
    if last_direction is not None:
        last_vector = [cos(last_direction), sin(last_direction)]
    return np.concatenate([gaps.ravel(), heading_vectors.ravel(), last_vector])


ACTIVATIONS: dict[str, Callable[[Floats], Floats]] = {
    "tanh": elementwise.tanh,
    "relu": lambda values: np.maximum(values, 0.0),
}
"""The functions that can be used between two layers, by their names in a spec."""


class PolicySection(PlainSection):
    """A learnt policy: a controller with a neural network, whose weights are in a file."""

    type: Literal["policy"]
    weights: str | None = Field(default=None, max_length=1000)
    """A JSON file of weights: {"layers": [{"weights": W, "bias": b}, ...]}, with W as a list of
    rows. The log keeps the file, and a resolved spec has its numbers as `layers`.
    """
    layers: Annotated[tuple[Layer, ...], Field(max_length=10)] = ()
    """The layers of the network, as tetractl writes them for `weights`."""
    activation: Literal["tanh", "relu"] = "tanh"
    """The function that is applied between two layers."""

    named_file: ClassVar[NamedFile | None] = NamedFile("weights", "layers", read_weights)

    def bounds(self) -> dict[str, str]:
        """Describe the size of the network for display: {"network": text}."""
        widths = [layer.inputs for layer in self.layers]
        return {"network": " to ".join(map(str, [*widths, N_OUTPUTS]))}

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield an error for each layer whose size does not fit.

        The size of a layer has to fit the previous layer, the number of robots, or the two
        components of a direction.
        """
        if not self.layers:
            yield (), "needs the field weights, the name of a JSON file"
            return
        n_expected = count_features(len(setup.names))
        for number, layer in enumerate(self.layers):
            if layer.inputs != n_expected:
                source = "the previous layer gives" if number else "the spec's robots need"
                message = f"has {layer.inputs} inputs, but {source} {n_expected}"
                yield ("layers", number), message
            n_expected = layer.outputs
        if n_expected != N_OUTPUTS:
            message = f"has {n_expected} outputs, but a direction has {N_OUTPUTS} components"
            yield ("layers", len(self.layers) - 1), message

    def build(self, setup: Setup, key: int, host: Host = ALONE) -> "PolicyController":
        """Create the controller of one trial; see `ControllerSection.build`."""
        return PolicyController(self, setup, key)


class PolicyController(PlainController):
    """The controller of one trial that sends the directions that a learnt policy chooses.

    Args:
        section: The fields of the controller in the spec.
        setup: The constants of the experiment.
        key: Only logged, because nothing is random.
    """

    def __init__(self, section: PolicySection, setup: Setup, key: int) -> None:
        super().__init__(section, setup, key)
        self._setup = setup
        self._layers = [layer.arrays() for layer in section.layers]
        self._activation = ACTIVATIONS[section.activation]
        self._last_direction: float | None = None

    def plan(
        self,
        observation: Observation,
        last_command: Command | None = None,
        earlier: Sequence[Observation] = (),
    ) -> Decision:
        """Record the direction that was sent last, and choose the next; see `Controller.plan`."""
        if last_command is not None and last_command.direction is not None:
            self._last_direction = last_command.direction
        return super().plan(observation, last_command, earlier)

    def decided(self, problem: Problem, observation: Observation, step_key: int) -> Plan:
        """Plan the direction that the policy chooses; see `PlainController.decided`.

        Raises:
            ControlError: If an output of the network is not a finite number.
        """
        outputs = compute_outputs(
            self._layers,
            self._activation,
            compute_features(self._setup, observation, self._last_direction),
        )
        if not np.isfinite(outputs).all():
            raise ControlError(
                "the policy's network returned an output that is not a finite number",
                "check the weights of the network (they may be too large) and the poses (one may "
                "be NaN)",
            )
        along_x, along_y = np.clip(outputs, -1.0, 1.0)
        direction = atan2(along_y, along_x)
        return given_plan(problem, np.array([direction]), step_key)


def compute_outputs(
    layers: Sequence[tuple[Floats, Floats]], activation: Callable[[Floats], Floats], inputs: Floats
) -> Floats:
    """Compute the outputs of a neural network from its inputs.

    Args:
        layers: For each layer, W of shape (outputs, inputs) and b of shape (outputs,).
        activation: The function that is applied between two layers.
        inputs: The inputs of the first layer.
    """
    layer_values = inputs
    with np.errstate(over="ignore", invalid="ignore"):  # the caller checks the outputs
        for number, (weights, bias) in enumerate(layers):
            if number > 0:
                layer_values = activation(layer_values)
            layer_values = np.einsum("oi,i->o", weights, layer_values) + bias
    return layer_values
