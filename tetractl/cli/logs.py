"""`tetractl info`, `recover` and `verify`: show what is in a log, save what is left, check it."""

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tetractl.cli import ui
from tetractl.cli.options import AsJson, Logs, argument, out_option
from tetractl.core.clock import milliseconds
from tetractl.core.errors import Exit, LogError, printable
from tetractl.log.read.find import find_log, find_logs
from tetractl.tools.table.table_files import json_text

LINE_MOST = 240
"""Characters of a line of `info`."""

if TYPE_CHECKING:
    from tetractl.log.read.overview import ChannelCount, Overview


def info(
    log: Annotated[Path, argument("LOG", "Log of a trial, finished or not.")],
    as_json: AsJson = False,
) -> int:
    """Print the contents of a log: run, result, events, estimate, channels, provenance, damage.

    Times count from the first direction sent.

    The whole log is read and checked. Exits with 1 if the log is damaged or has no result.

    Example: tetractl info logs/three-m3pi-20200101T000000Z/trial-000.mcap
    """
    from tetractl.log.read.overview import overview

    log = find_log(log)
    contents = overview(log)
    if as_json:
        print(json_text(contents))
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
    """Return the content digest that the log states and that of its records; one if they agree."""
    if log.brief:
        return {"of the whole log": log.digest}
    if log.stated_digest is None:
        return {"computed": log.digest}
    if log.stated_digest == log.digest:
        return {"stated and computed": log.digest}
    return {"stated": log.stated_digest, "computed": log.digest}


def _section(title: str, lines: Iterable[str]) -> Iterator[str]:
    """Yield a section's lines; nothing if it has none."""
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
        return {"outcome": "none: the log breaks off before the end of the trial"}
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
    """Return the last estimate, one line per robot, each value with its standard deviation."""
    from tetractl.core.plan import OF_PLACES, OF_TURNING
    from tetractl.run.news import turning

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
        turns = turning(estimate, robot)
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
        lines["not as predicted, which says nothing of a"] = ", ".join(sorted(strays))
    return lines


def _deviating(value: float, std: float) -> str:
    """Return "VALUE +- DEVIATION", rounded to two significant digits of the deviation."""
    digits = 1 - math.floor(math.log10(std)) if 0 < std < math.inf else 3
    digits = min(max(digits, 0), 9)
    return f"{value:.{digits}f} +- {std:.{digits}f}"


def recover(
    log: Annotated[Path, argument("LOG", "Log of a trial, or a .part file.")],
    out: Annotated[Path | None, out_option("FILE", "File to write. [NAME.recovered.mcap]")] = None,
    as_json: AsJson = False,
) -> int:
    """Copy the intact records of a damaged log to a complete file, and print what is lost.

    Exits with 0 if nothing is lost, 3 if something is, 1 if nothing can be saved.

    Example: tetractl recover logs/batch/trial-003.mcap.part
    """
    from tetractl.log.read.recover import recover as save

    log = find_log(log)
    copy = save(log, out)
    if as_json:
        print(json.dumps({**asdict(copy), "whole": copy.whole}, indent=2))
    elif copy.path is None:
        print(printable(f"{log}: complete; there is nothing to recover"))
    else:
        ui.tell(*(f"damaged: {problem}" for problem in copy.damage.problems))
        records = f"{copy.chunks} chunks with {copy.messages} messages"
        print(printable(f"{copy.path}: {records}, {copy.attachments} attachments"))
        for lost in copy.damage.lost:
            print(printable(f"lost: {lost}"))
        if copy.whole:
            print("nothing is lost: the content digest matches")
    return Exit.DONE if copy.whole else Exit.LOSSY


def verify(logs: Logs, as_json: AsJson = False) -> int:
    """Compute every control decision of a log again and compare it with the logged decision.

    Every number must be the same to the last bit. If one is not, and processor or versions
    (tetractl, Python, NumPy, numba) differ from those that wrote the log, only the costs of the
    logged plans are evaluated again; the output names the check that was made. If processor and
    versions agree, a simulation is run again, which decides every step again, and the two logs are
    compared record by record.

    If anything differs, exits with 1 and names the first step and field that differ.

    A log with the same messages that another program wrote again is ok, and said to be so.

    Example: tetractl verify logs/batch
    """
    from tetractl.replay.verify import verify as check

    checked: list[dict[str, Any]] = []
    for path in find_logs(logs):
        try:
            verification = check(path)
        except LogError as error:
            checked.append({"log": str(path), "ok": False, "error": error.message})
            lines = [f"{path}: FAILED: {error.message.removeprefix(f'{path}: ')}"]
        else:
            checked.append({**asdict(verification), "ok": verification.ok})
            lines = verification.lines
        if not as_json:
            for line in lines:
                print(printable(line))
    all_ok = all(log["ok"] for log in checked)
    if as_json:
        print(json.dumps({"ok": all_ok, "logs": checked}, indent=2))
    return Exit.DONE if all_ok else Exit.FAILED
