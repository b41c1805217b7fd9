"""Compiled twins of the readable code in `control`, and nothing that is not checked against it.

Particles are contiguous in memory: an array of signals has shape (L, P), of positions (N, P). A
kernel is a loop over the particles of one robot that the compiler turns into vector instructions:
what it calls is written as polynomials, not as calls to the C library, and what belongs to the
robot is a scalar. Nothing is allocated inside a search, and the interpreter's lock is free.

A kernel is compiled once for each class of constants of a motion (`tetractl.model.motion`) and for
each set of kinds of obstacles (`tetractl.model.shapes`).

Numba keeps compiled code by the time stamp of one source file. A kernel also depends on the other
files here and on those of motions and shapes, so each state of them gets a cache of its own;
without that, an edit or an upgrade would go on running old code.
"""

import os
from collections.abc import Iterator
from pathlib import Path

from numba import config

from tetractl.core.cache import cache_folder, digest
from tetractl.experiment.kinds import MOTIONS, SHAPES


def sources() -> Iterator[Path]:
    """Yield the files that kernels are compiled from.

    Of a motion or shape that is installed with another package these are all modules beside its own
    in the package, or its own alone where it is in none.
    """
    yield from Path(__file__).parent.glob("*.py")
    for registry in (MOTIONS, SHAPES):
        for file in registry.files():
            yield from (
                file.parent.glob("*.py") if (file.parent / "__init__.py").exists() else [file]
            )


if "NUMBA_CACHE_DIR" not in os.environ:
    folder = cache_folder() / f"kernels-{digest(set(sources()))}"
    config.CACHE_DIR = str(folder)  # pyright: ignore[reportAttributeAccessIssue]
