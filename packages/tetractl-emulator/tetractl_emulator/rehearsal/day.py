"""Runs one randomised test run (a *day*) with a script of faults, in its own process.

The process, which executes `tetractl run`, is forked, so that a signal, a full disk or a kill
affects a whole run, and so that what the run leaves behind (threads, open files) can be observed.
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
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from tetractl.cli.app import run_app
from tetractl.run.interrupt import SIGNAL_LISTENER
from tetractl.spec.yaml.core_yaml import format_yaml
from tetractl_emulator.rehearsal.day_plan import DayPlan

HANGS_S = 600.0
"""Processor time after which a test run counts as hanging, and is killed [s]."""
STILL_S = 60.0
"""Wall time within which an unfinished test run must use some processor time [s].

If it uses none, it counts as hanging. On a busy machine, test runs take long but must not count as
hanging.
"""
HUNG = -100
"""Exit code that stands for a test run that hung. No signal has this number."""
KEPT_BLOCKS_MAX = 20_000
"""Maximum number of memory blocks that a run may leave in its process if it loads no module."""


@dataclass(frozen=True, slots=True)
class DayOutcome:
    """The result of a randomised test run.

    Attributes:
        plan: The plan of the test run.
        events: The true events that the emulation has recorded.
        exit_code: Exit code of the run. -9 if it was killed, HUNG if it hung.
        output: The text that the run printed.
        log: The log of the trial. None if there is none.
        left_behind: Threads, open files and memory that the run left behind. "" if there are none.
        seconds: Processor time of the run [s].
    """

    plan: DayPlan
    events: list[dict[str, Any]]
    exit_code: int
    output: str
    log: Path | None
    left_behind: str
    seconds: float

    @property
    def digest(self) -> str:
        """A hash of all true events, 16 hexadecimal digits.

        It is the same each time the plan is run.
        """
        events = json.dumps(self.events).encode()
        return hashlib.sha256(events).hexdigest()[:16]


class DayFolder:
    """The files through which the process of a test run returns its results."""

    def __init__(self, folder: Path) -> None:
        self.script = folder / "script.yaml"
        """File of the faults of the test run."""
        self.output = folder / "said.txt"
        """File of the text that the run prints."""
        self.left = folder / "left.txt"
        """File of the description of what the run leaves behind."""
        self.modules = folder / "modules.txt"
        """File of the names of the modules that the run has imported."""
        self.truth = folder / "truth-000.jsonl"
        """File of the true events, one JSON object per line."""
        self.logs = folder / "log"
        """Folder of the log of the run."""


def _read_if_written(file: Path) -> str:
    """Return the text of a file, or "" if the process ended before it wrote the file."""
    return file.read_text() if file.exists() else ""


def run_day(spec: Path, sets: Sequence[str], plan: DayPlan, folder: Path) -> DayOutcome:
    """Run the plan of a randomised test run.

    Args:
        spec: The spec.
        sets: Settings that replace values of the spec.
        plan: The plan.
        folder: An empty folder for the files of the test run.
    """
    files = DayFolder(folder)
    files.script.write_text(format_yaml(plan.script()))
    arguments = ["run", str(spec), "--plant", "emulated", "--trials", "1", "--quiet"]
    arguments += ["--seed", str(plan.seed), "--out", str(files.logs)]
    plant_sets = f"plant.faults={files.script.resolve()}", f"plant.record={folder}"
    arguments += [argument for setting in (*sets, *plant_sets) for argument in ("--set", setting)]
    read_end, write_end = os.pipe()
    pid = os.fork()
    if not pid:
        _run_and_exit(arguments, files)
    os.close(write_end)
    exit_code, seconds = wait_for_child(pid, read_end)
    os.close(read_end)
    for name in _read_if_written(files.modules).split():
        with suppress(ImportError):
            importlib.import_module(name)  # so that the next days need not
    logs = sorted(files.logs.glob("*.mcap*"))
    return DayOutcome(
        plan=plan,
        events=[json.loads(line) for line in _read_if_written(files.truth).splitlines()],
        exit_code=exit_code,
        output=_read_if_written(files.output),
        log=logs[0] if logs else None,
        left_behind=_read_if_written(files.left),
        seconds=seconds,
    )


def _run_and_exit(arguments: list[str], files: DayFolder) -> NoReturn:
    """Run a command in this forked process, write its results to files, and exit.

    The exit code is the command's, or 1 if an exception ends it.
    """
    code = 1
    try:
        _limit_processor_time()
        _redirect(files.output)
        for signal_number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(signal_number, signal.default_int_handler)
        SIGNAL_LISTENER.start()  # as each process does, so that a day leaves no more behind
        census = Census()
        sys.argv = ["tetractl", *arguments]
        code = int(run_app())
        files.left.write_text("; ".join(census.left_behind()))
        files.modules.write_text("\n".join(census.new_modules()))
        sys.stdout.flush()
        sys.stderr.flush()
    except BaseException as error:
        with files.output.open("a") as output_file:
            traceback.print_exception(error, file=output_file)
    finally:
        os._exit(code & 0xFF)


def _limit_processor_time() -> None:
    """Limit the processor time of this process, in case its parent process is gone.

    Beyond HANGS_S + STILL_S, the system kills it.
    """
    limit_s = round(HANGS_S + STILL_S)
    resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s))


def _redirect(output: Path) -> None:
    """Redirect the standard output and error of this process to a file, and close its input."""
    output_fd = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    null_fd = os.open(os.devnull, os.O_RDONLY)
    for target, source in ((0, null_fd), (1, output_fd), (2, output_fd)):
        os.dup2(source, target)
    os.close(output_fd)
    os.close(null_fd)
    sys.stdin = os.fdopen(0)
    sys.stdout = os.fdopen(1, "w")
    sys.stderr = os.fdopen(2, "w")


class Census:
    """A snapshot of this process's threads, open files, modules and memory before a run."""

    def __init__(self) -> None:
        self._threads = set(threading.enumerate())
        self._files = _open_files()
        self._modules = set(sys.modules)
        gc.freeze()  # what there is need not be searched for garbage
        gc.disable()  # nor what comes: a day leaves little
        self._blocks = sys.getallocatedblocks()

    def new_modules(self) -> list[str]:
        """Return the names of the modules imported since the snapshot, in the order of import."""
        return [name for name in sys.modules if name not in self._modules]

    def left_behind(self) -> list[str]:
        """Describe the threads, open files and memory that were added since the snapshot.

        Up to KEPT_BLOCKS_MAX blocks of memory do not count. If new modules were imported, no memory
        counts.
        """
        gc.collect()
        threads = [thread.name for thread in threading.enumerate() if thread not in self._threads]
        files = sorted(_open_files() - self._files)
        blocks = sys.getallocatedblocks() - self._blocks
        if blocks > KEPT_BLOCKS_MAX and not self.new_modules():
            return [*threads, *files, f"{blocks} blocks of memory"]
        return [*threads, *files]


