"""Specs of all controllers by name, for the contract tests."""

from typing import Any

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
    "pso, target": {"optimizer": PSO | {"stop": {"type": "target", "cost": 900}}},
}
RECOMMENDED: dict[str, dict[str, Any]] = {
    "": {"optimizer": MULTISTART},
    "pso, margins": {"optimizer": {"type": "pso"} | PSO, "collision": {"margin": 20}},
    "dead time": {"optimizer": MULTISTART, "dead_time": 0.14, "signal_periods": 2},
    "bodies": {"optimizer": MULTISTART, "accept_error": 40, "collision": {"radius": 40}},
}
"""Model predictive control, each optimiser and other variants: the controller's part of a spec."""


CONTROLLERS: dict[str, dict[str, Any]] = {
    **{
        f"{kind}, {name}".removesuffix(", "): {"type": kind, "horizon_max": 14} | fields
        for kind, variants in (("pso-mpc", PUBLISHED), ("mpc", RECOMMENDED))
        for name, fields in variants.items()
    },
    "sequence": {"type": "sequence", "directions": [0.1 * i for i in range(20)]},
}
"""Every controller of the core. A further one joins the contract by an entry here."""
FOR_ONE_ROBOT = {"rrt"}
"""Types that steer one robot alone, also of packages: they get the experiments' first one."""
FOR_THREE_ROBOTS = {"policy"}
"""Types that fit three robots alone, also of packages."""
