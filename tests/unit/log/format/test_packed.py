"""Tests of packing the columns of camera frames, and of rounding values that are only drawn."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from testkit.paths import ROOT
from testkit.random_trials import trial, write

from tetractl.core.loggable import DRAWING_PRECISION, round_for_drawing
from tetractl.core.poses import Frames
from tetractl.log.format.channels import CHANNELS
from tetractl.log.format.codec import decode_frames, encode_frames
from tetractl.log.format.packed_columns import pack_columns, unpack_columns
from tetractl.log.read.salvage import scan

PAGE = (ROOT / "docs" / "reference" / "log-format.md").read_text()


def the_pages_function():
    """The function `unpacked` that the page prints, as a reader of the page would have it."""
    program = PAGE[PAGE.index("    import numpy as np\n") : PAGE.index("    frame, sampled_ns")]
    names: dict = {}
    exec("\n".join(line[4:] for line in program.splitlines()), names)
    return names["unpacked"]


@given(
    data=st.data(),
    kind=st.sampled_from(["<i8", "<f8", "<f4"]),
    shape=st.tuples(st.integers(0, 9), st.integers(1, 4)),
)
def test_columns_keep_every_bit_and_the_page_says_how(data, kind, shape):
    bits = data.draw(arrays(np.dtype(f"<i{kind[-1]}"), shape))
    again = unpack_columns(pack_columns(bits.view(kind)), shape[1], kind)
    assert again.view(bits.dtype).tolist() == bits.tolist()
    unpacked_by_the_page = the_pages_function()
    by_the_page = unpacked_by_the_page(pack_columns(bits.view(kind)), shape[1], kind)
    assert by_the_page.view(bits.dtype).tolist() == bits.tolist()


def is_no_subnormal(value):
    """Whether a float of 32 bits holds it in full precision."""
    return value == 0 or abs(value) > 1e-30


@given(value=st.floats(-1e9, 1e9).filter(is_no_subnormal))
def test_what_is_drawn_is_rounded_once(value):
    (rounded,) = round_for_drawing(np.array([value]))
    assert abs(rounded - value) <= DRAWING_PRECISION * abs(value)
    assert round_for_drawing(np.array([rounded])) == [rounded]


def test_each_schema_is_in_a_log_once(tmp_path):
    channels = scan(write(trial(steps=1), tmp_path / "trial.mcap")).channels
    ids = {schema.name: schema.id for _, schema in channels.values() if schema}
    assert all(schema and ids[schema.name] == schema.id for _, schema in channels.values())
    assert len(ids) == len({CHANNELS[topic].DESCRIPTOR.full_name for topic in channels})


@pytest.mark.parametrize("exact", [True, False])
def test_true_poses_that_were_measured_are_not_written_again(exact):
    poses = np.random.default_rng(1).normal(1000, 300, (240, 2, 3))
    truth = poses.copy() if exact else poses + 0.2
    times = np.arange(240) * 8_333_333
    exposed_ns = np.column_stack([times, np.where(times > 0, times - 30_000_000, 0)])
    frames = Frames(times, times, times, poses, np.ones((240, 2), bool), truth, exposed_ns)
    message = encode_frames(frames)
    assert message.exact == exact
    assert bool(message.truth) != exact
    decoded = decode_frames(message, 2)
    assert np.array_equal(decoded.poses, poses)
    assert np.array_equal(decoded.exposed_ns, exposed_ns)
    assert decoded.truth is not None
    assert np.array_equal(decoded.truth, truth if exact else truth.astype(np.float32))
