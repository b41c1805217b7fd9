"""Read trials from their logs: completely, or the intact part of a damaged log.

    read_trial(path)   = trial_of(scan(path))
    read_result(path)  = result_of(peek(path)), or of scan(path) if the index does not serve

`scan` finds the records of a file and checks them, and this module decodes them. Every function
raises LogError if the log has lost its spec, or contains values that tetractl does not write
(`decode_errors`).
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache
from itertools import islice
from pathlib import Path

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from google.protobuf.message import DecodeError

from tetractl.core.errors import LogError, SpecError, printable
from tetractl.core.plan import Outcome
from tetractl.core.poses import Bools, Floats, Frames, Poses
from tetractl.core.trial import RESERVED_FILE_NAMES, PlantInfo, Result, Start, Step
from tetractl.log import provenance
from tetractl.log.format import channels, codec
from tetractl.log.format.run_records import decode_facts
from tetractl.log.format.scene import decode_note
from tetractl.log.read import validate
from tetractl.log.read.raw_log import RawLog, writer
from tetractl.log.read.salvage import peek, scan
from tetractl.log.read.trial_log import Damage, Origin, ResultSummary, TrialLog
from tetractl.model.path_check import check_path
from tetractl.spec.experiment import Experiment
from tetractl.spec.load import parse_resolved
from tetractl.spec.yaml.spec_files import MAX_BYTES


def read_trial(path: Path) -> TrialLog:
    """Read a whole trial.

    Values have the same bits as when they were written, except true poses, which have single
    precision, and predicted paths, which have 14 significant bits and no headings. From a damaged
    or unfinished log, including a .part file, the intact records are read, and `damage` states what
    is missing.

    Raises:
        LogError: If the file is not a log of tetractl, has a newer format, or has lost its spec.
    """
    return trial_of(scan(Path(path)))


def trial_of(contents: RawLog, steps_max: int | None = None) -> TrialLog:
    """Decode the trial in a scanned file.

    Args:
        contents: The records of the file.
        steps_max: Maximum number of control steps to decode, from the first. None for all.

    Raises:
        LogError: If the log has lost its spec, or contains values that tetractl does not write.
    """
    experiment, start = _decode_start(contents)
    start_ns = start.start_unix_ns
    n_robots = len(start.setup.names)
    with decode_errors(contents):
        frames = _decode_frames(contents, n_robots)
        commands = tuple(map(codec.decode_command, contents.messages(channels.COMMANDS)))
        validate.check_commands(commands, n_robots)
        control_steps = _decode_steps(contents, n_robots, steps_max)
        notes = [decode_note(message, start_ns) for message in contents.messages(channels.LOG)]
        pictures = [
            (entry.publish_ns - start_ns, CompressedImage.FromString(entry.data).data)
            for entry in contents.entries_by_topic[channels.PICTURE_TOPIC]
        ]
    stops = [command for command in commands if command.stops]
    trial = TrialLog(
        log=str(contents.path),
        experiment=experiment,
        start=start,
        mocap_ns=frames.sampled_ns,
        mocap=frames.poses,
        valid=frames.valid,
        truth=frames.truth if start.plant.simulated else None,
        steps=control_steps,
        stop=stops[-1] if stops else None,
        result=contents.result,
        damage=None,
        facts=contents.facts,
        frames=frames.numbers,
        received_ns=frames.received_ns,
        exposed_ns=frames.exposed_ns,
        commands=commands,
        notes=tuple(
            replace(note, text=printable(note.text, channels.NOTE_LENGTH_MAX)) for note in notes
        ),
        digest=contents.stated_digests.content or None,
        pictures=tuple(pictures),
    )
    return replace(trial, damage=_describe_damage(contents, trial)) if contents.damaged else trial


@contextmanager
def decode_errors(contents: RawLog) -> Iterator[None]:
    """Raise a LogError for a value that cannot be decoded within the `with` block.

    The record is intact, but tetractl does not write such values.
    """
    try:
        yield
    except (DecodeError, LookupError, OverflowError, RecursionError, ValueError) as error:
        raise LogError(
            f"{contents.path}: the log contains a value that tetractl never writes: {error}"
        ) from None


def _describe_damage(contents: RawLog, trial: TrialLog) -> Damage:
    """Describe the damage of a torn, recovered or unfinished log. `trial` is its intact part."""
    source = contents.recovered or Damage((), ())
    problems = [*source.problems, *contents.problems]
    lost = [*source.lost, *contents.lost]
    if contents.result is None:
        problems.append(str(contents.result_or_problem))
        frames_ns = int(trial.received_ns.max()) if len(trial.received_ns) else None
        steps_ns = trial.steps[-1].command.sent_ns if trial.steps else None
        frames = _all_after(trial, "camera frames", frames_ns)
        lost.append(f"the result, {frames} and {_all_after(trial, 'control steps', steps_ns)}")
    return Damage(tuple(problems), tuple(lost))


def _all_after(trial: TrialLog, record_kind: str, last_ns: int | None) -> str:
    """Describe the lost records of one kind in a log without a result: all after the last record.

    Args:
        trial: The intact part of the log.
        record_kind: The kind of records, such as "camera frames".
        last_ns: Time of the last record of this kind [ns]. None if the log has none.
    """
    return (
        f"all {record_kind}"
        if last_ns is None
        else f"{record_kind} after {trial.elapsed_s(last_ns):.3f} s"
    )


def read_result(path: Path) -> ResultSummary:
    """Read only the result of a trial, without frames and steps.

    If file and result are intact, the file's index leads to the result. If not, the whole file is
    read. The errors are the same as for `result_of`.
    """
    contents = peek(Path(path))
    if contents is None or contents.damaged:
        contents = scan(Path(path))
    return result_of(contents)


def result_of(contents: RawLog) -> ResultSummary:
    """Decode only the result of the trial in a scanned file.

    If the result is lost, the frames and steps are decoded, and the result is computed from the
    last poses. Raises LogError if the log has no poses either.
    """
    experiment, start = _decode_start(contents)
    result = contents.result
    if result is None:
        result = _result_from_poses(trial_of(contents))
    return ResultSummary(
        log=str(contents.path),
        experiment=experiment,
        seed=start.seed,
        trial=start.trial,
        origin=Origin.from_spec(experiment, start.plant),
        result=result,
        recovered=contents.damaged,
        digest=contents.stated_digests.content or None,
        warnings=contents.warnings,
        code=contents.facts.get(provenance.TRIAL_CODE_KEY, ""),
    )


def _result_from_poses(trial: TrialLog) -> Result:
    """Compute the result of a trial from the poses in its log, assuming that it ended there.

    The true path is used for a simulation, otherwise the measured one. Raises LogError if a robot
    was never tracked.
    """
    path, has_pose = trial_path(trial)
    if not has_pose.any(axis=0).all():
        raise LogError(f"{trial.log}: the log contains no result, and no poses to compute it from")
    last_rows = len(path) - 1 - has_pose[::-1].argmax(axis=0)
    final = Poses.from_array(path[last_rows, np.arange(path.shape[1])])
    return Result.from_verdict(
        trial.start.setup,
        check_path(trial.start.setup, path, has_pose, final),
        outcome=Outcome.ABORTED,
        reason="the log ends before its result",
        duration_s=trial.elapsed_s(int(trial.mocap_ns[-1])),
        solve_ns=tuple(step.solve_ns for step in trial.steps),
        deadline_misses=sum(step.deadline_missed for step in trial.steps),
        route=trial.route,
        estimate=trial.last_estimate,
    )


def trial_path(trial: TrialLog) -> tuple[Floats, Bools]:
    """Return the poses (M, N, 3) by which a trial is evaluated, and which of them are known (M, N).

    For a simulation, these are the true poses. For a lab, they are the measured poses.
    """
    if trial.truth is None:
        return trial.mocap, trial.valid & np.isfinite(trial.mocap).all(axis=2)
    return trial.truth, np.asarray(np.isfinite(trial.truth).all(axis=2))


def content_digest(path: Path) -> str:
    """Compute the SHA-256 over all records of a log except its host records, as 64 hex digits.

    A simulated trial that is run again has the same digest. The last message of a complete log
    contains this digest.
    """
    return scan(Path(path)).content_digest


def _decode_start(contents: RawLog) -> tuple[Experiment, Start]:
    """Decode the experiment and the start of a trial from the records of its log.

    Raises:
        LogError: If one of them cannot be read.
    """
    run = contents.run
    resolved = contents.attachment_text(channels.RESOLVED_SPEC)
    if resolved is None:
        raise LogError(f"{contents.path}: the log is damaged, and its resolved spec is lost")
    if len(resolved) > MAX_BYTES:
        raise LogError(
            f"{contents.path}: the log's resolved spec is longer than {MAX_BYTES} characters"
        )
    try:
        experiment, spec_hash = _parse_spec(resolved)
        n_robots = len(experiment.robots)
        if len(run.robots) != n_robots:
            raise ValueError(
                f"the record of the run has {len(run.robots)} robots, but its spec has {n_robots}"
            )
        if not np.isfinite(run.camera_rate_hz):
            raise ValueError(f"camera_rate_hz is {run.camera_rate_hz!r}")
    except (SpecError, RecursionError, ValueError) as error:
        plugins = [
            f"{key.removeprefix(provenance.PLUGIN_PREFIX)} {version}"
            for key, version in contents.facts.items()
            if key.startswith(provenance.PLUGIN_PREFIX)
        ]
        raise LogError(
            f"{contents.path}: the record of the run cannot be read: {error}",
            f"this log was written with {', '.join(plugins) or writer(contents.facts)}: "
            "install this version",
        ) from None
    return experiment, Start(
        setup=experiment.setup,
        spec_text=contents.attachment_text(channels.SPEC) or "",
        spec_name=run.spec_name,
        resolved=resolved,
        spec_hash=spec_hash,
        seed=run.seed,
        trial=run.trial,
        plant=PlantInfo(run.plant, run.mode == "sim", run.camera_rate_hz, decode_facts(run.facts)),
        start_unix_ns=run.start_unix_ns,
        attached=tuple(
            (name, attachment.data.decode(errors="replace"))
            for name, attachment in contents.attachments.items()
            if name not in RESERVED_FILE_NAMES
        ),
    )


@lru_cache(maxsize=16)
def _parse_spec(resolved: str) -> tuple[Experiment, str]:
    """Parse the resolved spec in a log, and return the experiment and the spec's hash."""
    spec = parse_resolved(resolved, channels.RESOLVED_SPEC)
    return spec.experiment, spec.hash


def _decode_frames(contents: RawLog, n_robots: int) -> Frames:
    """Decode all camera frames of a trial with N robots."""
    no_frames = Frames.from_samples((), n_robots)  # a log may have no frames
    messages = contents.messages(channels.FRAMES)
    frames = Frames.join(
        [no_frames, *(codec.decode_frames(message, n_robots) for message in messages)]
    )
    validate.check_frames(frames)
    return frames


def _decode_steps(contents: RawLog, n_robots: int, steps_max: int | None) -> tuple[Step, ...]:
    """Decode at most `steps_max` control steps of N robots, with their solve times."""
    timings = {timing.k: timing for timing in contents.messages(channels.HOST_TIMING)}
    messages = islice(contents.messages(channels.STEP), steps_max)
    steps = tuple(
        codec.decode_step(message, timings.get(message.k), n_robots) for message in messages
    )
    validate.check_steps(steps, n_robots)
    return steps
