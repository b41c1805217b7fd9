"""However a file is damaged, what is read is what was written, and the damage is reported."""

import math
import random
from dataclasses import replace

import numpy as np
import pytest
from mcap.records import Attachment
from mcap.writer import CompressionType, IndexType, Writer
from support.fuzz import Original
from support.mutate import rewrite, rewritten, stating
from support.random_trials import trial, write

from tetractl.core.errors import LogError
from tetractl.core.plan import Outcome
from tetractl.log.format.channels import FRAMES, RESULT, RUN
from tetractl.log.read.overview import overview
from tetractl.log.read.reader import content_digest, read_result, read_trial
from tetractl.log.read.salvage import MAGIC, peek, scan
from tetractl.replay.comparison import first_difference

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A small log of a few chunks."""
    return write(trial(steps=34), tmp_path_factory.mktemp("log") / "trial.mcap")


@pytest.fixture(scope="module")
def whole(log):
    return read_trial(log)


@pytest.fixture(scope="module")
def chunks(log):
    """Of each chunk: first byte, byte behind it, messages; by the official reader."""
    found = Original(log).chunks
    assert len(found) > 3
    return found


def assert_part_of(damaged, whole):
    """Every number of a damaged log is one of the whole log's."""
    assert damaged.experiment == whole.experiment
    assert damaged.start.spec_text in ("", whole.start.spec_text)
    assert damaged.start.seed == whole.start.seed
    steps = {step.k: step for step in whole.steps}
    assert all(not first_difference(step, steps[step.k]) for step in damaged.steps)
    rows = np.searchsorted(whole.frames, damaged.frames)
    for name in ("frames", "mocap_ns", "received_ns", "mocap", "valid", "truth"):
        assert not first_difference(getattr(damaged, name), getattr(whole, name)[rows])
    assert damaged.stop is None or not first_difference(damaged.stop, whole.stop)
    assert whole.result is not None
    untimed = replace(whole.result, solve_ns=(), deadline_misses=0)
    assert any(
        not first_difference(damaged.result, result) for result in (None, untimed, whole.result)
    )


def _damaged(tmp_path, data):
    path = tmp_path / "damaged.mcap"
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("field", range(1, 9))
def test_a_bad_record_length_costs_nothing(tmp_path, log, whole, chunks, field):
    data = bytearray(log.read_bytes())
    data[chunks[1][0] + field] ^= 0x41
    found = read_trial(_damaged(tmp_path, bytes(data)))
    assert found.damage is not None
    assert len(found.steps) == len(whole.steps)
    assert not first_difference(found.mocap, whole.mocap)
    assert_part_of(found, whole)


