"""`tetractl init`: write a spec to start from."""

import re
import sys
from pathlib import Path
from typing import Annotated

import typer

from tetractl.core.errors import Exit, UsageError

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")


def init(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="Name of the experiment, and of its file.")
    ] = "experiment",
    lab: Annotated[
        bool, typer.Option("--lab", help="With the part of a lab of m3pi robots.")
    ] = False,
    cells: Annotated[
        bool, typer.Option("--cells", help="Cells, in um, in place of robots.")
    ] = False,
) -> int:
    """Write NAME.yaml, a commented spec that runs as it is. A file that is there is left alone.

    Example: tetractl init first
    """
    from tetractl.core.text import printable
    from tetractl.experiment.templates import template

    if lab and cells:
        raise UsageError("--lab and --cells: the lab is one of robots", "give one of the two")
    path = Path(re.sub(r"\.ya?ml$", "", name) + ".yaml")
    if not NAME.fullmatch(path.stem):
        raise UsageError(
            f"'{printable(name, 80)}' is no name of an experiment",
            "use up to 64 of a to z, A to Z, 0 to 9, dot, underscore and hyphen",
        )
    text = template(path.stem, path.name, cells, lab)
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise UsageError(f"{path}: is there already", "give another NAME") from None
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from None
    print(path)
    print(f"run it with: tetractl run {path}", file=sys.stderr)
    return Exit.DONE
