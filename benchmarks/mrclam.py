"""How real robots on two wheels follow their commands: the runs of a copy of the UTIAS MRCLAM data.

Data: Leung, Halpern, Barfoot, Liu, "The UTIAS multi-robot cooperative localization and mapping
dataset", International Journal of Robotics Research 30(8), 2011. Five iRobot Create under Vicon,
commands (v, w) as sent. Each set is a folder with RobotN_Odometry.dat and RobotN_Groundtruth.dat,
N from 1 to 5.

    .venv/bin/python benchmarks/mrclam.py MRCLAM_Dataset6 MRCLAM_Dataset7
"""

import argparse
from pathlib import Path

import numpy as np

from tetractl.core.errors import UsageError
from tetractl.core.table.table import Column, Table
from tetractl.core.table.terminal_table import print_tables
from tetractl.replay.identification.fit import SampleInterval
from tetractl.replay.identification.identify import cell
from tetractl.replay.identification.response import UNITS, respond
from tetractl.replay.identification.tracks import Track
from tetractl.results.estimate import t_quantile


def track(folder: Path, robot: int) -> Track:
    """Return one robot's run; lengths in metres."""
    seen, sent = (
        np.loadtxt(folder / f"Robot{robot}_{kind}.dat", ndmin=2)
        for kind in ("Groundtruth", "Odometry")
    )
    start = sent[0, 0]
    sent = sent[np.diff(sent[:, 0], prepend=-np.inf) > 0]  # some rows are twice in the files
    name = f"{folder.name[-1]}.{robot}"
    return Track(
        source=str(folder),
        origin="MRCLAM",
        unit="m",
        names=(name,),
        time=seen[:, 0] - start,
        poses=seen[:, None, 1:],
        valid=np.ones((len(seen), 1), dtype=np.bool_),
        sent=sent[:, 0] - start,
        u=np.full(len(sent), np.nan),
        until=float(sent[-1, 0] - start),
        twists=sent[:, None, 1:],
    )


def main(folders: list[Path]) -> None:
    """Print a row per quantity: of the runs, mean with its interval, deviation and extremes."""
    runs = [(one, k) for one in folders for k in range(1, 6) if list(one.glob(f"Robot{k}_*"))]
    if len(runs) < 2:
        raise UsageError("two runs are needed: folders with files such as Robot1_Odometry.dat")
    found = [respond([track(*run)])[0] for run in runs]
    every = [[run.quantities[name] for run in found] for name in UNITS]
    values = [np.array([one.value for one in of]) for of in every]
    half = [t_quantile(len(of) - 1) * of.std(ddof=1) / len(of) ** 0.5 for of in values]
    both = zip(values, half, strict=True)
    mean = [SampleInterval(of.mean(), of.mean() - h, of.mean() + h) for of, h in both]
    columns = (
        Column(
            "quantity", [f"{n.replace('_', ' ')} {u.format(unit='m')}" for n, u in UNITS.items()]
        ),
        Column("mean of runs", [*map(cell, mean)]),
        Column("deviation", [f"{of.std(ddof=1):.4f}" for of in values]),
        Column("least", [f"{of.min():.4f}" for of in values]),
        Column("greatest", [f"{of.max():.4f}" for of in values]),
        Column(
            "half width in a run",
            [f"{np.median([o.high - o.low for o in of]) / 2:.4f}" for of in every],
        ),
    )
    misfits = [sum(kind in one.misfits for one in found) for kind in ("turning", "speed")]
    note = (
        f"{sum(one.intervals for one in found)} steps, {sum(one.left_out for one in found)} left "
        f"out; residuals are correlated in {misfits[0]} runs (turning) and {misfits[1]} (speed)"
    )
    print_tables(
        [Table(f"MRCLAM, {len(found)} runs of real robots; 95 % intervals", columns, note)]
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folders", metavar="SET", nargs="+", type=Path)
    try:
        main(parser.parse_args().folders)
    except (OSError, ValueError, UsageError) as error:
        raise SystemExit(f"error: {error}") from None
