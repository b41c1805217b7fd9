import numpy as np
import pytest
import scipy
from hypothesis import given
from hypothesis import strategies as st
from testkit.references.paper import split_mix

from tetractl.control.search.rng import mix, normal, random_bits, uniform, uniform_pairs

KEYS = st.integers(0, 2**64 - 1)
PUBLISHED = {  # of the generator's reference implementation
    1234567: (
        6457827717110365317,
        3203168211198807973,
        9817491932198370423,
        4593380528125082431,
        16408922859458223821,
    ),
    0: (16294208416658607535, 7960286522194355700),
}


@pytest.mark.parametrize("seed", PUBLISHED)
def test_the_published_numbers_come_out(seed):
    expected = list(PUBLISHED[seed])
    assert [mix(seed, i) for i in range(len(expected))] == expected
    assert random_bits(seed, 0, len(expected)).tolist() == expected


@given(KEYS, st.integers(0, 10**9), st.integers(0, 40))
def test_a_draw_depends_on_its_key_and_index_alone(key, first, count):
    drawn = random_bits(key, first, count).tolist()
    assert drawn == [mix(key, first + i) for i in range(count)]
    assert drawn == [split_mix(key, first + i) for i in range(count)]


def test_numbers_are_uniform_and_independent():
    n = 100_000
    of_key_1 = uniform(1, 0, n)
    of_key_2 = uniform(2, 0, n)
    high, low = uniform_pairs(3, 0, n)
    for numbers in (of_key_1, of_key_2, high, low):
        assert numbers.min() >= 0
        assert numbers.max() < 1
        counts = np.histogram(numbers, 64, (0, 1))[0]
        assert scipy.stats.chisquare(counts).pvalue > 1e-4
    successors = (of_key_1[1:], of_key_1[:-1])
    pairs = ((of_key_1, of_key_2), (high, low), successors, (low[1:], high[:-1]))
    for first, second in pairs:
        table = np.histogram2d(first, second, 16, ((0, 1), (0, 1)))[0]
        assert scipy.stats.chisquare(table.ravel()).pvalue > 1e-4


def test_derived_keys_start_streams_of_their_own():
    streams = [random_bits(mix(7, i), 0, 2000) for i in range(50)]
    assert np.unique(np.concatenate(streams)).size == 100_000


def test_normal_numbers_are_normal():
    numbers = normal(1, 0, 100_000)
    assert scipy.stats.kstest(numbers, "norm").pvalue > 1e-4
    assert abs(np.corrcoef(numbers[1:], numbers[:-1])[0, 1]) < 0.02
