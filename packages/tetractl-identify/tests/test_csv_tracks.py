"""Tests of reading tracks from CSV files, both from `tetractl export` and from other programs."""

import bz2
import gzip
import math
from dataclasses import dataclass

import numpy as np
import pytest
from tetractl_identify.csv_tracks import read_csv_tracks

from tetractl.core.errors import UsageError

POSES = "time_s,robot,x_mm,y_mm,heading_rad,valid\n0,one,1,2,0.1,True\n0.1,one,3,2,0.2,False\n"
COMMANDS = "time_s,direction_rad\n0,0.5\n0.2,0.7\n"


def tracks_of(folder, poses, commands):
    """The tracks of a table of poses and a table of commands."""
    paths = [folder / "p.csv", folder / "c.csv"]
    paths[0].write_text(poses)
    paths[1].write_text(commands)
    return read_csv_tracks(paths)


def of_a_log(table):
    """A table as `export` writes it, with a column that names the log."""
    header, *rows = table.split()
    return "\n".join([f"{header},log", *(f"{row},one.mcap" for row in rows), ""])


@pytest.mark.parametrize("names", [("p.csv", "c.csv"), ("c.csv", "p.csv")])
def test_csv_files_are_read_in_any_order(tmp_path, names):
    (tmp_path / "p.csv").write_text(POSES)
    (tmp_path / "c.csv").write_text(COMMANDS)
    (track,) = read_csv_tracks([tmp_path / name for name in names])
    assert track.unit == "mm"
    assert track.names == ("one",)
    assert track.origin == "CSV"
    assert track.valid.ravel().tolist() == [True, False]
    assert track.poses[0, 0].tolist() == [1, 2, 0.1]
    assert track.direction_rad.tolist() == [0.5, 0.7]
    assert track.stop_s == pytest.approx(0.4)  # the last command acts for a period


def test_the_lag_of_wheels_is_that_of_the_commands(tmp_path):
    with_lag = "time_s,direction_rad,lag_ms\n0,0.5,40\n0.2,0.7,40\n"
    (track,) = tracks_of(tmp_path, POSES, with_lag)
    assert track.lag_s == pytest.approx(0.04)
    assert track.on_wheels
    assert track.rates_unstated
    (track,) = tracks_of(tmp_path, *(of_a_log(table) for table in (POSES, with_lag)))
    assert not track.rates_unstated  # by tetractl's host


def of_two_logs(text):
    """The same table twice, with a column that names the log."""
    header, *rows = text.splitlines()
    of_a = [f"a.mcap,{row}" for row in rows]
    of_b = [f"b.mcap,{row}" for row in rows]
    return "\n".join([f"path,{header}", *of_a, *of_b])


def test_poses_and_commands_of_one_path_are_a_trial(tmp_path):
    tracks = tracks_of(tmp_path, of_two_logs(POSES), of_two_logs(COMMANDS))
    assert [track.poses.shape for track in tracks] == [(2, 1, 3), (2, 1, 3)]


A_RAD_S = 4.0
SPEED_MM_S = 180.0
FRAME_RATE_HZ = 30.0
DRIVE_S = 12


@dataclass(frozen=True)
class Tables:
    """Rows (M, 4) of time [s], x, y [mm] and heading [rad], and rows (C, 2) of times [s] and
    directions [rad]."""

    poses: np.ndarray
    commands: np.ndarray


def drive():
    """The tables of a robot that follows a new direction every 1.5 s."""
    sent_s = np.arange(0, DRIVE_S, 1.5)
    directions = np.tile([0.0, 1.57, 3.0, -1.57], 2)
    substep_s = 1 / FRAME_RATE_HZ / 10
    pose = np.array([0.0, 0.0, 0.3])
    poses = []
    for k in range(round(DRIVE_S * FRAME_RATE_HZ)):
        time_s = k / FRAME_RATE_HZ
        poses.append((time_s, *pose))
        direction = directions[np.searchsorted(sent_s, time_s, side="right") - 1]
        for _ in range(10):
            heading = pose[2]
            velocity = SPEED_MM_S * np.array([math.cos(heading), math.sin(heading)])
            turning = A_RAD_S * math.sin(direction - heading)
            pose = pose + substep_s * np.array([*velocity, turning])
    return Tables(np.array(poses), np.column_stack([sent_s, directions]))


PLAIN_POSES = "time_s,robot,x_mm,y_mm,heading_rad"
PLAIN_COMMANDS = "time_s,direction_rad"


