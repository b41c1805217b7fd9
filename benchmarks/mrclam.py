"""Measures how real robots on two wheels follow their commands, with the UTIAS MRCLAM data.

    .venv/bin/python benchmarks/mrclam.py MRCLAM_Dataset6 MRCLAM_Dataset7

The data come from Leung, Halpern, Barfoot, Liu, "The UTIAS multi-robot cooperative localization and
mapping dataset", International Journal of Robotics Research 30(8), 2011. Five iRobot Create robots
drove under Vicon cameras, with known commands (v, w). Each set is a folder with RobotN_Odometry.dat
and RobotN_Groundtruth.dat, with N from 1 to 5.
"""

import argparse
from pathlib import Path

import numpy as np
from tetractl_identify.identify import cell
from tetractl_identify.response import respond
from tetractl_identify.robot_response import UNITS
from tetractl_identify.tracks import Track

from tetractl.core.errors import UsageError
from tetractl.core.poses import Floats
from tetractl.statistics.estimate import t_quantile
from tetractl.tools.likelihood import SampleInterval
from tetractl.tools.table.table import Column, Table
from tetractl.tools.table.terminal_table import print_tables


def recorded(folder: Path, robot: int) -> tuple[Floats, Floats]:
    """Read a robot's poses (M, 4) of time, x, y, heading, and its commands (K, 3) of time, v, w."""
    poses = np.loadtxt(folder / f"Robot{robot}_Groundtruth.dat", ndmin=2)
    sent = np.loadtxt(folder / f"Robot{robot}_Odometry.dat", ndmin=2)
    sent = sent[np.diff(sent[:, 0], prepend=-np.inf) > 0]  # some rows are twice in the files
    return poses, sent


def create(folder: Path, robot: int) -> tuple[Floats, Floats]:
    """Read a run's poses and commands as `recorded` does. Times count from the first command."""
    poses, sent = recorded(folder, robot)
    poses[:, 0] -= sent[0, 0]
    sent[:, 0] -= sent[0, 0]
    return poses, sent


def track(folder: Path, robot: int) -> Track:
    """Read one robot's run as a track, with lengths in metres."""
    poses, sent = create(folder, robot)
    name = f"{folder.name[-1]}.{robot}"
    return Track(
        source=str(folder),
        origin="MRCLAM",
        unit="m",
        names=(name,),
        time=poses[:, 0],
        poses=poses[:, None, 1:],
        valid=np.ones((len(poses), 1), dtype=np.bool_),
        sent=sent[:, 0],
        u=np.full(len(sent), np.nan),
        until=float(sent[-1, 0]),
        twists=sent[:, None, 1:],
    )


def _mean(values: Floats) -> SampleInterval:
    """Compute the mean of the runs' values with its 95 % interval."""
    n = len(values)
    mean = values.mean()
    half = t_quantile(n - 1) * values.std(ddof=1) / n**0.5
    return SampleInterval(mean, mean - half, mean + half)


def main(folders: list[Path]) -> None:
    """Print a row per quantity: its mean over the runs with interval, deviation and extremes."""
    runs = [
        (folder, k) for folder in folders for k in range(1, 6) if list(folder.glob(f"Robot{k}_*"))
    ]
    if len(runs) < 2:
        raise UsageError("two runs are needed: folders with files such as Robot1_Odometry.dat")
    responses = [respond([track(*run)])[0] for run in runs]
    values = []  # of the runs, of each quantity
    widths = []
    units = {name: UNITS[name] for name in responses[0].quantities}
    for name in units:
        intervals = [response.quantities[name] for response in responses]
        values.append(np.array([interval.value for interval in intervals]))
        widths.append(np.array([interval.high - interval.low for interval in intervals]))
    mean = [_mean(column) for column in values]
    columns = (
        Column(
            "quantity", [f"{n.replace('_', ' ')} {u.format(unit='m')}" for n, u in units.items()]
        ),
        Column("mean of runs", [*map(cell, mean)]),
        Column("deviation", [f"{column.std(ddof=1):.4f}" for column in values]),
        Column("least", [f"{column.min():.4f}" for column in values]),
        Column("greatest", [f"{column.max():.4f}" for column in values]),
        Column(
            "half width in a run",
            [f"{np.median(column) / 2:.4f}" for column in widths],
        ),
    )
    steps = sum(response.intervals for response in responses)
    left_out = sum(response.left_out for response in responses)
    note = f"{steps} steps, {left_out} left out"
    print_tables(
        [Table(f"MRCLAM, {len(responses)} runs of real robots; 95 % intervals", columns, note)]
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folders", metavar="SET", nargs="+", type=Path)
    try:
        main(parser.parse_args().folders)
    except (OSError, ValueError, UsageError) as error:
        raise SystemExit(f"error: {error}") from None
