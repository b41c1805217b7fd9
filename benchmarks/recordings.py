"""Public recordings of real robots as the tables that `tetractl identify` and
`benchmarks/independent_fit.py` read: NAME-poses.csv and NAME-commands.csv.

    python benchmarks/recordings.py car autoKoopman_codeocean/data/F1tenthCar
    python benchmarks/recordings.py rover Experiment/data_exp.xlsx
    python benchmarks/recordings.py mecanum data
    python benchmarks/recordings.py create MRCLAM_Dataset6/Robot1_Groundtruth.dat

docs/how-to/real-robots.md says where they are. Only the standard library and NumPy are needed.
Lengths in m, angles in rad, times in s; each take is a `trial`.
"""

import argparse
import csv
import re
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

CAR_WHEELBASE_M = 0.33
"""Of an F1TENTH car, by the bill of materials of its makers."""
ROVER_WHEELBASE_M = 0.136
"""Distance between the axles, by the authors' script."""
MECANUM_FRAME_S = 1 / 60
MECANUM_COUNTS = 256.0
"""Counts that are taken as 1 m/s: the recordings state no speed, so gains are a calibration."""
MECANUM_HALF_M = 0.2
"""Half of track plus wheelbase that is assumed, likewise."""
MECANUM_MOVED = 0.004
"""Where a take has moved by so much [m or rad], its command is taken as sent MECANUM_ONSET_S
before: the videos begin at unknown times, so the dead time means nothing."""
MECANUM_ONSET_S = 0.1


@dataclass(frozen=True)
class Take:
    """M poses (time, x, y, heading) and K commands (time, v, w) of one robot."""

    poses: np.ndarray
    commands: np.ndarray


def car(folder: Path) -> Iterator[Take]:
    """Yield the takes of the car: 40 Hz, 3 s; commands are steering angle and speed."""
    for take in sorted(folder.glob("measurement_*"), key=lambda path: int(path.name[12:])):
        state = np.loadtxt(take / "trajectory.csv", delimiter=",")
        steering, speed = np.loadtxt(take / "input.csv", delimiter=",").T
        time_s = 0.025 * np.arange(len(state))
        w = speed * np.tan(steering) / CAR_WHEELBASE_M
        yield Take(
            np.column_stack([time_s, state[:, :3]]),
            np.column_stack([time_s[: len(speed)], speed, w]),
        )


def rover(file: Path) -> Iterator[Take]:
    """Yield the take of the rover: 10 Hz, 103 s; its sheet has time, speed, steering, x, y and
    heading, without a header."""
    sheet = zipfile.ZipFile(file).read("xl/worksheets/sheet1.xml").decode()
    rows = [
        [float(re.search(rf'r="{column}\d+"[^>]*><v>([^<]*)', row)[1]) for column in "ABCDEF"]
        for row in re.findall(r"<row [^>]*>(.*?)</row>", sheet)
    ]
    time_s, speed, steering, x, y, heading = np.array(rows).T
    time_s -= time_s[0]
    w = -speed * np.tan(steering) / ROVER_WHEELBASE_M  # steering counts clockwise
    yield Take(np.column_stack([time_s, x, y, heading]), np.column_stack([time_s, speed, w]))


def mecanum(folder: Path) -> Iterator[Take]:
    """Yield the takes without sideways commands of the robot on mecanum wheels: 60 Hz, 6 s, one
    command each. Headings are counted from +y in the files."""
    states = sorted((folder / "20200114_statefile").glob("*.txt"))
    controls = sorted((folder / "20200114_CSG").glob("*.csg"))
    for state_file, control_file in zip(states, controls, strict=True):
        counts = np.loadtxt(control_file)[0, 1:]
        right_1, left_1, right_2, left_2 = counts * (1, -1, 1, -1)
        if right_1 + left_2 != left_1 + right_2:
            continue  # it is sent sideways
        right = (right_1 + right_2) / 2 / MECANUM_COUNTS
        left = (left_1 + left_2) / 2 / MECANUM_COUNTS
        state = np.loadtxt(state_file, usecols=(1, 2, 3))
        heading = np.unwrap(np.radians(state[:, 2])) + np.pi / 2
        xy = state[:, :2]
        moved = np.hypot(*(xy - xy[:5].mean(0)).T) + abs(heading - heading[:5].mean())
        still = moved < np.maximum(MECANUM_MOVED, 4 * moved[:5].max())
        onset = len(still) - np.argmax(still[::-1])  # the first frame after the last at rest
        time_s = MECANUM_FRAME_S * (np.arange(len(state)) - onset)
        sent_s = -MECANUM_ONSET_S + np.loadtxt(control_file)[::10, 0]
        command = [(left + right) / 2, (right - left) / 2 / MECANUM_HALF_M]
        commands = np.column_stack([sent_s, np.tile(command, (len(sent_s), 1))])
        commands = np.vstack([[time_s[0], 0, 0], commands])  # it stands until then
        used = time_s < sent_s[-1]
        yield Take(np.column_stack([time_s, xy, heading])[used], commands)


def create(file: Path) -> Take:
    """Return a run of an MRCLAM set, of 900 s or more, by its file of poses."""
    poses = np.loadtxt(file, ndmin=2)
    sent = np.loadtxt(str(file).replace("Groundtruth", "Odometry"), ndmin=2)
    sent = sent[np.diff(sent[:, 0], prepend=-np.inf) > 0]  # some rows are twice in the files
    poses[:, 0] -= sent[0, 0]
    sent[:, 0] -= sent[0, 0]
    return Take(poses, sent)


READERS = {"car": car, "rover": rover, "mecanum": mecanum, "create": lambda file: [create(file)]}


def main(name: str, paths: list[Path], out: Path) -> None:
    """Write the two tables of a recording."""
    takes = [take for path in paths for take in READERS[name](path)]
    for kind, columns in {
        "poses": ("time_s", "x_m", "y_m", "heading_rad"),
        "commands": ("time_s", "v_m_s", "w_rad_s"),
    }.items():
        with (out / f"{name}-{kind}.csv").open("w", newline="") as file:
            rows = csv.writer(file)
            rows.writerow(["trial", *columns])
            for number, take in enumerate(takes):
                for row in getattr(take, kind):
                    rows.writerow([number, *(f"{value:.6f}" for value in row)])
    print(f"{len(takes)} takes: {name}-poses.csv, {name}-commands.csv")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("name", choices=READERS)
    parser.add_argument("paths", metavar="PATH", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, default=Path())
    chosen = parser.parse_args()
    main(chosen.name, chosen.paths, chosen.out)
