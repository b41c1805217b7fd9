"""Tests of the tables of cells, printed and in files, and of the means over the cells.

A mean counts cells, not the pieces of their tracks.
"""

import math

import numpy as np
import pytest
from scipy import stats
from tetractl_microscope.tracks.cell_tables import (
    compute_cell_mean,
    create_cell_tables,
    create_data_table,
    extract_value,
    find_known_values,
)


def cell(number, since, seconds, speed, a=None, magnet=None):
    return {
        "cell": number, "since_s": since, "duration_s": seconds, "speed_um_s": speed,
        "a_rad_s": a, "magnetised": magnet,
    }  # fmt: skip


CELLS = [
    cell(1, 0.0, 8.0, 400.0, 4.0, True),
    cell(2, 0.0, 2.0, 300.0, 0.2, False),
    cell(3, 2.0, 6.0, 500.0, 5.0, True),  # the same cell as 2 under another number
    cell(4, 0.0, 8.0, 450.0, 4.0, True),
]


def test_a_cell_in_pieces_counts_once_and_by_its_time():
    mean = compute_cell_mean(*find_known_values(CELLS, "speed_um_s"))
    assert mean.n == 3
    assert mean.mean == pytest.approx(np.average([400, 300, 500, 450], weights=[8, 2, 6, 8]))
    assert mean.ci95.low < mean.mean < mean.ci95.high
    assert (
        compute_cell_mean(CELLS[:1], [400.0]).n == 1
        and not compute_cell_mean(CELLS[:1], [400.0]).ci95.known
    )


def test_cells_that_are_seen_together_for_equally_long_have_the_usual_mean_and_interval():
    values = [410.0, 380.0, 502.0, 444.0, 371.0]
    cells = [cell(k, 0.1 * k, 9.0, value) for k, value in enumerate(values)]
    mean = compute_cell_mean(cells, values)
    usual = stats.t.interval(0.95, 4, np.mean(values), stats.sem(values))
    assert (mean.n, mean.mean) == (5, pytest.approx(np.mean(values)))
    assert mean.std == pytest.approx(np.std(values, ddof=1))
    assert (mean.ci95.low, mean.ci95.high) == pytest.approx(usual)


@pytest.mark.parametrize(
    ("times", "n"),
    [
        ([(0, 5), (5, 5), (10, 5)], 1),  # one after another
        ([(0, 5), (4, 5), (8, 5)], 2),
        ([(0, 20), (4, 5), (8, 5)], 3),
        ([(0, 1), (3, 4), (5, 4), (6, 4)], 3),
    ],
)
def test_n_is_the_number_of_cells_that_were_seen_at_once(times, n):
    cells = [cell(k, since, seconds, 100.0 + k) for k, (since, seconds) in enumerate(times)]
    mean = compute_cell_mean(cells, [c["speed_um_s"] for c in cells])
    assert mean.n == n
    assert mean.ci95.known == (n >= 3)
    assert math.isnan(mean.std) == (n == 1)


def test_two_cells_have_a_spread_and_the_reason_why_there_is_no_interval():
    mean = compute_cell_mean(CELLS[:1] + CELLS[3:], [400.0, 450.0])
    assert mean.std == pytest.approx(np.std([400, 450], ddof=1))
    assert "3 cells" in mean.ci95.reason


def test_means_of_responses_are_of_the_cells_that_respond():
    chosen, values = find_known_values(CELLS, "a_rad_s")
    assert [c["cell"] for c in chosen] == [1, 3, 4] and values == [4.0, 5.0, 4.0]
    assert find_known_values(CELLS, "speed_um_s")[1] == [400.0, 300.0, 500.0, 450.0]


def test_a_value_of_0_is_known_and_none_is_not():
    cells = [cell(1, 0, 5, 0.0), cell(2, 0, 5, None), {"cell": 3}]
    assert find_known_values(cells, "speed_um_s") == (cells[:1], [0.0])


