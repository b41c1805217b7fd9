"""One day of a rehearsal: a script, played by `tetractl run` in a process of its own.

The process is forked, so that a signal, a full disk or a kill is that of a whole run, and what it
leaves behind (threads, open files) can be seen.
"""

import gc
import hashlib
import importlib
import json
import math
import os
import resource
import select
import signal
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from tetractl.cli.app import run_app
from tetractl.core.poses import Poses
from tetractl.core.setup import Setup
from tetractl.run.interrupt import LISTENER
from tetractl.spec.lab_section import LabSection
from tetractl.spec.yaml.core_yaml import dump
from tetractl_emulator.fault_rows import STRONG, Draw, FaultRow, scale_of
from tetractl_emulator.script import Sides

HANGS_S = 600.0
"""Processor time after which a day counts as one that hangs [s]."""
STILL_S = 60.0
"""Wall time in which a day that is not over has to use processor time [s]: a busy machine makes
days long, and must not make them hang."""
HUNG = -100
"""Stands for the exit code of a day that hangs; no signal has this number."""
KEPT = 20_000
"""Blocks of memory that a run may leave in its process, if it has loaded no module."""
START_SHARE = 0.16
"""Share of `start_mm` within which robots are put."""
SPAN_S = 11.0
"""Latest begin of a fault after the first command that moves robots [s]."""
CHOICE_S = 5.0
"""By how much later it may be if trials choose their cells first [s]."""
BLIND_SHARE = 0.1
"""Share of the days on which robots on wheels are driven blindly, until a limit stops them."""
BLIND_S = 15
"""Time of a day's blind drive [s], in which each robot comes to a rim."""
FACING_SHARE = 0.5
"""Share of these days on which two robots start face to face."""
FACING = (2.0, 3.0)
"""Distance of these two, as a multiple of `separation_mm`: while one turns round, they meet."""
SHORT_SHARE = 0.15
"""Share of the days whose trial ends after SHORT_S, while robots drive."""
SHORT_S = (2.0, 8.0)
OWN = ("kind", "right")  # keys of a drawn fault that a script does not have


@dataclass(frozen=True, slots=True)
class DayPlan:
    """What is to happen on a day: the `emulation` and the `faults` of a script, drawn for the trial
    with number `seed`, and the `settings` of the spec on that day.
    """

    seed: int
    emulation: Mapping[str, Any]
    faults: Sequence[Mapping[str, Any]]
    settings: Sequence[str] = ()

    @property
    def sorted(self) -> list[Mapping[str, Any]]:
        """The faults by their times."""
        return sorted(self.faults, key=lambda fault: fault["at"])

    def script(self) -> dict[str, Any]:
        """Return the script of the day."""
        faults = [
            {key: value for key, value in fault.items() if key not in OWN} for fault in self.sorted
        ]
        about = ", ".join(dict.fromkeys(fault["kind"] for fault in self.sorted)) or "no fault"
        runner = {"runner": {"set": [*self.settings]}} if self.settings else {}
        return {"about": about, "emulation": dict(self.emulation), "faults": faults, **runner}


@dataclass(frozen=True, slots=True)
class Day:
    """What became of a day: the true `events`, the exit code, -9 if it was killed, what the run
    printed, its log, and what it has `left_behind`. `seconds` is its processor time.
    """

    plan: DayPlan
    events: list[dict[str, Any]]
    exit: int
    said: str
    log: Path | None
    left_behind: str
    seconds: float

    @property
    def digest(self) -> str:
        """The hash of all that truly happened, the same in each play of the plan."""
        events = json.dumps(self.events).encode()
        return hashlib.sha256(events).hexdigest()[:16]


def rows_of(lab: LabSection, setup: Setup) -> list[FaultRow]:
    """Return the rows of all faults that a lab can have."""
    sides = Sides.of(lab.camera.type, lab.actuator.type)
    rows = [row for kind in sides.faults.values() for row in kind.rows]
    return [row for row in rows if "other" not in row.fields or len(setup.names) > 1]


