"""Tracks from CSV files: of `tetractl export`, and as other programs write them."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from tetractl.core.errors import UsageError
from tetractl.replay.identification.csv_tracks import csv_tracks
from tetractl.replay.identification.identify import identify

POSES = "time_s,robot,x_mm,y_mm,heading_rad,valid\n0,one,1,2,0.1,True\n0.1,one,3,2,0.2,False\n"
COMMANDS = "time_s,direction_rad\n0,0.5\n0.2,0.7\n"


def test_csv_files_are_read(tmp_path):
    (tmp_path / "p.csv").write_text(POSES)
    (tmp_path / "c.csv").write_text(COMMANDS)
    (track,) = csv_tracks([tmp_path / "c.csv", tmp_path / "p.csv"])
    assert (track.unit, track.names, track.origin) == ("mm", ("one",), "CSV")
    assert track.valid.ravel().tolist() == [True, False]
    assert track.poses[0, 0].tolist() == [1, 2, 0.1]
    assert (track.u.tolist(), track.until) == ([0.5, 0.7], pytest.approx(0.4))


def test_the_lag_of_wheels_is_that_of_the_commands(tmp_path):
    (tmp_path / "p.csv").write_text(POSES)
    (tmp_path / "c.csv").write_text("time_s,direction_rad,lag_ms\n0,0.5,40\n0.2,0.7,40\n")
    (track,) = csv_tracks([tmp_path / "p.csv", tmp_path / "c.csv"])
    assert track.lag == pytest.approx(0.04) and track.on_wheels
    (tmp_path / "c.csv").write_text("time_s,direction_rad,lag_s\n0,0.5,-1\n0.2,0.7,1\n")
    with pytest.raises(UsageError, match="line 2: lag_s must not be negative"):
        csv_tracks([tmp_path / "p.csv", tmp_path / "c.csv"])


def test_positions_whose_y_runs_downwards_are_not_those_of_the_headings(tmp_path):
    """Regression: speeds 8 and 31 % low, with intervals without the true ones."""
    time = np.arange(20) / 10
    heading = 0.3 + time
    x, y = np.cumsum([np.cos(heading), np.sin(heading)], axis=1)
    (tmp_path / "c.csv").write_text(COMMANDS)
    for down, says in ((1, None), (-1, "only with y reversed")):
        rows = np.column_stack([time, np.full(20, 7), x, down * y, heading])
        header = "time_s,robot,x_mm,y_mm,heading_rad"
        np.savetxt(tmp_path / "p.csv", rows, delimiter=",", header=header, comments="")
        if says is None:
            assert csv_tracks([tmp_path / "p.csv", tmp_path / "c.csv"])
            continue
        with pytest.raises(UsageError, match=says):
            csv_tracks([tmp_path / "p.csv", tmp_path / "c.csv"])


def test_poses_and_commands_of_one_path_are_a_trial(tmp_path):
    paths = [tmp_path / "p.csv", tmp_path / "c.csv"]
    for path, text in zip(paths, (POSES, COMMANDS), strict=True):
        head, *rows = text.splitlines()
        named = [f"{log},{row}" for log in ("a.mcap", "b.mcap") for row in rows]
        path.write_text("\n".join([f"path,{head}", *named]))
    found = csv_tracks(paths)
    assert [track.poses.shape for track in found] == [(2, 1, 3)] * 2


@pytest.mark.parametrize(
    ("poses", "commands", "says"),
    [
        (POSES.replace("x_mm", "x"), COMMANDS, "needs columns x_mm and y_mm"),
        (POSES, COMMANDS.replace("direction_rad", "u"), "contains neither poses nor commands"),
        (POSES.replace("0.2,False", "x,True"), COMMANDS, "heading_rad: 'x' is not a number"),
        (POSES, "time_s,direction_rad,path\n0,0.5,a\n", "poses and commands are needed"),
    ],
)
def test_what_is_wrong_with_a_csv_file_is_told(tmp_path, poses, commands, says):
    (tmp_path / "p.csv").write_text(poses)
    (tmp_path / "c.csv").write_text(commands)
    with pytest.raises(UsageError, match=says):
        csv_tracks([tmp_path / "p.csv", tmp_path / "c.csv"])


A, SPEED, RATE_HZ = 4.0, 180.0, 30.0
"""Turning rate [rad/s] and speed [mm/s] of the robot that drives in `driven`, and its frames."""


def driven():
    """Rows (M, 4) of time [s], x, y [mm] and heading [rad] of a robot that follows directions, and
    rows (C, 2) of times and directions [rad]."""
    sent = np.column_stack([np.arange(0, 12, 1.5), np.tile([0.0, 1.57, 3.0, -1.57], 2)])
    state = np.array([0.0, 0.0, 0.3])
    poses = []
    for k in range(round(12 * RATE_HZ)):
        time = k / RATE_HZ
        poses.append((time, *state))
        for _ in range(10):  # substeps of the exact motion
            u = sent[np.searchsorted(sent[:, 0], time, side="right") - 1, 1]
            course = [SPEED * math.cos(state[2]), SPEED * math.sin(state[2])]
            state = state + np.array([*course, A * math.sin(u - state[2])]) / RATE_HZ / 10
    return np.array(poses), sent


def files(folder: Path, poses: str, commands: str, **how: str) -> list[Path]:
    """Write poses and commands, `how` they are written by the names of the forms below."""
    rows, sent = driven()
    paths = [folder / "poses.csv", folder / "commands.csv"]
    for path, header, table in zip(paths, (poses, commands), (rows, sent), strict=True):
        scaled = table.copy()
        scaled[:, 0] = float(how.get("since", 0)) + table[:, 0] * float(how.get("times", 1))
        if "deg" in header:
            scaled[:, -1] = np.degrees(table[:, -1])
        separator = how.get("separator", ",")
        lines = [header]
        for row in scaled:
            words = [repr(float(number)) for number in row]
            if path == paths[0]:
                words.insert(1, "green")
            line = separator.join(words)
            lines.append(line.replace(".", ",") if "comma" in how else line)
        text = "\n".join([*how.get("above", "").splitlines(), *lines, ""])
        path.write_bytes(text.encode(how.get("encoding", "utf-8")))
    return paths


PLAIN = ("time_s,robot,x_mm,y_mm,heading_rad", "time_s,direction_rad")
FORMS = {
    "plain": (*PLAIN, {}),
    "Unix seconds": (*PLAIN, {"since": "1764000000.25"}),
    "Unix milliseconds": (
        "time_ms,robot,x_mm,y_mm,heading_rad",
        "time_ms,direction_rad",
        {"since": "1764000000250", "times": "1000"},
    ),
    "nanoseconds": (
        "timestamp [ns],robot,x_mm,y_mm,heading_rad",
        "timestamp [ns],direction_rad",
        {"since": "1764000000250000000", "times": "1e9"},
    ),
    "degrees": ("time_s,robot,x_mm,y_mm,heading_deg", "time_s,direction (deg)", {}),
    "spaces": ("time_s, robot, x_mm, y_mm, heading_rad", "time_s, direction_rad", {}),
    "semicolons and decimal commas": (
        PLAIN[0].replace(",", ";"),
        PLAIN[1].replace(",", ";"),
        {"separator": ";", "comma": "yes"},
    ),
    "tabs": (PLAIN[0].replace(",", "\t"), PLAIN[1].replace(",", "\t"), {"separator": "\t"}),
    "blanks": (PLAIN[0].replace(",", " "), PLAIN[1].replace(",", " "), {"separator": " "}),
    "NumPy's header": (
        "# " + PLAIN[0].replace(",", " "),
        "# " + PLAIN[1].replace(",", " "),
        {"separator": " "},
    ),
    "comments": (*PLAIN, {"above": "# exported by hand\n# 2026-11-26"}),
    "Excel's first line": (
        PLAIN[0].replace(",", ";"),
        PLAIN[1].replace(",", ";"),
        {"separator": ";", "above": "sep=;"},
    ),
    "UTF-16": (*PLAIN, {"encoding": "utf-16"}),
    "a byte order mark": (*PLAIN, {"encoding": "utf-8-sig"}),
    "Latin-1": (*PLAIN, {"above": "# gr\xfcn", "encoding": "latin-1"}),
    "capitals": ("Time_s,robot,X [mm],Y [mm],Heading [rad]", "Time (s),Direction (rad)", {}),
}


@pytest.mark.parametrize("form", FORMS)
def test_a_table_is_read_however_it_is_written(tmp_path, form):
    poses, commands, how = FORMS[form]
    (track,) = csv_tracks(files(tmp_path, poses, commands, **how))
    rows, sent = driven()
    assert track.unit == "mm"
    assert track.time == pytest.approx(rows[:, 0], abs=1e-6)
    assert track.poses[:, 0] == pytest.approx(rows[:, 1:], abs=1e-9)
    assert track.sent == pytest.approx(sent[:, 0], abs=1e-6)
    assert track.u == pytest.approx(sent[:, 1], abs=1e-9)
    assert not track.remarks


@pytest.mark.slow
def test_a_is_right_of_a_table_in_unix_seconds(tmp_path):
    found = identify(csv_tracks(files(tmp_path, *PLAIN, since="1764000000.25")), None)
    assert found.robots[0].a.value == pytest.approx(A, rel=0.01)


REFUSED = {
    "directions in degrees": (
        PLAIN[0],
        "time_s,direction_rad",
        "0,0\n1,90\n",
        "commands.csv, line 3: direction_rad: 90 is more than a whole turn",
    ),
    "another clock": (
        *PLAIN,
        "1000,0\n1001,1\n",
        "commands.csv, 1000 to 1001 s: no time is among those of .*poses.csv, 0 to 11.9",
    ),
    "no unit": (PLAIN[0], "time,direction_rad", "0,0\n1,1\n", "column time states no unit"),
    "an unknown unit": (
        PLAIN[0],
        "time (fortnights),direction_rad",
        "0,0\n1,1\n",
        "column time \\(fortnights\\) is in fortnights",
    ),
    "decimal commas": (*PLAIN, "0,5,1,2\n", "line 2: has 4 entries, the header has 2"),
    "quoted decimal commas": (*PLAIN, '0,"1,5"\n', "direction_rad: '1,5' is not a number"),
    "no header": (PLAIN[0], "0,0", "1,1\n", "has no header"),
    "a column twice": (PLAIN[0], "time_s,direction_rad,time_s", "0,0,0\n", "two columns time_s"),
    "a null character": (*PLAIN, "0,0\n1,\0\n", "line 3: is not a CSV file"),
    "words": (*PLAIN, "0,0\n1,north\n", "line 3: direction_rad: 'north' is not a number"),
    "an unknown time": (*PLAIN, "0,0\nNaN,1\n", "line 3: time_s: states no number"),
    "nothing sent": (*PLAIN, "0,\n1,NaN\n", "states no direction"),
    "no rows": (*PLAIN, "", "has no rows"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_right_is_refused(tmp_path, case):
    poses, header, rows, says = REFUSED[case]
    paths = files(tmp_path, poses, "time_s,direction_rad")
    paths[1].write_text(f"{header}\n{rows}")
    with pytest.raises(UsageError, match=says) as error:
        csv_tracks(paths)
    assert ("decimal comma" in str(error.value)) == ("decimal comma" in case)


@pytest.mark.parametrize("degrees", [True, False])
def test_headings_beyond_a_turn_are_degrees_or_whole_turns_by_the_motion(tmp_path, degrees):
    paths = files(tmp_path, *PLAIN)
    lines = [PLAIN[0]]
    for time, x, y, heading in driven()[0]:
        written = math.degrees(heading) if degrees else heading + 2 * math.pi
        lines.append(f"{time},green,{x},{y},{written}")
    paths[0].write_text("\n".join([*lines, ""]))
    if degrees:
        with pytest.raises(UsageError, match=r"a heading of .* is more than a whole turn"):
            csv_tracks(paths)
    else:
        assert csv_tracks(paths)[0].valid.all()


@pytest.mark.parametrize(
    ("times", "says"),
    [
        ("0,0\n1,1\n", "covers 2 s of the"),
        ("0,0\n1500,1\n3000,2\n", "only 1 of the 3 times .* are they in s"),
    ],
)
def test_spans_that_hardly_meet_are_said(tmp_path, times, says):
    paths = files(tmp_path, *PLAIN)
    paths[1].write_text(f"{PLAIN[1]}\n{times}")
    (track,) = csv_tracks(paths)
    (remark,) = track.remarks
    assert pytest.approx(track.time[-1], abs=0.1) == 12
    assert re.search(says, remark)


@pytest.mark.parametrize("table", ["poses", "directions", "speeds"])
def test_times_that_fall_are_refused(tmp_path, table):
    """Regression: rows were sorted, and a countdown gave the prior's a without a word."""
    paths = files(tmp_path, *PLAIN)
    if table == "speeds":
        paths[1].write_text("time_s,v_mm_s,w_rad_s\n0,180,1\n2,180,2\n")
    falling = paths[table != "poses"]
    header, first, second, *rest = falling.read_text().splitlines()
    falling.write_text("\n".join([header, second, first, *rest, ""]))
    with pytest.raises(UsageError, match=rf"{falling.name}, line 3: the time is earlier"):
        csv_tracks(paths)


