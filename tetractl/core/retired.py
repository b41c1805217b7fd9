"""Names of kinds that earlier versions had, each with what to use in its place."""

from tetractl.core.errors import UsageError

INSTEAD = {
    ("tetractl.commands", "design"): "run any trials, such as those of a controller of type "
    "sequence, and give their logs to `tetractl identify`",
}
"""What to use instead of a kind, by the group of its entry points and its name."""


def refuse_retired(group: str, name: str) -> None:
    """Raise UsageError for a name that an earlier version had."""
    if instead := INSTEAD.get((group, name)):
        raise UsageError(f"{name!r} is no longer there", instead)
