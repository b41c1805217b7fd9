"""Convert names of outcomes to the names used in logs, and back.

NO_BETTER_PLAN has its former name in logs, so that the digests of earlier logs stay valid.
"""

from tetractl.core.plan import Outcome

_NO_BETTER_PLAN = "nothing better"


def outcome_to_log(text: str) -> str:
    """Convert a text that begins with an outcome to the form used in logs."""
    if text.startswith(Outcome.NO_BETTER_PLAN):
        return _NO_BETTER_PLAN + text.removeprefix(Outcome.NO_BETTER_PLAN)
    return text


def outcome_from_log(text: str) -> str:
    """Convert a text from a log to present names, if it begins with an outcome."""
    if text.startswith(_NO_BETTER_PLAN):
        return Outcome.NO_BETTER_PLAN + text.removeprefix(_NO_BETTER_PLAN)
    return text
