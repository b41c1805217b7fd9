"""An observer that keeps a trial in memory."""

from tetractl.core.poses import Frames
from tetractl.core.trial import TrialRecords


class Recorder:
    """Keeps the records of one trial; `trial` returns them like a trial read from its log."""

    def __init__(self):
        self.samples = []
        self.commands = []
        self.steps = []
        self.notes = []
        self.result = None

    def on_start(self, start):
        self.start = start

    def on_samples(self, samples):
        self.samples += samples

    def on_command(self, command):
        self.commands.append(command)

    def on_note(self, note):
        self.notes.append(note)

    def on_step(self, step):
        self.steps.append(step)
        self.commands.append(step.command)

    def on_stop(self, stop, result):
        self.commands.append(stop)
        self.result = result

    @property
    def trial(self):
        frames = Frames.from_samples(self.samples, len(self.start.setup.names))
        return TrialRecords(
            start=self.start,
            frames=frames.numbers,
            mocap_ns=frames.sampled_ns,
            received_ns=frames.received_ns,
            exposed_ns=frames.exposed_ns,
            mocap=frames.poses,
            valid=frames.valid,
            truth=frames.truth,
            commands=tuple(self.commands),
            steps=tuple(self.steps),
            notes=tuple(self.notes),
            result=self.result,
        )
