"""Trials read back from their logs, whole or as much as a damaged file still holds."""

import json
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

import numpy as np
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from tetractl.core.commands import Verdict
from tetractl.core.errors import LogError, SpecError
from tetractl.core.plan import Outcome
from tetractl.core.poses import Floats, Poses
from tetractl.core.trial import Result, Start
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.load import parse_spec, spec_hash
from tetractl.log import provenance
from tetractl.log.format import channels, codec
from tetractl.log.format import metadata as facts
from tetractl.log.format import tetractl_pb2 as pb
from tetractl.log.format.channels import FORMAT_VERSION
from tetractl.log.format.digest import CHECKSUM, DIGEST
from tetractl.log.read.salvage import Contents, peek, scan
from tetractl.log.read.trial_log import Damage, ResultSummary, TrialLog
from tetractl.model.obstacles import Obstacles


def read_trial(path: Path) -> TrialLog:
    """Read a whole trial, bit for bit as it was written.

    Of a damaged or unfinished log, a .part too, everything that is provably intact is given, and
    `damage` says what is not. Raises LogError where the file is no tetractl log, is of a newer
    format, or has lost its spec.
    """
    return trial_of(scan(Path(path)))


def trial_of(contents: Contents) -> TrialLog:
    """Return the trial that a scanned file holds; raises as `read_trial` does."""
    experiment, start = _start(contents)
    try:
        return _trial(contents, experiment, start)
    except (DecodeError, LookupError, OverflowError, RecursionError, ValueError) as error:
        # intact, but not as we write it
        raise LogError(f"{contents.path}: holds what tetractl does not write: {error}") from None


def _trial(contents: Contents, experiment: Experiment, start: Start) -> TrialLog:
    before = _recovered(contents)
    problems = [*(before.problems if before else ()), *contents.problems]
    lost = [*(before.lost if before else ()), *contents.lost]
    robots = len(start.setup.names)
    data: dict[str, list[bytes]] = {topic: [] for topic in channels.CHANNELS}
    for entry in contents.entries:
        data.setdefault(entry.topic, []).append(entry.data)
    frames = map(pb.MocapSample.FromString, data[channels.MOCAP])
    samples = [codec.decode_observation(frame, robots) for frame in frames]
    sent = map(pb.WheelCommand.FromString, data[channels.COMMANDS])
    commands = tuple(map(codec.decode_command, sent))
    stops = [command for command in commands if command.direction is None]
    truths = map(pb.Truth.FromString, data[channels.TRUTH])
    true = {truth.frame: codec.decode_poses(truth, robots) for truth in truths}
    missing = Poses.of(np.full((robots, 3), np.nan))
    timings = {m.k: m for m in map(pb.StepTiming.FromString, data[channels.HOST_TIMING])}
    steps = map(pb.ControllerStep.FromString, data[channels.STEP])
    result = _result(contents)
    if result is None:
        problems.append("the log has no result: the run was cut short or the log's end is lost")
        until = max((seen.received_ns for seen in samples), default=0) / 1e9
        lost.append(f"the result and everything after {until:.3f} s")
    host = dict(contents.facts(channels.HOST) or {})
    host.pop(CHECKSUM, None)
    versions = {key: host.pop(key) for key in list(host) if provenance.is_version(key)}
    return TrialLog(
        path=str(contents.path),
        experiment=experiment,
        start=start,
        mocap_ns=_integers(seen.sampled_ns for seen in samples),
        mocap=_stack([seen.poses for seen in samples], robots),
        valid=np.array([seen.valid for seen in samples], dtype=np.bool_).reshape(-1, robots),
        truth=_stack([true.get(seen.frame, missing) for seen in samples], robots)
        if start.plant.simulated
        else None,
        steps=tuple(codec.decode_step(step, timings.get(step.k), robots) for step in steps),
        stop=stops[-1] if stops else None,
        result=result,
        damage=Damage(tuple(problems), tuple(lost)) if problems else None,
        host=host,
        provenance=versions,
        frames=_integers(seen.frame for seen in samples),
        received_ns=_integers(seen.received_ns for seen in samples),
        commands=commands,
        digest=(contents.facts(channels.RESULT) or {}).get(DIGEST),
    )


def read_result(path: Path) -> ResultSummary:
    """Read how a trial ended, without its course: by the file's index, in about a millisecond.

    Where index or result are lost the file is searched for what remains, and the result computed
    from the last poses if need be. Raises LogError as `read_trial` does, and where no pose is left.
    """
    contents = peek(Path(path))
    if contents and (result := _result(contents)):
        experiment, start = _start(contents)
        recovered, digest = (
            _recovered(contents) is not None,
            (contents.facts(channels.RESULT) or {}).get(DIGEST),
        )
    else:
        trial = read_trial(path)
        experiment, start, digest = trial.experiment, trial.start, trial.digest
        result, recovered = trial.result or recompute(trial), True
    return ResultSummary(
        path=str(path),
        experiment=experiment,
        seed=start.seed,
        trial=start.trial,
        simulated=start.plant.simulated,
        result=result,
        recovered=recovered,
        digest=digest,
    )


