"""Tests of the limits for tracks of swimming cells, and of the remarks about all of them."""

import math
from pathlib import Path

import numpy as np
import pytest
from tetractl_microscope.cells.field_record import FieldRecord
from tetractl_microscope.organisms import find_organism
from tetractl_microscope.tracks.fit_track import IMAGE_RATE_MIN_HZ, CellPath
from tetractl_microscope.tracks.foreign_tracks import SpotTrack
from tetractl_microscope.tracks.swimming_tracks import (
    create_track_record,
    describe_moving_stage,
    find_organism_by_speed,
    select_swimming_tracks,
)

from tetractl.core.errors import TetractlError, UsageError

SOURCE = Path("tracks.csv")
HZ = 20.0


def swimmer(number, seconds=5.0, begin_s=0.0, hz=HZ, velocity=(120.0, 50.0)):
    times = begin_s + np.arange(round(seconds * hz) + 1) / hz
    return SpotTrack(float(number), np.column_stack([times, np.outer(times, velocity)]))


def bead(number, seconds=5.0):
    times = np.arange(round(seconds * HZ) + 1) / HZ
    steps = np.random.default_rng(number).normal(0.0, 2.0, (len(times), 2))
    return SpotTrack(float(number), np.column_stack([times, np.cumsum(steps, axis=0)]))


def test_tracks_below_2_s_are_left_out_and_named():
    tracks = [swimmer(4, 2.0), swimmer(5, 1.95), swimmer(6, 0.5), swimmer(7, 9.0, begin_s=3.0)]
    cells = select_swimming_tracks(SOURCE, tracks, False)
    assert [path.number for path in cells.paths] == [4, 7]
    (line,) = cells.remarks
    assert line.endswith("less than 2 s: cell 5, cell 6")
    assert cells.period_s == pytest.approx(1 / HZ)
    assert cells.span_s == (0.0, 12.0)
    assert cells.paths[1].places == pytest.approx(tracks[3].rows[:, 1:])
    assert cells.paths[1].times == pytest.approx(tracks[3].rows[:, 0])


def test_swimmers_alone_get_no_remark_and_only_brief_tracks_are_refused():
    assert select_swimming_tracks(SOURCE, [swimmer(1), swimmer(2)], True).remarks == ()
    with pytest.raises(UsageError, match=r"tracks.csv: no cell was seen for 2 s"):
        select_swimming_tracks(SOURCE, [swimmer(1, 1.9)], False)


def test_beads_are_named_and_one_in_three_may_swim():
    cells = select_swimming_tracks(SOURCE, [bead(3), swimmer(1), bead(5)], False)
    assert [path.number for path in cells.paths] == [1]
    (line,) = cells.remarks
    assert line.startswith("warning: ") and line.endswith("as beads do: cell 3, cell 5")
    with pytest.raises(TetractlError, match="nothing swims"):
        select_swimming_tracks(SOURCE, [bead(3), swimmer(1), bead(5), bead(6)], False)


@pytest.mark.parametrize(
    ("hz", "with_field", "refused"),
    [
        (IMAGE_RATE_MIN_HZ + 0.1, True, False),
        (IMAGE_RATE_MIN_HZ - 0.1, True, True),
        (IMAGE_RATE_MIN_HZ - 0.1, False, False),
    ],
)
def test_images_that_are_too_rare_are_refused_only_with_a_field(hz, with_field, refused):
    tracks = [swimmer(1, 20.0, hz=hz)]
    if not refused:
        assert len(select_swimming_tracks(SOURCE, tracks, with_field).paths) == 1
        return
    with pytest.raises(UsageError, match="film at 7 images/s or more"):
        select_swimming_tracks(SOURCE, tracks, with_field)


def path(number, velocity, wobble_um=0.0, seconds=10.0):
    times = np.arange(round(seconds * HZ) + 1) / HZ
    places = np.outer(times, velocity)
    places[:, 1] += wobble_um * np.sin(math.tau * times / 2.0)
    return CellPath(number, times, places)


def in_all_directions(count, common, own_um_s):
    angles = math.tau * np.arange(count) / count
    own = own_um_s * np.column_stack([np.cos(angles), np.sin(angles)])
    return [path(k, common + velocity) for k, velocity in enumerate(own)]


