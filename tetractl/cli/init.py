"""`tetractl init`: write a spec to start from, or an example."""

import re
import sys
from pathlib import Path
from typing import Annotated

import typer

from tetractl.core.errors import Exit, UsageError
from tetractl.experiment.yaml.document import parse_document, read_text
from tetractl.experiment.yaml.problems import did_you_mean

FOLDER = "experiments"
NAMED = ("base", "identified")
"""Fields of a spec that name another file, relative to the spec's folder."""


def shipped_folder() -> Path:
    """Return the folder of the examples: in the source tree, or shipped inside the package."""
    here = Path(__file__).resolve()
    for folder in (here.parents[1] / FOLDER, here.parents[2] / FOLDER):
        if (folder / "three_m3pi.yaml").is_file():
            return folder
    raise UsageError("the examples are missing from this installation")


def example_names() -> list[str]:
    """Return the names of the examples: paths in their folder, without `.yaml`."""
    folder = shipped_folder()
    files = sorted(folder.rglob("*.yaml"))
    return [file.relative_to(folder).with_suffix("").as_posix() for file in files]


def example_files(name: str) -> dict[str, str]:
    """Return the texts of an example and of the files it names, by path in the examples' folder.

    Raises UsageError if there is no such example.
    """
    known, folder = example_names(), shipped_folder()
    name = name.removesuffix(".yaml").removeprefix(f"{FOLDER}/")
    if name not in known:
        guess = did_you_mean(name, known)
        top = ", ".join(one for one in known if "/" not in one)
        raise UsageError(
            f"there is no example '{name}'{guess}", f"the examples are {top}, studies/, faults/"
        )
    found: dict[str, str] = {}
    waiting = [folder / f"{name}.yaml"]
    while waiting:
        file = waiting.pop()
        text = read_text(file)
        found[file.relative_to(folder).as_posix()] = text
        data = parse_document(text, str(file)).data
        named = [(file.parent / data[key]).resolve() for key in NAMED if key in data]
        waiting += [one for one in named if one.relative_to(folder).as_posix() not in found]
    return found


NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")


def init(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="[NAME]",
            help="Name of the experiment and of the file to write.  \\[experiment]",
        ),
    ] = None,
    lab: Annotated[
        bool, typer.Option("--lab", help="Add a lab of m3pi robots to the spec.")
    ] = False,
    cells: Annotated[
        bool, typer.Option("--cells", help="Write a spec of two cells, in um, in place of robots.")
    ] = False,
    example: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Write an example instead, such as three_m3pi, to experiments/three_m3pi.yaml.",
        ),
    ] = None,
) -> int:
    """Write NAME.yaml, a commented spec that can be run. An existing file is left unchanged.

    With --example it writes a shipped spec, study or fault script, and the files it names, to
    experiments/, as the examples of other commands expect. With an unknown NAME it lists the
    examples.

    Example: tetractl init first

    Example: tetractl init --example studies/dead_time
    """
    if example is not None:
        if name is not None or lab or cells:
            raise UsageError(
                "--example cannot be combined with other options: it writes a file as shipped",
                "give --example alone",
            )
        return _example(example)
    from tetractl.core.errors import printable

    name = "experiment" if name is None else name
    if lab and cells:
        raise UsageError(
            "--lab and --cells exclude each other: the lab has robots, not cells",
            "leave out one of the two options",
        )
    path = Path(re.sub(r"\.ya?ml$", "", name) + ".yaml")
    if not NAME.fullmatch(path.stem):
        raise UsageError(
            f"'{printable(name, 80)}' cannot be the name of an experiment",
            "use up to 64 characters: a to z, A to Z, 0 to 9, dot, underscore and hyphen",
        )
    kind = "cells" if cells else "lab" if lab else "robots"
    _write(path, template(path.stem, path.name, kind), "give another NAME")
    print(f"run it with: tetractl run {path}", file=sys.stderr)
    return Exit.DONE


def _example(name: str) -> int:
    files = example_files(name)
    for inner in files:
        (Path(FOLDER) / inner).parent.mkdir(parents=True, exist_ok=True)
    for number, (inner, text) in enumerate(files.items()):
        path = Path(FOLDER) / inner
        if number and path.exists():  # the file was written with another example
            continue
        _write(path, text, "rename that file, or edit it")
    return Exit.DONE


def _write(path: Path, text: str, hint: str) -> None:
    """Write a file that does not exist yet, and print its name."""
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise UsageError(f"{path}: exists already", hint) from None
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from None
    print(path)


def template(name: str, file: str, kind: str) -> str:
    """Return a commented spec of an experiment called `name`, to be kept in `file`.

    `kind` is a file in experiment/templates: two robots, two cells, or robots with a lab.
    """
    from importlib.resources import files

    from tetractl.experiment.yaml.core_yaml import dump

    text = (files("tetractl.experiment") / "templates" / f"{kind}.yaml").read_text("utf-8")
    named = dump({"name": name}).strip("{}\n")  # in quotes if YAML would read the name as a number
    return text.replace("@NAME@", named).replace("@FILE@", file)
