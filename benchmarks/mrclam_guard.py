"""Converts recordings of real robots (the UTIAS MRCLAM data) to logs that the guard can watch.

For the data, see `benchmarks/mrclam.py`. Each set becomes the log of a lab with five robots, which
`tetractl lab guard` passes to the guard. As far as is known, nobody pushed a robot and no camera
failed, so every run that the guard would have ended is a false abort.

    python benchmarks/mrclam_guard.py SETS/MRCLAM_Dataset6 SETS/MRCLAM_Dataset7 --out logs/mrclam
    tetractl lab guard logs/mrclam/MRCLAM_Dataset6.mcap --most 0

Each robot was steered on its own. The odometry files contain the speeds sent to each robot, up to
0.086 m/s and 0.57 rad/s. An iRobot Create has no watchdog: until the next row, it keeps the last
speeds. Vicon recorded each robot at about 60 Hz. A frame of the log contains the robots with a row
within FRAME_S after the first one. The other robots count as unseen in this frame.
"""

import argparse
import math
from itertools import pairwise
from pathlib import Path

import numpy as np
from mrclam import read_recording

from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, Steer, Stop
from tetractl.core.errors import UsageError
from tetractl.core.plan import Outcome
from tetractl.core.poses import Floats, Observation, Poses, Sample
from tetractl.core.route_measure import RouteMeasure
from tetractl.core.trial import SIMULATED_START_NS, PlantInfo, Result, Verdict
from tetractl.log.write.writer import LogWriter
from tetractl.spec.load import parse_spec
from tetractl.spec.loaded_spec import LoadedSpec, create_start

ROBOTS = (1, 2, 3, 4, 5)
RADIUS_M = 0.129
"""Distance of a wheel of an iRobot Create from its centre [m]."""
SPEED_M_S = 0.09
"""Greatest speed that was sent, rounded up [m/s]."""
TURNING_RAD_S = 0.6
"""Greatest turning rate that was sent, rounded up [rad/s]."""
BODY_M = 0.17
"""Radius of the robots [m]."""
FRAME_S = 0.008
"""Rows of robots within this time are one frame [s]: half of the median time between two rows."""
REPEAT_S = 0.05
"""Time after which unchanged speeds are logged again [s]."""


def make_spec(starts: Floats) -> LoadedSpec:
    """Create the spec of a lab in which the robots drive. `starts` (5, 3) are their first poses."""
    robots = "\n".join(
        f"  - {{name: r{k}, start: [{x}, {y}], heading: {heading}, target: [{k}, 0], "
        f"a: {TURNING_RAD_S}, speed: {SPEED_M_S}}}"
        for k, (x, y, heading) in zip(ROBOTS, starts.tolist(), strict=True)
    )
    bodies = ", ".join(f"{{name: r{k}, body: r{k}}}" for k in ROBOTS)
    ports = ", ".join(f"{{name: r{k}, index: {k - 1}}}" for k in ROBOTS)
    text = f"""
name: mrclam
units: {{length: m}}
arena: {{left: -4, bottom: -8, width: 12, height: 16}}
robots:
{robots}
wheels: {{radius: {RADIUS_M}}}
controller: {{type: sequence, period: 0.2, directions: [0]}}
plant:
  type: lab
  camera: {{type: optitrack, server: 192.168.1.10, interface: 192.168.1.20, robots: [{bodies}]}}
  actuator: {{type: m3pi-xbee, port: /dev/null, robots: [{ports}]}}
trials: {{count: 1, seed: 1}}
"""
    return parse_spec(text, "mrclam.yaml")


def merge_by_time(tables: list[Floats]) -> Floats:
    """Merge tables, one of each robot, to one table that is sorted by time.

    The first column of each table is the time. A last column with the robot's index is added.
    """
    numbered = [np.column_stack([rows, np.full(len(rows), i)]) for i, rows in enumerate(tables)]
    merged = np.concatenate(numbered)
    return merged[np.argsort(merged[:, 0], kind="stable")]


def join_frames(poses: list[Floats]) -> tuple[Floats, Floats]:
    """Join the poses of single robots to camera frames of all robots.

    Args:
        poses: For each of N robots, rows of time [s], x, y [m] and heading [rad].

    Returns:
        The times of the M frames [s], shape (M,), and the poses, shape (M, N, 3). The pose of a
        robot that is not in a frame is NaN.
    """
    rows = merge_by_time(poses)
    starts = [0]
    robots_in_frame = set[int]()
    for k, row in enumerate(rows):
        robot = int(row[4])
        if row[0] - rows[starts[-1], 0] > FRAME_S or robot in robots_in_frame:
            starts.append(k)
            robots_in_frame = set()
        robots_in_frame.add(robot)
    frames = np.full((len(starts), len(poses), 3), np.nan)
    for frame, (first, last) in enumerate(pairwise([*starts, len(rows)])):
        frames[frame, rows[first:last, 4].astype(int)] = rows[first:last, 1:4]
    return rows[starts, 0], frames