def _open_files() -> set[str]:
    """List the open files of this process, each as "NUMBER TARGET". Empty without /proc."""
    names = set[str]()
    for entry in Path("/proc/self/fd").glob("*"):
        try:
            names.add(f"{entry.name} {entry.readlink()}")
        except OSError:  # the folder's own
            continue
    return names


def processor_time_s(pid: int) -> float:
    """Read the processor time that a process has used [s], in user and system mode.

    Raises:
        FileNotFoundError: If there is no such process.
    """
    stat = Path(f"/proc/{pid}/stat").read_text()
    fields = stat.rpartition(")")[2].split()  # after the program's name
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def wait_for_child(
    pid: int,
    pipe_end: int,
    used_s: Callable[[int], float] = processor_time_s,
    still_s: float = STILL_S,
) -> tuple[int, float]:
    """Wait until a process closes the other end of a pipe, and kill it if it hangs.

    Args:
        pid: Id of the process.
        pipe_end: Our end of the pipe.
        used_s: Returns the processor time of a process [s].
        still_s: Interval between checks [s]. A process that has used no processor time in this
            interval hangs.

    Returns:
        The exit code, the negative number of the signal that killed it, or HUNG, and its processor
        time [s].
    """
    hangs = False
    now_s = -1.0
    while not hangs and not select.select([pipe_end], [], [], still_s)[0]:
        previous_s = now_s
        now_s = used_s(pid)
        hangs = now_s == previous_s or now_s > HANGS_S
    if hangs:
        os.kill(pid, signal.SIGKILL)
    _, status, usage = os.wait4(pid, 0)
    return HUNG if hangs else os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime
