"""No trial goes on for long with cells of unknown identity."""

from dataclasses import replace

import numpy as np
import pytest
from support.labs import fake_lab
from support.trials import experiment

from tetractl.core.clock import SECOND
from tetractl.core.commands import FrameAddition, Note, Steer
from tetractl.core.errors import AbortError
from tetractl.experiment.lab_section import LabLimits
from tetractl.lab.identity_watch import IdentityWatch


def seen(seconds, *sure):
    return FrameAddition(round(1e9 * seconds), np.array(sure), (("/camera/picture", b"one"),))


def test_a_meeting_is_said_once_and_ends_the_run_only_where_it_stays_unknown():
    watch = IdentityWatch(("one", "two"), 3.0)
    rows = [
        (0.0, 1.0, 1.0),
        (1.0, 0.5, 0.5),
        (1.5, np.nan, 0.6),  # not seen: nothing is known of it
        (2.0, 0.95, 0.7),
        (3.9, 0.95, 0.8),
    ]
    notes = [note for row in rows for note in watch.see(seen(*row))]
    assert [(note.t_ns / 1e9, note.level, note.text.split()[0]) for note in notes] == [
        (1.0, "warning", "one"),
        (1.0, "warning", "two"),
        (2.0, "info", "one"),
    ]
    assert watch.unknown == {}
    assert list(watch.see(seen(4.1, 0.95, 0.85))) == []
    assert watch.unknown == {1: "for 3 s it has not been known which cell is two"}
    watch.forget(1)
    assert list(watch.see(seen(4.2, 0.95, 0.95))) == []
    assert watch.unknown == {}


def test_the_lab_aborts_where_its_camera_does_not_know_for_long_who_is_who():
    lab, sure, made = fake_lab(experiment().setup, LabLimits(identity=1.0)), [1.0, 1.0, 1.0], []
    frames = lab.camera.frames

    def filmed():
        fresh = frames()
        made.extend(replace(seen(0.0, *sure), sampled_ns=frame.sampled_ns) for frame in fresh)
        return fresh

    lab.camera.frames, lab.camera.additions = filmed, lambda: [made.pop(0) for _ in list(made)]
    plant, notes = lab.plant, []
    plant.open()
    with pytest.raises(AbortError, match="for 1 s it has not been known which cell is blue"):
        for k in range(10):
            sure[1] = 1.0 if k < 3 else 0.6
            plant.observe()
            plant.send(Steer(1.5))
            assert all(sample.messages for sample in plant.samples())
            notes += [one.text for one in plant.news() if isinstance(one, Note)]
            lab.clock.sleep_until(lab.clock.now() + SECOND // 5)
    plant.stop()
    plant.close()
    assert [text.split(":")[0] for text in notes] == ["blue has met another cell"]
