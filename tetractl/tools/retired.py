"""Names that earlier versions had, each with what to use in its place."""

from tetractl.core.errors import UsageError

_FRAME = "tables are CSV; in Python: tetractl.to_dataframe(log).to_parquet(file)"
_BATCH = "use --kind batch"
_OVER_TIME = "use --kind over-time"
INSTEAD = {
    ("tetractl.commands", "design"): "run any trials, such as those of a controller of type "
    "sequence, and give their logs to `tetractl identify`",
    ("tetractl.figures", "arms"): _BATCH,
    ("tetractl.figures", "ecdf"): _BATCH,
    ("tetractl.figures", "error"): "use --kind errors",
    ("tetractl.figures", "estimate"): _OVER_TIME,
    ("tetractl.figures", "scatter"): _BATCH,
    ("tetractl.figures", "signal"): _OVER_TIME,
    ("tetractl.figures", "timing"): _OVER_TIME,
    ("export", "--format"): _FRAME,
    ("export", "parquet"): _FRAME,
}
"""What to use instead of a name, by what it is a name of: a group of entry points or a command."""


def refuse_retired(what: str, name: str) -> None:
    """Raise UsageError for a name that an earlier version had."""
    instead = INSTEAD.get((what, name))
    if instead:
        raise UsageError(f"{name!r} is no longer there", instead)
