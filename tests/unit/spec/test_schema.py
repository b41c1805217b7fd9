import json
from functools import cache

import jsonschema
import pytest
from testkit.paths import ROOT, SPECS

from tetractl.spec.experiment import Experiment
from tetractl.spec.load import load_spec
from tetractl.spec.loaded_spec import resolved_yaml
from tetractl.spec.schema import schema_of
from tetractl.spec.yaml.document import parse_document

pytestmark = pytest.mark.slow

EXPERIMENTS = ROOT / "experiments"
COMMITTED = EXPERIMENTS / "experiment.schema.json"


@pytest.fixture
def packages():
    """What is committed is of all packages, and of no kind that a test of this process brought."""
    schema_of.cache_clear()
    for name in (
        "tetractl_emulator",
        "tetractl_learn",
        "tetractl_papers",
        "tetractl_microscope",
        "tetractl_motioncapture",
        "tetractl_ros2",
        "tetractl_toio",
    ):
        pytest.importorskip(name)


@pytest.mark.usefixtures("packages")
def test_the_committed_schema_is_that_of_the_models():
    assert json.loads(COMMITTED.read_text(encoding="utf-8")) == schema_of(Experiment), (
        f"run: tetractl schema -o {COMMITTED.relative_to(ROOT)}"
    )


@pytest.mark.usefixtures("packages")
def test_the_committed_reference_is_that_of_the_models():
    import make_reference  # works out the schema

    page = make_reference.PAGE.read_text(encoding="utf-8")
    assert page == make_reference.page(page), "run: python docs/make_reference.py"


def test_every_field_and_kind_has_a_description():
    schema = schema_of(Experiment)
    bare = [
        f"{model}.{name}"
        for model, node in {"Experiment": schema, **schema["$defs"]}.items()
        for name, field in node["properties"].items()
        if name != "type" and "description" not in field
    ]
    bare += [model for model, node in schema["$defs"].items() if "description" not in node]
    assert bare == []


@cache
def validator():
    schema = json.loads(COMMITTED.read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


@pytest.mark.parametrize("path", SPECS, ids=lambda path: path.stem)
def test_shipped_experiments_satisfy_the_committed_schema(path):
    written = parse_document(path.read_text(encoding="utf-8"), path.name).data
    resolved = parse_document(resolved_yaml(load_spec(path).experiment), path.name).data
    assert list(validator().iter_errors(written)) == []
    assert list(validator().iter_errors(resolved)) == []


@pytest.mark.parametrize(
    "change", [{"trials": 3}, {"unknown": 1}, {"units": {"length": "mile"}}, {"robots": []}]
)
def test_the_schema_refuses_what_the_models_refuse(change):
    data = parse_document(SPECS[0].read_text(encoding="utf-8"), "s").data | change
    assert not validator().is_valid(data)
