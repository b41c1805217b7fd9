"""Prints the result of a preflight, the check of a lab before a run, as text or JSON."""

from collections.abc import Callable
from typing import Any

from tetractl.lab.preflight import Preflight
from tetractl.tools.table.table import UNKNOWN_TEXT, Column, Table, pluralize
from tetractl.tools.table.terminal_table import open_console, print_tables

ANSWERS = {True: "yes", False: "no", None: "n/a"}


def _create_formatter(unknown: str, form: str) -> Callable[[Any], str]:
    return lambda value: unknown if value is None else form.format(value)


def print_findings(preflight: Preflight, latency_stated: bool) -> None:
    """Print the findings of a preflight, the check of a lab before a run.

    The output is a table of the robots (how far they are from their starts, whether they are
    tracked, their batteries, and whether they answer), the camera's rates and delays, warnings and
    problems. With `latency_stated`, the age of frames is not measured, but comes from the spec's
    lab.camera.latency.
    """
    console = open_console()
    robots = preflight.robots
    columns = (
        Column("robot", [robot.name for robot in robots]),
        Column(
            "off its start",
            [robot.off_mm for robot in robots],
            "mm",
            _create_formatter("not tracked", "{:.0f}"),
        ),
        Column(
            "off its heading",
            [robot.off_heading for robot in robots],
            "rad",
            _create_formatter(UNKNOWN_TEXT, "{:+.2f}"),
        ),
        Column(
            "battery",
            [robot.status.battery for robot in robots],
            format=_create_formatter(UNKNOWN_TEXT, "{}"),
        ),
        Column("answers", [ANSWERS[robot.status.answers] for robot in robots]),
    )
    print_tables([Table("Robots", columns)], console)
    rate = "unknown" if preflight.camera_rate_hz is None else f"{preflight.camera_rate_hz:.1f} Hz"
    lines = [f"camera: {rate}"]
    if preflight.latency_ms is not None:
        median, maximum = preflight.latency_ms
        condition = ", if lab.camera.latency is right" if latency_stated else ""
        age = f"{median:.1f} ms, at most {maximum:.1f} ms"
        lines.append(f"age of frames on arrival: {age}{condition}")
    lines += [f"{name}: {value}" for name, value in preflight.facts.items()]
    lines += [f"warning: {line}" for line in preflight.all_warnings]
    lines += [f"problem: {line}" for line in (*preflight.all_problems, *preflight.misplaced)]
    lines.append(_verdict(preflight))
    for line in lines:
        console.print(line, highlight=False, markup=False, soft_wrap=True)


def _verdict(preflight: Preflight) -> str:
    """Describe whether a run could start: "ready" or "not ready".

    If it is ready, the number of warnings follows unless there are none.
    """
    if not preflight.can_start:
        return "not ready"
    number = len(preflight.all_warnings)
    if number == 0:
        return "ready"
    return f"ready, with {number} {pluralize('warning', number)}"


def create_preflight_items(preflight: Preflight) -> dict[str, Any]:
    """Return the result of the preflight as data for JSON.

    Misplaced robots count among its problems. The latency is None if it is unknown.
    """
    robots = [
        {
            "name": robot.name,
            "tracked": robot.tracked,
            "off_mm": robot.off_mm,
            "off_heading": robot.off_heading,
            "placed": robot.tracked and not robot.misplaced,
            "answers": robot.status.answers,
            "battery_v": robot.status.battery_v,
            "charge": robot.status.charge,
        }
        for robot in preflight.robots
    ]
    latency = preflight.latency_ms
    return {
        "ready": preflight.can_start,
        "problems": [*preflight.all_problems, *preflight.misplaced],
        "warnings": list(preflight.all_warnings),
        "questions": list(preflight.questions),
        "camera_rate_hz": preflight.camera_rate_hz,
        "latency_ms": None if latency is None else {"p50": latency[0], "max": latency[1]},
        "robots": robots,
        "facts": dict(preflight.facts),
    }
