"""The example specs: those that tetractl ships, and those of other packages."""

from pathlib import Path

from tetractl.core.errors import UsageError
from tetractl.core.registries import EXAMPLES

FOLDER = "experiments"
"""Name of the folder of the examples."""


def shipped_folder() -> Path:
    """Return the folder of the examples: in the source tree, or shipped inside the package."""
    here = Path(__file__).resolve()
    for folder in (here.parents[1] / FOLDER, here.parents[2] / FOLDER):
        if (folder / "three_m3pi.yaml").is_file():
            return folder
    raise UsageError("the examples are missing from this installation")


def examples() -> dict[str, Path]:
    """Return the files of all examples, those of other packages too, by name: a path in their
    folder, without `.yaml`."""
    found: dict[str, Path] = {}
    for folder in (shipped_folder(), *EXAMPLES.usable().values()):
        for file in sorted(folder.rglob("*.yaml")):
            found.setdefault(file.relative_to(folder).with_suffix("").as_posix(), file)
    return found
