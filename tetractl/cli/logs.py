"""`tetractl info`, `recover` and `verify`: what is in a log, what is left of it, is it right."""

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
from tetractl.core.table.terminal_table import LISTED_MAX
from tetractl.log.read.find import find_log, find_logs

if TYPE_CHECKING:
    from tetractl.log.read.overview import ChannelCount, Overview
    from tetractl.replay.verify import Verification


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
    found = overview(log)
    if as_json:
        print(found.as_json())
    else:
        for line in _lines(found):
            print(printable(line, 240).rstrip())  # --json prints whole lines
    return Exit.FAILED if found.damage else Exit.DONE


def _channel_lines(channels: "Sequence[ChannelCount]") -> Iterator[str]:
    wide = max((len(item.topic) for item in channels), default=0)
    for item in channels:
        rate = "" if item.hz is None else f"{item.hz:.1f} Hz"
        yield f"{item.topic:<{wide}}  {item.schema:<25} {item.messages:>6} messages {rate:>9}"


def _lines(found: "Overview") -> Iterator[str]:
    yield f"{found.log}: {found.size} bytes, {found.chunks} chunks"
    events = (f"{one.time_s:8.2f} s  {one.level:<7}  {one.text}" for one in found.events)
    sizes = {name: f"{size} bytes" for name, size in found.attachments.items()}
    yield from _section("run", _aligned(found.run))
    yield from _section("result", _aligned(_result(found)))
    yield from _section("events", events)
    yield from _section(f"estimate at step {found.estimate_step}", _aligned(_estimate(found)))
    yield from _section("channels", _channel_lines(found.channels))
    yield from _section("attachments", _aligned(sizes))
    yield from _section("host", _aligned(found.host))
    yield from _section("provenance", _aligned(found.provenance))
    stated = {} if found.stated_digest is None else {"stated": found.stated_digest}
    digests = stated | {"computed": found.digest}
    if found.stated_digest == found.digest:
        digests = {"stated and computed": found.digest}
    if found.brief:
        digests = {"of the whole log": found.digest}
    yield from _section("content digest", _aligned(digests))
    if found.damage:
        lost = (f"lost: {lost}" for lost in found.damage.lost)
        yield from _section("damage", [*found.damage.problems, *lost])


def _section(title: str, lines: Iterable[str]) -> Iterator[str]:
    """Yield a section's lines; nothing if it has none."""
    for number, line in enumerate(lines):
        if not number:
            yield from ("", title)
        yield f"  {line}"


def _aligned(items: dict[str, str]) -> list[str]:
    width = max(map(len, items), default=0)
    return [f"{key:<{width}}  {value}" for key, value in items.items()]


def _result(found: "Overview") -> dict[str, str]:
    result, unit = found.result, found.run.get("unit", "")
    if result is None:
        return {"outcome": "none: the log breaks off before the end of the trial"}
    errors = ", ".join(f"{error:.1f}" for error in result.robot_errors)
    solve = sorted(result.solve_ns)
    return {
        "outcome": result.outcome.value,
        "reason": result.reason or "-",
        "steps": str(result.steps),
        "duration": f"{result.duration_s:.2f} s",
        "total error": f"{result.total_error:.1f} {unit}",
        "robot errors": f"{errors} {unit}",
        "entered obstacle": "yes" if result.entered_obstacle else "no",
        "longest solve": f"{milliseconds(solve[-1]):.1f} ms" if solve else "-",
        "deadline misses": str(result.deadline_misses),
    }


def _estimate(found: "Overview") -> dict[str, str]:
    """Return the last estimate, one line per robot, each value with its standard deviation."""
    from tetractl.run.model_news import turning

    estimate, unit = found.estimate, found.run.get("unit", "")
    if estimate is None:
        return {}
    names = json.loads(found.run["robots"])
    bias, bias_std = estimate.heading_bias, estimate.heading_bias_std
    lines: dict[str, str] = {}
    for i, name in enumerate(names):
        parts = [
            f"a {_deviating(estimate.a[i], estimate.a_std[i])} rad/s",
            f"speed {_deviating(estimate.speed[i], estimate.speed_std[i])} {unit}/s",
        ]
        if bias is not None and bias_std is not None:
            parts.append(f"heading bias {_deviating(bias[i], bias_std[i])} rad")
        if turns := turning(estimate, i):
            parts.append(turns)
        lines[name] = ", ".join(parts)
    if estimate.dead_time is not None and estimate.dead_time_std is not None:
        lines["dead time"] = f"{_deviating(estimate.dead_time, estimate.dead_time_std)} s"
    if unfit := estimate.unfit(names):
        lines["the model does not fit"] = ", ".join(sorted(unfit))
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
    done = save(log, out)
    if as_json:
        print(json.dumps({**asdict(done), "whole": done.whole}, indent=2))
    elif done.path is None:
        print(printable(f"{log}: complete; there is nothing to recover"))
    else:
        ui.tell(*(f"damaged: {problem}" for problem in done.damage.problems))
        kept = f"{done.chunks} chunks with {done.messages} messages"
        print(printable(f"{done.path}: {kept}, {done.attachments} attachments"))
        for lost in done.damage.lost:
            print(printable(f"lost: {lost}"))
        if done.whole:
            print("nothing is lost: the content digest matches")
    return Exit.DONE if done.whole else Exit.LOSSY


def verify(logs: Logs, as_json: AsJson = False) -> int:
    """Compute every control decision of a log again and compare it with the logged decision.

    A simulation is run again as well, and the two logs are compared record by record.

    On the machine that wrote a log, every number must be the same to the last bit. On another
    machine, only the costs of the logged plans are evaluated again; the output names the check that
    was made. If anything differs, exits with 1 and names the first step and field that differ.

    A log with the same messages that another program wrote again is ok, and said to be so.

    Example: tetractl verify logs/batch
    """
    from tetractl.replay.verify import verify as check

    done: list[dict[str, Any]] = []
    good = True
    for path in find_logs(logs):
        try:
            found = check(path)
        except LogError as error:
            good = False
            done.append({"log": str(path), "ok": False, "error": error.message})
            lines = iter([f"{path}: FAILED: {error.message.removeprefix(f'{path}: ')}"])
        else:
            good &= found.ok
            done.append({**asdict(found), "ok": found.ok})
            lines = _verdict(found)
        if not as_json:
            for line in lines:
                print(printable(line))
    if as_json:
        print(json.dumps({"ok": good, "logs": done}, indent=2))
    return Exit.DONE if good else Exit.FAILED


def _verdict(found: "Verification") -> "Iterator[str]":
    from tetractl.replay.verify import Method

    verdict = "ok" if found.ok else "FAILED"
    if found.rewritten:
        verdict += f", written again by {found.rewritten}"
        verdict += ": the same messages" * found.ok
    text = f"{found.checked} of {found.steps} decisions {found.method}"
    yield f"{found.log}: {verdict}: {text} ({found.seconds:.2f} s)"
    if found.method is Method.REEVALUATED:
        yield from (f"  written elsewhere: {line}" for line in found.elsewhere)
    for problem in found.problems[:LISTED_MAX]:
        yield f"  {problem}"
    if len(found.problems) > LISTED_MAX:
        yield f"  and {len(found.problems) - LISTED_MAX} more"
    yield from (f"  note: {note}" for note in found.notes)
