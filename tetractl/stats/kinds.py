"""The statistics by name, in the order of the tables. A new one is one file and one line here."""

from tetractl.core.registry import Registry
from tetractl.stats.statistic import Statistic

STATISTICS = Registry(
    "tetractl.statistics",
    "statistic",
    {
        "outcomes": "tetractl.stats.outcomes:OUTCOMES",
        "arrived": "tetractl.stats.outcomes:ARRIVED",
        "obstacle_violations": "tetractl.stats.outcomes:OBSTACLE_VIOLATIONS",
        "left_arena": "tetractl.stats.safety:LEFT_ARENA",
        "clearance": "tetractl.stats.safety:CLEARANCE",
        "edge": "tetractl.stats.safety:EDGE",
        "apart": "tetractl.stats.safety:APART",
        "aborted": "tetractl.stats.outcomes:ABORTED",
        "interrupted": "tetractl.stats.outcomes:INTERRUPTED",
        "recovered": "tetractl.stats.outcomes:RECOVERED",
        "solve_ms": "tetractl.stats.timing:SOLVE_MS",
        "deadline_misses": "tetractl.stats.timing:DEADLINE_MISSES",
    },
)


def statistics() -> list[Statistic]:
    """Return every statistic that can be used, the built-in ones first."""
    return list(STATISTICS.usable().values())