@dataclass(frozen=True)
class Form:
    """How the two tables are written: their headers; the time 0, in the header's unit, of which a
    second has `units_per_s`; how numbers are set apart and written, and the lines above.
    """

    poses: str = PLAIN_POSES
    commands: str = PLAIN_COMMANDS
    start: float = 0.0
    units_per_s: float = 1.0
    separator: str = ","
    decimal_comma: bool = False
    lines_above: tuple[str, ...] = ()
    encoding: str = "utf-8"

    def line(self, numbers, robot=None):
        """One row of a table."""
        words = [repr(float(number)) for number in numbers]
        if robot is not None:
            words.insert(1, robot)
        text = self.separator.join(words)
        return text.replace(".", ",") if self.decimal_comma else text

    def numbers(self, header, table):
        """The rows of a table in the units of its header; angles are in the last column."""
        rows = table.copy()
        rows[:, 0] = self.start + table[:, 0] * self.units_per_s
        if "deg" in header:
            rows[:, -1] = np.degrees(table[:, -1])
        return rows


PLAIN = Form()


def write_table(path, form, header, table, robot=None):
    rows = [form.line(row, robot) for row in form.numbers(header, table)]
    text = "\n".join([*form.lines_above, header, *rows, ""])
    path.write_bytes(text.encode(form.encoding))


def write_drive(folder, form=PLAIN):
    """Write poses and commands of the drive; return both paths."""
    tables = drive()
    paths = [folder / "poses.csv", folder / "commands.csv"]
    write_table(paths[0], form, form.poses, tables.poses, robot="green")
    write_table(paths[1], form, form.commands, tables.commands)
    return paths


def separated_by(separator, comment="", **how):
    """Plain headers with another separator."""
    return Form(
        poses=comment + PLAIN_POSES.replace(",", separator),
        commands=comment + PLAIN_COMMANDS.replace(",", separator),
        separator=separator,
        **how,
    )


FORMS = {
    "plain": PLAIN,
    "Unix seconds": Form(start=1764000000.25),
    "Unix milliseconds": Form(
        poses="time_ms,robot,x_mm,y_mm,heading_rad",
        commands="time_ms,direction_rad",
        start=1764000000250.0,
        units_per_s=1e3,
    ),
    "nanoseconds": Form(
        poses="timestamp [ns],robot,x_mm,y_mm,heading_rad",
        commands="timestamp [ns],direction_rad",
        start=1764000000250000000.0,
        units_per_s=1e9,
    ),
    "degrees": Form(poses="time_s,robot,x_mm,y_mm,heading_deg", commands="time_s,direction (deg)"),
    "spaces": Form(
        poses="time_s, robot, x_mm, y_mm, heading_rad", commands="time_s, direction_rad"
    ),
    "semicolons and decimal commas": separated_by(";", decimal_comma=True),
    "tabs": separated_by("\t"),
    "bars": separated_by("|"),
    "blanks": separated_by(" "),
    "NumPy's header": separated_by(" ", comment="# "),
    "comments": Form(lines_above=("# exported by hand", "# 2026-11-26")),
    "Excel's first line": separated_by(";", lines_above=("sep=;",)),
    "UTF-16": Form(encoding="utf-16"),
    "a byte order mark": Form(encoding="utf-8-sig"),
    "Latin-1": Form(lines_above=("# gr\xfcn",), encoding="latin-1"),
    "capitals": Form(
        poses="Time_s,robot,X [mm],Y [mm],Heading [rad]", commands="Time (s),Direction (rad)"
    ),
}


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS.keys())
def test_a_table_is_read_however_it_is_written(tmp_path, form):
    (track,) = read_csv_tracks(write_drive(tmp_path, form))
    tables = drive()
    assert track.unit == "mm"
    assert track.time_s == pytest.approx(tables.poses[:, 0], abs=1e-6)
    assert track.poses[:, 0] == pytest.approx(tables.poses[:, 1:], abs=1e-9)
    assert track.sent_s == pytest.approx(tables.commands[:, 0], abs=1e-6)
    assert track.direction_rad == pytest.approx(tables.commands[:, 1], abs=1e-9)
    assert not track.remarks


