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
from tetractl_identify.response import fit_responses
from tetractl_identify.robot_response import UNITS
from tetractl_identify.tracks import Track

from tetractl.core.errors import UsageError
from tetractl.core.poses import Floats
from tetractl.statistics.estimate import t_quantile
from tetractl.tools.likelihood import SampleInterval
from tetractl.tools.table.table import Column, Table
from tetractl.tools.table.terminal_table import print_tables


def read_recording(folder: Path, robot: int) -> tuple[Floats, Floats]:
    """Read the recording of one robot.

    Returns:
        The poses, rows of time [s], x, y [m] and heading [rad], shape (M, 4). The commands, rows of
        time [s], speed v [m/s] and turning rate w [rad/s], shape (K, 3).
    """
    poses = np.loadtxt(folder / f"Robot{robot}_Groundtruth.dat", ndmin=2)
    commands = np.loadtxt(folder / f"Robot{robot}_Odometry.dat", ndmin=2)
    commands = commands[
        np.diff(commands[:, 0], prepend=-np.inf) > 0
    ]  # some rows are twice in the files
    return poses, commands


def read_from_first_command(folder: Path, robot: int) -> tuple[Floats, Floats]:
    """Read a recording like `read_recording`, with times that count from the first command."""
    poses, commands = read_recording(folder, robot)
    poses[:, 0] -= commands[0, 0]
    commands[:, 0] -= commands[0, 0]
    return poses, commands


def read_track(folder: Path, robot: int) -> Track:
    """Read one robot's run as a track, with lengths in metres."""
    poses, commands = read_from_first_command(folder, robot)
    name = f"{folder.name[-1]}.{robot}"
    return Track(
        source=str(folder),
        origin="MRCLAM",
        unit="m",
        names=(name,),
        time_s=poses[:, 0],
        poses=poses[:, None, 1:],
        valid=np.ones((len(poses), 1), dtype=np.bool_),
        sent_s=commands[:, 0],
        direction_rad=np.full(len(commands), np.nan),
        stop_s=float(commands[-1, 0]),
        twists=commands[:, None, 1:],
    )


def _mean_with_interval(values: Floats) -> SampleInterval:
    """Compute the mean of some values with Student's 95 % interval."""
    count = len(values)
    mean = values.mean()
    half_width = t_quantile(count - 1) * values.std(ddof=1) / count**0.5
    return SampleInterval(mean, mean - half_width, mean + half_width)


def main(folders: list[Path]) -> None:
    """Fit each run, and print a table of the fitted quantities.

    Each row has the mean of a quantity over the runs with its interval, the standard deviation and
    the extremes.

    Args:
        folders: Folders of data sets, with one run for each robot.
    """
    runs = [
        (folder, robot)
        for folder in folders
        for robot in range(1, 6)
        if list(folder.glob(f"Robot{robot}_*"))
    ]
    if len(runs) < 2:
        raise UsageError("two runs are needed: folders with files such as Robot1_Odometry.dat")
    responses = [fit_responses([read_track(*run)])[0] for run in runs]
    values_by_quantity = []  # of the runs, of each quantity
    widths_by_quantity = []
    units = {name: UNITS[name] for name in responses[0].quantities}
    for name in units:
        intervals = [response.quantities[name] for response in responses]
        values_by_quantity.append(np.array([interval.value for interval in intervals]))
        widths_by_quantity.append(
            np.array([interval.high - interval.low for interval in intervals])
        )
    means = [_mean_with_interval(column) for column in values_by_quantity]
    columns = (
        Column(
            "quantity", [f"{n.replace('_', ' ')} {u.format(unit='m')}" for n, u in units.items()]
        ),
        Column("mean of runs", [*map(cell, means)]),
        Column("deviation", [f"{column.std(ddof=1):.4f}" for column in values_by_quantity]),
        Column("least", [f"{column.min():.4f}" for column in values_by_quantity]),
        Column("greatest", [f"{column.max():.4f}" for column in values_by_quantity]),
        Column(
            "half width in a run",
            [f"{np.median(column) / 2:.4f}" for column in widths_by_quantity],
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
