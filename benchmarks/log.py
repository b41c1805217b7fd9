"""What logs promise, measured: `python benchmarks/log.py [PART]...`, all parts by default.

    kills       seconds lost over 100 kills -9 at random times of a trial in real time
    torn        10,000 truncations and 10,000 changed bytes: chunks recovered of those complete
    tampering   each field of each channel, record and attachment changed: how many it notices
    cost        what logging costs a message, and the loop's p99 with and without it
    verify      time a trial
    faults      each promised fault, done for real
    soak        1000 trials: memory, handles, threads, frames
    long        one trial of two hours in virtual time: the same

Prints Markdown. `--scale 0.1` does a tenth of the work.
"""

import argparse
import errno
import gc
import os
import random
import resource
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import ClassVar

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "tests"))
sys.path.extend(map(str, ROOT.glob("packages/*/tests")))

import numpy as np  # noqa: E402
from mcap.reader import make_reader  # noqa: E402
from support.durable import RealTime, random_kill, small_disk  # noqa: E402
from support.fuzz import Original, fuzz  # noqa: E402
from support.lab_logs import dish_log, lab_log  # noqa: E402
from support.running import ENDLESS  # noqa: E402
from support.tampering import score, sim_log  # noqa: E402

from tetractl.control.build import warm_up  # noqa: E402
from tetractl.core.clock import MonotonicClock  # noqa: E402
from tetractl.core.commands import PlantInfo  # noqa: E402
from tetractl.core.protocols import LabSupervision, Observer  # noqa: E402
from tetractl.core.trial import EPOCH_NS  # noqa: E402
from tetractl.experiment.load import load_spec, parse_spec  # noqa: E402
from tetractl.experiment.loaded_spec import LoadedSpec, start_of  # noqa: E402
from tetractl.log.format.channels import FRAMES  # noqa: E402
from tetractl.log.format.packed_columns import unpack_columns  # noqa: E402
from tetractl.log.format.tetractl_pb2 import CameraFrames  # noqa: E402
from tetractl.log.read.reader import read_trial  # noqa: E402
from tetractl.log.write import sink  # noqa: E402
from tetractl.log.write.writer import LogWriter  # noqa: E402
from tetractl.replay.verify import verify  # noqa: E402
from tetractl.run.checked_controller import build_controller  # noqa: E402
from tetractl.run.control_loop import Trial  # noqa: E402
from tetractl.run.interrupt import Interrupt  # noqa: E402
from tetractl.run.spec_trial import log_path, run_logged, trial_seeds  # noqa: E402

SMALL = """
name: small
arena: {left: 0, bottom: 0, width: 1000, height: 1000}
robots:
  - {name: one, start: [100, 500], target: [300, 450], a: 6, speed: 200}
  - {name: two, start: [100, 300], target: [300, 350], a: 3, speed: 150}
controller: {type: pso-mpc, horizon_max: 6, steps_max: 5, optimizer: {particles: 6, iterations: 14}}
plant: {type: sim, camera_rate: 30, measurement_noise: {position: 1}, heading_noise: 0.1}
"""


def kills(folder: Path, scale: float) -> None:
    count = max(4, round(100 * scale))
    rngs = [random.Random(seed) for seed in range(count)]
    paths = [folder / f"{i}.mcap" for i in range(count)]
    with ThreadPoolExecutor(2) as pool:
        lost = [killed.lost_s for killed in pool.map(random_kill, paths, rngs)]
    middle = statistics.median(lost)
    print(f"{count} kills: lost {min(lost):.3f} s at least, {middle:.3f} s in the median,")
    print(f"{max(lost):.3f} s at most; {sum(x > 1.2 for x in lost)} lost more than 1.2 s")


def torn(folder: Path, scale: float) -> None:
    spec = parse_spec(SMALL, "small.yaml", ["plant.camera_rate=10"])
    run_logged(spec, folder, 0, (), Interrupt())
    original = Original(log_path(folder, 0))
    print("| damage | logs | no trial left in | chunks recovered of those complete | wrong | s |")
    print("|---|---|---|---|---|---|")
    for kind in ("truncated", "flipped"):
        count = round(10_000 * scale)
        began = time.perf_counter()
        copies = getattr(original, kind)(count, random.Random(1))
        tally = fuzz(original, copies, folder / "copy.mcap")
        chunks = f"{tally.chunks_recovered} of {tally.chunks_complete}"
        seconds = time.perf_counter() - began
        cells = (kind, tally.copies, tally.unreadable, chunks, len(tally.wrong), round(seconds))
        print("|", " | ".join(map(str, cells)), "|")
        for wrong in sorted(set(tally.wrong)):
            print(f"- {wrong}")