@pytest.mark.parametrize("corner", ["", " "])
@pytest.mark.parametrize("separator", [",", "\t", ";"])
def test_a_column_without_a_name_is_left_out(tmp_path, separator, corner):
    """Regression: with tabs, as pandas writes its index, and ImageJ the numbers of rows, "has 6
    entries, but the header has 5"."""
    paths = write_drive(tmp_path, separated_by(separator))
    plain = read_csv_tracks(paths)
    for path in paths:
        header, *rows = path.read_text().splitlines()
        numbered = [f"{k}{separator}{row}" for k, row in enumerate(rows)]
        path.write_text("\n".join([f"{corner}{separator}{header}", *numbered]))
    (track,) = read_csv_tracks(paths)
    assert np.array_equal(track.poses, plain[0].poses)
    assert np.array_equal(track.direction_rad, plain[0].direction_rad)


def write_headings(folder, heading_of):
    """Write the drive with other headings [rad], by the time [s] and the heading; return both
    paths."""
    paths = write_drive(folder)
    rows = [(*row[:3], heading_of(row[0], row[3])) for row in drive().poses]
    write_table(paths[0], PLAIN, PLAIN_POSES, np.array(rows), robot="green")
    return paths


@pytest.mark.parametrize("aside_mm", [0.0, 5.0])
def test_a_robot_at_two_places_at_once_is_refused(tmp_path, aside_mm):
    """Regression: tracks with one name for all robots gave an a of 0.009 [0.001, 0.066] for 4."""
    poses, commands = write_drive(tmp_path)
    with poses.open("a") as file:
        time_s, x_mm, y_mm, heading_rad = drive().poses[-1]
        file.write(f"{time_s},green,{x_mm + aside_mm},{y_mm},{heading_rad}\n")
    if aside_mm == 0.0:
        (track,) = read_csv_tracks([poses, commands])
        assert track.valid.all()
    else:
        with pytest.raises(UsageError, match=r"poses\.csv: green has two different places at .* s"):
            read_csv_tracks([poses, commands])


def test_two_places_at_one_unix_time_are_refused_with_that_time(tmp_path):
    """Regression: "at 1.764e+09 s", by which no row is found."""
    poses, commands = write_drive(tmp_path)
    lines = poses.read_text().splitlines()
    places = [line.split(",", 1)[1] for line in lines[1:]]
    rows = [f"{1_764_000_003 + k // 30},{place}" for k, place in enumerate(places)]
    poses.write_text("\n".join([lines[0], *rows, ""]))
    with pytest.raises(UsageError, match="green has two different places at 1764000003 s"):
        read_csv_tracks([poses, commands])


NOT_SENT = ["nan,nan", ",", "90,", "NULL,0.5"]


@pytest.mark.parametrize(
    "commands",
    [
        *(f"time_s,v_mm_s,w_rad_s\n0,90,0.1\n0.1,{entries}\n0.2,90,0.3\n" for entries in NOT_SENT),
        *(
            f"time_s,left_mm_s,right_mm_s,radius_mm\n0,90,0.1,40\n0.1,{entries},40\n0.2,90,0.3,40\n"
            for entries in NOT_SENT
        ),
        "time_s,direction_rad\n0,0.5\n0.2,0.7\n0.3,\n",
    ],
)
def test_at_a_row_without_speeds_or_a_direction_nothing_was_sent(tmp_path, commands):
    """Regression: `identify` refused the steps.csv of `export`, whose last row has no direction."""
    (track,) = tracks_of(tmp_path, POSES, commands)
    assert track.sent_s.tolist() == pytest.approx([0.0, 0.2])


# ---- Units, names, one robot, two recordings ----


SPEEDS = ["v_mm_s", "v_cm_s", "v [m/s]", "v_m/s", "v m/s", "v (mm/s)", "v_um_s", "V_mm_per_s"]
PER_METRE = [1e3, 1e2, 1.0, 1.0, 1.0, 1e3, 1e6, 1e3]


@pytest.mark.parametrize(("column", "per_metre"), list(zip(SPEEDS, PER_METRE, strict=True)))
def test_speeds_are_in_the_unit_of_their_column(tmp_path, column, per_metre):
    """Regression: the unit was read and dropped, and a speed gain was 0.000951 for 0.951."""
    poses = POSES.replace("_mm", "_m").replace(",False", ",True")
    commands = f"time_s,{column},w_rad_s\n0,{0.1 * per_metre},1\n0.2,{0.2 * per_metre},2\n"
    (track,) = tracks_of(tmp_path, poses, commands)
    assert track.twists[:, 0] == pytest.approx(np.array([(0.1, 1.0), (0.2, 2.0)]))


