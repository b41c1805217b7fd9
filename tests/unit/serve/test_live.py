from support import random_trials as made

from tetractl.core.commands import Command, Note, Steer
from tetractl.log.format import channels
from tetractl.log.read.salvage import scan
from tetractl.serve.live import ServedRun


class Server:
    """Keeps what is sent since the last jump."""

    def __init__(self, watched=True):
        self.watched, self.sent = watched, []

    def jump(self, time_ns, entries):
        self.sent = [*entries]

    def messages(self, entries):
        self.sent += entries

    def attachment(self, *attached):
        pass

    def flush(self):
        pass


class Wall:
    """A clock that only notes until when somebody wanted to sleep."""

    def __init__(self):
        self.time, self.slept = 1000, []

    def now(self):
        return self.time

    def sleep_until(self, when):
        self.slept.append(when)


def run(trial, server, wall):
    observer = ServedRun(server, wall)
    observer.on_start(trial.start)
    trial.give_rounds(observer)
    observer.on_command(Command(Steer(0.5), 7, (True,) * 3))
    observer.on_note(Note(8, "info", "a note"))
    observer.on_stop(trial.stop, trial.result)
    return server


def test_every_message_of_the_log_is_sent(tmp_path):
    for simulated in (True, False):
        trial = made.trial(3, steps=4, simulated=simulated)
        sent = run(trial, Server(), Wall()).sent
        logged = scan(made.write(trial, tmp_path / f"{simulated}.mcap")).entries
        frames = {"/frames", "/tf"}  # each by itself, in the log those of a chunk together
        of_file = {channels.HOST, channels.HOST_END, channels.DIGESTS}
        logged = [entry for entry in logged if entry.topic not in frames | of_file]
        extra = [one for one in sent if one.topic not in frames and one not in logged]
        assert [entry.topic for entry in extra] == ["/commands", "/log"]
        assert [entry for entry in sent if entry in logged] == logged
        for topic in frames:
            assert [entry.topic for entry in sent].count(topic) == len(trial.samples)


def test_a_simulation_is_slowed_to_the_wall_and_the_lab_is_not():
    trial = made.trial(3, steps=2)
    wall = Wall()
    run(trial, Server(), wall)
    assert wall.slept == [1000 + one.observation.received_ns for one in trial.samples]
    wall = Wall()
    run(made.trial(3, steps=2, simulated=False), Server(), wall)
    assert wall.slept == []


def test_while_nobody_looks_only_the_newest_poses_are_encoded():
    trial = made.trial(3, steps=4)
    sent = run(trial, Server(watched=False), Wall()).sent
    times = [entry.publish_ns for entry in sent if entry.topic == "/frames"]
    start = trial.start.start_unix_ns
    assert times == [start + samples[-1].observation.sampled_ns for samples, _ in trial.rounds]
    assert [entry.topic for entry in sent].count("/controller/step") == 4
