"""The rows of a batch: one record per trial, with or without a log.

The folder of a study's arm contains its spec and a file with one line of JSON per trial, in which
`result` has the fields of the log's message of the result, except those that are 0 or empty.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Self

from google.protobuf.json_format import MessageToDict, ParseDict, ParseError
from pydantic import AfterValidator, BaseModel, Field, ValidationError

from tetractl.core.commands import PlantInfo
from tetractl.core.errors import LogError, SpecError, UsageError
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.load import arm_hash, parse_spec
from tetractl.experiment.yaml.document import read_text
from tetractl.log.format.channels import RESOLVED_SPEC
from tetractl.log.format.run_records import encode_result
from tetractl.log.format.tetractl_pb2 import HostEnd
from tetractl.log.format.tetractl_pb2 import Result as ResultMessage
from tetractl.log.read.limits import CHUNK_MAX, file_limit, too_much
from tetractl.log.read.trial_log import Origin, ResultSummary
from tetractl.log.read.validate import INTEGER_MAX, TIME_MAX_NS, check_counts, stated_result

SIMULATED = PlantInfo("", simulated=True, camera_rate_hz=0.0, facts={})
"""The plant of every study: a simulation. Results need no other facts of the plant."""


def one_line(text: str) -> str:
    """Return a text; ValueError if it has characters that cannot be printed."""
    if not text.isprintable():
        raise ValueError("not a name")
    return text


Count = Annotated[int, Field(ge=0, le=INTEGER_MAX)]
Seconds = Annotated[float, Field(ge=0, le=TIME_MAX_NS / 1e9)]
Text = Annotated[str, Field(max_length=200), AfterValidator(one_line)]


class _Numbered(BaseModel, strict=True):
    """What identifies a line: other values may be damaged."""

    trial: Count


class _Line(_Numbered):
    """The values of a line, in their order."""

    arm_hash: Text
    code: Text
    processor: Text
    content_digest: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    count: Count
    logged: bool
    wall_s: Seconds
    cpu_s: Seconds
    result: dict[str, Any]
    solve_ns: list[Count]
    deadline_misses: Count


OTHERWISE = {"content_digest", "result", "solve_ns", "deadline_misses"}
"""The values of a line that a row has under another name, or in its result."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row(ResultSummary):
    """One finished trial of a batch; `path` is the file and line of the row, or its log.

    `arm_hash` identifies the experiment. `digest` is that of the trial's log, `count` is the number
    of trials of the batch, as stated in the log, and `logged` is whether the log was kept.
    `wall_s` and `cpu_s` are wall and processor time [s], None in a row made from a log.
    """

    arm_hash: str
    count: int
    logged: bool
    wall_s: float | None
    cpu_s: float | None

    @classmethod
    def of(cls, log: ResultSummary, known_by: str) -> Self:
        """Return the row of a whole log, whose experiment has the hash `known_by`."""
        same = {one.name: getattr(log, one.name) for one in fields(log)}
        count = log.experiment.trials.count
        return cls(**same, arm_hash=known_by, count=count, logged=True, wall_s=None, cpu_s=None)

    def line(self) -> str:
        """Return the row as a line of JSON."""
        message = encode_result(self.result, self.experiment.units.length, self.warnings)
        stated = {
            "trial": self.trial,
            "arm_hash": self.arm_hash,
            "code": self.code,
            "processor": self.processor,
            "content_digest": self.digest,
            "count": self.count,
            "logged": self.logged,
            "wall_s": self.wall_s,
            "cpu_s": self.cpu_s,
            "result": MessageToDict(message, preserving_proto_field_name=True),
            "solve_ns": self.result.solve_ns,
            "deadline_misses": self.result.deadline_misses,
        }
        return json.dumps(stated, allow_nan=False) + "\n"

    @classmethod
    def read(cls, line: str, experiment: Experiment, place: str) -> Self:
        """Check every value of a line, and return its row.

        Raises one of the exceptions `UNREADABLE` for a line that tetractl does not write.
        """
        stated = _Line.model_validate_json(line)
        message = ParseDict(stated.result, ResultMessage())
        end = HostEnd(solve_ns=stated.solve_ns, deadline_misses=stated.deadline_misses)
        check_counts("warnings", [message.warnings])
        return cls(
            **stated.model_dump(exclude=OTHERWISE),
            **simulated(experiment),
            path=place,
            digest=stated.content_digest,
            warnings=message.warnings,
            result=stated_result(message, end, len(experiment.robots), experiment.units.length),
        )


def simulated(experiment: Experiment) -> dict[str, Any]:
    """Return the values of a row that follow from its experiment, which is simulated."""
    seed, origin = experiment.trials.seed, Origin.of(experiment, SIMULATED)
    return {"experiment": experiment, "seed": seed, "origin": origin, "recovered": False}


UNREADABLE = (
    AttributeError,
    LookupError,
    OverflowError,
    ParseError,
    RecursionError,
    TypeError,
    ValueError,
)
"""Exceptions that decoding a line may raise if tetractl did not write it."""


def check_rows(path: Path) -> None:
    """Raise UsageError if a path is not a regular file, LogError if the file is too large."""
    if not path.is_file():  # reading a FIFO may never end
        raise UsageError(f"{path}: is not a regular file")
    if (size := path.stat().st_size) > file_limit():
        raise too_much(path, f"{size} bytes")


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield number and text of each complete line of at most CHUNK_MAX bytes."""
    number, begins = 1, True
    with path.open("rb") as file:
        while piece := file.readline(CHUNK_MAX):
            ends = piece.endswith(b"\n")
            if begins and ends:
                yield number, piece.decode(errors="replace")
            number, begins = number + ends, ends


def read_rows(path: Path, experiment: Experiment) -> dict[int, Row | None]:
    """Return the rows in a file by number of the trial; None stands for a row that tetractl did not
    write.

    Of two lines of a trial, the later is used. Lines that do not name a trial are skipped, as is an
    incomplete last line, left by a killed process. Raises LogError if the file cannot be read, and
    the errors of `check_rows`.
    """
    check_rows(path)
    found: dict[int, Row | None] = {}
    try:
        for number, line in _lines(path):
            try:
                trial = _Numbered.model_validate_json(line).trial
            except ValidationError:
                continue
            try:
                row = Row.read(line, experiment, f"{path}:{number}")
            except UNREADABLE:
                row = None
            found[trial] = row
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}") from error
    return dict(sorted(found.items()))


def cut_to_lines(path: Path) -> None:
    """Cut a file after its last complete line. Raises LogError if it cannot be written, and the
    errors of `check_rows`."""
    check_rows(path)
    try:
        with path.open("r+b") as file:
            text = file.read()
            whole = text.rfind(b"\n") + 1
            if whole < len(text):
                file.truncate(whole)
    except OSError as error:
        raise LogError(f"{path}: cannot be written: {error.strerror}") from error


def row_results(path: Path) -> dict[int, Row | None]:
    """Return the results in a file of rows by number of the trial, None for a damaged row.

    The experiment is that of the spec next to the file. Raises LogError if the file or its spec
    cannot be read, or if a row belongs to another spec.
    """
    beside = path.with_name(RESOLVED_SPEC)
    try:
        spec = parse_spec(read_text(beside), str(beside), written=True)
    except SpecError as error:
        raise LogError(error.message) from None
    known_by = arm_hash(spec.experiment)
    found = read_rows(path, spec.experiment)
    for row in found.values():
        if row is not None and row.arm_hash != known_by:
            raise LogError(f"{row.path}: belongs to another spec than that in {beside}")
    return found
