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

LINE_MOST = 240
"""Characters of a line of `info`."""

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
        for line in _lines(contents):
            print(printable(line, LINE_MOST).rstrip())  # --json prints whole lines
    return Exit.FAILED if contents.damage else Exit.DONE


def _channel_lines(channels: "Sequence[ChannelCount]") -> Iterator[str]:
    wide = max((len(item.topic) for item in channels), default=0)
    for item in channels:
        rate = "" if item.hz is None else f"{item.hz:.1f} Hz"
        yield f"{item.topic:<{wide}}  {item.schema:<25} {item.messages:>6} messages {rate:>9}"


def _lines(log: "Overview") -> Iterator[str]:
    yield f"{log.log}: {log.size} bytes, {log.chunks} chunks"
    events = [f"{event.time_s:8.2f} s  {event.level:<7}  {event.text}" for event in log.events]
    sizes = {name: f"{size} bytes" for name, size in log.attachments.items()}
    yield from _section("run", _aligned(log.run))
    yield from _section("result", _aligned(_result(log)))
    yield from _section("events", events)
    yield from _section(f"estimate at step {log.estimate_step}", _aligned(_estimate(log)))
    yield from _section("channels", _channel_lines(log.channels))
    yield from _section("attachments", _aligned(sizes))
    yield from _section("host", _aligned(log.host))
    yield from _section("provenance", _aligned(log.provenance))
    yield from _section("content digest", _aligned(_digests(log)))
    if log.damage:
        lost = [f"lost: {text}" for text in log.damage.lost]
        yield from _section("damage", [*log.damage.problems, *lost])


def _digests(log: "Overview") -> dict[str, str]:
    """Compare the content digest that a log states with the digest of its records."""
    if log.stated_digest is None:
        return {"computed": log.digest}
    if log.stated_digest == log.digest:
        return {"stated and computed": log.digest}
    return {"stated": log.stated_digest, "computed": log.digest}


def _section(title: str, lines: Iterable[str]) -> Iterator[str]:
    """Yield the lines of a section with its title. A section without lines is left out."""
    for number, line in enumerate(lines):
        if not number:
            yield from ("", title)
        yield f"  {line}"


def _aligned(items: dict[str, str]) -> list[str]:
    width = max(map(len, items), default=0)
    return [f"{key:<{width}}  {value}" for key, value in items.items()]


def _result(log: "Overview") -> dict[str, str]:
    result = log.result
    if result is None:
        return {"outcome": "none, because the log breaks off before the end of the trial"}
    unit = log.run.get("unit", "")
    errors = ", ".join(f"{error:.1f}" for error in result.robot_errors)
    longest = "-"
    if result.solve_ns:
        longest = f"{milliseconds(max(result.solve_ns)):.1f} ms"
    return {
        "outcome": result.outcome.value,
        "reason": result.reason or "-",
        "steps": str(result.steps),
        "duration": f"{result.duration_s:.2f} s",
        "total error": f"{result.total_error:.1f} {unit}",
        "robot errors": f"{errors} {unit}",
        "entered obstacle": "yes" if result.entered_obstacle else "no",
        "longest solve": longest,
        "deadline misses": str(result.deadline_misses),
    }


def _estimate(log: "Overview") -> dict[str, str]:
    """Return the last estimate of the motion, a line per robot, with standard deviations."""
    from tetractl.core.motion_estimate import OF_PLACES, OF_TURNING
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
        parts = [
            f"a {_deviating(estimate.a[robot], estimate.a_std[robot])} rad/s",
            f"speed {_deviating(estimate.speed[robot], estimate.speed_std[robot])} {unit}/s",
        ]
        if bias is not None and bias_std is not None:
            parts.append(f"heading bias {_deviating(bias[robot], bias_std[robot])} rad")
        if estimate.lag is not None and estimate.lag_std is not None:
            parts.append(f"lag {_deviating(estimate.lag[robot], estimate.lag_std[robot])} s")
        turns = describe_turning(estimate, robot)
        if turns:
            parts.append(turns)
        lines[name] = ", ".join(parts)
    if estimate.dead_time is not None and estimate.dead_time_std is not None:
        lines["dead time"] = f"{_deviating(estimate.dead_time, estimate.dead_time_std)} s"
    unfit = estimate.unexplained(names, OF_TURNING)
    if unfit:
        lines["the model does not fit"] = ", ".join(sorted(unfit))
    strays = estimate.unexplained(names, OF_PLACES)
    if strays:
        lines["not as predicted, which does not affect a"] = ", ".join(sorted(strays))
    return lines


def _deviating(value: float, std: float) -> str:
    """Format a value with its standard deviation, both rounded to two digits of the deviation."""
    digits = 1 - math.floor(math.log10(std)) if 0 < std < math.inf else 3
    digits = min(max(digits, 0), 9)
    return f"{value:.{digits}f} +- {std:.{digits}f}"
