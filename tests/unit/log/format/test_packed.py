"""The columns of camera frames, packed; and the rounding of what is only drawn."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from support.paths import ROOT
from support.random_trials import trial, write

from tetractl.log.format.channels import CHANNELS
from tetractl.log.format.codec import (
    DRAWN_PRECISION,
    Frames,
    decode_frames,
    drawn,
    encode_frames,
)
from tetractl.log.format.packed_columns import pack_columns, unpack_columns
from tetractl.log.read.salvage import scan

PAGE = (ROOT / "docs" / "reference" / "log-format.md").read_text()


@given(
    data=st.data(),
    kind=st.sampled_from(["<i8", "<f8", "<f4"]),
    shape=st.tuples(st.integers(0, 9), st.integers(1, 4)),
)
def test_columns_keep_every_bit_and_the_page_says_how(data, kind, shape):
    bits = data.draw(arrays(np.dtype(f"<i{kind[-1]}"), shape))
    again = unpack_columns(pack_columns(bits.view(kind)), shape[1], kind)
    assert again.view(bits.dtype).tolist() == bits.tolist()
    program = PAGE[PAGE.index("    import numpy as np\n") : PAGE.index("    frame, sampled_ns")]
    told: dict = {}
    exec("\n".join(line[4:] for line in program.splitlines()), told)
    found = told["unpacked"](pack_columns(bits.view(kind)), shape[1], kind)
    assert found.view(bits.dtype).tolist() == bits.tolist()


@pytest.mark.parametrize("exact", [True, False])
def test_true_poses_that_were_measured_are_not_written_again(exact):
    poses = np.random.default_rng(1).normal(1000, 300, (240, 2, 3))
    truth = poses.copy() if exact else poses + 0.2
    times = np.arange(240) * 8_333_333
    own = np.column_stack([times, times - 30_000_000 * (times > 0)])
    frames = Frames(times, times, times, poses, np.ones((240, 2), bool), truth, own)
    message = encode_frames(frames)
    assert message.exact == exact
    assert bool(message.truth) != exact
    found = decode_frames(message, 2)
    assert np.array_equal(found.poses, poses)
    assert np.array_equal(found.exposed_ns, own)
    assert found.truth is not None
    assert np.array_equal(found.truth, truth if exact else truth.astype(np.float32))


@given(value=st.floats(-1e9, 1e9).filter(lambda one: one == 0 or abs(one) > 1e-30))
def test_what_is_drawn_is_rounded_once(value):
    (found,) = drawn(np.array([value]))
    assert abs(found - value) <= DRAWN_PRECISION * abs(value)
    assert drawn(np.array([found])) == [found]


def test_each_schema_is_in_a_log_once(tmp_path):
    found = scan(write(trial(steps=1), tmp_path / "trial.mcap")).channels
    names = {schema.name: schema.id for _, schema in found.values() if schema}
    assert all(schema and names[schema.name] == schema.id for _, schema in found.values())
    assert len(names) == len({CHANNELS[topic].DESCRIPTOR.full_name for topic in found})
