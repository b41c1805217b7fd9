"""A controller that uses a learnt policy: a small network whose weights are in the spec.

The function `features` computes the input of the network from an observation. For N robots, it has
4 N + 2 numbers:

    gaps to the targets / the arena's longer side   x_1, y_1, ..., x_N, y_N
    headings                                        cos theta_1, sin theta_1, ..., cos theta_N, ...
    last direction sent                             cos u, sin u; 0, 0 before the first

Each layer is y = W x + b. The `activation` follows each layer except the last. The two outputs are
clipped to [-1, 1], because learners clip an action to this range. They point in the direction that
is
sent: u = atan2(y_2, y_1). No random numbers are used, so `verify` can repeat each decision, to the
bit on one computer.

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

OUTPUTS = 2
"""Number of outputs of a policy: the components of the direction along x and y."""


def features_of(robots: int) -> int:
    """Return the number of input features for a number of robots."""
    return 4 * robots + 2


def features(setup: Setup, observation: Observation, last_direction: float | None) -> Floats:
    """Compute the input of a policy, shape (4 N + 2,), in the order of the module's docstring.

    Args:
        setup: The constants of the experiment.
        observation: The newest camera frame.
        last_direction: The direction sent before [rad]. None if there was none.
    """
    side = max(setup.arena.width, setup.arena.height)
    gaps = (setup.targets - observation.poses.xy) / side
    heading = observation.poses.heading
    headings = np.stack([elementwise.cos(heading), elementwise.sin(heading)], axis=1)
    sent = [0.0, 0.0]
    if last_direction is not None:
        sent = [cos(last_direction), sin(last_direction)]
    return np.concatenate([gaps.ravel(), headings.ravel(), sent])


ACTIVATIONS: dict[str, Callable[[Floats], Floats]] = {
    "tanh": elementwise.tanh,
    "relu": lambda values: np.maximum(values, 0.0),
}
"""The functions that can be used between two layers, by their names in a spec."""


class PolicySection(PlainSection):
    """A learnt policy: a network, whose weights are in a file that the log keeps."""

    type: Literal["policy"]
    weights: str | None = Field(default=None, max_length=1000)
    """A JSON file of weights: {"layers": [{"weights": W, "bias": b}, ...]}, with W as a list of
    rows. The log keeps the file, and a resolved spec has its numbers as `layers`.
    """
    layers: Annotated[tuple[Layer, ...], Field(max_length=10)] = ()
    """The layers of the network, as tetractl writes them for `weights`."""
    activation: Literal["tanh", "relu"] = "tanh"
    """The function between two layers."""

    named_file: ClassVar[NamedFile | None] = NamedFile("weights", "layers", read_weights)

    def bounds(self) -> dict[str, str]:
        """Return the size of the network, for display: {name: text}."""
        widths = [layer.inputs for layer in self.layers]
        return {"network": " to ".join(map(str, [*widths, OUTPUTS]))}

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield an error for each layer that does not fit.

        A layer has to fit the previous layer, the number of robots, or the two components of a
        direction.
        """
        if not self.layers:
            yield (), "needs the field weights, the name of a JSON file"
            return
        expected = features_of(len(setup.names))
        for number, layer in enumerate(self.layers):
            if layer.inputs != expected:
                before = "the previous layer gives" if number else "the spec's robots need"
                message = f"has {layer.inputs} inputs, but {before} {expected}"
                yield ("layers", number), message
            expected = layer.outputs
        if expected != OUTPUTS:
            message = f"has {expected} outputs, but a direction has {OUTPUTS} components"
            yield ("layers", len(self.layers) - 1), message

    def build(self, setup: Setup, key: int, host: Host = ALONE) -> "PolicyController":
        """Create the controller of one trial; see `ControllerSection.build`."""
        return PolicyController(self, setup, key)


class PolicyController(PlainController):
    """The controller of one trial that sends what a learnt policy decides.

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
        """Note the direction that was sent, and decide what to send next; see `Controller.plan`."""
        if last_command is not None and last_command.direction is not None:
            self._last_direction = last_command.direction
        return super().plan(observation, last_command, earlier)

    def decided(self, problem: Problem, observation: Observation, step_key: int) -> Plan:
        """Plan the direction that the policy chooses; see `PlainController.decided`.

        Raises:
            ControlError: If an output of the network is not a finite number.
        """
        outputs = forward(
            self._layers,
            self._activation,
            features(self._setup, observation, self._last_direction),
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


def forward(
    layers: Sequence[tuple[Floats, Floats]], activation: Callable[[Floats], Floats], inputs: Floats
) -> Floats:
    """Compute the outputs of the network.

    Args:
        layers: For each layer, W of shape (outputs, inputs) and b of shape (outputs,).
        activation: The function between two layers.
        inputs: The inputs of the first layer.
    """
    values = inputs
    with np.errstate(over="ignore", invalid="ignore"):  # who asks looks at the outputs
        for number, (weights, bias) in enumerate(layers):
            if number > 0:
                values = activation(values)
            values = np.einsum("oi,i->o", weights, values) + bias
    return values
