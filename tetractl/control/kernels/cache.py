"""Keeps compiled kernels between runs, in numba's cache, which is checked first.

Numba's cache ends the process if one of its files is empty or damaged, and unpickles any file. It
is therefore kept in a folder to which only the user can write, with a list of the SHA-256 of each
file. Before the first kernel is loaded, every file is deleted that is not as listed; its code is
then compiled again.
"""

import atexit
import hashlib
import json
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from numba import config, njit

from tetractl.core.cache import cache_folder, claim, compiler_settings, digest, say_once
from tetractl.core.registries import MOTIONS

LIST = "sha256.json"
NEEDED = 16_000_000
"""Space that must be free, more than the code of one start needs [bytes]."""


def sources() -> Iterator[Path]:
    """Yield the source files of kernels.

    For a motion of another package these are all modules in its folder, or only its file if the
    module is in no package.
    """
    yield from Path(__file__).parent.glob("*.py")
    for file in MOTIONS.files():
        yield from file.parent.glob("*.py") if (file.parent / "__init__.py").exists() else [file]


@cache
def folder() -> Path | None:
    """Return the cache folder for the present sources and settings, None if it cannot be made.

    Its parent is $NUMBA_CACHE_DIR, or by default the user's cache folder.
    """
    name = f"kernels-{digest(set(sources()), compiler_settings())}"
    if given := os.environ.get("NUMBA_CACHE_DIR"):
        chosen = Path(given).absolute() / name
        why = claim(chosen, NEEDED)
        if why is None:
            return chosen
        say_once(f"NUMBA_CACHE_DIR is not used: {why}")
    try:
        chosen = cache_folder() / name
        why = claim(chosen, NEEDED)
        if why is None:
            return chosen
    except OSError as error:
        why = error.strerror or str(error)
    say_once(f"compiled code is not kept: {why}")
    return None


def found(place: Path) -> dict[str, str]:
    """Return the SHA-256 of each of numba's files in a folder, by its path in the folder."""
    files = sorted(file for file in place.rglob("*.nb[ic]") if file.is_file())
    return {str(f.relative_to(place)): hashlib.sha256(f.read_bytes()).hexdigest() for f in files}


def check(place: Path) -> None:
    """Delete the files that are not as listed, and list those that this process adds at its end."""
    try:
        listed = json.loads((place / LIST).read_bytes())
    except (OSError, ValueError):
        listed = {}
    present = found(place)
    for name, sha256 in present.items():
        if listed.get(name) != sha256:
            (place / name).unlink()
            if name in listed:
                say_once(f"{place}: damaged, compiled again")
    owner = os.getpid()

    def keep() -> None:
        """Write the list again if there are other files than before."""
        with suppress(OSError):  # what is not listed is compiled again
            if os.getpid() == owner and (now := found(place)) != present:
                with tempfile.NamedTemporaryFile(dir=place, delete=False) as file:
                    file.write(json.dumps(now).encode())
                Path(file.name).replace(place / LIST)

    atexit.register(keep)


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator like `numba.njit`, whose compiled code is kept between runs.

    The code of a function without a wrapper for Python is kept only within that of kernels.
    """
    place = None if options.get("no_cpython_wrapper") else prepared()

    def decorate(function: Callable[..., Any]) -> Any:
        settings: Any = config  # numba reads the folder when it decorates a function
        usual, settings.CACHE_DIR = settings.CACHE_DIR, str(place or settings.CACHE_DIR)
        try:
            return njit(cache=place is not None, **options)(function)
        finally:
            settings.CACHE_DIR = usual

    return decorate


@cache
def prepared() -> Path | None:
    """Return the folder after its check, None if no code is kept."""
    place = folder()
    try:
        if place is not None:
            check(place)
    except OSError as error:
        say_once(f"compiled code is not kept: {error}")
        return None
    return place
