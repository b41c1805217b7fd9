"""The compiled move of particles, (14)-(18), including the draws of its random numbers."""

import numpy as np

from tetractl.control.rng import FACTORS, GOLDEN
from tetractl.core.kernels.kernel_cache import compiled
from tetractl.core.kernels.kernel_options import ENTRY_FAST, INLINE_FAST
from tetractl.model.motion.motion import DIRECTION

STEP, MIX_1, MIX_2 = (np.uint64(number) for number in (GOLDEN, *FACTORS))
LOW, HIGH, _ = DIRECTION
S27, S30, S31, S33 = (np.uint64(s) for s in (27, 30, 31, 33))
LOW_31 = np.uint64(0x7FFF_FFFF)


@compiled(**INLINE_FAST)
def drawn(key, index):
    """Return draw `index` of a key, 64 random bits; see `tetractl.control.rng`."""
    z = key + np.uint64(index + 1) * STEP
    z = (z ^ (z >> S30)) * MIX_1
    z = (z ^ (z >> S27)) * MIX_2
    return z ^ (z >> S31)


@compiled(**ENTRY_FAST)
def move(u, v, best, u_gb, key, z, inertia, cognitive, social):
    """Apply (14)-(17) to u and v (L, P) in place, with the draws of iteration z."""
    length, particles = u.shape
    c1, c2 = cognitive * 2.0**-31, social * 2.0**-31  # r1, r2 are integers of 31 bits
    for j in range(length):
        for n in range(particles):
            draw = drawn(key, (z * length + j) * particles + n)
            r1, r2 = float(np.int32(draw >> S33)), float(np.int32(draw & LOW_31))
            at = u[j, n]
            velocity = inertia * v[j, n] + c1 * r1 * (best[j, n] - at) + c2 * r2 * (u_gb[j] - at)
            velocity = max(LOW - HIGH, min(velocity, HIGH - LOW))  # |ub - lb|, (15)
            v[j, n] = velocity
            u[j, n] = max(LOW, min(at + velocity, HIGH))
