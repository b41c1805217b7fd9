"""Converts the records of a run to their messages and back: what identifies the trial, and its
result.
"""

import json
from collections.abc import Iterable, Mapping

import numpy as np

from tetractl.core.commands import PlantInfo, Verdict
from tetractl.core.errors import printable
from tetractl.core.plan import Outcome
from tetractl.core.poses import Poses
from tetractl.core.trial import Result, Start
from tetractl.log.format import tetractl_pb2 as pb
from tetractl.log.format.channels import FORMAT_VERSION, TEXT
from tetractl.log.format.codec import named, stated

OF_RESULT = ("reason", "steps", "duration_s", "passed", "inside", "lost")
OF_ERRORS = ("total_error", "robot_errors")
OF_VERDICT = ("entered", "clearance", "edge", "apart", "turn", "turn_std")
OF_POSES = ("x", "y", "heading")
"""Fields that a result, its verdict and its final poses share with their message."""


def encode_facts(facts: Mapping[str, str]) -> Iterable[pb.Fact]:
    """Return facts as messages."""
    return (pb.Fact(key=key, value=value) for key, value in facts.items())


def decode_facts(facts: Iterable[pb.Fact]) -> dict[str, str]:
    """Return messages of facts as a mapping."""
    return {fact.key: fact.value for fact in facts}


def encode_run(start: Start) -> pb.Run:
    """Return the message that identifies a trial."""
    setup, plant = start.setup, start.plant
    run_id = f"{start.spec_hash[:12]}-{start.seed}-{start.trial}"
    if not plant.simulated:  # the start time distinguishes trials in a lab
        run_id += f"-{start.start_unix_ns}"
    return pb.Run(
        format_version=FORMAT_VERSION,
        run_id=run_id,
        mode="sim" if plant.simulated else "lab",
        name=setup.name,
        trial=start.trial,
        seed=start.seed,
        spec_hash=start.spec_hash,
        spec_name=start.spec_name,
        robots=setup.names,
        unit=setup.unit,
        start_unix_ns=start.start_unix_ns,
        plant=plant.kind,
        camera_rate_hz=plant.camera_rate_hz,
        facts=encode_facts(plant.facts),
    )


def decode_plant(run: pb.Run) -> PlantInfo:
    """Return the description of a run's plant."""
    return PlantInfo(run.plant, run.mode == "sim", run.camera_rate_hz, decode_facts(run.facts))


def run_items(run: pb.Run) -> dict[str, str]:
    """Return the values of a run as text by name, each fact of its plant as `plant.KEY`."""
    items = {field.name: str(getattr(run, field.name)) for field in run.DESCRIPTOR.fields}
    named = {f"plant.{key}": value for key, value in decode_facts(run.facts).items()}
    del items["facts"]
    return items | {"robots": json.dumps(list(run.robots))} | named


def encode_result(result: Result, unit: str, warnings: int = 0) -> pb.Result:
    """Return the message of a result without its solve times.

    `warnings` is the number of operator messages that are warnings or errors.
    """
    verdict = result.verdict
    final = {f"final_{name}": value for name, value in named(verdict.final, *OF_POSES).items()}
    numbers = named(result, *OF_RESULT, *OF_ERRORS) | named(verdict, *OF_VERDICT) | final
    numbers["reason"] = printable(result.reason, TEXT)
    return pb.Result(outcome=result.outcome.logged, unit=unit, warnings=warnings, **numbers)


def decode_result(message: pb.Result, end: pb.HostEnd | None, robots: int) -> Result:
    """Decode a result for `robots` robots; without `end` it has no solve times.

    Raises ValueError for another number of robots or an outcome that does not exist.
    """
    m = message
    final = (m.final_x, m.final_y, m.final_heading)
    columns = [*final, m.robot_errors, m.entered, m.clearance]
    columns += [column for column in (m.edge, m.apart, m.inside, m.lost) if column]
    columns += [m.turn, m.turn_std] if m.turn or m.turn_std else []
    if any(len(column) != robots for column in columns):
        raise ValueError("the result and the run have different numbers of robots")
    return Result(
        outcome=Outcome(Outcome.shown(m.outcome)),
        verdict=Verdict(
            final=Poses(*(np.array(column, dtype=np.float64) for column in final)),
            **stated(m, *OF_VERDICT),
        ),
        solve_ns=tuple(end.solve_ns) if end else (),
        deadline_misses=end.deadline_misses if end else 0,
        **stated(m, *OF_RESULT, *OF_ERRORS),
    )
