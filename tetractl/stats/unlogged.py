"""The trials of studies that have no log: their results are in the rows that the study keeps."""

from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

from tetractl.core.errors import LogError
from tetractl.log.read.find import is_set_aside
from tetractl.log.read.rows import row_results
from tetractl.log.read.trial_log import ResultSummary
from tetractl.stats.damaged import Damaged


def add_unlogged(
    files: Iterable[Path], trials: list[ResultSummary], damaged: list[Damaged]
) -> None:
    """Add the trials of files of rows to those read from logs, each once.

    A log goes before the row of its trial, unless the log has lost its end: then it is damaged, and
    the row counts. Logs that were set aside are attempts, and no reason to leave the row out.
    """
    logs: dict[tuple[Path, int], list[ResultSummary]] = defaultdict(list)
    for trial in trials:
        path = Path(trial.path)
        if not is_set_aside(path.name):
            logs[path.parent.resolve(), trial.trial].append(trial)
    for file in {file.resolve(): file for file in files}.values():
        try:
            rows = row_results(file)
        except LogError as error:
            damaged.append(Damaged(str(file), str(error).removeprefix(f"{file}: ")))
            continue
        lost = 0
        for number, row in rows.items():
            beside = logs[file.parent.resolve(), number]
            if row is None:
                lost += not beside
            elif all(log.recovered and not log.outcome.complete for log in beside):
                trials.append(row)
                for log in beside:
                    trials.remove(log)
                    damaged.append(Damaged(log.path, f"its end is lost, and read from {row.path}"))
        if lost:
            problem = f"{lost} trials have neither a log nor a result in their row"
            damaged.append(
                Damaged(str(file), f"{problem}; the study's --rerun-outdated runs them again")
            )
