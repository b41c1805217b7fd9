"""`tetractl verify` and `recover`: check a log, and save the intact part of a damaged one."""

import json
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from tetractl.cli import ui
from tetractl.cli.options import AsJson, Logs, argument, out_option
from tetractl.core.errors import Exit, LogError, printable
from tetractl.log.read.find import find_log, find_logs


def verify(logs: Logs, as_json: AsJson = False) -> int:
    """Compute every control decision of a log again and compare it with the logged decision.

    Every number must be the same to the last bit. If a number differs, and the log was written with
    another processor or other versions (tetractl, Python, NumPy, numba), the command only evaluates
    the costs of the logged plans again; the output names the check that was made. If processor and
    versions agree, the command also runs a simulation again, which repeats every decision, and
    compares the two logs record by record.

    If anything differs, it exits with 1 and names the first step and field that differ. If the
    check of a log would take too long, the log is "not checked to the end", and the command exits
    with 3. Compilation does not count.

    If another program has rewritten a log with the same messages, the log is ok, and the output
    says that it was rewritten.

    Example: tetractl verify logs/batch
    """
    from tetractl.verification.verify import verify as check

    checked: list[dict[str, Any]] = []
    for path in find_logs(logs):
        try:
            verification = check(path, partial(ui.announce_compiling, False))
        except LogError as error:
            verdicts = {"ok": False, "verdict": "FAILED"}
            checked.append({"log": str(path), **verdicts, "error": error.message})
            lines = [f"{path}: FAILED: {error.message.removeprefix(f'{path}: ')}"]
        else:
            verdicts = {"ok": verification.ok, "verdict": verification.verdict}
            checked.append({**asdict(verification), **verdicts})
            lines = verification.lines
        if not as_json:
            for line in lines:
                print(printable(line))
    all_ok = all(log["ok"] for log in checked)
    if as_json:
        print(json.dumps({"ok": all_ok, "logs": checked}, indent=2))
    if any(log["verdict"] == "FAILED" for log in checked):
        return Exit.FAILED
    return Exit.DONE if all_ok else Exit.LOSSY


def recover(
    log: Annotated[Path, argument("LOG", "Log of a trial, or a .part file.")],
    out: Annotated[Path | None, out_option("FILE", "File to write. [NAME.recovered.mcap]")] = None,
    as_json: AsJson = False,
) -> int:
    """Copy the intact records of a damaged log to a complete file, and print what is lost.

    Exits with 0 if nothing is lost, 3 if something is lost, and 1 if nothing can be saved.

    Example: tetractl recover logs/batch/trial-003.mcap.part
    """
    from tetractl.log.read.recover import recover as save

    log = find_log(log)
    copy = save(log, out)
    if as_json:
        print(json.dumps({**asdict(copy), "whole": copy.whole}, indent=2))
    elif copy.path is None:
        print(printable(f"{log}: the log is complete, so there is nothing to recover"))
    else:
        ui.print_messages(*(f"damaged: {problem}" for problem in copy.damage.problems))
        records = f"{copy.chunks} chunks with {copy.messages} messages"
        print(printable(f"{copy.path}: {records}, {copy.attachments} attachments"))
        for lost in copy.damage.lost:
            print(printable(f"lost: {lost}"))
        if copy.whole:
            print("nothing is lost, because the content digest matches")
    return Exit.DONE if copy.whole else Exit.LOSSY
