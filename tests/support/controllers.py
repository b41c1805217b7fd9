"""Controllers by name, as specs: what the contract suite runs against."""

from typing import Any

from tetractl.core.registries import OPTIMIZERS

SMALL: dict[str, dict[str, Any]] = {
    "pso": {"particles": 12, "iterations": 15},
    "multistart": {"type": "multistart", "particles": 16, "rounds": 2},
    "cem": {"type": "cem", "particles": 16, "elite": 4, "iterations": 12},
    "mppi": {"type": "mppi", "particles": 16, "iterations": 12},
}
"""A quick search by each optimiser."""
PSO, MULTISTART = SMALL["pso"], SMALL["multistart"]
assert SMALL.keys() == set(OPTIMIZERS.builtin), "a further optimiser joins the contract by an entry"

MPC: dict[str, dict[str, Any]] = {
    **{name: {"optimizer": optimizer} for name, optimizer in SMALL.items()},
    "pso, relative stop": {"optimizer": PSO | {"stop": {"type": "relative"}}, "motion": "exact"},
    "pso, target": {"optimizer": PSO | {"stop": {"type": "target", "cost": 900}}, "motion": "arc"},
    "pso, swept": {"optimizer": PSO, "collision": {"test": "swept", "margin": 20, "walls": True}},
    "multistart, dead time": {
        "optimizer": MULTISTART,
        "motion": "exact",
        "dead_time": 0.14,
        "estimate": True,
        "hold": 2,
    },
    "multistart, whole": {
        "optimizer": MULTISTART,
        "motion": "exact",
        "estimate": True,
        "initial_lengths": "geometric",
        "accept_error": 40,
        "stop_between": True,
        "collision": {"test": "swept", "radius": 40, "separation": 80, "adaptive": True},
    },
}
"""Model predictive control, each optimiser and other variants: the controller's part of a spec."""
CONTROLLERS: dict[str, dict[str, Any]] = {
    **{
        f"mpc, {name}": {"type": "pso-mpc", "horizon_max": 14} | fields
        for name, fields in MPC.items()
    },
    "mpc, recommended": {"type": "mpc", "horizon_max": 14, "optimizer": MULTISTART},
    "sequence": {"type": "sequence", "directions": [0.1 * i for i in range(20)]},
    "ensemble": {"type": "ensemble"},
    "rrt": {"type": "rrt", "margin": 40},
    "straight": {"type": "straight"},
}
"""Every controller. A further one joins the contract by an entry here."""
FOR_ONE_ROBOT = {"rrt"}
"""Types that steer one robot alone: they get the first one of the experiments."""
