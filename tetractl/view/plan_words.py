"""Words for what a plan says: what robots do by it, and why its search ended."""

from tetractl.core.commands import FieldOff
from tetractl.core.plan import Plan, Search, State, StopReason


def doing(plan: Plan) -> str:
    """Return words for what the robots do."""
    if isinstance(plan.instead, FieldOff):
        return "field off"
    if plan.state in (State.RESTING, State.STUCK):
        return "standing"
    if plan.state is State.TURNING:
        return "turning on the spot"
    return plan.state.value


def search_end(search: Search) -> str:
    """Return words for why a search ended."""
    return "no search" if search.stopped == StopReason.FIXED else str(search.stopped)
