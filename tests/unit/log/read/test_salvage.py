"""Tests that only what was written is read from a damaged file, and that damage is reported."""

import math
import random
from dataclasses import replace

import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType, Writer
from testkit.fuzz import Original
from testkit.mutate import rewrite, rewritten, stating
from testkit.random_trials import trial, write

from tetractl.core import elementwise
from tetractl.core.errors import LogError
from tetractl.core.plan import Outcome
from tetractl.log.format.channels import FRAMES, RESULT, RUN
from tetractl.log.read.overview import overview
from tetractl.log.read.reader import content_digest, read_result, read_trial
from tetractl.log.read.salvage import MAGIC, peek, scan
from tetractl.verification.comparison import first_difference

pytestmark = pytest.mark.slow

# How the record at the end of the data begins: its opcode, its length; 4 bytes of CRC-32 follow.
DATA_END = b"\x0f" + (4).to_bytes(8, "little")


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A small log of a few chunks."""
    return write(trial(steps=34), tmp_path_factory.mktemp("log") / "trial.mcap")


@pytest.fixture(scope="module")
def undamaged(log):
    """What the log says before it is damaged."""
    return read_trial(log)


@pytest.fixture(scope="module")
def chunks(log):
    """Where its chunks lie, by the official reader."""
    spans = Original(log).chunks
    assert len(spans) > 3
    return spans


def assert_part_of(damaged, undamaged):
    """Every number of a damaged log is one of the whole log's."""
    assert damaged.experiment == undamaged.experiment
    assert damaged.start.spec_text in ("", undamaged.start.spec_text)
    assert damaged.start.seed == undamaged.start.seed
    steps = {step.k: step for step in undamaged.steps}
    assert all(not first_difference(step, steps[step.k]) for step in damaged.steps)
    rows = np.searchsorted(undamaged.frames, damaged.frames)
    for name in ("frames", "mocap_ns", "received_ns", "mocap", "valid", "truth"):
        assert not first_difference(getattr(damaged, name), getattr(undamaged, name)[rows])
    assert damaged.stop is None or not first_difference(damaged.stop, undamaged.stop)
    untimed = replace(undamaged.result, solve_ns=(), deadline_misses=0)
    assert any(
        not first_difference(damaged.result, result) for result in (None, untimed, undamaged.result)
    )


def _damaged(tmp_path, data):
    path = tmp_path / "damaged.mcap"
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("field", range(1, 9))
def test_a_bad_record_length_costs_nothing(tmp_path, log, undamaged, chunks, field):
    data = bytearray(log.read_bytes())
    data[chunks[1].begin + field] ^= 0x41
    salvaged = read_trial(_damaged(tmp_path, bytes(data)))
    assert salvaged.damage is not None
    assert len(salvaged.steps) == len(undamaged.steps)
    assert not first_difference(salvaged.mocap, undamaged.mocap)
    assert_part_of(salvaged, undamaged)


