"""Controllers by name, as specs: what the contract suite runs against."""

from typing import Any

SMALL = {"particles": 12, "iterations": 15}

CONTROLLERS: dict[str, dict[str, Any]] = {
    "pso, to the letter": {"swarm": SMALL},
    "pso, relative stop": {"swarm": SMALL | {"stop": {"type": "relative"}}, "motion": "exact"},
    "pso, target": {"swarm": SMALL | {"stop": {"type": "target", "cost": 900}}, "motion": "arc"},
    "pso, swept": {"swarm": SMALL, "collision": {"check": "swept", "margin": 20, "walls": True}},
    "pso, on a budget": {"swarm": SMALL, "evaluations_max": 300},
    "multistart": {"swarm": {"type": "multistart", "particles": 16, "rounds": 2}},
    "multistart, dead time": {
        "swarm": {"type": "multistart", "particles": 16, "rounds": 2},
        "motion": "exact",
        "dead_time": 0.14,
        "estimate": True,
        "hold": 2,
    },
}
"""The controller's part of a spec. A further controller joins the contract by an entry here."""
