"""One day of a rehearsal: a script, played by `tetractl run` in a process of its own.

The process is forked, so that a signal, a full disk or a kill is that of a whole run, and what it
leaves behind (threads, open files) can be seen.
"""

import gc
import hashlib
import importlib
import json
import os
import resource
import select
import signal
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

from tetractl.cli.app import run_app
from tetractl.core.setup import Setup
from tetractl.experiment.yaml.core_yaml import dump
from tetractl.run.interrupt import listen_to_signals
from tetractl_emulator.rehearsal.participants import LabRehearsal
from tetractl_emulator.rehearsal.schedule import KINDS, FaultRow, faults_of_day
from tetractl_emulator.rehearsal.world import world_of_day

HANGS_S = 600.0
"""Processor time after which a day counts as one that hangs [s]."""
STILL_S = 60.0
"""Wall time in which a day that is not over has to use processor time [s]: a busy machine makes
days long, and must not make them hang."""
HUNG = -100
"""Stands for the exit code of a day that hangs; no signal has this number."""
KEPT = 20_000
"""Blocks of memory that a run may leave in its process, if it has loaded no module."""
OWN = ("kind", "strength")  # keys of a drawn fault that a script does not have


@dataclass(frozen=True, slots=True)
class DayPlan:
    """What is to happen on a day: the `emulation` and the `faults` of a script, drawn for the trial
    with number `seed`, and the reasons that are right even without a fault (`right`); `kinds` are
    the rows from which faults were drawn.
    """

    seed: int
    emulation: Mapping[str, Any]
    faults: Sequence[Mapping[str, Any]]
    right: str
    kinds: Sequence[FaultRow] = field(default=KINDS, repr=False)

    @property
    def sorted(self) -> list[Mapping[str, Any]]:
        """The faults by their times."""
        return sorted(self.faults, key=lambda fault: fault["at"])

    def kind(self, fault: Mapping[str, Any]) -> FaultRow:
        """Return the row of a drawn fault."""
        return next(kind for kind in self.kinds if kind.name == fault["kind"])

    def script(self) -> dict[str, Any]:
        """Return the script of the day."""
        faults = [
            {key: value for key, value in fault.items() if key not in OWN} for fault in self.sorted
        ]
        about = ", ".join(dict.fromkeys(fault["kind"] for fault in self.sorted)) or "no fault"
        return {"about": about, "emulation": dict(self.emulation), "faults": faults}


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


def plan_of_day(seed: int, day: int, setup: Setup, lab: LabRehearsal, bad: bool = True) -> DayPlan:
    """Draw the plan of a day; it depends on the seed and on the day's number alone. On one that is
    not `bad` there is no fault, and robots and wheels are as the spec allows.
    """
    random = Random(f"{seed}-{day}")
    faults = faults_of_day(random, lab.names, lab.kinds, lab.span_s, lab.scale) if bad else []
    emulation, right = world_of_day(random, setup, lab, bad)
    return DayPlan(random.randrange(2**31), emulation, faults, right, lab.kinds)


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
    _load_ahead(folder / "modules.txt")
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
        listen_to_signals()  # as each process does, so that a day leaves no more behind
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


def _load_ahead(modules: Path) -> None:
    """Import what a day has imported, so that the next ones need not."""
    for name in modules.read_text().split() if modules.exists() else ():
        with suppress(ImportError):
            importlib.import_module(name)


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