@pytest.mark.parametrize(
    ("left", "right", "radius", "row"),
    [
        ("left_mm_s", "right_mm_s", "radius_mm", "100,200,50"),
        ("left_mm_s", "right_mm_s", "radius_m", "100,200,0.05"),
        ("left_m_s", "right_m_s", "radius_cm", "0.1,0.2,5"),
        ("left_cm_s", "right_mm_s", "radius_m", "10,200,0.05"),
        ("left (mm/s)", "right (m/s)", "radius (mm)", "100,0.2,50"),
    ],
)
def test_wheels_are_in_the_units_of_their_columns(tmp_path, left, right, radius, row):
    poses = POSES.replace(",False", ",True")
    commands = f"time_s,{left},{right},{radius}\n0,{row}\n0.2,{row}\n"
    (track,) = tracks_of(tmp_path, poses, commands)
    assert track.twists[0, 0] == pytest.approx([150.0, 1.0])  # mm/s, as the poses


TWO_POSES = "time_s,robot,x_mm,y_mm,heading_rad\n" + "".join(
    f"{t / 10},{name},{t * 9},{aside},0.1\n"
    for t in range(8)
    for name, aside in (("a", 0), ("b", 50))
)
ONE_POSES = "time_s,x_mm,y_mm,heading_rad\n" + "".join(
    f"{t / 10},{t * 9},0,0.1\n" for t in range(8)
)
NO_NAME = "time_s,v_mm_s,w_rad_s\n" + "".join(f"{t / 10},90,{t}\n" for t in range(8))


def sent_to(*names):
    """Speeds for some robots."""
    rows = [f"{t / 10},{name},90,{t}\n" for t in range(8) for name in names]
    return "time_s,robot,v_mm_s,w_rad_s\n" + "".join(rows)


@pytest.mark.parametrize(
    ("poses", "commands", "names"),
    [
        (ONE_POSES, NO_NAME, ("robot",)),
        (ONE_POSES, sent_to("a"), ("robot",)),
        (TWO_POSES, NO_NAME, ("a", "b")),
        (TWO_POSES, sent_to("a", "b"), ("a", "b")),
        (TWO_POSES, sent_to("a", "b", "c"), ("a", "b")),
        (TWO_POSES, sent_to("b"), ("b",)),  # a is said to be sent nothing
    ],
)
def test_robots_are_those_of_the_commands(tmp_path, poses, commands, names):
    (track,) = tracks_of(tmp_path, poses, commands)
    assert track.names == names
    assert track.twists[:, :, 1] == pytest.approx(np.tile(np.arange(8.0), (len(names), 1)).T)
    assert [text for text in track.remarks if "no command is for a" in text] == [
        text for text in track.remarks if names == ("b",)
    ]


def test_a_robot_without_commands_is_said_with_the_names_of_those_that_have_some(tmp_path):
    """Regression: "no command is for a" did not say that commands are for "3"."""
    (track,) = tracks_of(tmp_path, TWO_POSES, sent_to("b", "3"))
    assert any("no command is for a; all commands are for 3, b" in text for text in track.remarks)
    assert f"{tmp_path / 'p.csv'}: the file has no pose of 3" in track.remarks


def test_names_that_look_alike_are_alike(tmp_path):
    """Regression: "no command is for Gr\u00fcn; commands are for Gr\u00fcn"."""
    composed = TWO_POSES.replace(",a,", ",Gr\u00fcn,")
    (track,) = tracks_of(tmp_path, composed, sent_to("Gru\u0308n", "\uff42"))
    assert set(track.names) == {"Gr\u00fcn", "b"}
    assert not any("no command" in text for text in track.remarks)


def test_poses_without_a_name_are_said(tmp_path):
    """Regression: "no command is for ; commands are for b"."""
    (track,) = tracks_of(tmp_path, TWO_POSES.replace(",a,", ",,"), sent_to("b"))
    assert any("no command is for rows without a robot" in text for text in track.remarks)


LOST = "time_s,robot,x_mm,y_mm,heading_rad\n" + "".join(
    f"{t / 10},a,{t * 9},0,0.1\n{t / 10},b,,,\n" for t in range(8)
)