class Busy(MonotonicClock):
    """Notes how long the loop works between two sleeps, planning included."""

    def __init__(self) -> None:
        super().__init__()
        self.woke = 0
        self.busy_ns = []

    def sleep_until(self, when: int) -> None:
        self.busy_ns.append(self.now() - self.woke)
        super().sleep_until(when)
        self.woke = self.now()


class Planning:
    """A controller that is timed."""

    def __init__(self, controller) -> None:
        self.controller = controller
        self.ns = []

    def plan(self, observation, last_command=None, earlier=()):
        before = time.perf_counter_ns()
        decision = self.controller.plan(observation, last_command, earlier)
        self.ns.append(time.perf_counter_ns() - before)
        return decision


def real_time(spec: LoadedSpec, observers: Sequence[Observer]) -> tuple[np.ndarray, int]:
    """Run a trial on the wall clock; ns the loop worked a step without planning, and its steps."""
    key, seed = trial_seeds(1, 0)
    clock = Busy()
    planning = Planning(build_controller(spec.experiment, key))
    start = start_of(spec, 0, PlantInfo("", True, 0, {}), EPOCH_NS)
    plant = spec.experiment.plant.build(spec.experiment.setup, clock, seed, LabSupervision())
    result = Trial(start, plant, planning, clock, observers, Interrupt()).run()
    busy = np.array(clock.busy_ns[1 : result.steps]) - np.array(planning.ns[1 : result.steps])
    return busy, result.steps


def cost(folder: Path, scale: float) -> None:
    steps = max(50, round(1000 * scale))
    spec = parse_spec(ENDLESS, "endless.yaml", [f"controller.steps_max={steps}"])
    fast = parse_spec(
        ENDLESS, "fast.yaml", [f"controller.steps_max={steps}", "controller.period=0.04"]
    )
    warm_up(spec.experiment, print)

    class Timed(LogWriter):
        ns: ClassVar[list[float]] = []

        def on_samples(self, samples):
            self._time(3 * len(samples), super().on_samples, samples)

        def on_step(self, step):
            self._time(5, super().on_step, step)

        def _time(self, messages: int, call: Callable, argument: object) -> None:
            before = time.perf_counter_ns()
            call(argument)
            if messages:
                self.ns.append((time.perf_counter_ns() - before) / messages)

    from tetractl.run import spec_trial

    spec_trial.LogWriter = Timed
    run_logged(spec, folder, 0, (), Interrupt())
    p50, p99 = np.percentile(Timed.ns, [50, 99]) / 1e3
    print(
        f"a message costs who logs it {p50:.1f} us (p50), {p99:.1f} us (p99), written by a thread"
    )
    spec_trial.LogWriter = LogWriter
    print("\n| loop at 25 Hz, without planning | steps | p50 [ms] | p99 [ms] | max [ms] |")
    print("|---|---|---|---|---|")
    for name in ("no log", "log", "log on a disk that takes 0.5 s a sync"):
        path = folder / f"{name}.mcap"
        plain = sink._sync_data
        if name.startswith("log on"):
            sink._sync_data = lambda handle: time.sleep(0.5)
        if name == "no log":
            busy, n = real_time(fast, [])
        else:
            with LogWriter(path, real_time=True) as writer:
                busy, n = real_time(fast, [writer])
        sink._sync_data = plain
        p50, p99, most = np.percentile(busy, [50, 99, 100]) / 1e6
        print(f"| {name} | {n} | {p50:.2f} | {p99:.2f} | {most:.2f} |")


def tampering(folder: Path, scale: float) -> None:
    """Print how many changes of each field are noticed, by channel."""
    count = max(1, round(6 * scale))
    logs_of = {"simulation": sim_log, "emulated lab": lab_log, "emulated microscope": dish_log}
    for name, log_of in logs_of.items():
        place = folder / name
        place.mkdir()
        recovered, tried = score(log_of(place), count)
        print(f"\n| {name} | noticed | missed, by field |\n|---|---|---|")
        for channel in dict.fromkeys(channel for channel, _ in tried):
            kinds = [kind for kind in tried if kind[0] == channel]
            missed = [
                f"{kind[1]} {tried[kind] - recovered[kind]} of {tried[kind]}"
                for kind in kinds
                if recovered[kind] < tried[kind]
            ]
            total = (sum(recovered[k] for k in kinds), sum(tried[k] for k in kinds))
            print(f"| {channel} | {total[0]} of {total[1]} | {', '.join(missed)} |")
        print(f"| all | {recovered.total()} of {tried.total()} | |", flush=True)


