"""Results of trials that a study has run, from the rows it keeps in place of logs.

The folder of an arm has its spec in one file and in another a line of JSON a trial, in which
`result` and `timing` are the records of those names in a log.
"""

import json
from pathlib import Path

from tetractl.core.commands import PlantInfo
from tetractl.core.errors import LogError, SpecError
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.load import parse_spec
from tetractl.experiment.yaml.document import read_text
from tetractl.log.format.metadata import WARNINGS, read_result
from tetractl.log.read.believe import believe_result
from tetractl.log.read.origin import Origin
from tetractl.log.read.trial_log import ResultSummary

ROWS = "trials.jsonl"
SPEC = "spec.resolved.yaml"
SIMULATED = PlantInfo("", simulated=True, camera_rate_hz=0.0, facts={})
"""What all plants of studies have in common."""


def find_rows(folder: Path) -> list[Path]:
    """Return the files of rows in a folder and its sub-folders, sorted; of another path none."""
    return sorted(folder.rglob(ROWS)) if folder.is_dir() else []


def read_rows(path: Path) -> tuple[list[ResultSummary], str]:
    """Return the results in a file of rows, by trial, and what is wrong with it, "" if nothing is.

    Of two lines of a trial the later counts; a last line that does not end is what a killed process
    left, and no row. Raises LogError where the file or its spec cannot be read.
    """
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").split("\n")[:-1]
        experiment = parse_spec(read_text(path.with_name(SPEC)), SPEC).experiment
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}") from error
    except SpecError as error:
        raise LogError(f"{path.with_name(SPEC)}: cannot be read: {error}") from None
    found: dict[int, ResultSummary] = {}
    lost = 0
    for number, line in enumerate(lines, start=1):
        try:
            one = _result(f"{path}:{number}", json.loads(line), experiment)
        except (KeyError, TypeError, ValueError, RecursionError):
            lost += 1
        else:
            found[one.trial] = one
    problem = f"{lost} of {len(lines)} rows hold no result: the study's --again runs them again"
    return [found[trial] for trial in sorted(found)], problem if lost else ""


def _result(place: str, row: dict[str, dict[str, str]], experiment: Experiment) -> ResultSummary:
    stated = row["result"]
    result = read_result(stated, row["timing"], len(experiment.robots))
    believe_result(result)
    return ResultSummary(
        path=place,
        experiment=experiment,
        seed=experiment.trials.seed,
        trial=int(str(row["trial"])),
        origin=Origin.of(experiment, SIMULATED),
        result=result,
        recovered=False,
        digest=None,
        warnings=int(stated[WARNINGS]),
    )