def test_a_robot_may_be_seen_in_one_of_two_trials(tmp_path):
    """The second robot is, in the second trial alone."""
    place_of_b = {1: ",,", 2: "{x},9,0.1"}
    poses = "time_s,robot,x_mm,y_mm,heading_rad,trial\n"
    commands = "time_s,v_mm_s,w_rad_s,trial\n"
    for trial in (1, 2):
        for t in range(8):
            poses += f"{t / 10},a,{t * 9},0,0.1,{trial}\n"
            poses += f"{t / 10},b,{place_of_b[trial].format(x=t * 9)},{trial}\n"
            commands += f"{t / 10},90,{t},{trial}\n"
    first, second = tracks_of(tmp_path, poses, commands)
    assert first.names == second.names == ("a", "b")
    assert first.valid.sum(axis=0).tolist() == [8, 0]
    assert second.valid.sum(axis=0).tolist() == [8, 8]


def retimed(table, time_of):
    """The rows of a table with other times, by their own, below its header."""
    header, *rows = table.splitlines()
    cells = [row.partition(",") for row in rows]
    return "\n".join([header, *(f"{time_of(float(time))},{rest}" for time, _, rest in cells), ""])


def twice(table, later_s=0.0):
    """A table whose rows follow once more, from their first time or a little later on."""
    _, _, again = retimed(table, lambda time_s: time_s + later_s).partition("\n")
    return table + again


@pytest.mark.parametrize("later_s", [0.0, 0.05])
@pytest.mark.parametrize("poses", [ONE_POSES, TWO_POSES])
def test_two_recordings_in_one_table_are_told(tmp_path, poses, later_s):
    """Regression: they were to be sorted by time, which mixes them."""
    with pytest.raises(UsageError, match=r"time goes back .*\nhint: .*column named trial"):
        tracks_of(tmp_path, twice(poses, later_s), NO_NAME)
    with pytest.raises(UsageError, match=r"c\.csv.*time goes back .*\nhint: .*column named trial"):
        tracks_of(tmp_path, poses, twice(NO_NAME, later_s))


def test_two_recordings_by_two_clocks_are_told(tmp_path):
    """Regression: a grid of half seconds from one to the other took all memory."""
    poses = twice(ONE_POSES, 1_764_000_000.0)
    with pytest.raises(UsageError, match=r"no pose between .*\nhint: .*column named trial"):
        tracks_of(tmp_path, poses, NO_NAME)


def test_a_recording_that_begins_amidst_another_may_be_numbered(tmp_path):
    """Regression: they were only to be sorted by time, which mixes them."""
    middle_s = float(ONE_POSES.splitlines()[-1].partition(",")[0]) / 2
    with pytest.raises(
        UsageError, match=r"earlier than in the line before\nhint: sort.*column named trial instead"
    ):
        tracks_of(tmp_path, twice(ONE_POSES, middle_s), NO_NAME)


def poses_at(times):
    """A table of a robot that drives straight on, at these times."""
    rows = [f"{float(time_s)},{k},0,0" for k, time_s in enumerate(times)]
    return "\n".join(["time_s,x_mm,y_mm,heading_rad", *rows, ""])


def sent(rows):
    """A table of directions."""
    return f"{PLAIN_COMMANDS}\n{rows}"


FOR_EACH = "time_s,robot,direction_rad\n" + "".join(
    f"{t / 10},{robot},{t / 9}\n" for t in range(8) for robot in "ab"
)
LAG_BELOW_0 = "time_s,direction_rad,lag_s\n0,0.5,-1\n0.2,0.7,1\n"
NEVER_SEEN = LOST.replace(",a,", ",b,").replace("0.1\n", "\n")


