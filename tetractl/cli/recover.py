"""`tetractl recover`: copies the intact records of a damaged log to a complete file."""

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from tetractl.cli.options import AsJson
from tetractl.core.errors import Exit


def recover(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="Log of a trial, or a .part file.")],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="FILE", help="File to write.  [NAME.recovered.mcap]"),
    ] = None,
    as_json: AsJson = False,
) -> int:
    """Copy the intact records of a damaged log to a complete file, and print what is lost.

    Exits with 0 if nothing is lost, 3 if something is, 1 if nothing can be saved.

    Example: tetractl recover logs/batch/trial-003.mcap.part
    """
    from tetractl.core.errors import printable
    from tetractl.log.read.find import find_log
    from tetractl.log.read.recover import recover as save

    log = find_log(log)
    done = save(log, out)
    if as_json:
        print(json.dumps({**asdict(done), "whole": done.whole}, indent=2))
    elif done.path is None:
        print(printable(f"{log}: complete; there is nothing to recover"))
    else:
        for problem in done.damage.problems:
            print(printable(f"damaged: {problem}"), file=sys.stderr)
        print(
            printable(
                f"{done.path}: {done.chunks} chunks with {done.messages} messages,"
                f" {done.metadata} metadata records, {done.attachments} attachments"
            )
        )
        for lost in done.damage.lost:
            print(printable(f"lost: {lost}"))
        if done.whole:
            print("nothing is lost: the content digest matches")
    return Exit.DONE if done.whole else Exit.LOSSY
