"""The firmware's own cores, compiled for this machine: emulated devices run what real ones run.

`<name>_core.c` and `framing.c` of `firmware/` are built once into the user's cache folder, by the
compiler in $CC or the first of cc, gcc and clang.
"""

import ctypes
import os
import platform
import shutil
import subprocess
import tempfile
from pathlib import Path

from tetractl.core.cache import cache_folder, digest
from tetractl.core.errors import TetractlError

FLAGS = ("-std=c99", "-O2", "-fPIC", "-shared")


def compiler() -> str | None:
    """Return the path of a C compiler, or None."""
    names = [os.environ.get("CC", ""), "cc", "gcc", "clang"]
    return next(filter(None, (shutil.which(name) for name in names if name)), None)


def source_folder() -> Path:
    """Return the folder of the C sources: in the source tree, or shipped inside the package."""
    here = Path(__file__).resolve()
    for folder in (here.parents[1] / "firmware", here.parents[2] / "firmware"):
        if (folder / "framing.c").is_file():
            return folder
    raise TetractlError("the firmware's C sources are missing from this installation")


def load(name: str, folder: Path | None = None) -> ctypes.CDLL:
    """Return the compiled core `name`, built in `folder` (default: the cache) where needed.

    TetractlError where there is no compiler, no source, or the source does not compile.
    """
    sources = source_folder()
    codes = [sources / f"{name}_core.c", sources / "framing.c"]
    parts = [part for code in codes for part in (code, code.with_suffix(".h"))]
    state = digest(parts, " ".join(FLAGS))
    path = (folder or cache_folder()) / f"{name}_core-{platform.machine()}-{state}.so"
    if not path.is_file():
        _build(codes, path)
    return ctypes.CDLL(str(path))


def _build(codes: list[Path], path: Path) -> None:
    name = compiler()
    if name is None:
        raise TetractlError(
            "no C compiler found; emulated devices run the compiled firmware",
            hint="install gcc or clang, or set CC",
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as scratch:
        built = Path(scratch) / path.name
        done = subprocess.run(
            [name, *FLAGS, *map(str, codes), "-o", str(built)], capture_output=True, text=True
        )
        if done.returncode:
            line = (done.stderr.strip() or "no message").splitlines()[0]
            raise TetractlError(f"{name} could not build the firmware's core: {line}")
        built.replace(path)  # in one step: other processes see all of it or nothing
