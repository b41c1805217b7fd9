"""The table of packages in CONTRIBUTING.md."""

import importlib
import re
import tomllib
from pathlib import Path

HERE = Path(__file__).parents[3]


def test_packages_are_in_the_order_of_imports_and_in_their_own_words():
    rows = re.findall(
        r"^\| `(\w+)` \| (.+) \| `(.+)` \|$", (HERE / "CONTRIBUTING.md").read_text(), re.M
    )
    contract = tomllib.loads((HERE / "pyproject.toml").read_text())["tool"]["importlinter"]
    layers = [layer.split(" | ") for layer in contract["contracts"][0]["layers"]]
    packages = [[p for p in layer if (HERE / "tetractl" / p).is_dir()] for layer in layers]
    listed = [name for name, *_ in rows]
    assert listed == [p for layer in packages for p in sorted(layer, key=listed.index)]
    text = (HERE / "CONTRIBUTING.md").read_text()
    for layer in packages:
        assert len(layer) == 1 or ", ".join(f"`{p}`" for p in layer) in text.replace("\n", " ")
    for name, holds, first in rows:
        package = importlib.import_module(f"tetractl.{name}")
        assert package.__doc__ is not None and package.__doc__.split("\n")[0] == holds
        assert (HERE / "tetractl" / name / first).exists()
