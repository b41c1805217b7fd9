"""Tests of a camera's problems and warnings about its stream of images."""

import pytest
from tetractl_microscope.pictures.searches import PictureSearch, describe_stream

from tetractl.core.clock import SECOND

pytestmark = pytest.mark.slow

GOOD = {"ended": "", "now": 0.7, "declared": 30.0, "damaged": 0, "every": 1, "hz": 30.0}


@pytest.mark.parametrize(
    ("changes", "problem", "warning"),
    [
        ({}, None, None),
        ({"ended": "the stream ended"}, "the stream ended", None),
        ({"now": 1.2}, "no images come from film any more", None),
        ({"declared": 60.0}, None, "only 30 images per second come instead of 60: is there"),
        ({"hz": 10.0, "declared": None, "now": 2.0}, None, "only 10 images per second come"),
        (
            {"every": 2},
            None,
            "19 of the last 39 images were not searched, because searching one takes",
        ),
        ({"damaged": 3}, None, "3 images were damaged"),
    ],
)
def test_each_fault_of_the_stream_is_one_line(changes, problem, warning):
    stream = GOOD | changes
    step = stream["every"]
    hz = stream["hz"]
    searches = [
        PictureSearch(k * step, round(k * step * SECOND / hz), 5_000_000, None) for k in range(20)
    ]
    now_ns = round(stream["now"] * SECOND) + (step - 1) * 19 * SECOND // 30
    problems, warnings = describe_stream(
        searches, "film", stream["ended"], now_ns, stream["declared"], stream["damaged"]
    )
    assert problems == ([] if problem is None else [problem])
    assert [line.startswith(warning) for line in warnings] == ([] if warning is None else [True])


@pytest.mark.parametrize(
    ("numbers", "missing"),
    [
        (range(7, 27), None),
        ([*range(7, 17), *range(20, 30)], "3 of the last 23 images"),
        ([9], None),
    ],
)
def test_images_are_counted_from_the_first_that_is_kept(numbers, missing):
    searches = [PictureSearch(k, round(k * SECOND / 30), 5_000_000, None) for k in numbers]
    now_ns = searches[-1].received_ns
    _, warnings = describe_stream(searches, "film", "", now_ns, None, 0)
    assert len(warnings) == (missing is not None)
    assert all(line.startswith(missing) for line in warnings)


def test_a_stream_without_images_has_one_problem():
    assert describe_stream([], "film", "", SECOND, 30.0, 0) == (
        ["no images come from film any more"],
        [],
    )
