"""Print constraints for pip: `python tools/versions.py lowest|newest`.

`lowest` prints the versions after `>=` in each pyproject.toml. `newest` prints no constraints.
"""

import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]


def find_lowest_versions() -> dict[str, str]:
    """Find the lowest version of each library that the packages and their tests need."""
    version_by_name: dict[str, str] = {}
    for file in (ROOT / "pyproject.toml", *ROOT.glob("packages/*/pyproject.toml")):
        project = tomllib.loads(file.read_text())["project"]
        extras = project.get("optional-dependencies", {})
        test_requirements = [*extras.get("dev", []), *extras.get("docs", [])]
        for requirement in [*project["dependencies"], *test_requirements]:
            if match := re.fullmatch(r"([\w.-]+)>=([\w.]+)", requirement):
                name, version = match.groups()
                if version_by_name.setdefault(name, version) != version:
                    other_version = version_by_name[name]
                    sys.exit(f"error: {file}: {requirement}, elsewhere >={other_version}")
    return version_by_name


if __name__ == "__main__":
    if sys.argv[1] == "lowest":
        print(
            "\n".join(
                f"{name}=={version}" for name, version in sorted(find_lowest_versions().items())
            )
        )
