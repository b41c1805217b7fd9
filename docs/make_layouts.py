"""Write the layouts for Lichtblick and Foxglove of the experiments, docs/layouts/NAME.json.

Run `python docs/make_layouts.py` after a change of an experiment or of the layout; a test fails
while they differ. Each log holds the layout of its own experiment.
"""

import json
from pathlib import Path

from tetractl.log.format.layout import layout
from tetractl.spec.load import load_spec

FOLDER = Path(__file__).parent / "layouts"
EXPERIMENTS = Path(__file__).parent.parent / "experiments"
NAMES = ("three_m3pi", "five_robots", "tetrahymena")


def layouts() -> dict[Path, str]:
    """Return the text of each file."""
    made = {}
    for name in NAMES:
        found = json.loads(layout(load_spec(EXPERIMENTS / f"{name}.yaml").experiment.setup))
        made[FOLDER / f"{name}.json"] = json.dumps(found, indent=2, ensure_ascii=False) + "\n"
    return made


if __name__ == "__main__":
    for path, text in layouts().items():
        path.write_text(text, encoding="utf-8")
