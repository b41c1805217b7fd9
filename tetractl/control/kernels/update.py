"""The compiled move of particles, (14)-(18), including the draws of its random numbers."""

import math

import numpy as np

from tetractl.control.kernels.cache import compiled
from tetractl.control.kernels.options import INLINE_FAST

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
MIX_1, MIX_2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
S27, S30, S31, S33 = (np.uint64(s) for s in (27, 30, 31, 33))
LOW_31 = np.uint64(0x7FFF_FFFF)
UNIT_31 = 2.0**-31
SPAN = 2 * math.pi  # |ub - lb|, (15)


@compiled(**INLINE_FAST)
def mixed(z):
    """Return 64 random bits, the mix of the generator's state z; see `tetractl.control.rng`."""
    z = (z ^ (z >> S30)) * MIX_1
    z = (z ^ (z >> S27)) * MIX_2
    return z ^ (z >> S31)


@compiled(**INLINE_FAST)
def move(u, v, best, better, j, u_gb, key, first, inertia, cognitive, social):
    """Apply (14)-(17) to signal j of every particle, with draws first, first + 1, ...

    Before that, the coordinate of a particle that has just improved becomes its local best, (18):
    this is done here because the row is in the processor's cache.
    """
    c1, c2 = cognitive * UNIT_31, social * UNIT_31  # r1, r2 are integers of 31 bits
    base = key + np.uint64(first + 1) * GOLDEN
    for n in range(u.shape[1]):
        z = mixed(base + np.uint64(n) * GOLDEN)
        r1, r2 = float(np.int32(z >> S33)), float(np.int32(z & LOW_31))
        at = u[j, n]
        own = at if better[n] > 0.5 else best[j, n]
        best[j, n] = own
        velocity = inertia * v[j, n] + c1 * r1 * (own - at) + c2 * r2 * (u_gb - at)
        velocity = max(-SPAN, min(velocity, SPAN))
        v[j, n] = velocity
        u[j, n] = max(-math.pi, min(at + velocity, math.pi))
