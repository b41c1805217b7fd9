"""The example specs that tetractl and other packages ship."""

from pathlib import Path

from tetractl.core.errors import UsageError
from tetractl.core.registries import EXAMPLES

FOLDER = "experiments"
"""Name of the folder of the examples."""


def shipped_folder() -> Path:
    """Return the folder of the example specs, in the installed package or in the source tree.

    Raises:
        UsageError: If neither of them has the examples.
    """
    package, source_tree = Path(__file__).resolve().parents[1:3]
    for folder in (package / FOLDER, source_tree / FOLDER):
        if (folder / "three_m3pi.yaml").is_file():
            return folder
    raise UsageError("the examples are missing from this installation of tetractl")


def find_examples() -> dict[str, Path]:
    """Find the files of all examples, including the examples of other packages.

    Returns:
        The file of each example, by name. The name is the path in the examples' folder, without
        `.yaml`.
    """
    files: dict[str, Path] = {}
    for folder in (shipped_folder(), *EXAMPLES.load_usable().values()):
        for file in sorted(folder.rglob("*.yaml")):
            name = file.relative_to(folder).with_suffix("")
            files.setdefault(name.as_posix(), file)
    return files
