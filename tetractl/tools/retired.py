"""Names that earlier versions had: commands, options, figures and keys of specs.

INSTEAD says what to write in place of each. A log keeps the keys with which it was
written: `replace_retired_keys` turns them into those of today.
"""

from typing import Any

from tetractl.core.errors import UsageError

KEY = "key of a spec"
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
    (KEY, "first_plan"): "robots stand while the first plan is computed; leave it out",
    (KEY, "intensity"): "a controller chooses a direction only; write strength: [mT], and "
    "a: {per_mT: ...}",
    (KEY, "silence"): "plans are no longer asked what a silence of the radio does; leave it out",
    (KEY, "steps_max"): "a trial's limit is a time now; write time_limit: [s], which is "
    "(steps_max + 1) control periods",
}
"""What to use instead of a name, by what it is a name of: a group of entry points, a command, or a
KEY."""


def refuse_retired(what: str, name: str) -> None:
    """Raise UsageError for a name that an earlier version had."""
    instead = INSTEAD.get((what, name))
    if instead:
        in_python = instead.replace("--kind", "kind")
        raise UsageError(f"{name!r} is no longer there", instead, in_python)


def replace_retired_keys(spec: dict[str, Any]) -> None:
    """Replace the retired keys in the resolved spec of a log, which has every field of its time.

    `steps_max` is the time that so many steps took, but for `pso-mpc`, which still counts them. A
    `silence` is left out, and so is a `first_plan` for which robots stood; one for which they drove
    stays, and is refused.
    """
    controller = spec.get("controller")
    if not isinstance(controller, dict):
        return
    if controller.get("first_plan") == {"type": "stand"}:
        del controller["first_plan"]
    collision = controller.get("collision")
    if isinstance(collision, dict):
        collision.pop("silence", None)
    steps = controller.get("steps_max")
    period_s = controller.get("period")
    is_counted = controller.get("type") == "pso-mpc"
    if not is_counted and isinstance(steps, int) and isinstance(period_s, int | float):
        del controller["steps_max"]
        controller["time_limit"] = float(f"{(steps + 1) * period_s:.9g}")
