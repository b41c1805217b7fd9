"""The metadata of a log: the run at its start and the result at its end, as strings.

MCAP guards messages and attachments with checksums but not metadata, so each record of ours carries
one of its own. Lists are JSON; a number that is not finite is a string in them ("inf", "nan"),
since JSON has no such number.
"""

import json
import zlib
from collections.abc import Iterable, Mapping

import numpy as np

from tetractl.core.commands import PlantInfo, Verdict
from tetractl.core.plan import Outcome
from tetractl.core.poses import Poses
from tetractl.core.setup import Setup
from tetractl.core.trial import Result, Start
from tetractl.log.format.channels import FORMAT_VERSION
from tetractl.log.format.digest import CHECKSUM
from tetractl.log.read.trial_log import Damage

_FACT = "plant."


def seal(facts: Mapping[str, str]) -> dict[str, str]:
    """Return the facts with their checksum."""
    return {**facts, CHECKSUM: _checksum(facts)}


def intact(facts: Mapping[str, str]) -> bool:
    """Whether the facts are those that were sealed."""
    return facts.get(CHECKSUM) == _checksum(facts)


def _checksum(facts: Mapping[str, str]) -> str:
    items = sorted((key, value) for key, value in facts.items() if key != CHECKSUM)
    return f"{zlib.crc32(json.dumps(items).encode()):08x}"


def run_metadata(start: Start) -> dict[str, str]:
    """Return what identifies a trial: the metadata record at the start of the log."""
    setup, plant = start.setup, start.plant
    run_id = f"{start.spec_hash[:12]}-{start.seed}-{start.trial}"
    if not plant.simulated:  # the same trial in the lab twice is two runs
        run_id += f"-{start.start_unix_ns}"
    return {
        "format_version": str(FORMAT_VERSION),
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
        **{_FACT + key: value for key, value in plant.facts.items()},
    }


def read_start(
    facts: Mapping[str, str], setup: Setup, spec_text: str, resolved: str, spec_hash: str
) -> Start:
    """Return the start of a trial; the inverse of `run_metadata`.

    Raises KeyError or ValueError where the facts are not ours.
    """
    plant = PlantInfo(
        kind=facts["plant"],
        simulated=facts["mode"] == "sim",
        camera_rate_hz=float(facts["camera_rate_hz"]),
        facts={k.removeprefix(_FACT): v for k, v in facts.items() if k.startswith(_FACT)},
    )
    return Start(
        setup=setup,
        spec_text=spec_text,
        spec_name=facts["spec_name"],
        resolved=resolved,
        spec_hash=spec_hash,
        seed=int(facts["seed"]),
        trial=int(facts["trial"]),
        plant=plant,
        start_unix_ns=int(facts["start_unix_ns"]),
    )


def result_metadata(result: Result, unit: str) -> dict[str, str]:
    """Return how a trial ended, host facts left out: the metadata record at the end of the log."""
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
        "final_x": _numbers(final.x.tolist()),
        "final_y": _numbers(final.y.tolist()),
        "final_heading": _numbers(final.heading.tolist()),
    }


def timing_metadata(result: Result) -> dict[str, str]:
    """Return the host facts of a result: the metadata record before it."""
    return {
        "solve_ns": json.dumps([int(ns) for ns in result.solve_ns]),
        "deadline_misses": str(result.deadline_misses),
    }


def damage_metadata(damage: Damage, source: str, size: int, sha256: str) -> dict[str, str]:
    """Return what a recovered log says of the file it comes from: metadata `tetractl.recovered`."""
    return {
        "source": source,
        "source_bytes": str(size),
        "source_sha256": sha256,
        "problems": json.dumps(damage.problems),
        "lost": json.dumps(damage.lost),
    }


def read_damage(facts: Mapping[str, str]) -> Damage | None:
    """Return what was lost before a log was recovered, None for nothing."""
    problems, lost = (json.loads(facts[key]) for key in ("problems", "lost"))
    if not isinstance(problems, list) or not isinstance(lost, list):
        raise TypeError("no lists")
    if not lost:
        return None
    whence = f"recovered from {facts['source']}, which was damaged"
    return Damage((whence, *map(str, problems)), tuple(map(str, lost)))


def read_result(
    facts: Mapping[str, str], timing: Mapping[str, str] | None, robots: int | None = None
) -> Result:
    """Return how a trial ended; the inverse of `result_metadata` and `timing_metadata`.

    Without the timing there are no solve times. Raises KeyError, TypeError or ValueError where the
    facts are not ours, or not of so many robots.
    """
    final = [_floats(facts[key]) for key in ("final_x", "final_y", "final_heading")]
    entered = tuple(bool(entered) for entered in json.loads(facts["entered"]))
    errors, clearance = _floats(facts["robot_errors"]), _floats(facts["clearance"])
    count = len(errors) if robots is None else robots
    if any(len(column) != count for column in (*final, entered, errors, clearance)):
        raise ValueError("the result is not of as many robots as the run")
    return Result(
        outcome=Outcome(facts["outcome"]),
        reason=facts["reason"],
        steps=int(facts["steps"]),
        duration_s=float(facts["duration_s"]),
        total_error=float(facts["total_error"]),
        robot_errors=errors,
        verdict=Verdict(
            final=Poses(*(np.array(column, dtype=np.float64) for column in final)),
            entered=entered,
            clearance=clearance,
        ),
        solve_ns=tuple(int(ns) for ns in json.loads(timing["solve_ns"])) if timing else (),
        deadline_misses=int(timing["deadline_misses"]) if timing else 0,
    )


def _numbers(values: Iterable[float]) -> str:
    floats = [float(value) for value in values]
    return json.dumps([value if np.isfinite(value) else str(value) for value in floats])


def _floats(text: str) -> tuple[float, ...]:
    return tuple(float(value) for value in json.loads(text))
