"""Print constraints for pip: `python tools/versions.py lowest|newest`.

The lowest are the versions after `>=` in each pyproject.toml; the newest are no constraints.
"""

import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]


def lowest() -> dict[str, str]:
    """Return the lowest version of each library that the packages and their tests need."""
    found: dict[str, str] = {}
    for file in (ROOT / "pyproject.toml", *ROOT.glob("packages/*/pyproject.toml")):
        project = tomllib.loads(file.read_text())["project"]
        extras = project.get("optional-dependencies", {})
        of_tests = [*extras.get("dev", []), *extras.get("docs", [])]
        for requirement in [*project["dependencies"], *of_tests]:
            if match := re.fullmatch(r"([\w.-]+)>=([\w.]+)", requirement):
                name, version = match.groups()
                if found.setdefault(name, version) != version:
                    sys.exit(f"error: {file}: {requirement}, elsewhere >={found[name]}")
    return found


if __name__ == "__main__":
    if sys.argv[1] == "lowest":
        print("\n".join(f"{name}=={version}" for name, version in sorted(lowest().items())))