def recompute(trial: TrialLog) -> Result:
    """Compute a result from what a log holds: the last pose known of each robot ends its path.

    The true path decides where there is one, else the measured one, at the camera's rate. Raises
    LogError where a robot was never seen.
    """
    setup = trial.start.setup
    path = trial.mocap if trial.truth is None else trial.truth
    known = np.asarray(np.isfinite(path).all(axis=2))
    if trial.truth is None:
        known &= trial.valid
    if not known.any(axis=0).all():
        raise LogError(f"{trial.path}: holds no result, and no poses to compute it from")
    last = len(path) - 1 - known[::-1].argmax(axis=0)
    final = Poses.of(path[last, np.arange(path.shape[1])])
    errors = final.distances(setup.targets)
    distance = Obstacles.of(setup.obstacles).distance(path[..., 0], path[..., 1])
    clearance = np.where(known, distance, np.inf).min(axis=0)
    return Result(
        outcome=Outcome.ABORTED,
        reason="the log ends before its result",
        steps=len(trial.steps),
        duration_s=float(trial.mocap_ns[-1]) / 1e9,
        total_error=float(errors.sum()),
        robot_errors=tuple(errors.tolist()),
        verdict=Verdict(final, tuple((clearance <= 0).tolist()), tuple(clearance.tolist())),
        solve_ns=tuple(step.solve_ns for step in trial.steps),
        deadline_misses=sum(step.deadline_missed for step in trial.steps),
    )


def content_digest(path: Path) -> str:
    """Return the SHA-256 over all that repeats when a simulated trial is run again.

    That is every message, metadata record and attachment except the host records; a whole log
    states the same number in its result.
    """
    return scan(Path(path)).digest()


def _start(contents: Contents) -> tuple[Experiment, Start]:
    """Return the experiment and the start of a trial."""
    path, run = contents.path, contents.facts(channels.RUN)
    if run is None:
        if contents.problems:
            raise LogError(f"{path}: damaged: the record of the run is lost")
        raise LogError(f"{path}: an MCAP file, but no log of tetractl's")
    resolved = contents.attachment(channels.RESOLVED_SPEC)
    try:
        version = int(run["format_version"])
        if version > FORMAT_VERSION:
            raise LogError(
                f"{path}: of log format {version}; this tetractl reads up to {FORMAT_VERSION}",
                "update tetractl",
            )
        if resolved is None:
            raise LogError(f"{path}: damaged: the resolved spec is lost")
        text = contents.attachment(channels.SPEC) or ""
        experiment, hashed = _resolved(resolved)
        return experiment, facts.read_start(run, experiment.setup, text, resolved, hashed)
    except (SpecError, KeyError, RecursionError, ValueError) as error:
        used = [
            f"{key.removeprefix(provenance.PLUGIN)} {version}"
            for key, version in (contents.facts(channels.HOST) or {}).items()
            if key.startswith(provenance.PLUGIN)
        ]
        hint = f"it was written with {', '.join(used)}; install that" if used else None
        raise LogError(f"{path}: the record of the run cannot be read: {error}", hint) from None


@lru_cache(maxsize=16)
def _resolved(text: str) -> tuple[Experiment, str]:
    experiment = parse_spec(text, channels.RESOLVED_SPEC).experiment
    return experiment, spec_hash(experiment)


def _recovered(contents: Contents) -> Damage | None:
    """Return what a recovered log says was wrong with the one before it, None for nothing."""
    found = contents.facts(channels.RECOVERED)
    if found is None:
        return None
    try:
        return facts.read_damage(found)
    except (KeyError, RecursionError, TypeError, ValueError):
        return Damage(("recovered from a damaged log",), ())


def _result(contents: Contents) -> Result | None:
    """Return the stated result, None where there is none that can be read."""
    result = contents.facts(channels.RESULT)
    run = contents.facts(channels.RUN)
    if result is None or run is None:
        return None
    try:
        robots = len(json.loads(run["robots"]))
        return facts.read_result(result, contents.facts(channels.TIMING), robots)
    except (KeyError, OverflowError, RecursionError, TypeError, ValueError):
        return None


def _integers(values: Iterable[int]) -> NDArray[np.int64]:
    return np.fromiter(values, dtype=np.int64)


def _stack(poses: list[Poses], robots: int) -> Floats:
    """Stack poses to shape (M, N, 3)."""
    return np.array([item.array() for item in poses], dtype=np.float64).reshape(-1, robots, 3)
