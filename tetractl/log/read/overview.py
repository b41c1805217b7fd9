"""What is in a log, at a glance: facts, counts and sizes, but no course."""

import json
import math
from collections import defaultdict
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tetractl.core.trial import Result
from tetractl.log.format.channels import CHANNELS, RESULT, RUN
from tetractl.log.format.digest import CHECKSUM, DIGEST
from tetractl.log.read.reader import trial_of
from tetractl.log.read.salvage import Contents, scan
from tetractl.log.read.trial_log import Damage


@dataclass(frozen=True, slots=True)
class ChannelCount:
    """One channel: how many messages it holds, how often they come and what they take."""

    topic: str
    schema: str
    messages: int
    hz: float | None  # None for fewer than two moments
    bytes: int  # before compression


@dataclass(frozen=True, slots=True)
class Overview:
    """What is in a log. `digest` is computed; `stated_digest` is what the log says of itself."""

    path: str
    size: int
    chunks: int
    run: dict[str, str]
    result: Result | None
    channels: tuple[ChannelCount, ...]
    attachments: dict[str, int]  # bytes
    host: dict[str, str]
    provenance: dict[str, str]
    digest: str
    stated_digest: str | None
    damage: Damage | None

    def as_json(self) -> str:
        """Return the overview as a JSON object; a number that is not finite is null."""
        return json.dumps(_plain(asdict(self)), indent=2, ensure_ascii=False)


def overview(path: Path) -> Overview:
    """Look into a log; raises LogError as `read_trial` does."""
    contents = scan(path)
    trial = trial_of(contents)
    digest = contents.digest()
    problems, lost = (trial.damage.problems, trial.damage.lost) if trial.damage else ((), ())
    if trial.digest and trial.digest != digest:
        problems = (*problems, "the content does not match the digest that the log states")
    facts = contents.facts(RUN) or {}
    return Overview(
        path=str(path),
        size=contents.size,
        chunks=contents.chunks,
        run={key: value for key, value in facts.items() if key != CHECKSUM},
        result=trial.result,
        channels=_channels(contents),
        attachments={item.name: len(item.data) for item in contents.attachments},
        host=trial.host,
        provenance=trial.provenance,
        digest=digest,
        stated_digest=(contents.facts(RESULT) or {}).get(DIGEST),
        damage=Damage(problems, lost) if problems else None,
    )


def _channels(contents: Contents) -> tuple[ChannelCount, ...]:
    times, sizes = defaultdict[str, list[int]](list), defaultdict[str, int](int)
    for entry in contents.entries:
        times[entry.topic].append(entry.log_ns)
        sizes[entry.topic] += len(entry.data)
    schemas = {topic: message.DESCRIPTOR.full_name for topic, message in CHANNELS.items()}
    return tuple(
        ChannelCount(topic, schemas.get(topic, ""), len(at), _rate(at), sizes[topic])
        for topic, at in sorted(times.items())
    )


def _rate(times: list[int]) -> float | None:
    span = max(times) - min(times)
    return (len(times) - 1) * 1e9 / span if span else None


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value
