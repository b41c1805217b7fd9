"""Words that describe a plan to people: what robots do under it, and why its search ended."""

from tetractl.core.commands import FieldOff
from tetractl.core.plan import Plan, Search, State, StopReason


def describe_activity(plan: Plan) -> str:
    """Describe in words what the robots do under a plan, such as "driving" or "field off"."""
    if isinstance(plan.instead, FieldOff):
        return "field off"
    if plan.state in (State.RESTING, State.STUCK):
        return "standing"
    if plan.state is State.TURNING:
        return "turning on the spot"
    return plan.state.value


def describe_search_end(search: Search) -> str:
    """Describe in words why an optimiser's search ended. "no search" for given signals."""
    return "no search" if search.stopped == StopReason.FIXED else str(search.stopped)