def test_the_value_of_an_interval_is_its_middle_value():
    assert extract_value({"value": 3.0, "ci95": [2.0, 5.0]}) == 3.0
    assert extract_value(2.5) == 2.5
    assert extract_value(None) is None


def measured(number, speed, a, magnet, **more):
    return {
        "cell": number,
        "since_s": 0.25,
        "duration_s": 10.0,
        "pictures": 300,
        "speed_um_s": {"value": speed, "ci95": [speed - 20, speed + 30]},
        "vsl_um_s": 0.9 * speed,
        "a_rad_s": {"value": a, "ci95": [a - 0.5, a + 0.25]},
        "magnetised": magnet,
        **more,
    }


RECORD = {
    "notes": ["one note", "another"],
    "cells": [
        measured(7, 300.0, 4.0, True, sway_rad=0.25),
        measured(9, 360.0, 0.0, False),
        measured(12, 330.0, 5.0, True),
    ],
}


def columns(table):
    return {column.name: list(column.values) for column in table.columns}


def test_the_printed_table_has_values_with_intervals_and_leaves_out_what_no_cell_has():
    table, _ = create_cell_tables(RECORD)
    shown = columns(table)
    assert shown["cell"] == [7, 9, 12]
    assert shown["speed"] == ["300 [280, 330]", "360 [340, 390]", "330 [310, 360]"]
    assert shown["a"][0] == "4.00 [3.50, 4.25]"
    assert shown["magnet"] == ["yes", "no", "yes"]
    assert shown["from"] == ["0.2"] * 3 and shown["for"] == ["10.0"] * 3
    assert shown["sway"][0] == "0.25" and shown["sway"][1] == shown["sway"][2] != "0.25"
    assert not {"bias", "helix", "pictures"} & set(shown)
    assert table.note == "one note\nanother"


def test_means_are_printed_with_their_n_and_not_for_times_and_magnets():
    _, means = create_cell_tables(RECORD)
    rows = list(zip(*(column.values for column in means.columns), strict=True))
    by_name = {row[0]: row[1:] for row in rows}
    assert list(by_name) == [
        "speed [um/s]",
        "VSL [um/s]",
        "sway [rad]",
        "a [rad/s] of those that respond",
    ]
    low, high = stats.t.interval(0.95, 2, 330, 30 / math.sqrt(3))
    assert by_name["speed [um/s]"] == ("3", "330", f"{low:.0f} to {high:.0f}", "30")
    n, mean, interval, _ = by_name["a [rad/s] of those that respond"]
    assert (n, mean) == ("2", "4.50") and interval.startswith("none")
    assert by_name["sway [rad]"][:2] == ("1", "0.25")


def test_a_single_cell_has_no_table_of_means():
    assert len(create_cell_tables({"notes": [], "cells": RECORD["cells"][:1]})) == 1


def test_no_known_quantity_has_no_table_of_means():
    cells = [{"cell": 1, "duration_s": 3.0}, {"cell": 2, "duration_s": 3.0}]
    assert len(create_cell_tables({"notes": [], "cells": cells})) == 1


def test_the_file_has_every_quantity_and_the_ends_of_its_interval():
    data = columns(create_data_table(RECORD))
    assert data["speed_um_s"] == [300.0, 360.0, 330.0]
    assert data["speed_low_um_s"] == [280.0, 340.0, 310.0]
    assert data["speed_high_um_s"] == [330.0, 390.0, 360.0]
    assert data["a_low_rad_s"] == [3.5, -0.5, 4.5]
    assert data["a_high_rad_s"] == [4.25, 0.25, 5.25]
    assert data["bias_low_rad"] == [None] * 3
    assert data["pictures"] == [300] * 3
    assert data["magnetised"] == [True, False, True]
    assert {"helix_hz", "helix_um", "speed_sd_um_s", "path_um"} <= set(data)
    assert not {"vsl_low_um_s", "since_low_s"} & set(data)
