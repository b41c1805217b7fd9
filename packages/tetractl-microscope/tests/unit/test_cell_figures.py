"""The figures of a film's cells."""

import numpy as np
import pytest
from tetractl_microscope.figures.cells import FilmTracks, cells_figure, turns

RATE_HZ = 30.0
A = 3.0
SPEED = 400.0
FIELD = {"time_s": [0.0, 2.0, 4.0], "x": [1.0, 0.0, -0.5], "y": [0.0, 1.0, 0.0]}


def swum(heading):
    """Poses of a cell that turns by equation (3) in FIELD."""
    times = np.arange(180) / RATE_HZ
    state = np.array([500.0, 500.0, heading])
    rows = []
    for t in times:
        rows.append(state.copy())
        k = np.searchsorted(FIELD["time_s"], t, side="right") - 1
        x = FIELD["x"][k]
        y = FIELD["y"][k]
        turn = A * (y * np.cos(state[2]) - x * np.sin(state[2]))
        state += np.array([SPEED * np.cos(state[2]), SPEED * np.sin(state[2]), turn]) / RATE_HZ
    return times, np.array(rows)


def film(cells=6, field=True):
    """A film of some cells."""
    paths = [swum(0.5 * k) for k in range(cells)]
    listed = [
        {
            "cell": k + 1, "vsl_um_s": 300.0,
            "speed_um_s": {"value": 380.0 + 9 * k, "ci95": [370.0 + 9 * k, 390.0 + 9 * k]},
            "magnetised": True, "a_rad_s": {"value": A, "ci95": [2.9, 3.1]},
            "since_s": 0.0, "duration_s": 6.0,
        }
        for k in range(cells)
    ]  # fmt: skip
    record = {
        "film": "dish.avi", "pictures": 180, "rate_hz": RATE_HZ, "um_per_px": 4.0, "width": 640,
        "height": 480, "cells": listed, "field": FIELD if field else None,
    }  # fmt: skip
    return FilmTracks(
        record=record,
        paths=[(number, *path) for number, path in enumerate(paths, 1)],
        picture=np.tile(np.arange(640, dtype=np.uint8), (480, 1)),
    )


def test_the_figure_states_the_film():
    figure = cells_figure(film())
    words = [text.get_text() for text in figure.texts]
    assert any("dish.avi: 6 tracks, 6 s, 4 µm/px" in text for text in words)


def test_a_film_without_a_field_or_without_cells_has_the_other_panels():
    def titles(tracks):
        return [axes.get_title(loc="left") for axes in cells_figure(tracks).axes]

    assert titles(film()) == ["(a) paths over the first picture", "(b) speed", "(c) turning"]
    assert titles(film(field=False)) == ["(a) paths over the first picture", "(b) speed"]
    assert titles(film(0)) == ["(a) paths over the first picture"]


def test_the_turning_stated_is_that_of_the_cells_that_respond():
    swimmers = film(7)
    swimmers.record["cells"][6] |= {"magnetised": None, "a_rad_s": None}  # a piece of 0.4 s
    swimmers.record["cells"][5] |= {"magnetised": False, "a_rad_s": {"value": 0.1, "ci95": [-1, 1]}}
    axes = cells_figure(swimmers).axes[2]
    assert "a = 3.00 [3.00, 3.00], n = 5 cells" in axes.get_xlabel()
    squares, curve = (line.get_data()[1] for line in axes.lines[-2:])
    highest = np.nanmax(np.abs(squares))
    assert highest == pytest.approx(np.abs(curve).max(), rel=0.1)


def test_the_rate_of_turning_is_that_of_the_model_at_any_strength():
    times, poses = swum(1.0)
    angle, rate = turns(times, poses[:, 2], FIELD)
    assert len(angle) > 100
    assert np.abs(rate - A * np.sin(angle)).max() < 0.2
