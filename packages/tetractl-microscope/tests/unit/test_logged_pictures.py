"""Tests that the images of a camera are logged unchanged."""

import pytest
from testkit.microscope.dish_films import film
from testkit.microscope.film_logs import write_film

from tetractl.log.format import channels
from tetractl.log.read.salvage import scan
from tetractl.verification.verify import verify


@pytest.fixture(scope="module")
def film_log(tmp_path_factory):
    path = tmp_path_factory.mktemp("film") / "trial-000.mcap"
    samples = write_film(film(seed=52, side=384, cells=3, seconds=1.6), path)
    return path, samples


@pytest.mark.long
def test_what_the_camera_adds_is_logged_as_it_is_with_the_times_of_its_frame(film_log):
    path, samples = film_log
    log = scan(path)
    begin = log.run.start_unix_ns
    added = [
        (topic, begin + sample.observation.received_ns, begin + sample.observation.sampled_ns, data)
        for sample in samples
        for topic, data in sample.messages
    ]
    logged = [
        *log.entries_by_topic[channels.PICTURE_TOPIC],
        *log.entries_by_topic[channels.BACKGROUND_TOPIC],
    ]
    assert sorted(map(tuple, logged)) == sorted(added)
    assert {topic for topic, *_ in added} == {channels.PICTURE_TOPIC, channels.BACKGROUND_TOPIC}
    assert verify(path).problems == ()
