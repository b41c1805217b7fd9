"""Whether all packages of this checkout are installed, which pages about all of them need."""

from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

PACKAGES = Path(__file__).parents[1] / "packages"


def require_all_packages() -> None:
    """End the program with a hint if a package of this checkout is not installed.

    Its commands and fields would silently be missing in the page.
    """
    missing: list[str] = []
    for folder in sorted(PACKAGES.iterdir()):
        try:
            distribution(folder.name)
        except PackageNotFoundError:
            missing.append(folder.name)
    if missing:
        names = ", ".join(missing)
        raise SystemExit(f"not installed: {names}; 'make test' installs all packages")
