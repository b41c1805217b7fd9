"""Controllers by name, as specs: what the contract suite runs against."""

from base64 import b64encode
from typing import Any

import numpy as np

from tetractl.core.registries import OPTIMIZERS

SMALL: dict[str, dict[str, Any]] = {
    "pso": {"particles": 12, "iterations": 15},
    "multistart": {"type": "multistart", "particles": 16, "rounds": 2},
}
"""A quick search by each optimiser."""
PSO = SMALL["pso"]
MULTISTART = SMALL["multistart"]
assert SMALL.keys() == set(OPTIMIZERS.builtin), "a further optimiser joins the contract by an entry"

PUBLISHED: dict[str, dict[str, Any]] = {
    **{name: {"optimizer": optimizer} for name, optimizer in SMALL.items()},
    "pso, relative stop": {"optimizer": PSO | {"stop": {"type": "relative"}}, "motion": "exact"},
    "pso, target": {"optimizer": PSO | {"stop": {"type": "target", "cost": 900}}, "motion": "arc"},
}
RECOMMENDED: dict[str, dict[str, Any]] = {
    "": {"optimizer": MULTISTART},
    "pso, margins": {"optimizer": {"type": "pso"} | PSO, "collision": {"margin": 20}},
    "dead time": {"optimizer": MULTISTART, "dead_time": 0.14, "signal_periods": 2},
    "bodies": {"optimizer": MULTISTART, "accept_error": 40, "collision": {"radius": 40}},
}
"""Model predictive control, each optimiser and other variants: the controller's part of a spec."""


def straight(robots: int) -> dict[str, Any]:
    """A policy's layer: along the sum of the robots' gaps."""
    gaps = np.kron(np.ones(robots), np.eye(2))  # adds up x and y
    others = np.zeros((2, 2 * robots + 2))  # headings, and the last direction
    weights = np.hstack([gaps, others])
    biases = np.zeros(2)
    numbers = np.concatenate([weights.ravel(), biases])
    packed = b64encode(numbers.tobytes()).decode()
    return {"inputs": 4 * robots + 2, "outputs": 2, "numbers": packed}


CONTROLLERS: dict[str, dict[str, Any]] = {
    **{
        f"{kind}, {name}".removesuffix(", "): {"type": kind, "horizon_max": 14} | fields
        for kind, variants in (("pso-mpc", PUBLISHED), ("mpc", RECOMMENDED))
        for name, fields in variants.items()
    },
    "sequence": {"type": "sequence", "directions": [0.1 * i for i in range(20)]},
    "ensemble": {"type": "ensemble"},
    "rrt": {"type": "rrt", "margin": 40},
    "policy": {"type": "policy", "layers": [straight(3)]},
}
"""Every controller. A further one joins the contract by an entry here."""
FOR_ONE_ROBOT = {"rrt"}
"""Types that steer one robot alone: they get the first one of the experiments."""
FOR_THREE_ROBOTS = {"policy"}
"""Types whose entry above fits three robots alone."""
