"""A random generator without state: each random number depends only on a key and an index.

The generator is SplitMix64 (Steele, Lea and Flood, OOPSLA 2014): random number i of a key is a
64-bit mixing of key + (i + 1) * golden ratio. A plan therefore does not depend on the number of
threads or on the order in which particles are computed, and compiled code gets the same numbers.
"""

import numpy as np
from numpy.typing import NDArray

from tetractl.core import elementwise
from tetractl.core.poses import Floats

RandomBits = NDArray[np.uint64]

GOLDEN = 0x9E3779B97F4A7C15
"""2^64 over the golden ratio, made odd: the step of SplitMix64 (Steele, Lea and Flood 2014)."""
FACTORS = (0xBF58476D1CE4E5B9, 0x94D049BB133111EB)
"""Factors of the mixing function of SplitMix64."""
MASK = 0xFFFF_FFFF_FFFF_FFFF
"""Mask for 64 bits, with which Python's unlimited integers wrap around like machine words."""


def mix(key: int, index: int) -> int:
    """Return the random number that belongs to a key and an index, with 64 random bits.

    The result can also serve as a new key.
    """
    z = (key + (index + 1) * GOLDEN) & MASK
    z = ((z ^ (z >> 30)) * FACTORS[0]) & MASK
    z = ((z ^ (z >> 27)) * FACTORS[1]) & MASK
    return z ^ (z >> 31)


def random_bits(key: int, first_index: int, count: int) -> RandomBits:
    """Return consecutive random numbers of a key, each with 64 random bits, shape (count,).

    Args:
        key: The key.
        first_index: Index of the first number.
        count: How many numbers to return.
    """
    with np.errstate(over="ignore"):
        z = np.arange(first_index + 1, first_index + count + 1, dtype=np.uint64) * np.uint64(GOLDEN)
        z += np.uint64(key)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(FACTORS[0])
        z = (z ^ (z >> np.uint64(27))) * np.uint64(FACTORS[1])
    return z ^ (z >> np.uint64(31))


def uniform(key: int, first_index: int, count: int) -> Floats:
    """Return uniform numbers in [0, 1) with 53 random bits each, shape (count,).

    Args:
        key: The key.
        first_index: Index of the first number.
        count: How many numbers to return.
    """
    return (random_bits(key, first_index, count) >> np.uint64(11)).astype(np.float64) * 2.0**-53


def uniform_pairs(key: int, first_index: int, count: int) -> tuple[Floats, Floats]:
    """Return pairs of independent uniform numbers in [0, 1), with 31 random bits each.

    Args:
        key: The key.
        first_index: Index of the first pair.
        count: How many pairs to return.

    Returns:
        The first and the second numbers of the pairs, shape (count,) each.
    """
    words = random_bits(key, first_index, count)
    high = words >> np.uint64(33)
    low = words & np.uint64(0x7FFF_FFFF)
    return high.astype(np.float64) * 2.0**-31, low.astype(np.float64) * 2.0**-31


def normal(key: int, first_index: int, count: int) -> Floats:
    """Return random numbers of the standard normal distribution, shape (count,).

    The method is that of Box and Muller (1958): sqrt(-2 ln r) cos(2 pi phi), with r in (0, 1] and
    phi of 31 bits each. Therefore no number exceeds 6.6.

    Args:
        key: The key.
        first_index: Index of the first number.
        count: How many numbers to return.
    """
    high, low = uniform_pairs(key, first_index, count)
    return np.sqrt(-2 * elementwise.log(1 - high)) * elementwise.cos(2 * np.pi * low)
