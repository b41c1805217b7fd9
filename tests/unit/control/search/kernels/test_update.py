"""Tests of one move of a swarm against the paper's equations, number by number."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.control.search.kernels import update
from tetractl.control.search.rng import mix
from tetractl.tools.kernels.kernel_cache import compiled

pytestmark = pytest.mark.slow

KEYS = st.integers(0, 2**64 - 1)


@compiled()
def drawn(key, index):
    return update.random_bits(key, index)


@given(KEYS, st.integers(0, 2**40))
def test_compiled_random_numbers_are_those_of_splitmix(key, index):
    assert int(drawn(np.uint64(key), index)) == mix(key, index)


@given(
    key=KEYS,
    z=st.integers(0, 500),
    length=st.integers(1, 4),
    particles=st.integers(1, 5),
    inertia=st.floats(0, 2),
    cognitive=st.floats(0, 3),
    social=st.floats(0, 3),
)
def test_a_swarm_moves_by_14_to_17(key, z, length, particles, inertia, cognitive, social):
    rng = np.random.default_rng(key)
    u, u_lb = rng.uniform(-math.pi, math.pi, (2, length, particles))
    v = rng.uniform(-math.tau, math.tau, (length, particles))
    u_gb = rng.uniform(-math.pi, math.pi, length)
    moved = u.copy()
    faster = v.copy()
    numbers = z, inertia, cognitive, social
    update.move(moved, faster, u_lb, u_gb, np.uint64(key), *numbers)
    for j in range(length):
        for n in range(particles):
            bits = mix(key, (z * length + j) * particles + n)
            r1 = (bits >> 33) / 2**31
            r2 = (bits % 2**31) / 2**31
            velocity = inertia * v[j, n]
            velocity += cognitive * r1 * (u_lb[j, n] - u[j, n])
            velocity += social * r2 * (u_gb[j] - u[j, n])  # (14)
            velocity = np.clip(velocity, -math.tau, math.tau)  # (15)
            assert faster[j, n] == pytest.approx(velocity, abs=1e-12)
            expected = np.clip(u[j, n] + velocity, -math.pi, math.pi)  # (16), (17)
            assert moved[j, n] == pytest.approx(expected, abs=1e-12)


def test_particles_at_the_best_of_all_keep_what_inertia_leaves_of_their_velocities():
    best = np.array([[0.5, 0.5]])
    u = best.copy()
    v = np.array([[1.0, -2.0]])
    update.move(u, v, best, best[:, 0], np.uint64(3), 0, 0.25, 2.0, 2.0)
    assert v.tolist() == [[0.25, -0.5]]
    assert u.tolist() == [[0.75, 0.0]]