def test_without_first_chunk_and_index_the_rest_is_read(tmp_path, log, whole, chunks):
    data = bytearray(log.read_bytes()[: chunks[-1][1]])
    for begin, end, _ in chunks[:3]:  # the run's with all channel records, the scene's, the next
        data[(begin + end) // 2] ^= 0xFF
    found = read_trial(_damaged(tmp_path, bytes(data)))
    assert 0 < len(found.steps) < len(whole.steps)
    assert_part_of(found, whole)


def test_a_file_that_lost_its_head_is_read(tmp_path, log, whole):
    data = log.read_bytes()
    for head in (data[8:], b"\0" * 40 + data[40:], b"some text before\n" + data):
        found = read_trial(_damaged(tmp_path, head))
        assert found.damage is not None
        assert not first_difference(found.mocap, whole.mocap)
        assert not first_difference(found.result, whole.result)


@pytest.mark.parametrize("tail", [b"\0" * 5000, b"\xff" * 5000, MAGIC])
def test_what_a_crash_leaves_behind_the_last_chunk_does_no_harm(tmp_path, log, whole, chunks, tail):
    found = read_trial(_damaged(tmp_path, log.read_bytes()[: chunks[-2][1]] + tail))
    assert found.damage is not None
    assert found.result is None
    assert_part_of(found, whole)
    assert len(found.steps) >= 10


def test_a_lost_result_is_computed_from_the_last_true_poses(tmp_path, log, whole, chunks):
    cut = _damaged(tmp_path, log.read_bytes()[: chunks[-2][1]])
    found, result = read_trial(cut), read_result(cut)
    assert result.recovered
    assert found.truth is not None
    final = found.truth[-1]
    targets = np.array([robot.target for robot in whole.experiment.robots])
    errors = np.hypot(*(final[:, :2] - targets).T)
    assert result.result.robot_errors == tuple(errors)
    assert result.result.total_error == pytest.approx(errors.sum(), rel=1e-15)
    assert not first_difference(result.result.verdict.final.array(), final)
    assert result.result.outcome is Outcome.ABORTED
    assert result.result.steps == len(found.steps)
    box = whole.experiment.obstacles[0]
    circle = whole.experiment.obstacles[1]
    inside = [
        any(
            (box.shape().contain(x, y) | circle.shape().contain(x, y)).any()
            for x, y, _ in found.truth[:, i]
        )
        for i in range(3)
    ]
    assert result.result.verdict.entered == tuple(inside)


def test_in_the_lab_the_last_tracked_pose_counts(tmp_path):
    made = trial(steps=12, simulated=False)
    for samples, _ in made.rounds:  # an untracked robot's pose is no measurement
        for i, sample in enumerate(samples):
            seen, last = sample.observation, sample is made.samples[-1]
            valid = np.array([False, True, True]) if last else seen.valid
            poses = replace(seen.poses, x=np.where(valid, seen.poses.x, 1e9))
            samples[i] = replace(sample, observation=replace(seen, poses=poses, valid=valid))
    contents = scan(write(made, tmp_path / "trial.mcap"))
    spoilt = rewrite(contents, tmp_path / "no.mcap", stating(contents, RESULT, duration_s=math.nan))
    summary = read_result(spoilt)
    assert summary.recovered
    assert max(summary.result.robot_errors) < 1e6
    last = [
        next(s.observation for s in reversed(made.samples) if s.observation.valid[i])
        for i in range(3)
    ]
    expected = [seen.poses.x[i] for i, seen in enumerate(last)]
    assert summary.result.verdict.final.x.tolist() == expected


def test_without_any_pose_there_is_no_result(tmp_path):
    contents = scan(write(trial(steps=1), tmp_path / "trial.mcap"))
    none = {"times": b"", "poses": b"", "truth": b"", "valid": []}
    empty = stating(contents, FRAMES, **none) | stating(contents, RESULT, duration_s=math.nan)
    with pytest.raises(LogError, match="no poses to compute it from"):
        read_result(rewrite(contents, tmp_path / "empty.mcap", empty))


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


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    for read in (read_trial, read_result, content_digest):
        with pytest.raises(LogError, match="No such file"):
            read(tmp_path / "none.mcap")
        with pytest.raises(LogError, match="is not a regular file"):
            read(tmp_path)


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


LEFT_OUT = {
    "checksums": {"enable_crcs": False},
    "summary": {
        "index_types": IndexType.NONE,
        "repeat_channels": False,
        "repeat_schemas": False,
        "use_statistics": False,
        "use_summary_offsets": False,
    },
}


@pytest.mark.parametrize("left_out", LEFT_OUT)
def test_a_log_that_another_program_wrote_again_without_a_part_is_whole(
    left_out, log, whole, tmp_path
):
    """Regression: without checksums "the record of the run is lost", without a summary "the index
    is damaged"."""
    path = tmp_path / "again.mcap"
    contents = scan(log)
    with path.open("wb") as file:
        writer = Writer(file, **LEFT_OUT[left_out])
        writer.start(library="another 1.0")
        numbers = {}
        for topic, (channel, schema) in contents.channels.items():
            number = writer.register_schema(schema.name, schema.encoding, schema.data)
            encoding = channel.message_encoding
            numbers[topic] = writer.register_channel(topic, encoding, number)
        for one in contents.records:
            if isinstance(one, Attachment):
                writer.add_attachment(0, one.log_time, one.name, one.media_type, one.data)
            else:
                writer.add_message(numbers[one.topic], one.log_ns, one.data, one.publish_ns)
        writer.finish()
    found = read_trial(path)
    assert found.damage is None
    assert not first_difference(found.mocap, whole.mocap)
    assert not first_difference(found.result, whole.result)


def test_a_log_of_another_format_is_refused(tmp_path, log):
    contents = scan(log)
    other = rewrite(contents, tmp_path / "new.mcap", stating(contents, RUN, format_version=5))
    with pytest.raises(LogError, match="format 5, not 4; read it by what wrote it, tetractl 0"):
        read_trial(other)


@pytest.mark.parametrize("version", ["1", "2"])
def test_a_log_of_the_first_formats_is_named(tmp_path, version):
    """Regression: it was "an MCAP file, but not a log of tetractl"."""
    path = tmp_path / "old.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(library="tetractl 0.1.0")
        writer.add_metadata("tetractl.run", {"format_version": version})
        writer.add_metadata("tetractl.host", {"tetractl": "0.1.0", "git_commit": "e47a2adaa665ea"})
        writer.finish()
    said = rf"is in format {version}, not 4; read it .* tetractl 0.1.0, git commit e47a2adaa665$"
    for read in (read_trial, read_result, overview):
        with pytest.raises(LogError, match=said):
            read(path)


def test_a_log_that_was_written_again_without_chunks_is_told(log, tmp_path):
    """Regression: it was "not a log of tetractl in format 4"."""
    again = rewritten(log, tmp_path / "again.mcap", use_chunking=False)
    for read in (read_trial, read_result, overview):
        with pytest.raises(LogError, match="was written again without chunks by another program"):
            read(again)


@pytest.mark.parametrize("how", [CompressionType.LZ4, CompressionType.NONE])
def test_chunks_of_other_writers_are_read(tmp_path, log, how):
    again = rewritten(log, tmp_path / "again.mcap", True, compression=how, chunk_size=3000)
    assert [entry.data for entry in scan(again).entries] == [one.data for one in scan(log).entries]
    assert not scan(again).problems


def test_a_flipped_bit_is_seen_without_reading_the_trial(log, tmp_path):
    """Regression: `stats` and `--resume`, which read by the index, missed nine of ten."""
    data, rng = log.read_bytes(), random.Random(7)
    path = tmp_path / "trial.mcap"
    end = data.rindex(b"\x0f" + (4).to_bytes(8, "little"))  # of the data, with its length
    for at in (*range(end, end + 13), *(rng.randrange(len(data)) for _ in range(100))):
        changed = bytearray(data)
        changed[at] ^= 1 << rng.randrange(8)
        path.write_bytes(changed)
        try:
            assert read_result(path).recovered, at
        except LogError:
            continue


def test_a_file_without_the_checksum_of_its_data_is_not_read_by_its_index(log, tmp_path):
    data = log.read_bytes()
    assert peek(log) is not None
    at = data.rindex(b"\x0f" + (4).to_bytes(8, "little")) + 9
    assert peek(_damaged(tmp_path, data[:at] + bytes(4) + data[at + 4 :])) is None