def plan_of_day(
    seed: int, day: int, lab: LabSection, setup: Setup, chosen: bool = False, bad: bool = True
) -> DayPlan:
    """Draw the plan of a day; it depends on the lab, the seed and the day's number alone.

    On a day that is not `bad` there is no fault. `chosen`: whether trials choose their cells.
    """
    random = Random(f"{seed}-{day}")
    sides = Sides.of(lab.camera.type, lab.actuator.type)
    faults: list[dict[str, Any]] = []
    if bad:
        names = sides.actuator.choosable if chosen else setup.names
        span_s = SPAN_S + CHOICE_S if chosen else SPAN_S
        scale = scale_of(lab, setup)
        faults = faults_of_day(random, names, rows_of(lab, setup), span_s, scale)
    emulation: dict[str, Any] = {}
    for name, side in (("camera", sides.camera), ("actuator", sides.actuator)):
        if hasattr(side, "world_of_day"):
            emulation[name] = side.world_of_day(random, lab, setup)
    starts = setup.starts
    settings: list[str] = []
    trial_seed = random.randrange(2**31)
    drawn = random.random() if bad and lab.actuator.type != "field" else SHORT_SHARE
    if drawn < SHORT_SHARE:
        settings = [f"controller.time_limit={random.uniform(*SHORT_S):.1f}"]
    elif drawn > 1 - BLIND_SHARE:
        separation = lab.limits.separation_mm / 1000 / setup.metres
        first_rad = random.uniform(-math.pi, math.pi)
        if random.random() < FACING_SHARE:
            starts, first_rad = _face_to_face(random, setup, separation)
        settings = [_blind(random, setup.period_s, first_rad)]
        for i, (x, y, heading) in enumerate(starts.array().tolist()):
            settings += [f"robots.{i}.start={[x, y]}", f"robots.{i}.heading={heading}"]
    if not chosen:
        near = START_SHARE * lab.limits.start_mm / 1000 / setup.metres
        emulation["robots"] = _placed(random, setup.names, starts, near)
    return DayPlan(trial_seed, emulation, faults, settings)


def _blind(random: Random, period_s: float, first_rad: float) -> str:
    """Draw a blind controller, of which each direction is held for about a second; the first one is
    given.
    """
    held = round(1 / period_s)
    drawn_rad = [first_rad, *(random.uniform(-math.pi, math.pi) for _ in range(BLIND_S - 1))]
    directions = [round(direction, 2) for direction in drawn_rad for _ in range(held)]
    return f"controller={{type: sequence, period: {period_s}, directions: {directions}}}"


def _face_to_face(random: Random, setup: Setup, separation: float) -> tuple[Poses, float]:
    """Return starts of which two are face to face, and the heading of the first of the two [rad]:
    sent that direction, it drives ahead, and the other towards it until it has turned round.

    The first stands on its own start, and faces the middle of the arena. Where the other would
    stand in an obstacle, a further pair is drawn; if none is left, all stand as in the spec.
    """
    starts = setup.starts.array()
    pairs = list(permutations(range(len(starts)), 2))
    middle_x = setup.arena.left + setup.arena.width / 2
    middle_y = setup.arena.bottom + setup.arena.height / 2
    for first, second in random.sample(pairs, len(pairs)):
        x, y, _ = starts[first]
        ahead_rad = math.atan2(middle_y - y, middle_x - x)
        apart = random.uniform(*FACING) * separation
        other_x = x + apart * math.cos(ahead_rad)
        other_y = y + apart * math.sin(ahead_rad)
        if all(shape.distance(other_x, other_y) > setup.body_radius for shape in setup.obstacles):
            starts[first, 2] = ahead_rad
            starts[second] = (other_x, other_y, ahead_rad - math.pi)
            return Poses.of(np.round(starts, 4)), ahead_rad
    return setup.starts, 0.0


def faults_of_day(
    random: Random,
    names: Sequence[str],
    rows: Sequence[FaultRow],
    span_s: float = SPAN_S,
    scale: float = 1.0,
) -> list[dict[str, Any]]:
    """Draw a day's faults as of a script; a third of the days have one, others two to six. Each
    also says its `kind`, the name of the row, and which reasons are `right`.
    """
    count = 1 if random.random() < 1 / 3 else random.randint(2, 6)
    chosen = random.choices(rows, [row.weight for row in rows], k=count)
    return [_fault(row, random, names, span_s, scale) for row in chosen]


def _fault(
    row: FaultRow, random: Random, names: Sequence[str], span_s: float, scale: float
) -> dict[str, Any]:
    draw = Draw(random, random.sample(names, len(names)), random.random(), scale)
    fault: dict[str, Any] = {"kind": row.name, "right": row.right, "fault": row.fault}
    for key, value in row.fields.items():
        fault[key] = value(draw) if callable(value) else value
    when = random.random()
    if when < row.start:
        fault |= {"since": "start", "at": round(random.uniform(0, 1), 3)}
    elif when > 1 - row.stop:
        fault |= {"since": "stop", "at": round(random.uniform(0, 0.5), 3)}
    else:
        fault["at"] = round(random.uniform(0, span_s), 3)
    if not row.at_once and "for" not in fault and draw.strength < STRONG:
        fault["for"] = round(0.02 * 800 ** random.random(), 3)  # from 20 ms to 16 s
    return fault


def _placed(
    random: Random, names: Sequence[str], starts: Poses, near: float
) -> list[dict[str, Any]]:
    """Return robots at places off their starts by up to `near` [length unit]."""
    placed = []
    for name, (x, y, heading) in zip(names, starts.array().tolist(), strict=True):
        off = random.uniform(0, near)
        angle = random.uniform(-math.pi, math.pi)
        placed_x = x + off * math.cos(angle)
        placed_y = y + off * math.sin(angle)
        turned = round(heading + random.uniform(-0.05, 0.05), 4)
        placed.append(
            {"name": name, "start": [round(placed_x, 2), round(placed_y, 2)], "heading": turned}
        )
    return placed


