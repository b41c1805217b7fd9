"""Build wheels and source archives of all packages: `python tools/dist.py FOLDER`, or `make dist`.

The core has two of the same version: one for any Python and system, and one for this Python and
system that brings its compiled code, for processors of level x86-64-v3. Pip takes the second where
it fits. Other processors, and other versions of Numba, compile as with the first.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from llvmlite import binding

from tetractl.tools.cache import FOLDER_VARIABLE, compiler_settings
from tetractl.tools.kernels.kernel_cache import SHIPPED_LEVEL

ROOT = Path(__file__).parents[1]
SPECS = (
    "three_m3pi",
    "three_m3pi_bench",
    "three_m3pi_paper",
    "three_m3pi_paper_bench",
    "five_robots",
    "five_robots_bench",
    "tetrahymena",
    "tetrahymena_disturbed",
    "tetrahymena_hold",
    "single_cell",
    "round_obstacle",
    "micro_channels",
)
"""Experiments of which one trial each is run: what these compile is in the wheel."""


def main(folder: Path) -> None:
    """Build all wheels and source archives into a folder, which is emptied."""
    shutil.rmtree(folder, ignore_errors=True)
    packages = sorted(one.parent for one in ROOT.glob("packages/*/pyproject.toml"))
    for package in (ROOT, *packages):
        source_archive(folder, package)
    wheel(folder, ROOT, *packages)
    if binding.get_process_triple().startswith("x86_64"):
        with tempfile.TemporaryDirectory() as scratch:
            wheel(folder, ROOT, TETRACTL_KERNELS=str(kernels(Path(scratch))))
    else:
        print(f"no wheel with compiled code: this is no processor of level {SHIPPED_LEVEL}")
    for one in sorted(folder.iterdir()):
        print(f"{one.stat().st_size / 1e6:5.1f} MB  {folder / one.name}")


def wheel(folder: Path, *sources: Path, **variables: str) -> None:
    """Build the wheels of some packages, by pip."""
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check"]
    command += ["--no-deps", "--wheel-dir", str(folder), *map(str, sources)]
    subprocess.run(command, check=True, env=os.environ | variables)


def source_archive(folder: Path, package: Path) -> None:
    """Build the source archive of a package."""
    command = [sys.executable, "-m", "build", "--sdist", "--outdir", str(folder), str(package)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def kernels(scratch: Path) -> Path:
    """Compile what trials need in an empty cache; return the folder of the files."""
    if compiler_settings() != "none":
        sys.exit(f"error: code in a wheel is compiled without {compiler_settings()}")
    chosen = {
        FOLDER_VARIABLE: str(scratch / "cache"),
        "NUMBA_CPU_NAME": SHIPPED_LEVEL,
        "NUMBA_CPU_FEATURES": "",
    }
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"} | chosen
    found = scratch / "kernels"
    found.mkdir()
    for spec in SPECS:
        print(f"compiling: {spec} ...", flush=True)
        run = [sys.executable, "-m", "tetractl", "run", str(ROOT / f"experiments/{spec}.yaml")]
        run += ["--plant", "sim", "--trials", "1", "--jobs", "1", "--quiet"]
        done = subprocess.run(
            [*run, "--out", str(scratch / spec)], env=environment, capture_output=True, text=True
        )
        if done.returncode:
            sys.exit(f"{' '.join(run)}\n{done.stderr}")
    for one in (scratch / "cache").rglob("*.kernel"):
        shutil.copy(one, found)
    return found


if __name__ == "__main__":
    main(Path(sys.argv[1]).absolute())
