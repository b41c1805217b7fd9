"""The metadata records of a log: the run at its start, the result at its end; values are strings.

MCAP has checksums for messages and attachments but not for metadata, so each metadata record of
tetractl has an item `checksum`. Lists are JSON; in them a number that is not finite is a string
("inf", "nan"), since JSON has no such number.
"""

import json
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from tetractl.core.commands import PlantInfo, Verdict
from tetractl.core.plan import Outcome
from tetractl.core.poses import Poses
from tetractl.core.trial import Result, Start
from tetractl.log.format.channels import FORMAT_VERSION
from tetractl.log.format.digest import CHECKSUM
from tetractl.log.read.trial_log import Damage

FORMAT = "format_version"
WARNINGS = "warnings"
_PLANT = "plant."


def add_checksum(items: Mapping[str, str]) -> dict[str, str]:
    """Return the items of a metadata record with their checksum added."""
    return {**items, CHECKSUM: _checksum(items)}


def checksum_ok(items: Mapping[str, str]) -> bool:
    """Return whether the checksum of a metadata record matches its items."""
    return items.get(CHECKSUM) == _checksum(items)


def _checksum(items: Mapping[str, str]) -> str:
    pairs = sorted((key, value) for key, value in items.items() if key != CHECKSUM)
    return f"{zlib.crc32(json.dumps(pairs).encode()):08x}"


def run_metadata(start: Start) -> dict[str, str]:
    """Return the metadata record at the start of a log, which identifies the trial."""
    setup, plant = start.setup, start.plant
    run_id = f"{start.spec_hash[:12]}-{start.seed}-{start.trial}"
    if not plant.simulated:  # the start time distinguishes trials in a lab
        run_id += f"-{start.start_unix_ns}"
    return {
        FORMAT: str(FORMAT_VERSION),
        "run_id": run_id,
        "mode": "sim" if plant.simulated else "lab",
        "name": setup.name,
        "trial": str(start.trial),
        "seed": str(start.seed),
        "spec_hash": start.spec_hash,
        "spec_name": start.spec_name,
        "robots": json.dumps(setup.names),
        "unit": setup.unit,
        "start_unix_ns": str(start.start_unix_ns),
        "plant": plant.kind,
        "camera_rate_hz": repr(float(plant.camera_rate_hz)),
        **{_PLANT + key: value for key, value in plant.facts.items()},
    }


@dataclass(frozen=True, slots=True)
class RunRecord:
    """The decoded metadata record of a run; `items` are as written, without the checksum."""

    items: dict[str, str]
    version: int  # version of the log format
    robots: tuple[str, ...]  # names
    spec_name: str
    seed: int
    trial: int
    plant: PlantInfo
    start_unix_ns: int


def read_run(items: Mapping[str, str]) -> RunRecord:
    """Decode the metadata record that `run_metadata` returns.

    Raises KeyError, TypeError or ValueError for items that `run_metadata` does not write.
    """
    plant = PlantInfo(
        kind=items["plant"],
        simulated=items["mode"] == "sim",
        camera_rate_hz=float(items["camera_rate_hz"]),
        facts={k.removeprefix(_PLANT): v for k, v in items.items() if k.startswith(_PLANT)},
    )
    return RunRecord(
        items={key: value for key, value in items.items() if key != CHECKSUM},
        version=int(items[FORMAT]),
        robots=tuple(map(str, json.loads(items["robots"]))),
        spec_name=items["spec_name"],
        seed=int(items["seed"]),
        trial=int(items["trial"]),
        plant=plant,
        start_unix_ns=int(items["start_unix_ns"]),
    )


