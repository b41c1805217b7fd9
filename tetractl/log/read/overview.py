"""Summarise a log: which trial it contains, and the number and size of its records."""

from dataclasses import dataclass
from pathlib import Path

from tetractl.core.clock import SECOND
from tetractl.core.motion_estimate import Estimate
from tetractl.core.trial import Result
from tetractl.log.format.channels import CHANNELS
from tetractl.log.format.run_records import run_items
from tetractl.log.provenance import is_version
from tetractl.log.read.raw_log import ALTERED_TEXT, RawLog
from tetractl.log.read.reader import trial_of
from tetractl.log.read.salvage import scan
from tetractl.log.read.trial_log import Damage, Event


@dataclass(frozen=True, slots=True)
class ChannelCount:
    """The number, rate and size of the messages of one channel.

    Attributes:
        topic: Topic of the channel.
        schema: Name of the channel's schema.
        messages: Number of messages.
        hz: Messages per second of trial time [Hz]. None if all have the same time.
        bytes: Size of the messages before compression [bytes].
    """

    topic: str
    schema: str
    messages: int
    hz: float | None
    bytes: int


@dataclass(frozen=True, slots=True)
class Overview:
    """A summary of the contents of a log.

    Attributes:
        log: Path of the file.
        size: Size of the file [bytes].
        chunks: Number of chunks.
        run: The record of the run, as strings.
        result: The result. None if it is lost.
        events: The operator messages.
        estimate: The controller's last estimate of the motion. None without an estimate.
        estimate_step: The control step of that estimate. None without an estimate.
        channels: The channels, with the number and size of their messages.
        attachments: Size of each attachment [bytes].
        host: Facts about the computer that wrote the log.
        provenance: Versions of the code that wrote the log.
        digest: The content digest computed from the file.
        stated_digest: The content digest stored in the log. None if there is none.
        damage: What is missing or altered. None for an intact log.
    """

    log: str
    size: int
    chunks: int
    run: dict[str, str]
    result: Result | None
    events: tuple[Event, ...]
    estimate: Estimate | None
    estimate_step: int | None
    channels: tuple[ChannelCount, ...]
    attachments: dict[str, int]
    host: dict[str, str]
    provenance: dict[str, str]
    digest: str
    stated_digest: str | None
    damage: Damage | None


def overview(path: Path) -> Overview:
    """Read a whole log, and return a summary of its contents.

    A damaged or unfinished log is summarised as far as it can be read, and `damage` states what is
    missing.

    Raises:
        LogError: If the file is not a log of tetractl, has a newer format, or has lost its spec.
    """
    contents = scan(path)
    trial = trial_of(contents)
    damage = trial.damage
    if contents.altered:
        earlier_damage = damage or Damage((), ())
        damage = Damage((*earlier_damage.problems, ALTERED_TEXT), earlier_damage.lost)
    estimated_step = next(
        (step for step in reversed(trial.steps) if step.plan.estimate is not None), None
    )
    return Overview(
        log=str(path),
        size=contents.size,
        chunks=contents.chunks,
        run=run_items(contents.run) | {"mode": trial.origin.value},
        result=trial.result,
        events=trial.events,
        estimate=estimated_step.plan.estimate if estimated_step else None,
        estimate_step=estimated_step.k if estimated_step else None,
        channels=channel_counts(contents),
        attachments={
            name: len(attachment.data) for name, attachment in contents.attachments.items()
        },
        host={key: value for key, value in trial.facts.items() if not is_version(key)},
        provenance={key: value for key, value in trial.facts.items() if is_version(key)},
        digest=contents.content_digest,
        stated_digest=trial.digest,
        damage=damage,
    )


def channel_counts(contents: RawLog) -> tuple[ChannelCount, ...]:
    """Count the messages of each channel of a log, sorted by topic.

    Empty channels are left out.
    """
    schemas = {topic: message.DESCRIPTOR.full_name for topic, message in CHANNELS.items()}
    schemas |= {topic: schema.name for topic, (_, schema) in contents.channels.items() if schema}
    counts: list[ChannelCount] = []
    for topic, entries in sorted(contents.entries_by_topic.items()):
        if not entries:
            continue
        times_ns = [entry.log_ns for entry in entries]
        span_ns = max(times_ns) - min(times_ns)
        rate_hz = (len(entries) - 1) * SECOND / span_ns if span_ns else None
        size = sum(len(entry.data) for entry in entries)
        schema = schemas.get(topic, "")
        counts.append(ChannelCount(topic, schema, len(entries), rate_hz, size))
    return tuple(counts)
