"""Tests that no trial goes on for long with cells of uncertain identity."""

import numpy as np
from tetractl_microscope.cells.identity_watch import IdentityWatch


def see(watch, seconds, *probabilities):
    t_ns = round(1e9 * seconds)
    return list(watch.update(t_ns, np.array(probabilities)))


def test_a_meeting_is_said_once_and_ends_the_run_only_where_it_stays_unknown():
    watch = IdentityWatch(("one", "two"), 3.0)
    rows = [
        (0.0, 1.0, 1.0),
        (1.0, 0.5, 0.5),
        (1.5, np.nan, 0.6),  # not seen: nothing is known of it
        (2.0, 0.95, 0.7),
        (3.9, 0.95, 0.8),
    ]
    notes = [note for row in rows for note in see(watch, *row)]
    assert [(note.t_ns / 1e9, note.level, note.text.split()[0]) for note in notes] == [
        (1.0, "warning", "one"),
        (1.0, "warning", "two"),
        (2.0, "info", "one"),
    ]
    assert watch.unknown == {}
    assert see(watch, 4.1, 0.95, 0.85) == []
    assert watch.unknown == {1: "for 3 s it has been uncertain which cell is two"}
    watch.forget(1)
    assert see(watch, 4.2, 0.95, 0.95) == []
    assert watch.unknown == {}
