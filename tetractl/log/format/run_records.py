"""Convert the identity and the result of a trial to messages of its log, and back."""

import json
from collections.abc import Iterable, Mapping

import numpy as np

from tetractl.core.errors import printable
from tetractl.core.plan import Outcome
from tetractl.core.poses import Poses
from tetractl.core.trial import Result, Start, Verdict
from tetractl.log.format import tetractl_pb2 as pb
from tetractl.log.format.channels import FORMAT_VERSION, NOTE_LENGTH_MAX
from tetractl.log.format.derived_messages import outcome_from_log, outcome_to_log


def encode_facts(facts: Mapping[str, str]) -> Iterable[pb.Fact]:
    """Convert a mapping from names to texts to protobuf messages, one `Fact` for each name."""
    return (pb.Fact(key=key, value=value) for key, value in facts.items())


def decode_facts(facts: Iterable[pb.Fact]) -> dict[str, str]:
    """Convert protobuf `Fact` messages to a mapping from names to texts."""
    return {fact.key: fact.value for fact in facts}


def encode_run(start: Start) -> pb.Run:
    """Create the message of the log that identifies the trial."""
    setup = start.setup
    plant = start.plant
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


def run_items(run: pb.Run) -> dict[str, str]:
    """Return the fields of a run's record as strings, {name: value}.

    Facts about its plant are called `plant.KEY`.
    """
    items = {field.name: str(getattr(run, field.name)) for field in run.DESCRIPTOR.fields}
    del items["facts"]
    items["robots"] = json.dumps(list(run.robots))
    for key, value in decode_facts(run.facts).items():
        items[f"plant.{key}"] = value
    return items


def encode_result(result: Result, unit: str, warnings: int = 0) -> pb.Result:
    """Convert a result to its message, without its solve times.

    Args:
        result: The result.
        unit: Length unit of its errors.
        warnings: Number of operator messages that are warnings or errors.
    """
    verdict = result.verdict
    return pb.Result(
        outcome=outcome_to_log(result.outcome),
        reason=printable(result.reason, NOTE_LENGTH_MAX),
        steps=result.steps,
        duration_s=result.duration_s,
        total_error=result.total_error,
        robot_errors=result.robot_errors,
        unit=unit,
        warnings=warnings,
        passed=result.passed,
        inside=result.inside,
        lost=result.lost,
        final_x=verdict.final.x.tolist(),
        final_y=verdict.final.y.tolist(),
        final_heading=verdict.final.heading.tolist(),
        entered=verdict.entered,
        clearance=verdict.clearance,
        edge=verdict.edge,
        apart=verdict.apart,
        turn=verdict.turn,
        turn_std=verdict.turn_std,
        wheel_lag=result.wheel_lag_s,
    )


def decode_result(message: pb.Result, host_end: pb.HostEnd | None, n_robots: int) -> Result:
    """Decode the result of a trial from a message of the log.

    Args:
        message: The message with the result.
        host_end: The message with the solve times. If it is None, the result has no solve times.
        n_robots: Number of robots.

    Raises:
        ValueError: If the number of robots differs, or the outcome does not exist.
    """
    _require_robots(message, n_robots)
    return Result(
        outcome=Outcome(outcome_from_log(message.outcome)),
        reason=message.reason,
        steps=message.steps,
        duration_s=message.duration_s,
        total_error=message.total_error,
        robot_errors=tuple(message.robot_errors),
        verdict=Verdict(
            final=Poses(
                np.array(message.final_x, dtype=np.float64),
                np.array(message.final_y, dtype=np.float64),
                np.array(message.final_heading, dtype=np.float64),
            ),
            entered=tuple(message.entered),
            clearance=tuple(message.clearance),
            edge=tuple(message.edge),
            apart=tuple(message.apart),
            turn=tuple(message.turn),
            turn_std=tuple(message.turn_std),
        ),
        solve_ns=tuple(host_end.solve_ns) if host_end else (),
        deadline_misses=host_end.deadline_misses if host_end else 0,
        drove=tuple(host_end.drove) if host_end else (),
        passed=tuple(message.passed),
        inside=tuple(message.inside),
        lost=tuple(message.lost),
        wheel_lag_s=message.wheel_lag if message.HasField("wheel_lag") else None,
    )


def _require_robots(message: pb.Result, n_robots: int) -> None:
    """Check that each column of a stored result has an entry for each robot.

    Some columns are optional. These are either complete or empty, and columns that belong together
    are all complete or all empty. `passed` has an entry for each way-point.

    Raises:
        ValueError: If a column does not fit.
    """
    columns = [message.final_x, message.final_y, message.final_heading]
    columns += [message.robot_errors, message.entered, message.clearance]
    optional_columns = [[message.edge], [message.apart], [message.inside], [message.lost]]
    for group in (*optional_columns, [message.turn, message.turn_std]):
        if any(group):
            columns += group
    if any(len(column) != n_robots for column in columns):
        raise ValueError("the result and the run have different numbers of robots")
