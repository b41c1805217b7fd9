"""Build wheels and source archives of all packages: `python tools/dist.py FOLDER`, or `make dist`.

The core has two wheels of the same version. The first is for any Python and system. The second is
for this Python and system, and contains compiled code for processors of level x86-64-v3. Pip
installs the second wheel where it fits. On other processors, and with other versions of Numba, the
code is compiled when it is first used, as with the first wheel.
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
"""Experiments of which one trial each is run. The wheel contains the code that these compile."""


def main(folder: Path) -> None:
    """Build all wheels and source archives into a folder, which is emptied."""
    shutil.rmtree(folder, ignore_errors=True)
    packages = sorted(project.parent for project in ROOT.glob("packages/*/pyproject.toml"))
    for package in (ROOT, *packages):
        build_source_archive(folder, package)
    build_wheels(folder, ROOT, *packages)
    if binding.get_process_triple().startswith("x86_64"):
        with tempfile.TemporaryDirectory() as scratch:
            kernels = compile_kernels(Path(scratch))
            build_wheels(folder, ROOT, TETRACTL_KERNELS=str(kernels))
    else:
        print(f"no wheel with compiled code: this is no processor of level {SHIPPED_LEVEL}")
    for built_file in sorted(folder.iterdir()):
        print(f"{built_file.stat().st_size / 1e6:5.1f} MB  {folder / built_file.name}")


def build_wheels(folder: Path, *packages: Path, **variables: str) -> None:
    """Build the wheels of packages with pip, with additional environment variables."""
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check"]
    command += ["--no-deps", "--wheel-dir", str(folder), *map(str, packages)]
    subprocess.run(command, check=True, env=os.environ | variables)


def build_source_archive(folder: Path, package: Path) -> None:
    """Build the source archive of a package into a folder."""
    command = [sys.executable, "-m", "build", "--sdist", "--outdir", str(folder), str(package)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def compile_kernels(scratch: Path) -> Path:
    """Compile the kernels that trials need, and return the folder that contains their files.

    Args:
        scratch: Folder for the cache, the logs and the kernels.
    """
    if compiler_settings() != "none":
        sys.exit(f"error: code in a wheel is compiled without {compiler_settings()}")
    settings = {
        FOLDER_VARIABLE: str(scratch / "cache"),
        "NUMBA_CPU_NAME": SHIPPED_LEVEL,
        "NUMBA_CPU_FEATURES": "",
    }
    environment = os.environ | settings
    environment.pop("NUMBA_CACHE_DIR", None)
    kernel_folder = scratch / "kernels"
    kernel_folder.mkdir()
    for spec in SPECS:
        print(f"compiling: {spec} ...", flush=True)
        command = [sys.executable, "-m", "tetractl", "run", str(ROOT / f"experiments/{spec}.yaml")]
        command += ["--plant", "sim", "--trials", "1", "--jobs", "1", "--quiet"]
        finished = subprocess.run(
            [*command, "--out", str(scratch / spec)],
            env=environment,
            capture_output=True,
            text=True,
        )
        if finished.returncode:
            sys.exit(f"{' '.join(command)}\n{finished.stderr}")
    for kernel_file in (scratch / "cache").rglob("*.kernel"):
        shutil.copy(kernel_file, kernel_folder)
    return kernel_folder


if __name__ == "__main__":
    main(Path(sys.argv[1]).absolute())
