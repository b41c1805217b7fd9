"""The statistics by name, in the order of the tables. A new one is one file and one line here."""

from tetractl.core.registry import Registry
from tetractl.results.statistic import Statistic

STATISTICS = Registry(
    "tetractl.statistics",
    "statistic",
    {
        "outcomes": "tetractl.results.outcomes:OUTCOMES",
        "arrived": "tetractl.results.outcomes:ARRIVED",
        "obstacle_violations": "tetractl.results.outcomes:OBSTACLE_VIOLATIONS",
        "left_arena": "tetractl.results.outcomes:LEFT_ARENA",
        "clearance": "tetractl.results.outcomes:CLEARANCE",
        "edge": "tetractl.results.outcomes:EDGE",
        "apart": "tetractl.results.outcomes:APART",
        "way_points": "tetractl.results.outcomes:WAY_POINTS",
        "time_inside": "tetractl.results.outcomes:TIME_INSIDE",
        "aborted": "tetractl.results.outcomes:ABORTED",
        "interrupted": "tetractl.results.outcomes:INTERRUPTED",
        "recovered": "tetractl.results.outcomes:RECOVERED",
        "solve_ms": "tetractl.results.outcomes:SOLVE_MS",
        "deadline_misses": "tetractl.results.outcomes:DEADLINE_MISSES",
    },
)


def statistics() -> list[Statistic]:
    """Return every statistic that can be used, the built-in ones first."""
    return list(STATISTICS.usable().values())
