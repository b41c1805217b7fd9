"""Functions of the Python interface that load specs from files, texts and dicts."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tetractl.core.errors import require_type
from tetractl.spec import load
from tetractl.spec.loaded_spec import LoadedSpec


def load_spec(path: str | Path, *sets: str) -> LoadedSpec:
    """Read a spec from a YAML file and check it.

    Args:
        path: The YAML file.
        *sets: Values that replace those in the file, such as "trials.count=5".

    Returns:
        The checked spec. Its attribute `experiment` holds the fields.

    Raises:
        SpecError: If the spec is wrong. The message has one line per problem.

    Example:
        >>> spec = tetractl.load_spec("experiments/single_cell.yaml", "trials.count=2")
        >>> spec.experiment.trials.count
        2
    """
    require_type(path, str | Path, "load_spec needs a file; parse_spec takes a dict")
    _demand_texts(sets)
    return load.load_spec(Path(path), sets)


def parse_spec(text: str | Mapping[str, Any], *sets: str) -> LoadedSpec:
    """Check a spec that is given as YAML text or as a mapping.

    Args:
        text: The contents of a spec: YAML text, or a mapping such as `yaml.safe_load` returns.
        *sets: Values that replace those in the contents, such as "trials.count=5".

    Returns:
        The checked spec. Its attribute `experiment` holds the fields.

    Raises:
        SpecError: If the spec is wrong. The message has one line per problem.

    Example:
        >>> text = Path("experiments/single_cell.yaml").read_text()
        >>> tetractl.parse_spec(text).experiment.name
        'single-cell'
    """
    _demand_texts(sets)
    if isinstance(text, Mapping):
        return load.parse_contents(text, "spec", sets)
    require_type(text, str, "the contents of a spec must be a string or a dict")
    return load.parse_spec(text, "spec", sets)


def experiment_schema() -> dict[str, Any]:
    """Return the JSON schema of a spec, including the kinds that installed packages add.

    Example:
        >>> tetractl.experiment_schema()["required"]
        ['name', 'arena', 'robots']
    """
    from tetractl.spec.experiment import Experiment
    from tetractl.spec.schema import schema_of

    return schema_of(Experiment)


Spec = LoadedSpec | str | Path | Mapping[str, Any]
"""An experiment: a loaded spec, a YAML file, or the contents of one."""


def as_spec(spec: Spec) -> LoadedSpec:
    """Load a spec that is given as a file or a mapping. A loaded spec is returned unchanged."""
    if isinstance(spec, LoadedSpec):
        return spec
    if isinstance(spec, Mapping):
        return parse_spec(spec)
    require_type(
        spec, str | Path, "a spec must be a file, a dict or a value that load_spec returns"
    )
    return load_spec(spec)


def _demand_texts(sets: Sequence[str]) -> None:
    """Check that all settings of a call are texts such as "trials.count=5"."""
    for setting in sets:
        require_type(setting, str, 'a setting must be a string such as "trials.count=5"')
