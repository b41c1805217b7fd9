"""Tests of the records that an encoder makes of a trial: which, when, and in which chunks."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from testkit.random_trials import PERIOD_NS, trial

from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, Steer
from tetractl.core.trial import SIMULATED_START_NS, Note
from tetractl.log.format import channels, codec
from tetractl.log.format.channels import CHANNELS, Entry
from tetractl.log.write.encoder import CHUNK_NS, LAB_CHUNK_NS, PLAN_SHOWN_NS, Encoder

FRAMES = 6  # of a control step
ATTACHED = [channels.SPEC, channels.RESOLVED_SPEC, channels.LAYOUT]


class Sink:
    """Keeps the records of each chunk; the last list is the open chunk."""

    def __init__(self):
        self.chunks = [[]]

    def add(self, record):
        self.chunks[-1].append(record)

    def flush(self):
        self.chunks.append([])

    @property
    def records(self):
        return [record for chunk in self.chunks for record in chunk]

    def of(self, topic):
        return [r for r in self.records if isinstance(r, Entry) and r.topic == topic]

    def messages(self, topic):
        return [CHANNELS[topic].FromString(entry.data) for entry in self.of(topic)]


def encoded(made_up, *, stops=True, **options):
    """The sink and the encoder after a whole trial."""
    sink = Sink()
    encoder = Encoder(sink, **options)
    encoder.on_start(made_up.start)
    made_up.give_rounds(encoder)
    if stops:
        encoder.on_stop(made_up.stop, made_up.result)
    return sink, encoder


def made(steps=12, **fields):
    return trial(steps=steps, robots=2, frames=FRAMES, first=1, iterations=1, length=2, **fields)


def topic_of(record):
    return record.topic if isinstance(record, Entry) else record.name


def test_a_trial_begins_with_its_run_its_specs_its_scene_and_a_note():
    sink, _ = encoded(made(), stops=False)
    begin = [topic_of(record) for record in sink.records[:6]]
    assert begin == [channels.RUN, *ATTACHED, channels.SCENE, channels.LOG]
    assert {r.log_ns for r in sink.records[:6] if isinstance(r, Entry)} == {SIMULATED_START_NS}


def test_records_of_the_host_are_only_in_the_log_of_a_host():
    alone, _ = encoded(made())
    hosted, _ = encoded(made(), hosted=True)
    topics = Counter(map(topic_of, hosted.records)) - Counter(map(topic_of, alone.records))
    assert topics == {channels.HOST: 1, channels.HOST_END: 1, channels.ENVIRONMENT: 1}
    names = [topic_of(record) for record in hosted.records]
    assert names[1] == channels.HOST
    assert names.index(channels.ENVIRONMENT) == names.index(channels.LAYOUT) + 1


def test_every_frame_is_logged_once_and_in_order_whatever_its_message():
    made_up = made()
    sink, _ = encoded(made_up)
    numbers = [
        frame
        for message in sink.messages(channels.FRAMES)
        for frame in codec.decode_frames(message, 2).numbers.tolist()
    ]
    assert numbers == [sample.observation.frame for sample in made_up.samples]


def test_a_simulation_shows_every_eighth_frame_and_the_newest_of_each_message():
    """A camera of 120 Hz is shown at 15 Hz."""
    made_up = made(steps=23)
    sink, _ = encoded(made_up)
    sampled = [sample.observation.sampled_ns + SIMULATED_START_NS for sample in made_up.samples]
    shown = [
        [stamp_ns(t) for t in message.transforms if t.child_frame_id == "robot/robot 1"]
        for message in sink.messages(channels.TRANSFORMS)
    ]
    frames = [
        len(codec.decode_frames(message, 2).numbers) for message in sink.messages(channels.FRAMES)
    ]
    assert len(frames) > 1
    end = 0
    for count, times in zip(frames, shown, strict=True):
        begin, end = end, end + count
        assert times == sampled[begin:end][::-1][::8][::-1]


def stamp_ns(transform):
    return transform.timestamp.seconds * SECOND + transform.timestamp.nanos


def test_messages_of_frames_have_the_times_of_their_last_and_transforms_of_their_first():
    made_up = made(steps=8)
    sink, _ = encoded(made_up)
    (frames,) = sink.of(channels.FRAMES)
    (shown,) = sink.of(channels.TRANSFORMS)
    seen = [sample.observation for sample in made_up.samples]
    assert (frames.log_ns, frames.publish_ns) == (
        SIMULATED_START_NS + seen[-1].received_ns,
        SIMULATED_START_NS + seen[-1].sampled_ns,
    )
    first = seen[(len(seen) - 1) % 8]
    assert (shown.log_ns, shown.publish_ns) == (
        SIMULATED_START_NS + first.received_ns,
        SIMULATED_START_NS + first.sampled_ns,
    )


def test_a_lab_logs_and_shows_each_frame_as_it_arrives():
    made_up = made(steps=3, simulated=False)
    sink = Sink()
    encoder = Encoder(sink, real_time=True)
    encoder.on_start(made_up.start)
    (samples, _), *_ = made_up.rounds
    for count, sample in enumerate(samples, 1):
        encoder.on_samples([sample])
        assert len(sink.of(channels.FRAMES)) == len(sink.of(channels.TRANSFORMS)) == count
    encoder.on_samples([])
    assert len(sink.of(channels.FRAMES)) == len(samples)
    begin_ns = made_up.start.start_unix_ns
    times = [(entry.log_ns, entry.publish_ns) for entry in sink.of(channels.FRAMES)]
    assert times == [
        (begin_ns + s.observation.received_ns, begin_ns + s.observation.sampled_ns) for s in samples
    ]


@pytest.mark.parametrize(("real_time", "length_ns"), [(False, CHUNK_NS), (True, LAB_CHUNK_NS)])
def test_a_chunk_ends_as_soon_as_it_has_its_length(real_time, length_ns):
    made_up = made(steps=26, simulated=not real_time)
    sink, _ = encoded(made_up, real_time=real_time, stops=False)
    begin_ns = made_up.start.start_unix_ns
    since_ns = 0
    for chunk in sink.chunks[:-1]:
        times = [r.log_ns - begin_ns for r in chunk if isinstance(r, Entry)]
        assert max(times) - since_ns >= length_ns
        assert sorted(times)[-2] - since_ns < length_ns + PERIOD_NS
        since_ns = max(times)
    assert len(sink.chunks) - 1 >= 26 * PERIOD_NS // (length_ns + PERIOD_NS)


def test_the_chunk_of_frames_that_a_step_ends_has_them():
    """A crash behind it would lose them otherwise."""
    sink, _ = encoded(made(steps=26), stops=False)
    for chunk in sink.chunks[:-1]:
        assert channels.FRAMES in [topic_of(record) for record in chunk]
    assert channels.FRAMES not in [topic_of(record) for record in sink.chunks[-1]]


def test_the_result_and_the_run_are_in_a_last_chunk_of_their_own():
    sink, _ = encoded(made(), hosted=True)
    last = [topic_of(record) for record in sink.chunks[-1]]
    assert last == [channels.HOST_END, channels.RUN, channels.RESULT]
    before = [topic_of(record) for record in sink.chunks[-2]]
    assert before[-2:] == [channels.COMMANDS, channels.LOG]


def test_a_step_is_logged_with_its_command_its_time_and_the_sampling_of_its_frame():
    made_up = made(steps=5)
    sink, _ = encoded(made_up)
    for step, entry, timing in zip(
        made_up.steps, sink.of(channels.STEP), sink.messages(channels.HOST_TIMING), strict=True
    ):
        assert entry.log_ns == SIMULATED_START_NS + step.command.sent_ns
        assert entry.publish_ns == SIMULATED_START_NS + step.observation.sampled_ns
        assert (timing.k, timing.solve_ns) == (step.k, step.solve_ns)
        assert timing.deadline_missed == step.deadline_missed
    sent = [entry.log_ns - SIMULATED_START_NS for entry in sink.of(channels.COMMANDS)]
    assert sent == [*(step.command.sent_ns for step in made_up.steps), made_up.stop.sent_ns]


def test_plans_are_shown_at_most_every_so_often():
    made_up = made(steps=40)
    times = [k * PLAN_SHOWN_NS // 3 for k in range(40)]
    rounds = [
        (samples, replace(step, command=replace(step.command, sent_ns=sent_ns)))
        for (samples, step), sent_ns in zip(made_up.rounds, times, strict=True)
    ]
    sink, _ = encoded(replace(made_up, rounds=rounds), stops=False)
    shown = [entry.log_ns - SIMULATED_START_NS for entry in sink.of(channels.SCENE_PLAN)]
    assert shown == times[::3]


def test_a_command_outside_of_the_steps_is_logged_alone():
    made_up = made()
    sink = Sink()
    encoder = Encoder(sink)
    encoder.on_start(made_up.start)
    before = len(sink.records)
    encoder.on_command(Command(Steer(0.5), 17, (True, False)))
    (entry,) = sink.records[before:]
    assert (entry.topic, entry.log_ns, entry.publish_ns) == (
        channels.COMMANDS,
        SIMULATED_START_NS + 17,
        SIMULATED_START_NS + 17,
    )


def test_only_warnings_and_errors_before_the_end_are_counted():
    made_up = made()
    delivered = [
        (samples, replace(step, command=replace(step.command, delivered=(True, True))))
        for samples, step in made_up.rounds
    ]
    made_up = replace(made_up, rounds=delivered)
    sink, encoder = encoded(made_up, stops=False)
    assert encoder.warnings == 0
    for level in ("info", "debug", "warning", "error", "warning"):
        encoder.on_note(Note(5, level, "text"))
    assert encoder.warnings == 3
    encoder.on_stop(made_up.stop, made_up.result)
    (result,) = sink.messages(channels.RESULT)
    assert result.warnings == 3


def test_messages_of_a_camera_have_the_times_of_their_sample():
    made_up = made(steps=1)
    (samples, step) = made_up.rounds[0]
    pictured = [replace(samples[0], messages=((channels.PICTURE_TOPIC, b"jpeg"),)), *samples[1:]]
    sink, _ = encoded(replace(made_up, rounds=[(pictured, step)]))
    (entry,) = sink.of(channels.PICTURE_TOPIC)
    seen = samples[0].observation
    assert (entry.log_ns, entry.publish_ns, entry.data) == (
        SIMULATED_START_NS + seen.received_ns,
        SIMULATED_START_NS + seen.sampled_ns,
        b"jpeg",
    )


def test_a_message_of_frames_is_of_bounded_size(monkeypatch):
    monkeypatch.setattr("tetractl.log.write.encoder.MESSAGE_POSES_MAX", 20)
    made_up = made(steps=4)
    sink, _ = encoded(made_up)
    numbers = [codec.decode_frames(message, 2).numbers for message in sink.messages("/frames")]
    assert [len(part) for part in numbers] == [10, 10, 4]
    assert np.concatenate(numbers).tolist() == list(range(24))


def test_the_steps_of_a_trial_without_frames_need_none():
    made_up = made(steps=2)
    without = replace(made_up, rounds=[([], step) for _, step in made_up.rounds])
    sink, _ = encoded(without)
    assert sink.of(channels.FRAMES) == []
    assert len(sink.of(channels.STEP)) == 2