@pytest.mark.parametrize(
    ("poses", "commands", "says"),
    [
        (POSES.replace("x_mm", "x"), COMMANDS, "needs the columns x_mm and y_mm"),
        (POSES, COMMANDS.replace("direction_rad", "u"), "contains neither poses nor commands"),
        (POSES.replace("0.2,False", "x,True"), COMMANDS, "heading_rad: 'x' is not a number"),
        (POSES, "time_s,direction_rad,path\n0,0.5,a\n", "each trial needs a file of poses and"),
        (POSES, LAG_BELOW_0, "line 2: lag_s must not be negative"),
        (
            TWO_POSES,
            sent_to("1", "2"),
            "no command is for the robots a, b; .* 1, 2",
        ),
        (
            TWO_POSES,
            sent_to("A", "B"),
            "no command is for the robots a, b; .* A, B",
        ),
        (
            ONE_POSES,
            sent_to("a", "b"),
            "no column named robot, but .* robots a, b",
        ),
        (TWO_POSES.replace("robot", "body"), NO_NAME, "two different places at 0 s"),
        (
            TWO_POSES,
            FOR_EACH.replace("0.7,b,", "0.7,b,1"),
            "b does not receive the directions of",
        ),
        (NEVER_SEEN, COMMANDS, "no robot was seen"),
        (ONE_POSES + ONE_POSES, NO_NAME, "line 10: the header occurs a second time"),
        (
            ONE_POSES.replace("heading_rad", "theta_rad"),
            NO_NAME,
            "poses, but lacks heading_rad; its",
        ),
        (ONE_POSES.replace("time_s", "frame"), NO_NAME, "poses, but lacks time_s; its columns"),
        (ONE_POSES.replace("y_mm", "z_mm"), NO_NAME, "poses, but lacks y_mm; its columns"),
        (ONE_POSES, NO_NAME.replace("w_rad_s", "turn"), "speeds, but lacks w_rad_s; its columns"),
        (ONE_POSES, NO_NAME.replace("v_mm_s", "speed"), "speeds, but lacks v_mm_s; its columns"),
        (ONE_POSES, "time_s,left_mm_s,right_mm_s\n0,1,2\n", "wheels, but lacks radius_mm; its"),
        (ONE_POSES, "time_s,left_mm_s,radius_mm\n0,1,2\n", "wheels, but lacks right_mm_s; its"),
        (ONE_POSES, "frame,direction_rad\n0,1\n", "directions, but lacks time_s; its columns"),
        (POSES, sent("9,0\n10,1\n"), r"c\.csv: no command acts .* from 9 to 10 s, but the"),
        (POSES, sent("0,0\n0,1\n"), "robot is sent two different commands at the same time, 0 s"),
        (ONE_POSES, NO_NAME.replace("v_mm_s", "v_km_h"), "unit of column v_km_h is none of"),
        (ONE_POSES.replace("heading_rad", "heading_turns"), NO_NAME, "column heading_turns is"),
        (poses_at(np.arange(0, 1320, 33)), NO_NAME, "poses of a robot are 33 s apart"),
        (POSES, "time,direction_rad\n0,0\n1,1\n", "column time states no unit"),
        (POSES, "time (weeks),direction_rad\n0,0\n", r"column time \(weeks\) is in weeks"),
        (POSES, sent("0,5,1,2\n"), "line 2: this line has 4 entries, but the header has 2"),
        (POSES, sent('0,"1,5"\n'), "direction_rad: '1,5' is not a number"),
        (POSES, "0,0\n1,1\n", "has no header"),
        (POSES, "time_s,direction_rad,time_s\n0,0,0\n", "two columns have the same name, time_s"),
        (POSES, sent("0,0\n1,\0\n"), "line 3: this is not a CSV file"),
        (POSES, sent("0,0\n1,north\n"), "line 3: direction_rad: 'north' is not a number"),
        (POSES, sent("0,0\nNaN,1\n"), "line 3: time_s: this is not a number"),
        (POSES, sent("0,\n1,NaN\n"), "states no direction"),
        (POSES, sent(""), "has no rows"),
    ],
)
def test_tables_that_cannot_be_a_recording_are_refused(tmp_path, poses, commands, says):
    """Regression: "robot Robot1 drives in only 0 steps", and robots were taken to follow each
    other's directions."""
    with pytest.raises(UsageError, match=says) as error:
        tracks_of(tmp_path, poses, commands)
    has_decimal_commas = commands in (sent("0,5,1,2\n"), sent('0,"1,5"\n'))
    assert ("decimal comma" in str(error.value)) == has_decimal_commas


BY_ROBOT = "time_s,robot,direction_rad\n" + "".join(
    f"{t / 10},{robot},{t / 9}\n" for robot in "ab" for t in range(8)
)
ONE_OF_THEM = "time_s,robot,direction_rad\n" + "".join(f"{t / 10},a,{t / 9}\n" for t in range(8))


@pytest.mark.parametrize("commands", [FOR_EACH, BY_ROBOT, ONE_OF_THEM])
def test_directions_may_name_each_robot(tmp_path, commands):
    """Regression: in the order of robots, "two robots? name them in a column robot"."""
    (track,) = tracks_of(tmp_path, TWO_POSES, commands)
    assert track.sent_s.tolist() == pytest.approx([t / 10 for t in range(8)])
    assert track.direction_rad.tolist() == pytest.approx([t / 9 for t in range(8)])


