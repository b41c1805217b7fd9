"""Tests of the random streams of a trial: independent of each other, and always the same."""

import numpy as np

from tetractl.plant.random_streams import RandomStream, generator


def numbers(seed, number):
    return generator(seed, number).random(4).tolist()


def test_a_stream_depends_on_the_seed_and_its_number_alone():
    seed = np.random.SeedSequence(5)
    first = numbers(seed, RandomStream.CAMERA)
    numbers(seed, RandomStream.RADIO)
    assert numbers(seed, RandomStream.CAMERA) == first
    assert numbers(np.random.SeedSequence(5), 0) == first
    assert numbers(np.random.SeedSequence(6), 0) != first


def test_all_streams_of_many_trials_differ():
    trials = np.random.SeedSequence(5).spawn(3)
    streams = [*RandomStream, *range(RandomStream.DISTURBANCES, RandomStream.DISTURBANCES + 100)]
    drawn = {number: [tuple(numbers(trial, number)) for trial in trials] for number in set(streams)}
    flat = [sample for samples in drawn.values() for sample in samples]
    assert len(set(flat)) == len(flat) == 3 * len(set(streams))


def test_a_hundred_disturbances_have_streams_that_nothing_else_uses():
    disturbances = range(RandomStream.DISTURBANCES, RandomStream.DISTURBANCES + 100)
    others = set(RandomStream) - {RandomStream.DISTURBANCES}
    assert not others & set(disturbances)


def test_the_streams_of_older_logs_stay_what_they_were():
    """A change of these numbers would make every older log fail verification."""
    trial = np.random.SeedSequence(2024).spawn(2)[1]
    expected = np.random.default_rng(np.random.SeedSequence(2024, spawn_key=(1, 2))).random(4)
    assert numbers(trial, RandomStream.RADIO) == expected.tolist()
