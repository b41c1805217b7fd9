"""Feeds hostile input to every parser: `python benchmarks/fuzz.py [--target T]... [--seconds S]`.

The targets are all parsers of data from outside (see tests/testkit/targets.py). Each is fuzzed for
S seconds, 30 by default. With atheris (`pip install -e '.[dev,fuzz]'`), the inputs are chosen to
reach new code. Without it, they are random mutations of real packets and files. The output is
Markdown. Three results count as a crash: an exception that the parser does not document, a number
that it must not return, or an input that takes more than two minutes. The input is kept in the
folder `--keep`.
"""

import argparse
import faulthandler
import hashlib
import json
import os
import random
import subprocess
import sys
import tempfile
import time
import traceback
from contextlib import nullcontext
from importlib.util import find_spec
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "tests"))

HANG_S = 120
"""Time after which a parser has hung [s]. On a busy host, a report alone takes half a minute."""
INSTRUMENTED_MODULES = [
    "tetractl.spec",
    "tetractl.lab",
    "tetractl.log",
    "yaml",
    "testkit.targets",
    "testkit.emulator.wire_targets",
]


def all_targets() -> dict[str, Any]:
    """Collect the parsers of the core and of the installed packages, by name."""
    from testkit import targets
    from testkit.emulator import wire_targets

    found_targets = {**targets.TARGETS, **wire_targets.TARGETS}
    if find_spec("cv2"):
        from testkit.microscope import picture_targets

        found_targets |= picture_targets.TARGETS
    return found_targets


class Fuzzer:
    """Feeds inputs to one target until its time is over, and counts them."""

    def __init__(self, run: Any, seconds: float, folder: Path) -> None:
        self.runs = 0
        self.crashes: dict[str, str] = {}  # messages by location, so that one bug counts once
        self._run = run
        self._folder_of_crashes = folder
        self._until_s = time.perf_counter() + seconds
        self._armed_s = 0.0

    def __call__(self, data: bytes) -> None:
        now_s = time.perf_counter()
        if now_s > self._until_s:
            self.finish()
        if now_s > self._armed_s + 1:
            faulthandler.dump_traceback_later(HANG_S, exit=True)
            self._armed_s = now_s
        try:
            self._run(data)
        except Exception as error:
            self._record_crash(error, data)
        self.runs += 1

    def _record_crash(self, error: Exception, data: bytes) -> None:
        last = traceback.extract_tb(error.__traceback__)[-1]
        location = f"{type(error).__name__} at {Path(last.filename).name}:{last.lineno}"
        if location not in self.crashes:
            self.crashes[location] = str(error)[:200]
            name = f"crash-{hashlib.sha256(data).hexdigest()[:12]}"
            (self._folder_of_crashes / name).write_bytes(data)
            traceback.print_exception(error)

    def finish(self) -> None:
        """Report to the parent process and exit immediately, because libFuzzer would continue."""
        print(json.dumps({"runs": self.runs, "crashes": self.crashes}), flush=True)
        os._exit(0)


def fuzz_here(name: str, seconds: float, seed: int, folder_of_crashes: Path) -> None:
    """Fuzz one target in this process."""
    atheris: Any = None
    if find_spec("atheris"):
        import atheris
    with atheris.instrument_imports(include=INSTRUMENTED_MODULES) if atheris else nullcontext():
        from testkit.targets import mutant

        target = all_targets()[name]
    seeds = target.seeds()
    for data in seeds:
        target.run(data)
    fuzz = Fuzzer(target.run, seconds, folder_of_crashes)
    if atheris:
        corpus = Path(tempfile.mkdtemp())
        for i, data in enumerate(seeds):
            (corpus / str(i)).write_bytes(data)
        longest = max(1024, 2 * max(map(len, seeds)))
        options = [f"-seed={seed + 1}", f"-max_len={longest}", f"-timeout={HANG_S}", "-verbosity=0"]
        atheris.Setup(
            [sys.argv[0], *options, f"-artifact_prefix={folder_of_crashes}/", str(corpus)], fuzz
        )
        atheris.Fuzz()
    rng = random.Random(seed)
    while True:
        fuzz(mutant(seeds, rng))


def run_fuzzer(
    name: str, seconds: float, seed: int, folder_of_crashes: Path
) -> subprocess.CompletedProcess[str]:
    """Fuzz a target in a process of its own, with its own folder for files."""
    options = [
        "--target",
        name,
        "--seconds",
        str(seconds),
        "--seed",
        str(seed),
        "--keep",
        str(folder_of_crashes),
    ]
    with tempfile.TemporaryDirectory() as scratch:
        return subprocess.run(
            [sys.executable, __file__, "--child", *options],
            env=os.environ | {"TMPDIR": scratch},
            capture_output=True,
            text=True,
        )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--target", action="append", metavar="T")
    parser.add_argument("--seconds", type=float, default=30)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, default=Path("crashes"))
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    folder_of_crashes = options.keep.absolute()
    if options.child:
        fuzz_here(options.target[0], options.seconds, options.seed, folder_of_crashes)
    unknown = set(options.target or ()) - set(all_targets())
    if unknown:
        names = ", ".join(all_targets())
        parser.error(f"no such target: {unknown.pop()}; there are {names}")
    method = "atheris" if find_spec("atheris") else "seeded mutations, for atheris is not installed"
    folder_of_crashes.mkdir(parents=True, exist_ok=True)
    print(f"With {method}, {options.seconds:g} s a target:\n", flush=True)
    print("| target | runs | crashes |\n|---|---|---|", flush=True)
    failed = False
    for name in options.target or all_targets():
        process = run_fuzzer(name, options.seconds, options.seed, folder_of_crashes)
        if process.returncode:
            print(f"| {name} | died with {process.returncode} | |\n\n{process.stderr}", flush=True)
            failed = True
            continue
        record = json.loads(process.stdout.splitlines()[-1])
        print(f"| {name} | {record['runs']} | {len(record['crashes'])} |")
        for location, message in record["crashes"].items():
            print(f"\n{location}: {message}\n\n{process.stderr}")
        failed |= bool(record["crashes"])
        sys.stdout.flush()
    if folder_of_crashes.exists() and not any(
        folder_of_crashes.iterdir()
    ):  # another run may have removed it
        folder_of_crashes.rmdir()
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