@pytest.mark.parametrize("far_mm", [9e8, -9e8])
@pytest.mark.parametrize("column", ["x_mm", "y_mm"])
def test_a_last_place_far_off_says_nothing_of_the_headings(tmp_path, column, far_mm):
    """Regression: whole turns were called degrees because of a single wrong place."""
    poses, commands = write_headings(tmp_path, lambda _, heading: heading + 2 * math.pi)
    *rows, last = poses.read_text().splitlines()
    pose = last.split(",")
    pose[PLAIN_POSES.split(",").index(column)] = str(far_mm)
    poses.write_text("\n".join([*rows, ",".join(pose), ""]))
    (track,) = read_csv_tracks([poses, commands])
    assert track.valid[:-1].all()
    assert not track.valid[-1]  # it is no measurement


@pytest.mark.parametrize(
    ("packed", "form"),
    [
        (gzip.compress(b"time_s,direction_rad\n0,0\n", mtime=0), "gzip"),
        (bz2.compress(b"time_s,direction_rad\n0,0\n"), "bzip2"),
        (b"PK\x03\x04 the start of an .xlsx", "zip, or a spreadsheet"),
    ],
    ids=["gzip", "bzip2", "zip"],
)
def test_a_compressed_table_is_named_as_such(tmp_path, packed, form):
    """Regression: it was said to be no UTF-8."""
    poses, commands = write_drive(tmp_path)
    commands.write_bytes(packed)
    with pytest.raises(UsageError, match=rf"commands\.csv: the file is compressed \({form}\)"):
        read_csv_tracks([poses, commands])


@pytest.mark.parametrize(
    ("table", "commands"),
    [
        ("poses.csv", None),
        ("commands.csv", "time_s,direction_rad\n0,0.5\n2,1.5\n"),
        ("commands.csv", "time_s,v_mm_s,w_rad_s\n0,180,1\n2,180,2\n"),
    ],
    ids=["poses", "directions", "speeds"],
)
def test_times_that_fall_are_refused(tmp_path, table, commands):
    """Regression: rows were sorted, and a countdown gave the prior's a without a word."""
    paths = write_drive(tmp_path)
    if commands:
        paths[1].write_text(commands)
    header, first, second, *others = (tmp_path / table).read_text().splitlines()
    (tmp_path / table).write_text("\n".join([header, second, first, *others, ""]))
    with pytest.raises(UsageError, match=f"{table}, line 3: the time is earlier"):
        read_csv_tracks(paths)


@pytest.mark.parametrize(
    ("is_wrong", "factor", "added"),
    [
        (np.random.default_rng(1).uniform(size=len(drive().poses)) < 0.05, 1.0, (0, 0, 0, math.pi)),
        (drive().poses[:, 0] % 5 > 4, (1.0, 0.0, 0.0, 0.0), 0.0),
    ],
    ids=["one heading in twenty flipped", "zeros while lost"],
)
def test_poses_that_are_no_measurement_show_no_turns(tmp_path, is_wrong, factor, added):
    """Regression: with one heading in twenty half a turn off, "the commands explain 1% of the
    turns": another robot's, as was asked, they were not."""
    paths = write_drive(tmp_path)
    poses = drive().poses
    poses[is_wrong] = poses[is_wrong] * factor + added
    write_table(paths[0], PLAIN, PLAIN_POSES, poses, robot="green")
    (track,) = read_csv_tracks(paths)
    assert not track.valid[is_wrong].any()
    assert track.valid[~is_wrong].mean() > 0.9


@pytest.mark.parametrize("commands", [NO_NAME, sent_to("a", "b"), COMMANDS])
def test_a_robot_that_is_never_tracked_is_left_out(tmp_path, commands):
    """Regression: a traceback."""
    (track,) = tracks_of(tmp_path, LOST, commands)
    assert track.names == ("a",)
    assert f"{tmp_path / 'p.csv'}: the file has no pose of b" in track.remarks


def test_headings_beyond_a_turn_that_turn_as_the_motion_are_whole_turns(tmp_path):
    paths = write_headings(tmp_path, lambda _, heading: heading + 2 * math.pi)
    (track,) = read_csv_tracks(paths)
    assert track.valid.all()


def test_a_file_that_is_named_twice_is_refused(tmp_path):
    poses, _ = write_drive(tmp_path)
    with pytest.raises(UsageError, match=r"poses\.csv: this file is given twice"):
        read_csv_tracks([poses, tmp_path / "." / poses.name])


def exchange_two_rows(path):
    """Write the second row of a table before the first."""
    header, first, second, *others = path.read_text().splitlines()
    path.write_text("\n".join([header, second, first, *others, ""]))