def verify_time(folder: Path, scale: float) -> None:
    print("| experiment | steps | run [s] | verify [s] | |")
    print("|---|---|---|---|---|")
    for name in ("three_m3pi", "three_m3pi_paper", "tetrahymena"):
        spec = load_spec(ROOT / "experiments" / f"{name}.yaml")
        warm_up(spec.experiment, print)
        place = folder / name
        place.mkdir()
        before = time.perf_counter()
        run_logged(spec, place, 0, (), Interrupt())
        ran = time.perf_counter() - before
        times = [verify(log_path(place, 0)) for _ in range(3)]
        fastest = min(times, key=lambda timed: timed.seconds)
        cells = (name, fastest.steps, f"{ran:.2f}", f"{fastest.seconds:.2f}", fastest.method)
        print("|", " | ".join(map(str, cells)), "|" if fastest.ok else "FAILED |")


def faults(folder: Path, scale: float) -> None:
    print("| fault | promised | found |")
    print("|---|---|---|")
    for name, promise, test in FAULTS:
        place = folder / name.replace(" ", "-").replace("/", "")
        place.mkdir()
        try:
            answer = test(place)
        except Exception as error:
            answer = f"BROKEN: {type(error).__name__}: {error}"
        print(f"| {name} | {promise} | {answer} |")


def ends(trial: RealTime, path: Path, why: str) -> str:
    outcome, reason, steps = trial.end().strip().split(" | ")
    assert outcome == "aborted", outcome
    assert why in reason, reason
    log = read_trial(path)
    return f"aborted after {steps} steps, {len(log.steps)} of them in the log: {why}"


def full(folder: Path) -> str:
    with small_disk(folder / "disk", "200k") as disk:
        trial = RealTime(disk / "trial.mcap")
        return ends(trial, disk / "trial.mcap.part", "No space left on device")


def removed(folder: Path) -> str:
    (folder / "logs").mkdir()
    path = folder / "logs" / "trial.mcap"
    trial = RealTime(path)
    time.sleep(1.5)
    shutil.rmtree(folder / "logs")
    return ends(trial, path.with_name("trial.mcap.part"), "was removed during the trial")


def moved(folder: Path) -> str:
    (folder / "logs").mkdir()
    trial = RealTime(folder / "logs" / "trial.mcap")
    time.sleep(1.5)
    (folder / "logs").rename(folder / "elsewhere")
    return ends(trial, folder / "elsewhere" / "trial.mcap.part", "was moved during the trial")


SHIM = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static int ours(int fd) {
    char link[64], path[4096];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = readlink(link, path, sizeof path - 1);
    if (n < 0) return 0;
    path[n] = 0;
    return strstr(path, ".mcap.part") != NULL;
}

static int count;

static int fault(int fd) {
    if (!ours(fd)) return 0;
    const char *slow = getenv("SHIM_SLOW_MS"), *after = getenv("SHIM_EIO_AFTER");
    count++;
    if (slow && count > 12) usleep(1000 * atoi(slow));
    return after && count > atoi(after);
}

ssize_t write(int fd, const void *data, size_t size) {
    static ssize_t (*real)(int, const void *, size_t);
    if (!real) real = dlsym(RTLD_NEXT, "write");
    if (fault(fd)) { errno = EIO; return -1; }
    return real(fd, data, size);
}

