"""`tetractl lab guard`: reports what the guard would have done in logged trials."""

from collections import Counter
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

from tetractl.cli import ui
from tetractl.cli.options import AsJson, Logs, Sets, option
from tetractl.core.clock import SECOND
from tetractl.core.errors import Exit, UsageError
from tetractl.log.read.find import find_logs
from tetractl.tools.table.table import Column, Table, pluralize

if TYPE_CHECKING:
    from tetractl.lab.guard_observer import Intervention
    from tetractl.log.read.trial_log import TrialLog
    from tetractl.spec.lab_section import LabLimits
    from tetractl.verification.guard_replay import GuardReport

SHOWN_MAX = 20
"""Maximum number of interventions that are listed for a log."""
LIMITS = "lab.limits."


def guard(
    logs: Logs,
    sets: Sets = None,
    rows_max: Annotated[
        int,
        option(
            "N",
            "Maximum number of interventions of the guard to list for each log. "
            "Further ones are only counted.",
            "--most",
            min=0,
        ),
    ] = SHOWN_MAX,
    as_json: AsJson = False,
) -> int:
    """Report what the guard would have done in logged trials, without acting.

    The guard receives the poses and commands of each log again. For everything that it would have
    done, a row states the time, the check, the robot, and the value with its limit. For each check,
    a table at the end counts the refused poses, the stopped robots and the ended runs, and the
    hours for which the check was active. Try other limits with --set lab.limits.wheel_error=0.2.

    A log holds only the poses that the guard accepted in the trial. Where the guard refused a pose,
    the robot now counts as untracked. Without wheel speeds in a log, motion and drift are not
    checked.

    Example: tetractl lab guard logs/batch --set lab.limits.wheel_error=0.15
    """
    from tetractl.verification.guard_replay import observe_log

    reports_by_log: list[tuple[str, GuardReport]] = []
    for path in find_logs(logs):
        log = ui.open_trial(path)
        reports_by_log.append((str(path), observe_log(log, _change_limits(log, sets or []))))
    counts = _count_interventions([report for _, report in reports_by_log])
    json_items = {
        "logs": [_convert_to_item(name, report) for name, report in reports_by_log],
        "checks": counts,
    }
    rows = [
        _build_event_table(name, report, rows_max)
        for name, report in reports_by_log
        if report.interventions and rows_max
    ]
    ui.print_results(as_json, json_items, [*rows, _build_total_table(counts, len(reports_by_log))])
    return Exit.DONE


def _change_limits(log: "TrialLog", sets: list[str]) -> "LabLimits":
    """Return the limits of the guard in a log's lab, with the given changes.

    If the log has no lab, the default limits are used.

    Raises:
        UsageError: If something else than a limit is to be changed, or a value is wrong.
    """
    from pydantic import ValidationError

    from tetractl.spec.explain_errors import explain_in_words
    from tetractl.spec.lab_section import LabLimits
    from tetractl.spec.yaml.document import parse_value
    from tetractl.verification.guard_replay import lab_limits

    values = lab_limits(log).model_dump()
    for setting in sets:
        path, equals, new_value = setting.partition("=")
        if not path.startswith(LIMITS) or not equals:
            raise UsageError(f"--set {setting}: this command accepts only `{LIMITS}NAME=VALUE`")
        values[path.removeprefix(LIMITS)] = parse_value(new_value, f"--set {setting}")
    try:
        return LabLimits.model_validate(values)
    except ValidationError as error:
        problem = error.errors()[0]
        path = ".".join(["lab", "limits", *(str(step) for step in problem["loc"])])
        message = explain_in_words(problem, problem["input"])
        raise UsageError(f"--set {path}: {message}") from None


def _convert_to_item(name: str, report: "GuardReport") -> dict[str, Any]:
    return {
        "log": name,
        "watched_s": report.watched_s,
        "interventions": [
            {**asdict(event), "t_s": _compute_time_s(report, event)}
            for event in report.interventions
        ],
    }


def _compute_time_s(report: "GuardReport", event: "Intervention") -> float:
    return (event.t_ns - report.began_ns) / SECOND


def _build_event_table(name: str, report: "GuardReport", rows_max: int) -> Table:
    """Return a table of the first `rows_max` interventions of the guard in a log."""
    events = report.interventions[:rows_max]
    columns = (
        Column("time s", [f"{_compute_time_s(report, event):.2f}" for event in events]),
        Column("check", [event.check for event in events], words=True),
        Column("robot", [event.robot for event in events], words=True),
        Column("would have", [event.act.value for event in events], words=True),
        Column("value", [_format_number(event, "value") for event in events]),
        Column("limit", [_format_number(event, "limit") for event in events]),
        Column("reason", [event.text for event in events], words=True),
    )
    left_out = len(report.interventions) - len(events)
    note = f"and {left_out} more" if left_out else ""
    return Table(f"{name}: watched for {report.watched_s:.1f} s", columns, note)


def _format_number(event: "Intervention", field: str) -> str:
    """Return the value of an intervention, or the limit that it exceeded, with its unit."""
    if event.excess is None:
        return ""
    value = event.excess.value if field == "value" else event.excess.limit
    return f"{value:.3g} {event.excess.unit}".rstrip()


def _count_interventions(reports: "list[GuardReport]") -> list[dict[str, Any]]:
    """Count the interventions of each check, and sum the hours for which the check was active."""
    from tetractl.lab.guard_observer import Action
    from tetractl.verification.guard_replay import COMMON_CHECKS, WHEEL_CHECKS

    by_check = Counter(
        (event.check, event.act) for report in reports for event in report.interventions
    )
    check_names = dict.fromkeys((*COMMON_CHECKS, *WHEEL_CHECKS, *(check for check, _ in by_check)))
    rows: list[dict[str, Any]] = []
    for name in check_names:
        is_special = name not in COMMON_CHECKS + WHEEL_CHECKS
        watched_s = [report.watched_s for report in reports if is_special or name in report.checks]
        rows.append(
            {
                "check": name,
                "poses_refused": by_check[name, Action.REFUSES],
                "robots_stopped": by_check[name, Action.STOPS],
                "runs_ended": by_check[name, Action.ENDS],
                "hours": sum(watched_s) / 3600,
            }
        )
    return rows


def _build_total_table(counts: list[dict[str, Any]], logs: int) -> Table:
    """Return a table of how often each check of the guard would have acted in a number of logs."""
    columns = (
        Column("check", [row["check"] for row in counts], words=True),
        Column("poses refused", [row["poses_refused"] for row in counts]),
        Column("robots stopped", [row["robots_stopped"] for row in counts]),
        Column("runs ended", [row["runs_ended"] for row in counts]),
        Column("hours", [f"{row['hours']:.4f}" for row in counts]),
    )
    idle = [row["check"] for row in counts if not row["hours"]]
    note = f"not checked, because no log has wheel speeds: {', '.join(idle)}" if idle else ""
    title = f"What the guard would have done in {logs} {pluralize('log', logs)}"
    return Table(title, columns, note)