@pytest.mark.parametrize(
    "table",
    ["time_s,direction_rad\n0,0.5\n2,1.5\n", "time_s,v_mm_s,w_rad_s\n0,180,1\n2,180,2\n"],
    ids=["directions", "speeds"],
)
def test_times_of_commands_that_fall_are_refused(tmp_path, table):
    """Regression: rows were sorted, and a countdown gave the prior's a without a word."""
    poses, commands = write_drive(tmp_path)
    commands.write_text(table)
    exchange_two_rows(commands)
    with pytest.raises(UsageError, match=r"commands.csv, line 3: the time is earlier"):
        read_csv_tracks([poses, commands])


def test_robots_on_two_wheels_may_move_against_their_headings(tmp_path):
    poses, commands = write_headings(tmp_path, lambda _, heading: heading + math.pi)
    commands.write_text("time_s,v_mm_s,w_rad_s\n0,-180,1\n2,-180,2\n")
    (track,) = read_csv_tracks([poses, commands])
    assert track.valid.all()


def test_a_row_without_a_direction_is_a_step_at_which_nothing_was_sent(tmp_path):
    """Regression: `identify` refused the steps.csv of `export`, whose last row has none."""
    poses, commands = write_drive(tmp_path)
    with commands.open("a") as file:
        file.write("11.5,\n")
    (track,) = read_csv_tracks([poses, commands])
    assert track.sent_s.tolist() == drive().commands[:, 0].tolist()


def test_two_recordings_that_are_numbered_are_read(tmp_path):
    def numbered(table):
        header, *rows = table.splitlines()
        lines = [f"{trial},{row}" for trial in (1, 2) for row in rows]
        return "\n".join(["trial," + header, *lines, ""])

    tracks = tracks_of(tmp_path, numbered(ONE_POSES), numbered(NO_NAME))
    assert [len(track.time_s) for track in tracks] == [8, 8]


def test_rows_sorted_by_robot_are_one_recording(tmp_path):
    header, *rows = TWO_POSES.splitlines()
    by_robot = sorted(rows, key=lambda row: row.split(",")[1])
    (track,) = tracks_of(tmp_path, "\n".join([header, *by_robot, ""]), NO_NAME)
    assert track.poses.shape == (8, 2, 3)


def test_whole_seconds_of_commands_and_whole_milliseconds_are_read(tmp_path):
    poses = poses_at(range(0, 3300, 33)).replace("time_s", "time_ms")
    assert tracks_of(tmp_path, poses, NO_NAME)
    assert tracks_of(tmp_path, poses_at(np.arange(40) * 0.5), NO_NAME)


def test_a_speed_in_a_table_of_poses_makes_it_no_commands(tmp_path):
    header, *rows = ONE_POSES.splitlines()
    with_speed = "\n".join([header + ",v_mm_s", *(row + ",90" for row in rows), ""])
    (track,) = tracks_of(tmp_path, with_speed, NO_NAME)
    assert track.names == ("robot",)


def test_a_word_among_numbers_is_told_from_an_entry_that_is_empty(tmp_path):
    with pytest.raises(UsageError, match=r"line 3: x_mm: 'lost' is not a number") as caught:
        tracks_of(tmp_path, POSES.replace("3,2,0.2", "lost,2,0.2"), COMMANDS)
    assert caught.value.hint == "if nothing was measured, leave the entry empty"


@pytest.mark.parametrize("begin_s", [0.0, 50.0, -50.0, 1_764_000_000.0])
@pytest.mark.parametrize(
    ("falls_to_s", "says"),
    [
        (0.0, "the time goes back to an earlier value"),
        (0.9, "the time goes back to an earlier value"),
        (5.0, "the time is earlier than in the line before"),
        (9.5, "the time is earlier than in the line before"),
    ],
)
def test_a_time_that_falls_to_about_the_first_one_begins_again(tmp_path, begin_s, falls_to_s, says):
    """Wherever the clock starts, only how far it fell of the 10 s so far matters."""
    times = [begin_s + k for k in range(11)] + [begin_s + falls_to_s]
    rows = "\n".join(f"{time},{k},0,0" for k, time in enumerate(times))
    path = tmp_path / "poses.csv"
    path.write_text(f"time_s,x_mm,y_mm,heading_rad\n{rows}\n")
    with pytest.raises(UsageError, match=f"line 13: {says}"):
        read_csv_tracks([path])
