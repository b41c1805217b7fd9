"""Compiled twins of the readable code in `control`, and nothing that is not checked against it.

Particles are contiguous in memory: an array of signals has shape (L, P), of positions (N, P). A
kernel is a loop over the particles of one robot that the compiler turns into vector instructions:
what it calls is written as polynomials, not as calls to the C library, and what belongs to the
robot is a scalar. Nothing is allocated inside a search, and the interpreter's lock is free.

Numba keeps compiled code by the time stamp of one source file. A kernel also depends on the other
files here, so each state of them gets a cache of its own; without that, an edit or an upgrade would
go on running old code.
"""

import os
from pathlib import Path

from numba import config

from tetractl.core.cache import cache_folder, digest

if "NUMBA_CACHE_DIR" not in os.environ:
    folder = cache_folder() / f"kernels-{digest(Path(__file__).parent.glob('*.py'))}"
    config.CACHE_DIR = str(folder)  # pyright: ignore[reportAttributeAccessIssue]