def test_without_first_chunk_and_index_the_rest_is_read(tmp_path, log, undamaged, chunks):
    data = bytearray(log.read_bytes()[: chunks[-1].end])
    for chunk in chunks[:3]:  # the run's with all channel records, the scene's, the next
        data[(chunk.begin + chunk.end) // 2] ^= 0xFF
    salvaged = read_trial(_damaged(tmp_path, bytes(data)))
    assert 0 < len(salvaged.steps) < len(undamaged.steps)
    assert_part_of(salvaged, undamaged)


def test_a_file_that_lost_its_head_is_read(tmp_path, log, undamaged):
    data = log.read_bytes()
    for beheaded in (data[8:], b"\0" * 40 + data[40:], b"some text before\n" + data):
        salvaged = read_trial(_damaged(tmp_path, beheaded))
        assert salvaged.damage is not None
        assert not first_difference(salvaged.mocap, undamaged.mocap)
        assert not first_difference(salvaged.result, undamaged.result)


@pytest.fixture
def without_result(log, chunks, tmp_path):
    """The log as a crash leaves it just before the result is written."""
    return _damaged(tmp_path, log.read_bytes()[: chunks[-2].end])


def test_a_lost_result_is_computed_from_the_last_true_poses(undamaged, without_result):
    salvaged = read_trial(without_result)
    summary = read_result(without_result)
    assert summary.recovered
    assert summary.result.outcome is Outcome.ABORTED
    assert summary.result.steps == len(salvaged.steps)
    final = salvaged.truth[-1]
    targets = np.array([robot.target for robot in undamaged.experiment.robots])
    errors = elementwise.hypot(*(final[:, :2] - targets).T)
    assert summary.result.robot_errors == tuple(errors)
    assert summary.result.total_error == pytest.approx(errors.sum(), rel=1e-15)
    assert not first_difference(summary.result.verdict.final.array(), final)


def _lose(sample, tracked):
    """The sample with robots that are not tracked, whose poses then are no measurements."""
    poses = sample.observation.poses
    nowhere = replace(poses, x=np.where(tracked, poses.x, 1e9))
    return replace(sample, observation=replace(sample.observation, poses=nowhere, valid=tracked))


def test_in_the_lab_the_last_tracked_pose_counts(tmp_path):
    random_trial = trial(steps=12, simulated=False)
    last_round, _ = random_trial.rounds[-1]
    last = _lose(last_round[-1], np.array([False, True, True]))
    for samples, _ in random_trial.rounds:
        samples[:] = [_lose(sample, sample.observation.valid) for sample in samples]
    last_round[-1] = last
    contents = scan(write(random_trial, tmp_path / "trial.mcap"))
    spoilt = rewrite(contents, tmp_path / "no.mcap", stating(contents, RESULT, duration_s=math.nan))
    summary = read_result(spoilt)
    assert summary.recovered
    assert max(summary.result.robot_errors) < 1e6
    observations = [sample.observation for sample in random_trial.samples]
    for i in range(3):
        tracked_x = [o.poses.x[i] for o in observations if o.valid[i]]
        assert summary.result.verdict.final.x[i] == tracked_x[-1]


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "the file is empty"),
        (b"\0", "not an MCAP file"),
        (b"name: three-m3pi\n" * 10, "not an MCAP file"),
        (MAGIC, "the record of the run is lost"),
        (b"\x04\0\0\0zstd" * 100, "not an MCAP file"),
        (random.Random(3).randbytes(100_000), "not an MCAP file"),
    ],
)
def test_what_is_no_log_is_refused(tmp_path, data, message):
    path = _damaged(tmp_path, data)
    for read in (read_trial, read_result):
        with pytest.raises(LogError, match=message):
            read(path)


def test_an_mcap_file_of_somebody_else_is_refused(tmp_path):
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/chatter", "json", 0)
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    with pytest.raises(LogError, match="an MCAP file, but not a log of tetractl"):
        read_trial(path)


OPTIONS_WITHOUT = {
    "checksums": {"enable_crcs": False},
    "summary": {
        "index_types": IndexType.NONE,
        "repeat_channels": False,
        "repeat_schemas": False,
        "use_statistics": False,
        "use_summary_offsets": False,
    },
}


@pytest.mark.parametrize("left_out", OPTIONS_WITHOUT)
def test_a_log_that_another_program_wrote_again_without_a_part_is_whole(
    left_out, log, undamaged, tmp_path
):
    """Regression: without checksums "the record of the run is lost", without a summary "the index
    is damaged"."""
    path = tmp_path / "again.mcap"
    again = read_trial(rewritten(log, path, in_order=True, **OPTIONS_WITHOUT[left_out]))
    assert again.damage is None
    assert not first_difference(again.mocap, undamaged.mocap)
    assert not first_difference(again.result, undamaged.result)


@pytest.mark.parametrize("in_order", [True, False])
def test_a_copy_under_tetractls_name_with_attachments_first_is_not_altered(log, tmp_path, in_order):
    """Regression: "the content does not match the digest", although every record was equal."""
    again = scan(rewritten(log, tmp_path / "again.mcap", in_order, keeps_name=True))
    assert not again.altered
    assert again.reordered == (not in_order)
    assert again.rewritten_by == "an unknown program"
    assert scan(log).rewritten_by == ""


def test_a_log_of_another_format_is_refused(tmp_path, log):
    contents = scan(log)
    newer = rewrite(contents, tmp_path / "new.mcap", stating(contents, RUN, format_version=5))
    with pytest.raises(
        LogError,
        match="format 5, but this version of tetractl reads format 4; read the log with the "
        "version that wrote it, tetractl 0",
    ):
        read_trial(newer)