@pytest.mark.parametrize(
    ("factor", "says"),
    [
        (RATE_HZ, "robots turn at its times if these are numbers of pictures"),
        (1e3, "robots turn at its times if these are milliseconds"),
        (1 / 60, "robots turn at its times if these are minutes"),
    ],
)
def test_times_of_another_unit_are_refused_by_how_robots_turn(tmp_path, factor, says):
    """Regression: a was .4 to .9 of the true one."""
    paths = files(tmp_path, *PLAIN)
    sent = driven()[1]
    rows = "".join(f"{factor * time!r},{direction!r}\n" for time, direction in sent.tolist())
    paths[1].write_text(f"{PLAIN[1]}\n{rows}")
    with pytest.raises(UsageError, match=rf"commands\.csv: {says}"):
        csv_tracks(paths)


def mirrored(folder: Path) -> list[Path]:
    """Poses whose y and headings are reversed, and the directions that robots turned by."""
    paths = files(folder, *PLAIN)
    rows = "".join(f"{t!r},green,{x!r},{-y!r},{-h!r}\n" for t, x, y, h in driven()[0].tolist())
    paths[0].write_text(f"{PLAIN[0]}\n{rows}")
    return paths


def test_a_mirrored_picture_is_refused_by_how_robots_turn(tmp_path):
    """Regression: poses agree with their headings, and a was wrong without a word."""
    with pytest.raises(UsageError, match=r"robots turn right where .*commands\.csv turns left"):
        csv_tracks(mirrored(tmp_path))


def test_a_direction_that_never_changes_shows_no_side(tmp_path):
    paths = mirrored(tmp_path)
    paths[1].write_text(f"{PLAIN[1]}\n0,0.5\n5,0.5\n11,0.5\n")
    assert not csv_tracks(paths)[0].remarks


def test_a_row_without_a_direction_is_a_step_at_which_nothing_was_sent(tmp_path):
    """Regression: `identify` refused the steps.csv of `export`, whose last row has none."""
    paths = files(tmp_path, *PLAIN)
    with paths[1].open("a") as file:
        file.write("11.5,\n")
    (track,) = csv_tracks(paths)
    assert track.sent.tolist() == driven()[1][:, 0].tolist()
