"""The benchmark's instances: each is valid, and README tells of it."""

import pytest
from support.paths import ROOT

from tetractl.experiment.load import load_spec

FOLDER = ROOT / "experiments/benchmark"
SPECS = sorted(FOLDER.glob("*.yaml"))


@pytest.mark.parametrize("path", SPECS, ids=lambda path: path.stem)
def test_an_instance_is_valid_and_told_of(path):
    spec = load_spec(path)
    experiment = spec.experiment
    assert experiment.name == path.stem
    assert experiment.trials.count == 100
    row = f"| `{path.stem}` | {len(experiment.robots)} | {len(experiment.obstacles)} |"
    assert row in (FOLDER / "README.md").read_text("utf-8")
    assert (path.parent / "../experiment.schema.json").is_file()
    assert "../experiment.schema.json" in path.read_text("utf-8").splitlines()[0]