def play(spec: Path, sets: Sequence[str], plan: DayPlan, folder: Path) -> Day:
    """Play a plan on a spec with settings, with its files in an empty folder."""
    script = folder / "script.yaml"
    script.write_text(dump(plan.script()))
    words = ["run", str(spec), "--plant", "emulated", "--trials", "1", "--quiet"]
    words += ["--seed", str(plan.seed), "--out", str(folder / "log")]
    plant_sets = f"plant.faults={script.resolve()}", f"plant.record={folder}"
    words += [word for setting in (*sets, *plant_sets) for word in ("--set", setting)]
    ended, ends = os.pipe()
    pid = os.fork()
    if not pid:
        _run(words, folder)
    os.close(ends)
    code, seconds = wait_for_child(pid, ended)
    os.close(ended)
    modules = folder / "modules.txt"
    for name in modules.read_text().split() if modules.exists() else ():
        with suppress(ImportError):
            importlib.import_module(name)  # so that the next days need not
    record = folder / "truth-000.jsonl"
    lines = record.read_text().splitlines() if record.exists() else []
    logs = sorted((folder / "log").glob("*.mcap*"))
    log = logs[0] if logs else None
    left_file = folder / "left.txt"
    said = (folder / "said.txt").read_text()
    return Day(
        plan,
        [json.loads(line) for line in lines],
        code,
        said,
        log,
        left_file.read_text() if left_file.exists() else "",
        seconds,
    )


def _run(words: list[str], folder: Path) -> None:
    """Run a command in this forked process, and end it."""
    code = 1
    most_s = round(HANGS_S + STILL_S)
    try:
        # should the process that waits for it be gone
        resource.setrlimit(resource.RLIMIT_CPU, (most_s, most_s))
        said = os.open(folder / "said.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        null = os.open(os.devnull, os.O_RDONLY)
        for target, source in ((0, null), (1, said), (2, said)):
            os.dup2(source, target)
        os.close(said)
        os.close(null)
        sys.stdin = os.fdopen(0)
        sys.stdout = os.fdopen(1, "w")
        sys.stderr = os.fdopen(2, "w")
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.default_int_handler)
        LISTENER.start()  # as each process does, so that a day leaves no more behind
        running = set(threading.enumerate())
        before = _open_files()
        loaded = set(sys.modules)
        gc.freeze()  # what there is need not be searched for garbage
        gc.disable()  # nor what comes: a day leaves little
        blocks = sys.getallocatedblocks()
        sys.argv = ["tetractl", *words]
        code = int(run_app())
        gc.collect()
        threads = [thread.name for thread in threading.enumerate() if thread not in running]
        files = sorted(_open_files() - before)
        kept_blocks = sys.getallocatedblocks() - blocks
        new = sys.modules.keys() - loaded
        memory = [f"{kept_blocks} blocks of memory"] if kept_blocks > KEPT and not new else []
        (folder / "left.txt").write_text("; ".join([*threads, *files, *memory]))
        (folder / "modules.txt").write_text("\n".join(new))
        sys.stdout.flush()
        sys.stderr.flush()
    except BaseException as error:
        import traceback

        with (folder / "said.txt").open("a") as out:
            traceback.print_exception(error, file=out)
    finally:
        os._exit(code & 0xFF)


def _open_files() -> set[str]:
    """Return the files that this process has open, with their numbers."""
    names = set[str]()
    for entry in Path("/proc/self/fd").glob("*"):
        try:
            names.add(f"{entry.name} {entry.readlink()}")
        except OSError:  # the folder's own
            continue
    return names


def processor_time_s(pid: int) -> float:
    """Return the processor time that a process has used [s]."""
    stat = Path(f"/proc/{pid}/stat").read_text()
    fields = stat.rpartition(")")[2].split()  # after the program's name
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def wait_for_child(
    pid: int,
    ended: int,
    used_s: Callable[[int], float] = processor_time_s,
    still_s: float = STILL_S,
) -> tuple[int, float]:
    """Wait for a process, which closes the other end of the pipe `ended`; return its exit code, or
    the number of the signal that killed it less than 0, HUNG if it hangs; and its processor time
    [s]. `used_s` returns that of a process, which is read every `still_s`.
    """
    hangs = False
    now_s = -1.0
    while not hangs and not select.select([ended], [], [], still_s)[0]:
        before_s = now_s
        now_s = used_s(pid)
        hangs = now_s == before_s or now_s > HANGS_S
    if hangs:
        os.kill(pid, signal.SIGKILL)
    _, status, used = os.wait4(pid, 0)
    return HUNG if hangs else os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime
