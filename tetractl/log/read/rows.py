"""Results of trials from the rows that a study keeps, with or without logs.

The folder of an arm has its spec in one file and in another a line of JSON a trial, in which
`result` and `timing` are the records of those names in a log.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tetractl.core.commands import PlantInfo
from tetractl.core.errors import LogError, SpecError
from tetractl.experiment.load import LoadedSpec, arm_hash, parse_spec
from tetractl.experiment.yaml.document import read_text
from tetractl.log.format.metadata import WARNINGS
from tetractl.log.read.origin import Origin
from tetractl.log.read.trial_log import ResultSummary
from tetractl.log.read.validate import COUNT_MAX, stated_result

SPEC = "spec.resolved.yaml"
SIMULATED = PlantInfo("", simulated=True, camera_rate_hz=0.0, facts={})
"""The plant of every study is a simulation; nothing else of it is needed for a result."""


def row_results(path: Path) -> dict[int, ResultSummary | None]:
    """Return the results in a file of rows by trial, None where its row holds none.

    Rows of older code hold none. Of two lines of a trial the later counts. What is no row is passed
    over, since the study runs its trial again: the last line where it does not end, for instance,
    is what a killed process left. Raises LogError where the file or its spec cannot be read, or
    where a row is of another spec.
    """
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").split("\n")[:-1]
        beside = path.with_name(SPEC)
        spec = parse_spec(read_text(beside), str(beside))
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}") from error
    except SpecError as error:
        raise LogError(str(error)) from None
    known_by = None if spec.notices else arm_hash(spec.experiment)  # of older names it is another
    found: dict[int, ResultSummary | None] = {}
    for number, line in enumerate(lines, start=1):
        try:
            row = json.loads(line)
            trial, stated = row["trial"], row["arm_hash"]
        except (KeyError, TypeError, ValueError, RecursionError):
            continue
        if type(trial) is not int or not 0 <= trial <= COUNT_MAX:
            continue
        if stated != (known_by or stated):
            raise LogError(f"{path}:{number}: is not of the spec in {beside}")
        try:
            found[trial] = _result(f"{path}:{number}", trial, row, spec)
        except (AttributeError, LookupError, OverflowError, RecursionError, TypeError, ValueError):
            found[trial] = None
    return dict(sorted(found.items()))


def _result(place: str, trial: int, row: Mapping[str, Any], spec: LoadedSpec) -> ResultSummary:
    experiment = spec.experiment
    stated, timing = _texts(row["result"]), _texts(row["timing"])
    result = stated_result(stated, timing, len(experiment.robots), experiment.units.length)
    return ResultSummary(
        path=place,
        experiment=experiment,
        seed=experiment.trials.seed,
        trial=trial,
        origin=Origin.of(experiment, SIMULATED),
        result=result,
        recovered=False,
        digest=None,
        warnings=int(stated[WARNINGS]),
    )


def _texts(items: Any) -> Mapping[str, str]:
    """Return the items of a record; TypeError where one is no text, as all are in a log."""
    if not all(isinstance(value, str) for value in items.values()):
        raise TypeError("an item is no text")
    return items
