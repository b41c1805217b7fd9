"""Tests of what a served run sends to viewers, and when."""

import pytest
from testkit import random_trials

from tetractl.core.commands import Command, Steer
from tetractl.core.trial import Note
from tetractl.log.format import channels
from tetractl.log.read.salvage import scan
from tetractl.serve.live import ServedRun

STEPS = 4
FRAME_TOPICS = {"/frames", "/tf"}


class RecordingServer:
    """Stands for the server of viewers: keeps the entries sent to them since the last jump."""

    def __init__(self, watched=True):
        self.watched = watched
        self.sent = []

    def jump(self, time_ns):
        self.sent = []

    def add(self, record):
        if isinstance(record, channels.Entry):
            self.sent.append(record)

    def flush(self):
        pass


class RecordingClock:
    """Stands for the clock on the wall: it stands still, and keeps until when it was to sleep."""

    def __init__(self):
        self.time = 1000
        self.slept_until = []

    def now(self):
        return self.time

    def sleep_until(self, when):
        self.slept_until.append(when)


def serve(trial, server, wall):
    """Serve a trial with a command between two steps and a note."""
    observer = ServedRun(server, wall)
    observer.on_start(trial.start)
    trial.give_rounds(observer)
    observer.on_command(Command(Steer(0.5), 7, (True,) * 3))
    observer.on_note(Note(8, "info", "a note"))
    observer.on_stop(trial.stop, trial.result)


def sent_entries(trial, watched=True):
    server = RecordingServer(watched)
    serve(trial, server, RecordingClock())
    return server.sent


def count(entries, topic):
    return [entry.topic for entry in entries].count(topic)


@pytest.mark.parametrize("simulated", [True, False])
def test_every_message_of_the_log_is_sent(tmp_path, simulated):
    """But for those of frames, which the log has by chunks, and of the file itself."""
    trial = random_trials.trial(3, steps=STEPS, simulated=simulated)
    sent = sent_entries(trial)
    written = scan(random_trials.write(trial, tmp_path / "trial.mcap")).entries
    not_compared = FRAME_TOPICS | {channels.HOST, channels.HOST_END, channels.DIGESTS}
    logged = [entry for entry in written if entry.topic not in not_compared]
    assert [entry for entry in sent if entry in logged] == logged
    others = [entry for entry in sent if entry not in logged]
    of_serve = [entry.topic for entry in others if entry.topic not in FRAME_TOPICS]
    assert of_serve == ["/commands", "/log"]


def test_a_simulation_is_slowed_to_the_wall():
    trial = random_trials.trial(3, steps=2)
    wall = RecordingClock()
    serve(trial, RecordingServer(), wall)
    received = [sample.observation.received_ns for sample in trial.samples]
    assert wall.slept_until == [1000 + received_ns for received_ns in received]


def test_while_nobody_looks_only_the_newest_poses_are_encoded():
    trial = random_trials.trial(3, steps=STEPS)
    sent = sent_entries(trial, watched=False)
    newest = [samples[-1].observation.sampled_ns for samples, _ in trial.rounds]
    published = [entry.publish_ns for entry in sent if entry.topic == "/frames"]
    assert published == [trial.start.start_unix_ns + sampled_ns for sampled_ns in newest]
    assert count(sent, "/controller/step") == STEPS


@pytest.mark.parametrize("simulated", [True, False])
def test_every_frame_is_sent_by_itself(simulated):
    trial = random_trials.trial(3, steps=STEPS, simulated=simulated)
    sent = sent_entries(trial)
    for topic in FRAME_TOPICS:
        assert count(sent, topic) == len(trial.samples)


def test_a_lab_is_not_slowed():
    wall = RecordingClock()
    serve(random_trials.trial(3, steps=2, simulated=False), RecordingServer(), wall)
    assert wall.slept_until == []
