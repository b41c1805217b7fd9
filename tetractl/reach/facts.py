"""Collect facts about steering the robots of a spec together, as a table and as JSON."""

from typing import Any

import numpy as np

from tetractl.core.setup import Setup
from tetractl.reach.reach import reach
from tetractl.spec.experiment import Experiment
from tetractl.tools.table.table import Table, pluralize


def most_similar(setup: Setup) -> tuple[int, int] | None:
    """Find the two robots with the most similar turning rates a.

    Returns:
        The indices of the slower and of the faster robot. None for a single robot.
    """
    order = np.argsort(setup.a, kind="stable")
    if len(order) < 2:
        return None
    relative_gaps = setup.a[order[1:]] / setup.a[order[:-1]] - 1
    closest = int(np.argmin(relative_gaps))
    slower, faster = order[closest : closest + 2].tolist()
    return slower, faster


def facts_table(experiment: Experiment) -> Table | None:
    """Create the table of facts about a spec that are known before a trial.

    Returns:
        The table. None if each trial finds its own robots, as in a dish.
    """
    if experiment.must_choose_robots:
        return None
    setup = experiment.setup
    facts: list[tuple[str, str]] = []
    reached = reach(experiment)
    if reached:
        facts.append(("reach of the signal", str(reached)))
    similar_robots = most_similar(setup)
    if similar_robots:
        names = ", ".join(setup.names[robot] for robot in similar_robots)
        facts.append(
            (
                "smallest difference of a",
                f"{100 * _difference(setup, *similar_robots):.3g} % ({names})",
            )
        )
    if setup.hold is not None and not setup.on_wheels:
        radii = setup.speed / setup.a.min()
        circles = [f"{name} {radius:.3g}" for name, radius in zip(setup.names, radii, strict=True)]
        facts.append((f"radii of the smallest circles [{setup.unit}]", ", ".join(circles)))
    title = f"{setup.name}: {len(setup.names)} {pluralize('robot', len(setup.names))}"
    return Table.of_texts(title, ("figure", "value"), facts)


def facts_items(experiment: Experiment) -> dict[str, Any]:
    """Return the facts about a spec as JSON items: the signal's reach and the most similar robots.

    `reach` and `smallest_difference` are None and `most_similar` is empty if they are unknown.
    """
    reached = reach(experiment)
    similar_robots = None if experiment.must_choose_robots else most_similar(experiment.setup)
    setup = experiment.setup
    return {
        "reach": reached.fields if reached else None,
        "most_similar": [setup.names[robot] for robot in similar_robots] if similar_robots else [],
        "smallest_difference": _difference(setup, *similar_robots) if similar_robots else None,
    }


def _difference(setup: Setup, slower: int, faster: int) -> float:
    """Compute the difference of two turning rates, as a fraction of the slower robot's rate."""
    return float(setup.a[faster] / setup.a[slower] - 1)
