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
from mrclam import recorded

from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, Steer, Stop
from tetractl.core.errors import UsageError
from tetractl.core.plan import Outcome
from tetractl.core.poses import Floats, Observation, Poses, Sample
from tetractl.core.route_measure import RouteMeasure
from tetractl.core.trial import EPOCH_NS, PlantInfo, Result, Verdict
from tetractl.log.write.writer import LogWriter
from tetractl.spec.load import parse_spec
from tetractl.spec.loaded_spec import LoadedSpec, start_of

ROBOTS = (1, 2, 3, 4, 5)
RADIUS_M = 0.129
"""Distance of a wheel of an iRobot Create from its centre [m]."""
SPEED_M_S = 0.09
"""Greatest speed that was sent, rounded up [m/s]."""
TURNING = 0.6
"""Greatest turning rate that was sent, rounded up [rad/s]."""
BODY_M = 0.17
"""Radius of the robots [m]."""
FRAME_S = 0.008
"""Rows of robots within this time are one frame [s]: half of the median time between two rows."""
REPEAT_S = 0.05
"""Time after which unchanged speeds are logged again [s]."""


def spec_of(starts: Floats) -> LoadedSpec:
    """Create the spec of a lab in which the robots drive. `starts` (5, 3) are their first poses."""
    robots = "\n".join(
        f"  - {{name: r{k}, start: [{x}, {y}], heading: {heading}, target: [{k}, 0], "
        f"a: {TURNING}, speed: {SPEED_M_S}}}"
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


def frames_of(poses: list[Floats]) -> tuple[Floats, Floats]:
    """Join poses to frames of all robots: times (M,) [s] and poses (M, N, 3), NaN if missing."""
    rows = np.concatenate([np.column_stack([p, np.full(len(p), i)]) for i, p in enumerate(poses)])
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    starts = [0]
    seen = set[int]()
    for k, row in enumerate(rows):
        robot = int(row[4])
        if row[0] - rows[starts[-1], 0] > FRAME_S or robot in seen:
            starts.append(k)
            seen = set()
        seen.add(robot)
    shown = np.full((len(starts), len(poses), 3), np.nan)
    for m, (first, last) in enumerate(pairwise([*starts, len(rows)])):
        shown[m, rows[first:last, 4].astype(int)] = rows[first:last, 1:4]
    return rows[starts, 0], shown


def commands_of(sent: list[Floats], until_s: float) -> list[Command]:
    """Create the commands: one for each change of a speed, and repetitions every REPEAT_S."""
    rows = np.concatenate([np.column_stack([s, np.full(len(s), i)]) for i, s in enumerate(sent)])
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    rows = rows[rows[:, 0] < until_s]
    twists = np.zeros((len(sent), 2))
    commands: list[Command] = []
    last_s = -np.inf

    def put(t_s: float) -> None:
        v, w = twists.T
        delivered = (True,) * len(sent)
        left, right = v - w * RADIUS_M, v + w * RADIUS_M
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


def convert(folder: Path, out: Path, longest_s: float = math.inf) -> Path:
    """Write the log of a set, or of its first `longest_s` [s], and return the log's file."""
    raw = [recorded(folder, k) for k in ROBOTS]
    zero_s = max(sent[0, 0] for _, sent in raw)  # when the last robot began to be sent speeds
    until_s = min(longest_s, min(poses[-1, 0] for poses, _ in raw) - zero_s)
    poses = [np.column_stack([p[:, 0] - zero_s + 1, p[:, 1:]]) for p, _ in raw]
    sent = [np.column_stack([s[:, 0] - zero_s + 1, s[:, 1:]]) for _, s in raw]
    poses = [p[(p[:, 0] > 0) & (p[:, 0] < until_s + 1)] for p in poses]
    commands = commands_of(sent, until_s + 1)
    commands = [command for command in commands if command.sent_ns >= SECOND]
    spec = spec_of(np.array([p[0, 1:] for p in poses]))
    times_s, shown = frames_of(poses)
    path = out / f"{folder.name}.mcap"
    path.parent.mkdir(parents=True, exist_ok=True)
    stop = Command(Stop(), commands[-1].sent_ns + 1, (True,) * len(ROBOTS))
    last = Poses.from_array(np.array([p[0, 1:] for p in poses]))
    with LogWriter(path) as log:
        log.on_start(start_of(spec, 0, PlantInfo("lab", False, 60.0, {}), EPOCH_NS))
        due = iter(commands)
        command = next(due, None)
        for m, (t_s, row) in enumerate(zip(times_s.tolist(), shown, strict=True)):
            t_ns = round(t_s * SECOND)
            while command is not None and command.sent_ns < t_ns:
                log.on_command(command)
                command = next(due, None)
            valid = ~np.isnan(row[:, 0])
            last = Poses.from_array(np.where(valid[:, None], row, last.array()))
            log.on_samples([Sample(Observation(m, t_ns, t_ns, last, valid), None, ())])
        log.on_stop(stop, ended(spec, last, until_s))
    return path


def ended(spec: LoadedSpec, final: Poses, duration_s: float) -> Result:
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
