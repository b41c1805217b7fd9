"""`tetractl info`: the contents of a log."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tetractl.core.errors import Exit, UsageError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tetractl.log.read.overview import Overview


def info(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="Log of a trial, finished or not.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print a JSON object.")] = False,
) -> int:
    """Print the contents of a log: run, result, channels, provenance, and any damage.

    Everything is read and checked. Exits with 1 where the log is damaged or has no result.

    Example: tetractl info logs/three-m3pi-20200101T000000Z/trial-000.mcap
    """
    from tetractl.experiment.yaml.problems import printable
    from tetractl.log.read.overview import overview

    if not log.exists():
        raise UsageError(f"{log}: no such file")
    found = overview(log)
    if as_json:
        print(found.as_json())
    else:
        for line in _lines(found):
            print(printable(line).rstrip())
    return Exit.FAILED if found.damage else Exit.DONE


def _lines(found: "Overview") -> "Iterator[str]":
    yield f"{found.path}: {found.size} bytes, {found.chunks} chunks"
    yield from _section("run", found.run)
    yield from _section("result", _result(found))
    yield ""
    yield "channels"
    for item in found.channels:
        rate = "" if item.hz is None else f"{item.hz:.1f} Hz"
        yield f"  {item.topic:<17} {item.schema:<25} {item.messages:>6} messages {rate:>9}"
    yield from _section("attachments", {k: f"{v} bytes" for k, v in found.attachments.items()})
    yield from _section("host", found.host)
    yield from _section("provenance", found.provenance)
    yield from _section("content digest", _digest(found))
    if found.damage:
        yield ""
        yield "damage"
        yield from (f"  {problem}" for problem in found.damage.problems)
        yield from (f"  lost: {lost}" for lost in found.damage.lost)


def _section(title: str, items: dict[str, str]) -> "Iterator[str]":
    if items:
        width = max(map(len, items))
        yield ""
        yield title
        yield from (f"  {key:<{width}}  {value}" for key, value in items.items())


def _result(found: "Overview") -> dict[str, str]:
    from tetractl.core.clock import milliseconds

    result, unit = found.result, found.run.get("unit", "")
    if result is None:
        return {"outcome": "none: the log ends before its trial"}
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


def _digest(found: "Overview") -> dict[str, str]:
    if found.stated_digest is None:
        return {"computed": found.digest}
    if found.stated_digest == found.digest:
        return {"stated and computed": found.digest}
    return {"stated": found.stated_digest, "computed": found.digest}