def result_metadata(result: Result, unit: str, warnings: int = 0) -> dict[str, str]:
    """Return the metadata record at the end of a log: the result without its solve times.

    `warnings` is the number of operator messages that are warnings or errors.
    """
    final = result.verdict.final
    return {
        "outcome": result.outcome.value,
        "reason": result.reason,
        "unit": unit,
        "steps": str(result.steps),
        "duration_s": repr(float(result.duration_s)),
        "total_error": repr(float(result.total_error)),
        "robot_errors": _numbers(result.robot_errors),
        "entered": json.dumps([bool(entered) for entered in result.verdict.entered]),
        "clearance": _numbers(result.verdict.clearance),
        "edge": _numbers(result.verdict.edge),
        "apart": _numbers(result.verdict.apart),
        "final_x": _numbers(final.x.tolist()),
        "final_y": _numbers(final.y.tolist()),
        "final_heading": _numbers(final.heading.tolist()),
        **{
            name: _numbers(values)
            for name, values in (("passed", result.passed), ("inside", result.inside))
            if values
        },
        **({"lost": json.dumps(result.lost)} if result.lost else {}),
        WARNINGS: str(warnings),
    }


def timing_metadata(result: Result) -> dict[str, str]:
    """Return the metadata record of the solve times, which depend on the host; it precedes the
    result.
    """
    return {
        "solve_ns": json.dumps([int(ns) for ns in result.solve_ns]),
        "deadline_misses": str(result.deadline_misses),
    }


def damage_metadata(damage: Damage, source: str, size: int, sha256: str) -> dict[str, str]:
    """Return the metadata record of a recovered log: the file it comes from, and the damage."""
    return {
        "source": source,
        "source_bytes": str(size),
        "source_sha256": sha256,
        "problems": json.dumps(damage.problems),
        "lost": json.dumps(damage.lost),
    }


def read_damage(items: Mapping[str, str]) -> Damage | None:
    """Decode the metadata record that `damage_metadata` returns; None if nothing was lost."""
    problems, lost = (json.loads(items[key]) for key in ("problems", "lost"))
    if not isinstance(problems, list) or not isinstance(lost, list):
        raise TypeError("problems and losses must be lists")
    if not lost:
        return None
    whence = f"recovered from {items['source']}, which was damaged"
    return Damage((whence, *map(str, problems)), tuple(map(str, lost)))


def read_result(items: Mapping[str, str], timing: Mapping[str, str] | None, robots: int) -> Result:
    """Decode the metadata records of `result_metadata` and `timing_metadata` for `robots` robots.

    Without `timing` the result has no solve times. Raises KeyError, TypeError or ValueError for
    items that these functions do not write, and for another number of robots.
    """
    final = [_floats(items[key]) for key in ("final_x", "final_y", "final_heading")]
    entered = tuple(bool(entered) for entered in json.loads(items["entered"]))
    errors, clearance = _floats(items["robot_errors"]), _floats(items["clearance"])
    edge, apart = (_floats(items.get(key, "[]")) for key in ("edge", "apart"))
    inside = _floats(items.get("inside", "[]"))
    lost = tuple(int(times) for times in json.loads(items.get("lost", "[]")))
    # older logs lack some columns
    kept = [column for column in (edge, apart, inside, lost) if column]
    if any(len(column) != robots for column in (*final, entered, errors, clearance, *kept)):
        raise ValueError("the result and the run have different numbers of robots")
    return Result(
        outcome=Outcome(items["outcome"]),
        reason=items["reason"],
        steps=int(items["steps"]),
        duration_s=float(items["duration_s"]),
        total_error=float(items["total_error"]),
        robot_errors=errors,
        verdict=Verdict(
            final=Poses(*(np.array(column, dtype=np.float64) for column in final)),
            entered=entered,
            clearance=clearance,
            edge=edge,
            apart=apart,
        ),
        solve_ns=tuple(int(ns) for ns in json.loads(timing["solve_ns"])) if timing else (),
        deadline_misses=int(timing["deadline_misses"]) if timing else 0,
        passed=_floats(items.get("passed", "[]")),
        inside=inside,
        lost=lost,
    )


def _numbers(values: Iterable[float]) -> str:
    floats = [float(value) for value in values]
    return json.dumps([value if np.isfinite(value) else str(value) for value in floats])


def _floats(text: str) -> tuple[float, ...]:
    return tuple(float(value) for value in json.loads(text))
