"""The row of a trial: what a study keeps of it, with or without its log."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Self

from tetractl.core.clock import MILLISECOND
from tetractl.experiment.experiment import Experiment
from tetractl.log.format.metadata import result_metadata, timing_metadata
from tetractl.log.read.trial_log import ResultSummary
from tetractl.results.trial_tables import trial

HOST_COLUMNS = ("deadline_misses",)
"""Columns of `export` that differ between two runs of a trial; they are in the table of times."""


@dataclass(frozen=True, slots=True)
class Row:
    """One trial of an arm.

    `arm_hash` and `code` name the experiment and the code that ran it, `trial_digest` is that of
    `log.format.trial_digest`, and `count` the number of trials that its log states. `columns` are
    those of `tetractl export` that repeat whenever the trial is run again, `times` those that do
    not. `result` and `timing` are the records of those names in a log, for `log.read.rows`; rows of
    older code have neither.
    """

    trial: int
    arm_hash: str
    code: str
    trial_digest: str
    count: int
    logged: bool  # whether the log was kept
    columns: Mapping[str, Any]
    times: Mapping[str, Any]
    result: Mapping[str, str] = field(default_factory=dict)
    timing: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        found: ResultSummary,
        arm_hash: str,
        code: str,
        trial_digest: str,
        logged: bool,
        took_s: tuple[float, float],
    ) -> Self:
        """Return the row of a trial with its digest; it took wall and CPU time."""
        columns = {column.key: column.known[0] for column in trial(found).columns}
        times = {name: columns.pop(name) for name in HOST_COLUMNS}
        solve_ms = [ns / MILLISECOND for ns in found.result.solve_ns]
        times |= {
            "solve_mean_ms": sum(solve_ms) / len(solve_ms) if solve_ms else None,
            "solve_max_ms": max(solve_ms, default=None),
            "wall_s": took_s[0],
            "cpu_s": took_s[1],
        }
        experiment = found.experiment
        return cls(
            trial=found.trial,
            arm_hash=arm_hash,
            code=code,
            trial_digest=trial_digest,
            count=experiment.trials.count,
            logged=logged,
            columns=columns,
            times=times,
            result=result_metadata(found.result, experiment.units.length, found.warnings),
            timing=timing_metadata(found.result),
        )

    @classmethod
    def read(cls, line: str) -> Self:
        """Return the row of a line; ValueError or TypeError where it is none."""
        fields = json.loads(line)
        if "digest" in fields:  # that of the log's bytes, which rows of older code state
            fields["trial_digest"] = fields.pop("digest")
        return cls(**fields)

    def line(self) -> str:
        """Return the row as a line of JSON."""
        return json.dumps(asdict(self), allow_nan=False) + "\n"

    @property
    def complete(self) -> bool:
        """Whether the trial ran to its own end."""
        return self.columns["outcome"] != "aborted"

    def error(self, experiment: Experiment) -> float | None:
        """Return the total error, None where the trial does not count."""
        column = self.columns[f"total_error_{experiment.units.length}"]
        return column if self.columns["counted"] else None