def make_commands(sent_speeds: list[Floats], until_s: float) -> list[Command]:
    """Create a command for each change of a speed, and repeat the last one every REPEAT_S.

    Args:
        sent_speeds: For each robot, rows of time [s], speed [m/s] and turning rate [rad/s].
        until_s: Later rows are left out [s].
    """
    rows = merge_by_time(sent_speeds)
    rows = rows[rows[:, 0] < until_s]
    twists = np.zeros((len(sent_speeds), 2))
    commands: list[Command] = []
    last_s = -np.inf

    def put(t_s: float) -> None:
        speeds, turning_rates = twists.T
        delivered = (True,) * len(sent_speeds)
        left, right = speeds - turning_rates * RADIUS_M, speeds + turning_rates * RADIUS_M
        commands.append(Command(Steer(0.0), round(t_s * SECOND), delivered, left, right))

    for t_s, v, w, robot in rows.tolist():
        while last_s + REPEAT_S < t_s and np.isfinite(last_s):
            last_s += REPEAT_S
            put(last_s)
        if (twists[int(robot)] != (v, w)).any() or not commands:
            twists[int(robot)] = v, w
            last_s = t_s
            put(t_s)
    return commands


def convert(folder: Path, folder_of_logs: Path, longest_s: float = math.inf) -> Path:
    """Write the log of a set of recordings.

    Args:
        folder: Folder of the set.
        folder_of_logs: Where to write the log.
        longest_s: Only this much of the recordings is written [s].

    Returns:
        The log's file.
    """
    raw = [read_recording(folder, k) for k in ROBOTS]
    start_s = max(sent[0, 0] for _, sent in raw)  # when the last robot began to be sent speeds
    until_s = min(longest_s, min(poses[-1, 0] for poses, _ in raw) - start_s)
    poses = [np.column_stack([p[:, 0] - start_s + 1, p[:, 1:]]) for p, _ in raw]
    sent = [np.column_stack([s[:, 0] - start_s + 1, s[:, 1:]]) for _, s in raw]
    poses = [p[(p[:, 0] > 0) & (p[:, 0] < until_s + 1)] for p in poses]
    commands = make_commands(sent, until_s + 1)
    commands = [command for command in commands if command.sent_ns >= SECOND]
    spec = make_spec(np.array([p[0, 1:] for p in poses]))
    times_s, frames = join_frames(poses)
    path = folder_of_logs / f"{folder.name}.mcap"
    path.parent.mkdir(parents=True, exist_ok=True)
    stop = Command(Stop(), commands[-1].sent_ns + 1, (True,) * len(ROBOTS))
    last = Poses.from_array(np.array([p[0, 1:] for p in poses]))
    with LogWriter(path) as log:
        log.on_start(create_start(spec, 0, PlantInfo("lab", False, 60.0, {}), SIMULATED_START_NS))
        pending = iter(commands)
        command = next(pending, None)
        for frame, (t_s, row) in enumerate(zip(times_s.tolist(), frames, strict=True)):
            t_ns = round(t_s * SECOND)
            while command is not None and command.sent_ns < t_ns:
                log.on_command(command)
                command = next(pending, None)
            valid = ~np.isnan(row[:, 0])
            last = Poses.from_array(np.where(valid[:, None], row, last.array()))
            log.on_samples([Sample(Observation(frame, t_ns, t_ns, last, valid), None, ())])
        log.on_stop(stop, interrupted_result(spec, last, until_s))
    return path


def interrupted_result(spec: LoadedSpec, final: Poses, duration_s: float) -> Result:
    """Create the result of a recording, which only says that it ended."""
    setup = spec.experiment.setup
    robots = len(ROBOTS)
    return Result.from_verdict(
        setup,
        Verdict(final, (False,) * robots, (math.inf,) * robots),
        outcome=Outcome.INTERRUPTED,
        reason="end of the recording",
        duration_s=duration_s,
        solve_ns=(),
        deadline_misses=0,
        route=RouteMeasure(setup.legs, setup.hold, setup.loss, setup.speed),
    )


def main() -> None:
    """Convert each set, and print the name of its log."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folders", metavar="SET", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True, help="folder for the logs")
    parser.add_argument("--seconds", type=float, default=math.inf, help="only the first seconds")
    chosen = parser.parse_args()
    for folder in chosen.folders:
        print(convert(folder, chosen.out, chosen.seconds))


if __name__ == "__main__":
    try:
        main()
    except (OSError, ValueError, UsageError) as error:
        raise SystemExit(f"error: {error}") from None
