"""What a preflight found, for people and as JSON."""

from typing import Any

from rich.console import Console
from rich.table import Table

from tetractl.lab.preflight import Preflight

ANSWERS = {True: "yes", False: "no", None: "cannot"}


def print_findings(found: Preflight) -> None:
    """Print a table of the robots, the camera's figures, and every warning and problem."""
    table = Table(box=None, header_style="bold")
    for name in ("robot", "off its start", "off its heading", "battery", "answers"):
        table.add_column(name, justify="left" if name == "robot" else "right")
    for robot in found.robots:
        battery_v = robot.status.battery_v
        table.add_row(
            robot.name,
            "not tracked" if robot.off_mm is None else f"{robot.off_mm:.0f} mm",
            "" if robot.off_heading is None else f"{robot.off_heading:+.2f} rad",
            "" if battery_v is None else f"{battery_v:.2f} V",
            ANSWERS[robot.status.answers],
        )
    console = Console()
    console.print(table)
    rate = "unknown" if found.camera_rate_hz is None else f"{found.camera_rate_hz:.1f} Hz"
    lines = [f"camera: {rate}"]
    if found.latency_ms is not None:
        median, most = found.latency_ms
        lines.append(f"age of frames on arrival: {median:.1f} ms, at most {most:.1f} ms")
    lines += [f"{name}: {value}" for name, value in found.facts.items()]
    lines += [f"warning: {line}" for line in found.all_warnings]
    lines += [f"problem: {line}" for line in (*found.all_problems, *found.misplaced)]
    lines.append("ready" if found.ready else "not ready")
    for line in lines:
        console.print(line, highlight=False, markup=False, soft_wrap=True)


def as_json(found: Preflight) -> dict[str, Any]:
    """Return the same as plain data."""
    robots = [
        {
            "name": robot.name,
            "tracked": robot.tracked,
            "off_mm": robot.off_mm,
            "off_heading": robot.off_heading,
            "placed": robot.tracked and not robot.misplaced,
            "answers": robot.status.answers,
            "battery_v": robot.status.battery_v,
        }
        for robot in found.robots
    ]
    latency = found.latency_ms
    return {
        "ready": found.ready,
        "problems": [*found.all_problems, *found.misplaced],
        "warnings": list(found.all_warnings),
        "questions": list(found.questions),
        "camera_rate_hz": found.camera_rate_hz,
        "latency_ms": None if latency is None else {"p50": latency[0], "max": latency[1]},
        "robots": robots,
        "facts": dict(found.facts),
    }