@pytest.mark.long
def test_a_flipped_bit_is_seen_without_reading_the_trial(log, tmp_path):
    """Regression: `stats` and `--resume`, which read by the index, missed nine of ten."""
    data = log.read_bytes()
    rng = random.Random(7)
    path = tmp_path / "trial.mcap"
    end = data.rindex(DATA_END)
    in_the_data_end = range(end, end + len(DATA_END) + 4)
    anywhere = [rng.randrange(len(data)) for _ in range(100)]
    for offset in (*in_the_data_end, *anywhere):
        changed = bytearray(data)
        changed[offset] ^= 1 << rng.randrange(8)
        path.write_bytes(changed)
        try:
            assert read_result(path).recovered, offset
        except LogError:
            continue


@pytest.mark.parametrize("tail", [b"\0" * 5000, b"\xff" * 5000, MAGIC])
def test_what_a_crash_leaves_behind_the_last_chunk_does_no_harm(
    tmp_path, log, undamaged, chunks, tail
):
    cut = log.read_bytes()[: chunks[-2].end]
    salvaged = read_trial(_damaged(tmp_path, cut + tail))
    assert salvaged.damage is not None
    assert salvaged.result is None
    assert_part_of(salvaged, undamaged)
    assert len(salvaged.steps) >= 10


def test_a_lost_result_says_who_was_in_an_obstacle(undamaged, without_result):
    shapes = [obstacle.shape() for obstacle in undamaged.experiment.obstacles]

    def in_an_obstacle(poses):
        x, y, _ = poses.T
        return any(shape.contains(x, y).any() for shape in shapes)

    truth = read_trial(without_result).truth
    inside = tuple(in_an_obstacle(truth[:, i]) for i in range(3))
    assert read_result(without_result).result.verdict.entered == inside


def test_without_any_pose_there_is_no_result(tmp_path):
    contents = scan(write(trial(steps=1), tmp_path / "trial.mcap"))
    none = {"times": b"", "poses": b"", "truth": b"", "valid": []}
    empty = stating(contents, FRAMES, **none) | stating(contents, RESULT, duration_s=math.nan)
    with pytest.raises(LogError, match="no poses to compute it from"):
        read_result(rewrite(contents, tmp_path / "empty.mcap", empty))


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    for read in (read_trial, read_result, content_digest):
        with pytest.raises(LogError, match="No such file"):
            read(tmp_path / "none.mcap")
        with pytest.raises(LogError, match="is a folder, not a log"):
            read(tmp_path)


def test_a_log_that_was_written_again_without_chunks_is_told(log, tmp_path):
    """Regression: it was "not a log of tetractl in format 4"."""
    again = rewritten(log, tmp_path / "again.mcap", use_chunking=False)
    for read in (read_trial, read_result, overview):
        with pytest.raises(LogError, match="another program has rewritten this log without chunks"):
            read(again)


@pytest.mark.parametrize("how", [CompressionType.LZ4, CompressionType.NONE])
def test_chunks_of_other_writers_are_read(tmp_path, log, how):
    again = rewritten(log, tmp_path / "again.mcap", True, compression=how, chunk_size=3000)
    contents = scan(again)
    assert [entry.data for entry in contents.entries] == [entry.data for entry in scan(log).entries]
    assert not contents.problems


def test_a_file_without_the_checksum_of_its_data_is_not_read_by_its_index(log, tmp_path):
    data = log.read_bytes()
    assert peek(log) is not None
    checksum = data.rindex(DATA_END) + len(DATA_END)
    without = data[:checksum] + bytes(4) + data[checksum + 4 :]
    assert peek(_damaged(tmp_path, without)) is None


def test_a_whole_log_is_read_by_its_index_without_most_of_its_chunks(log):
    """Without it, `stats` and `--resume` would take three times as long."""
    brief, whole = peek(log), scan(log)
    assert brief.run == whole.run
    assert not first_difference(brief.result, whole.result)
    assert brief.facts == whole.facts
    assert brief.stated_digests == whole.stated_digests
    assert brief.attachments == whole.attachments
    assert not brief.damaged
    assert 0 < brief.chunks < whole.chunks
