"""The log of a trial: its messages, and the records about it, added to an MCAP file."""

from collections.abc import Sequence

from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, Note, Sample
from tetractl.core.trial import Result, Start, Step
from tetractl.log import provenance
from tetractl.log.format import channels, layout
from tetractl.log.format.channels import Entry
from tetractl.log.format.metadata import result_metadata, run_metadata, timing_metadata
from tetractl.log.write.messages import Messages
from tetractl.log.write.sink import Sink

FLUSH_NS = SECOND
"""A chunk ends after this much trial time, so that a simulation that runs faster than the wall
clock gives the same chunks again. A slower trial is flushed by the wall clock, `sink.CHUNK_S`."""


class Encoder:
    """Adds the records of one trial to a `Sink`."""

    def __init__(self, sink: Sink, start: Start) -> None:
        self._sink = sink
        self._start_ns = start.start_unix_ns
        self._unit = start.setup.unit
        self._messages = Messages(start)
        self._flushed_ns = 0

    def start(self, start: Start) -> None:
        """Add metadata, specs and scene, and sync the file."""
        self._sink.metadata(channels.RUN, run_metadata(start))
        self._sink.metadata(channels.HOST, provenance.host_metadata(start.packages))
        for name, media_type, text in (
            (channels.SPEC, "application/yaml", start.spec_text),
            (channels.RESOLVED_SPEC, "application/yaml", start.resolved),
            (channels.ENVIRONMENT, "application/json", provenance.environment()),
            (channels.LAYOUT, layout.MEDIA_TYPE, layout.layout(start.setup)),
            *((name, "application/yaml", text) for name, text in start.attached),
        ):
            self._sink.attachment(name, media_type, self._start_ns, text.encode())
        self._write(self._messages.start())
        self._sink.sync()

    def samples(self, samples: list[Sample]) -> None:
        """Add camera frames."""
        if samples:
            self._write(self._messages.samples(samples), samples[-1].observation.received_ns)

    def command(self, command: Command) -> None:
        """Add a command sent outside the control steps."""
        self._write([self._messages.command(command)])

    def note(self, note: Note) -> None:
        """Add a message for people."""
        self._write([self._messages.note(note)])

    def step(self, step: Step) -> None:
        """Add a control step."""
        self._write(self._messages.step(step), step.command.sent_ns)

    def stop(self, stop: Command, result: Result) -> None:
        """Add the stop and the result."""
        self._write(self._messages.stop(stop, result))
        timing = timing_metadata(result) | {"ended": provenance.now()}
        self._sink.last_host_metadata(channels.TIMING, timing)
        self._sink.last_metadata(
            channels.RESULT, result_metadata(result, self._unit, self._messages.warnings)
        )

    def _write(self, entries: Sequence[Entry], trial_ns: int | None = None) -> None:
        """Write encoded messages; end the chunk after each second of the trial."""
        self._sink.messages(entries)
        if trial_ns is not None and trial_ns - self._flushed_ns >= FLUSH_NS:
            self._sink.flush()
            self._flushed_ns = trial_ns
