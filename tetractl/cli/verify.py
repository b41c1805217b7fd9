"""`tetractl verify`: compute every decision of a log again."""

import json
from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from tetractl.cli.options import AsJson, Logs
from tetractl.core.errors import Exit

if TYPE_CHECKING:
    from tetractl.replay.verify import Verification

SHOWN = 20  # largest number of problems printed per log


def verify(
    logs: Logs,
    as_json: AsJson = False,
) -> int:
    """Compute every control decision of a log again and compare it with the logged decision.

    A simulation is run again as well, and the messages for viewers are compared with the records.

    On the machine that wrote a log, every number must be the same to the last bit. On another
    machine, only the costs of the logged plans are evaluated again; the output names the check that
    was made. If anything differs, exits with 1 and names the first step and field that differ.

    Example: tetractl verify logs/batch
    """
    from tetractl.core.errors import LogError, printable
    from tetractl.log.read.find import find_logs
    from tetractl.replay.verify import verify as check

    done: list[dict[str, Any]] = []
    good = True
    for path in find_logs(logs):
        try:
            found = check(path)
        except LogError as error:
            good = False
            done.append({"path": str(path), "ok": False, "error": str(error)})
            lines = iter([f"{path}: FAILED: {str(error).removeprefix(f'{path}: ')}"])
        else:
            good &= found.ok
            done.append({**asdict(found), "ok": found.ok})
            lines = _lines(found)
        if not as_json:
            for line in lines:
                print(printable(line))
    if as_json:
        print(json.dumps({"ok": good, "logs": done}, indent=2))
    return Exit.DONE if good else Exit.FAILED


def _lines(found: "Verification") -> "Iterator[str]":
    from tetractl.replay.verify import Method

    verdict = "ok" if found.ok else "FAILED"
    text = f"{found.checked} of {found.steps} decisions {found.method}"
    yield f"{found.path}: {verdict}: {text} ({found.seconds:.2f} s)"
    if found.method is Method.REEVALUATED:
        yield from (f"  written elsewhere: {line}" for line in found.elsewhere)
    for problem in found.problems[:SHOWN]:
        yield f"  {problem}"
    if len(found.problems) > SHOWN:
        yield f"  and {len(found.problems) - SHOWN} more"
    yield from (f"  note: {note}" for note in found.notes)