int fdatasync(int fd) {
    static int (*real)(int);
    if (!real) real = dlsym(RTLD_NEXT, "fdatasync");
    if (fault(fd)) { errno = EIO; return -1; }
    return real(fd);
}
"""


def shim(folder: Path) -> str:
    """A library that makes the disk slow or broken for logs alone, below Python."""
    (folder / "shim.c").write_text(SHIM)
    library = folder / "shim.so"
    build = ["cc", "-shared", "-fPIC", "-o", str(library), str(folder / "shim.c"), "-ldl"]
    subprocess.run(build, check=True, capture_output=True)
    return str(library)


def broken(folder: Path) -> str:
    path = folder / "trial.mcap"
    trial = RealTime(path, LD_PRELOAD=shim(folder), SHIM_EIO_AFTER="24")
    return ends(trial, path.with_name("trial.mcap.part"), os.strerror(errno.EIO))


def slow(folder: Path) -> str:
    library = shim(folder)
    rows = []
    for name, env in (("plain", {}), ("slow", {"LD_PRELOAD": library, "SHIM_SLOW_MS": "700"})):
        path = folder / f"{name}.mcap"
        trial = RealTime(path, **env)
        time.sleep(8)
        trial.ask(signal.SIGTERM)
        log = read_trial(path)
        assert log.damage is None
        sent = np.array([step.command.sent_ns for step in log.steps]) / 1e6
        p50, worst = np.percentile(np.abs(np.diff(sent) - 200), [50, 100])
        rows.append(f"{p50:.0f} ms off its time in the median, {worst:.0f} at most")
    return f"0.7 s a write or sync: a step {rows[1]}; with the disk as it is {rows[0]}"


def asked(number: signal.Signals) -> Callable[[Path], str]:
    def ask(folder: Path) -> str:
        trial = RealTime(folder / "trial.mcap")
        time.sleep(1.5)
        said = trial.ask(number).strip()
        log = read_trial(folder / "trial.mcap")
        assert log.damage is None and log.result is not None
        assert np.array_equal(log.frames, np.arange(len(log.frames)))
        assert len(log.steps) == log.result.steps
        return f"{said.split(' | ')[0]}; every one of {len(log.frames)} frames in the log"

    return ask


def killed(folder: Path) -> str:
    outcome = random_kill(folder / "trial.mcap", random.Random(1))
    return f"lost {outcome.lost_s:.2f} s of {outcome.ran_s:.2f} s"


END = "robots stopped, trial aborted, message, readable log"
FAULTS: list[tuple[str, str, Callable[[Path], str]]] = [
    ("kill -9", "loses at most 1.2 s", killed),
    ("SIGTERM", "loses nothing", asked(signal.SIGTERM)),
    ("Ctrl-C", "loses nothing", asked(signal.SIGINT)),
    ("disk full", END, full),
    ("I/O error", END, broken),
    ("folder removed", END + ", put back", removed),
    ("folder moved", END, moved),
    ("slow disk", "never delays the loop", slow),
]


def memory_mb() -> float:
    gc.collect()
    _, resident, *_ = Path("/proc/self/statm").read_text().split()
    pages = int(resident)
    return pages * resource.getpagesize() / 1e6


def handles() -> int:
    descriptors = Path("/proc/self/fd").iterdir()
    return len(list(descriptors))


class Watch:
    """Notes memory as a trial goes on."""

    def __init__(self, every: int) -> None:
        self.every = every
        self.seen = []

    def on_start(self, start) -> None: ...
    def on_samples(self, samples) -> None: ...
    def on_command(self, command) -> None: ...
    def on_note(self, note) -> None: ...
    def on_stop(self, stop, result) -> None: ...

    def on_step(self, step) -> None:
        if step.k % self.every == 0:
            self.seen.append((step.k, memory_mb(), handles()))


def soak(folder: Path, scale: float) -> None:
    spec = parse_spec(SMALL, "small.yaml")
    count = max(20, round(1000 * scale))
    warm_up(spec.experiment, print)
    missed = 0
    marks = []
    for i in range(count):
        run_logged(spec, folder, i, (), Interrupt())
        missed += missing_frames(log_path(folder, i))
        log_path(folder, i).unlink()
        if i + 1 in (count // 10, count // 2, count):
            marks.append(f"{i + 1}: {memory_mb():.0f} MB, {handles()} handles")
    print(f"{count} trials, after trial {'; '.join(marks)}; {threading.active_count()} threads;")
    print(f"{missed} camera samples missing")


def long(folder: Path, scale: float) -> None:
    hours = 2 * scale
    steps = round(hours * 3600 / 0.2)
    spec = parse_spec(ENDLESS, "far.yaml", [f"controller.steps_max={steps}"])
    warm_up(spec.experiment, print)
    watch = Watch(max(1, steps // 4))
    began = time.perf_counter()
    result = run_logged(spec, folder, 0, (watch,), Interrupt())
    assert result.steps == steps + 1, result.reason
    seconds = time.perf_counter() - began
    path = log_path(folder, 0)
    marks = [f"{k * 0.2 / 60:.0f} min: {mb:.0f} MB, {n} handles" for k, mb, n in watch.seen]
    size = path.stat().st_size / 1e6
    print(f"{hours:g} h in virtual time took {seconds:.0f} s and {size:.0f} MB of log;")
    print(f"at {'; '.join(marks)};")
    print(f"{missing_frames(path)} camera samples missing")


def missing_frames(path: Path) -> int:
    """Count the frames missing in a log, by the official reader, chunk by chunk."""
    numbers: set[int] = set()
    with path.open("rb") as file:
        for _, _, message in make_reader(file).iter_messages(topics=[FRAMES]):
            times = unpack_columns(CameraFrames.FromString(message.data).times, 3, "<i8")
            numbers.update(times[:, 0].tolist())
    return max(numbers) + 1 - len(numbers)


PARTS = {
    "kills": kills,
    "torn": torn,
    "tampering": tampering,
    "cost": cost,
    "verify": verify_time,
    "faults": faults,
    "soak": soak,
    "long": long,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], metavar="PART")
    parser.add_argument("--scale", type=float, default=1.0)
    options = parser.parse_args()
    for name in options.parts or PARTS:
        print(f"\n## {name}\n", flush=True)
        with tempfile.TemporaryDirectory() as folder:
            PARTS[name](Path(folder), options.scale)


if __name__ == "__main__":
    main()
