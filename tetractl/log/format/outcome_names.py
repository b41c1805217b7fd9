"""What logs call outcomes: NO_BETTER_PLAN has its old name there, so that digests stay the same."""

from tetractl.core.plan import Outcome

_NO_BETTER_PLAN = "nothing better"


def outcome_to_log(text: str) -> str:
    """Return a text that begins with an outcome, as logs have it."""
    if text.startswith(Outcome.NO_BETTER_PLAN):
        return _NO_BETTER_PLAN + text.removeprefix(Outcome.NO_BETTER_PLAN)
    return text


def outcome_from_log(text: str) -> str:
    """Return a text of a log, with the name of today if it begins with an outcome."""
    if text.startswith(_NO_BETTER_PLAN):
        return Outcome.NO_BETTER_PLAN + text.removeprefix(_NO_BETTER_PLAN)
    return text