@pytest.mark.parametrize(
    ("count", "common", "own", "said"),
    [
        (12, (90.0, 0.0), 29.0, True),
        (12, (90.0, 0.0), 31.0, False),
        (12, (0.0, -90.0), 29.0, True),
        (12, (0.0, 0.0), 30.0, False),
        (8, (90.0, 0.0), 10.0, True),
        (7, (90.0, 0.0), 10.0, False),
    ],
)
def test_cells_that_move_together_are_said_to_with_both_speeds(count, common, own, said):
    lines = describe_moving_stage(in_all_directions(count, np.array(common), own))
    assert len(lines) == said
    for line in lines:
        assert f"at 90 um/s, while each swims at {own:.0f} um/s" in line
        assert "no turning rate a is fitted" not in line


TURNS = FieldRecord(np.arange(10.0), math.tau * np.arange(10) / 5)
STAYS = FieldRecord(np.array([0.0]), np.array([1.0]))
MOSTLY = FieldRecord(np.array([0.0, 3.0]), np.array([1.0, 1.0 + math.pi]))
"""A field that has one direction for seven of ten seconds, so its mean is 0.4."""


@pytest.mark.parametrize(
    ("field", "wobble_um", "said"),
    [
        (TURNS, 0.0, True),
        (STAYS, 0.0, False),  # the field itself takes them to one side
        (MOSTLY, 0.0, True),
        (TURNS, 100.0, False),  # they go on detours of their own
    ],
)
def test_in_a_field_cells_are_carried_if_they_go_straight_while_it_turns(field, wobble_um, said):
    paths = [path(k, (90.0, 0.5 * k), wobble_um) for k in range(10)]
    lines = describe_moving_stage(paths, field)
    assert len(lines) == said
    assert all(line.endswith("and no turning rate a is fitted") for line in lines)


def test_a_field_whose_strength_varies_is_judged_by_its_directions():
    strong = FieldRecord(TURNS.times, TURNS.angles, np.where(TURNS.angles < 1.0, 50.0, 0.1))
    paths = [path(k, (90.0, 0.5 * k)) for k in range(10)]
    assert len(describe_moving_stage(paths, strong)) == 1


@pytest.mark.parametrize("hz", [2.0, 20.0, 100.0])
def test_the_organism_does_not_depend_on_the_rate_of_images(hz):
    cells = [swimmer(k, 5.0, hz=hz, velocity=(88.0, 0.0)) for k in range(3)]
    paths = select_swimming_tracks(SOURCE, cells, False).paths
    assert find_organism_by_speed(paths).name == "euglena"


def test_the_organism_is_that_of_the_middle_cell():
    speeds = (900.0, 88.0, 85.0)
    cells = [swimmer(k, velocity=(0.0, speed)) for k, speed in enumerate(speeds)]
    assert (
        find_organism_by_speed(select_swimming_tracks(SOURCE, cells, False).paths).name == "euglena"
    )


def record(tracks, field=None, organism="tetrahymena"):
    cells = select_swimming_tracks(SOURCE, tracks, False)
    return create_track_record(Path("folder") / SOURCE, cells, find_organism(organism), field)


def test_a_record_says_what_was_fitted():
    result = record([swimmer(3), swimmer(8)])
    assert result["tracks"] == "tracks.csv"
    assert result["rate_hz"] == pytest.approx(HZ)
    assert result["organism"] == "tetrahymena"
    assert [cell["cell"] for cell in result["cells"]] == [3, 8]
    assert result["field"] is None
    (note,) = result["notes"]
    assert note.startswith("the cells are tracked as tetrahymena")
    for cell in result["cells"]:
        assert cell["speed_um_s"]["value"] == pytest.approx(130.0, rel=0.05)
        assert cell["vsl_um_s"] == pytest.approx(130.0)


def test_a_record_has_the_field_as_it_was_read():
    result = record([swimmer(3)], TURNS)
    assert result["field"]["time_s"] == TURNS.times.tolist()
    assert result["field"]["x"] == pytest.approx(np.cos(TURNS.angles))
    assert result["field"]["y"] == pytest.approx(np.sin(TURNS.angles))


def test_rare_images_are_noted_instead_of_the_organism():
    result = record([swimmer(3, 30.0, hz=4.0)])
    (note,) = result["notes"]
    assert note.startswith("with fewer than 7 images/s, the speed")
    assert result["cells"][0]["speed_um_s"] is None
    assert result["cells"][0]["vsl_um_s"] == pytest.approx(130.0)
