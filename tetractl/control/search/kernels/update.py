"""The compiled move of a particle swarm, the paper's (14)-(17), with its random numbers."""

import numpy as np

from tetractl.control.search.rng import FACTORS, GOLDEN
from tetractl.model.motion.motion import LOWER, UPPER
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import ENTRY_FAST, INLINE_FAST

# constants of `tetractl.control.search.rng.mix`, as numbers of 64 bits
STEP = np.uint64(GOLDEN)  # between two keys
MIX_1 = np.uint64(FACTORS[0])  # first factor
MIX_2 = np.uint64(FACTORS[1])  # second factor
S27 = np.uint64(27)  # shift of its second round [bits]
S30 = np.uint64(30)  # shift of its first round [bits]
S31 = np.uint64(31)  # shift of its last round [bits]
S33 = np.uint64(33)  # shift that leaves the upper 31 bits [bits]
LOW_31 = np.uint64(0x7FFF_FFFF)  # mask of the lower 31 bits


@compiled(**INLINE_FAST)
def random_bits(key, index):
    """Return the 64 random bits that belong to a key and an index, as `rng.mix` does."""
    z = key + np.uint64(index + 1) * STEP
    z = (z ^ (z >> S30)) * MIX_1
    z = (z ^ (z >> S27)) * MIX_2
    return z ^ (z >> S31)


@compiled(**ENTRY_FAST)
def move(u, v, u_lb, u_gb, key, z, inertia, cognitive, social):
    """Move all particles of a swarm by the paper's equations (14)-(17), in place.

    The random factors r1 and r2 are the upper and the lower 31 bits of one random number. The scale
    2^-31 that brings them into [0, 1) is part of the weights c1 and c2.

    Args:
        u: Positions [rad], shape (L, P).
        v: Velocities, shape (L, P).
        u_lb: Best position of each particle, shape (L, P).
        u_gb: Best position of all particles, shape (L,).
        key: Key of the random numbers.
        z: Index of the iteration.
        inertia: Weight of the velocity.
        cognitive: Weight c1 of the pull to the particle's best position.
        social: Weight c2 of the pull to the best position of all.
    """
    length, particles = u.shape
    c1 = cognitive * 2.0**-31
    c2 = social * 2.0**-31
    for j in range(length):
        for n in range(particles):
            bits = random_bits(key, (z * length + j) * particles + n)
            r1 = float(np.int32(bits >> S33))
            r2 = float(np.int32(bits & LOW_31))
            to_own_best = c1 * r1 * (u_lb[j, n] - u[j, n])
            to_common_best = c2 * r2 * (u_gb[j] - u[j, n])
            velocity = inertia * v[j, n] + to_own_best + to_common_best  # (14)
            velocity = max(LOWER - UPPER, min(velocity, UPPER - LOWER))  # (15)
            v[j, n] = velocity
            u[j, n] = max(LOWER, min(u[j, n] + velocity, UPPER))  # (16), (17)
