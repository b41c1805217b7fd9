"""The command `tetractl info`, which shows what is in the log of a trial."""

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tetractl.cli.options import AsJson, argument
from tetractl.core.clock import milliseconds
from tetractl.core.errors import Exit, printable
from tetractl.log.read.find import find_log
from tetractl.tools.table.table_files import format_json

LINE_LENGTH_MAX = 240
"""Maximum number of characters of a printed line."""

if TYPE_CHECKING:
    from tetractl.log.read.overview import ChannelCount, Overview


def info(
    log: Annotated[Path, argument("LOG", "Log of a trial, finished or unfinished.")],
    as_json: AsJson = False,
) -> int:
    """Print the contents of a log: run, result, events, estimate, channels, provenance, damage.

    Times count from the first direction that was sent.

    The command reads and checks the whole log. It exits with 1 if the log is damaged or has no
    result.

    Example: tetractl info logs/three-m3pi-20200101T000000Z/trial-000.mcap
    """
    from tetractl.log.read.overview import overview

    log = find_log(log)
    contents = overview(log)
    if as_json:
        print(format_json(contents))
    else:
        for line in _format_lines(contents):
            print(printable(line, LINE_LENGTH_MAX).rstrip())  # --json prints whole lines
    return Exit.FAILED if contents.damage else Exit.DONE


def _format_channels(channels: "Sequence[ChannelCount]") -> Iterator[str]:
    topic_width = max((len(channel.topic) for channel in channels), default=0)
    for channel in channels:
        rate = "" if channel.hz is None else f"{channel.hz:.1f} Hz"
        count = f"{channel.messages:>6} messages"
        yield f"{channel.topic:<{topic_width}}  {channel.schema:<25} {count} {rate:>9}"


def _format_lines(log: "Overview") -> Iterator[str]:
    yield f"{log.log}: {log.size} bytes, {log.chunks} chunks"
    events = [f"{event.time_s:8.2f} s  {event.level:<7}  {event.text}" for event in log.events]
    sizes = {name: f"{size} bytes" for name, size in log.attachments.items()}
    yield from _format_section("run", _align(log.run))
    yield from _format_section("result", _align(_describe_result(log)))
    yield from _format_section("events", events)
    yield from _format_section(
        f"estimate at step {log.estimate_step}", _align(_describe_estimate(log))
    )
    yield from _format_section("channels", _format_channels(log.channels))
    yield from _format_section("attachments", _align(sizes))
    yield from _format_section("host", _align(log.host))
    yield from _format_section("provenance", _align(log.provenance))
    yield from _format_section("content digest", _align(_compare_digests(log)))
    if log.damage:
        lost = [f"lost: {text}" for text in log.damage.lost]
        yield from _format_section("damage", [*log.damage.problems, *lost])


def _compare_digests(log: "Overview") -> dict[str, str]:
    """Compare the content digest that a log states with the digest of its records."""
    if log.stated_digest is None:
        return {"computed": log.digest}
    if log.stated_digest == log.digest:
        return {"stated and computed": log.digest}
    return {"stated": log.stated_digest, "computed": log.digest}


def _format_section(title: str, lines: Iterable[str]) -> Iterator[str]:
    """Yield the title and the lines of a section. A section without lines is left out."""
    for number, line in enumerate(lines):
        if not number:
            yield from ("", title)
        yield f"  {line}"


def _align(values_by_title: dict[str, str]) -> list[str]:
    title_width = max(map(len, values_by_title), default=0)
    return [f"{key:<{title_width}}  {value}" for key, value in values_by_title.items()]


def _describe_result(log: "Overview") -> dict[str, str]:
    result = log.result
    if result is None:
        return {"outcome": "none, because the log breaks off before the end of the trial"}
    unit = log.run.get("unit", "")
    errors = ", ".join(f"{error:.1f}" for error in result.robot_errors)
    longest_solve = "-"
    if result.solve_ns:
        longest_solve = f"{milliseconds(max(result.solve_ns)):.1f} ms"
    return {
        "outcome": result.outcome.value,
        "reason": result.reason or "-",
        "steps": str(result.steps),
        "duration": f"{result.duration_s:.2f} s",
        "total error": f"{result.total_error:.1f} {unit}",
        "robot errors": f"{errors} {unit}",
        "entered obstacle": "yes" if result.entered_obstacle else "no",
        "longest solve": longest_solve,
        "deadline misses": str(result.deadline_misses),
    }


def _describe_estimate(log: "Overview") -> dict[str, str]:
    """Describe the last estimate of the motion, with standard deviations, in one line per robot."""
    from tetractl.core.motion_estimate import POSITION_INNOVATIONS, TURNING_INNOVATIONS
    from tetractl.run.model_changes import describe_turning

    estimate = log.estimate
    if estimate is None:
        return {}
    unit = log.run.get("unit", "")
    names = json.loads(log.run["robots"])
    bias = estimate.heading_bias
    bias_std = estimate.heading_bias_std
    lines: dict[str, str] = {}
    for robot, name in enumerate(names):
        quantities = [
            f"a {_format_estimate(estimate.a[robot], estimate.a_std[robot])} rad/s",
            f"speed {_format_estimate(estimate.speed[robot], estimate.speed_std[robot])} {unit}/s",
        ]
        if bias is not None and bias_std is not None:
            quantities.append(f"heading bias {_format_estimate(bias[robot], bias_std[robot])} rad")
        if estimate.lag is not None and estimate.lag_std is not None:
            quantities.append(
                f"lag {_format_estimate(estimate.lag[robot], estimate.lag_std[robot])} s"
            )
        turns = describe_turning(estimate, robot)
        if turns:
            quantities.append(turns)
        lines[name] = ", ".join(quantities)
    if estimate.dead_time is not None and estimate.dead_time_std is not None:
        lines["dead time"] = f"{_format_estimate(estimate.dead_time, estimate.dead_time_std)} s"
    unexplained_turning = estimate.list_unexplained(names, TURNING_INNOVATIONS)
    if unexplained_turning:
        lines["the model does not fit"] = ", ".join(sorted(unexplained_turning))
    unexplained_positions = estimate.list_unexplained(names, POSITION_INNOVATIONS)
    if unexplained_positions:
        lines["not as predicted, but without effect on a"] = ", ".join(
            sorted(unexplained_positions)
        )
    return lines


def _format_estimate(value: float, std: float) -> str:
    """Format a value with its standard deviation, both rounded to two digits of the deviation."""
    digits = 1 - math.floor(math.log10(std)) if 0 < std < math.inf else 3
    digits = min(max(digits, 0), 9)
    return f"{value:.{digits}f} +- {std:.{digits}f}"
