"""A writer without a file: it computes the content digest that a trial's log would have."""

from collections.abc import Iterable, Mapping

from tetractl.core.commands import Command, Note, Sample
from tetractl.core.trial import Result, Start, Step
from tetractl.log.format.channels import Entry
from tetractl.log.format.digest import ContentDigest
from tetractl.log.write.encoder import Encoder


class DigestWriter:
    """Encodes one trial as `LogWriter` does, and keeps nothing of it but digest and warnings."""

    def on_start(self, start: Start) -> None:
        """Encode what a log begins with."""
        self._sink = _DigestSink()
        self._encoder = Encoder(self._sink, start)
        self._encoder.start(start)

    def on_samples(self, samples: list[Sample]) -> None:
        """Encode camera frames."""
        self._encoder.samples(samples)

    def on_command(self, command: Command) -> None:
        """Encode a command sent outside the control steps."""
        self._encoder.command(command)

    def on_note(self, note: Note) -> None:
        """Encode a message for people."""
        self._encoder.note(note)

    def on_step(self, step: Step) -> None:
        """Encode a control step."""
        self._encoder.step(step)

    def on_stop(self, stop: Command, result: Result) -> None:
        """Encode the stop and the result."""
        self._encoder.stop(stop, result)

    @property
    def digest(self) -> str:
        """The content digest; after `on_stop`, that of the whole log."""
        return self._sink.digest.hexdigest()

    @property
    def warnings(self) -> int:
        """The number of messages for people that warn or tell of an error."""
        return self._encoder.warnings

    @property
    def failure(self) -> Exception | None:
        """None: nothing is written that could fail."""
        return None


class _DigestSink:
    """Takes the records of a log as `Sink` does."""

    def __init__(self) -> None:
        self.digest = ContentDigest()

    def messages(self, entries: Iterable[Entry]) -> None:
        for entry in entries:
            self.digest.message(entry)

    def metadata(self, name: str, items: Mapping[str, str]) -> None:
        self.digest.metadata(name, items)

    last_host_metadata = last_metadata = metadata

    def attachment(self, name: str, media_type: str, unix_ns: int, data: bytes) -> None:
        self.digest.attachment(name, media_type, data)

    def flush(self) -> None:
        """Do nothing: there is no file."""

    sync = flush
