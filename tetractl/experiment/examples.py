"""The specs, studies and fault scripts that are shipped with tetractl, by name."""

from pathlib import Path

from tetractl.core.errors import UsageError
from tetractl.experiment.yaml.document import parse_document, read_text
from tetractl.experiment.yaml.problems import did_you_mean

FOLDER = "experiments"
NAMED = ("base", "identified")
"""Fields that name another file, relative to the file they stand in."""


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
    """Return an example and the files that it names: paths in the examples' folder, and texts.

    Raises UsageError if there is no such example.
    """
    known, folder = example_names(), shipped_folder()
    name = name.removesuffix(".yaml").removeprefix(f"{FOLDER}/")
    if name not in known:
        guess = did_you_mean(name, known)
        top = ", ".join(one for one in known if "/" not in one)
        raise UsageError(
            f"there is no example '{name}'{guess}", f"there are {top}, studies/, faults/"
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
