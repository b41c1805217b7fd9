"""Tests of what the records of a log say of it: its trial, its writer, its damage, its digests."""

import pytest
from mcap.records import Attachment
from testkit.mutate import rewrite, rewritten, stating
from testkit.random_trials import SMALL, trial, write

from tetractl.core.errors import LogError
from tetractl.log.format import channels
from tetractl.log.format.channels import RECOVERED, RESULT, RUN, Entry
from tetractl.log.format.tetractl_pb2 import Recovered
from tetractl.log.read import raw_log
from tetractl.log.read.raw_log import RawLog, read_file, writer
from tetractl.log.read.salvage import scan


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write(trial(steps=3, **SMALL), tmp_path_factory.mktemp("log") / "trial.mcap")


@pytest.fixture(scope="module")
def log(path):
    return scan(path)


def without(log, topic, **fields):
    records = [r for r in log.records if not (isinstance(r, Entry) and r.topic == topic)]
    return RawLog(log.path, records=records, library=log.library, **fields)


def changed(log, tmp_path, topic, **fields):
    """The log after one field of a message was changed, with digests that fit."""
    return scan(rewrite(log, tmp_path / "changed.mcap", stating(log, topic, **fields)))


@pytest.mark.parametrize(
    ("facts", "text"),
    [
        ({}, "tetractl of an unknown version"),
        ({"tetractl": "1.2.3"}, "tetractl 1.2.3"),
        (
            {"tetractl": "1.2.3", "git_commit": "0123456789abcdef"},
            "tetractl 1.2.3, git commit 01234567",
        ),
        ({"git_commit": "abc"}, "tetractl of an unknown version, git commit abc"),
        ({"tetractl": "1", "git_commit": ""}, "tetractl 1"),
    ],
)
def test_the_version_that_wrote_a_log_has_its_commit_if_it_is_known(facts, text):
    assert writer(facts).startswith(text)
    assert ("git commit" in writer(facts)) == bool(facts.get("git_commit"))


def test_a_whole_log_is_neither_damaged_nor_altered_nor_rewritten(log):
    assert not log.damaged
    assert not log.altered
    assert not log.host_altered
    assert not log.reordered
    assert log.rewritten_by == ""
    assert log.recovered is None
    assert log.run.trial == 0
    assert log.result.steps == 3


@pytest.mark.parametrize("topic", [channels.COMMANDS, channels.STEP, channels.FRAMES])
def test_a_record_that_is_missing_alters_the_content_and_not_the_host(log, topic):
    less = without(log, topic)
    assert less.altered
    assert not less.host_altered


@pytest.mark.parametrize("topic", [channels.HOST, channels.HOST_TIMING, channels.HOST_END])
def test_a_record_of_the_host_that_is_missing_alters_the_host_and_not_the_content(log, topic):
    less = without(log, topic)
    assert less.host_altered
    assert not less.altered


def test_a_log_that_states_no_digest_is_not_altered(log):
    less = without(without(log, channels.DIGESTS), channels.STEP)
    assert not less.altered
    assert not less.host_altered


def test_a_log_without_its_run_says_what_it_is_instead(log):
    damaged = without(log, RUN, problems=["torn"])
    with pytest.raises(LogError, match="the log is damaged, and the record of the run is lost"):
        _ = damaged.run
    with pytest.raises(LogError, match="not a log of tetractl in format 4"):
        _ = without(log, RUN).run
    loose = without(log, RUN, has_loose_messages=True)
    with pytest.raises(LogError, match="another program has rewritten this log without chunks"):
        _ = loose.run


@pytest.mark.parametrize("version", [3, 5])
def test_a_log_of_another_format_is_refused(log, tmp_path, version):
    other = changed(log, tmp_path, RUN, format_version=version)
    with pytest.raises(LogError, match=f"is in format {version}, but .* reads format 4; read"):
        _ = other.run


def test_a_result_that_is_missing_or_impossible_damages_a_log(log, tmp_path):
    unfinished = without(log, RESULT)
    assert unfinished.damaged
    assert unfinished.result is None
    assert "has no result" in unfinished.result_or_problem
    assert unfinished.warnings == 0
    impossible = changed(log, tmp_path, RESULT, duration_s=float("nan"))
    assert impossible.damaged
    assert "values that tetractl never writes" in impossible.result_or_problem


@pytest.mark.parametrize(("stated", "shown"), [(-3, 0), (0, 0), (7, 7)])
def test_the_number_of_warnings_is_never_negative(log, tmp_path, stated, shown):
    assert changed(log, tmp_path, RESULT, warnings=stated).warnings == shown


def with_source(log, **fields):
    message = Recovered(**fields).SerializeToString()
    return RawLog(log.path, records=[*log.records, Entry(RECOVERED, 1, 1, message)])


def test_a_recovered_log_is_damaged_only_if_its_source_had_lost_something(log):
    whole = with_source(log, source="a.mcap", problems=["torn"])
    assert whole.recovered is None
    assert not whole.damaged
    torn = with_source(log, source="a.mcap", problems=["torn"], lost=["3 of 9 messages"])
    assert torn.damaged
    assert torn.recovered.lost == ("3 of 9 messages",)
    assert torn.recovered.problems == (
        "this log was recovered from a.mcap, which was damaged",
        "torn",
    )
    unreadable = with_source(log)  # nobody knows what it has lost
    assert unreadable.damaged
    assert "from another log" in unreadable.recovered.problems[0]


def test_of_two_attachments_of_one_name_the_first_counts(log):
    first, second = (Attachment(0, 0, "notes", "text/plain", text) for text in (b"1", b"2"))
    both = RawLog(log.path, records=[first, second])
    assert both.attachment_text("notes") == "1"
    assert both.attachment_text("others") is None


def test_records_are_in_the_order_of_the_file(log):
    assert [*log.entries] == [r for r in log.records if isinstance(r, Entry)]
    for topic, entries in log.entries_by_topic.items():
        assert entries == [entry for entry in log.entries if entry.topic == topic]


@pytest.mark.parametrize("keeps_name", [True, False])
@pytest.mark.parametrize("in_order", [True, False])
def test_who_rewrote_a_log_and_whether_its_messages_were_sorted(
    path, tmp_path, in_order, keeps_name
):
    again = scan(rewritten(path, tmp_path / "again.mcap", in_order, keeps_name=keeps_name))
    assert again.rewritten_by
    assert ("mcap" in again.rewritten_by) == (not keeps_name)
    assert again.reordered == (not in_order)
    assert not again.altered


def test_a_log_of_an_unknown_program_is_called_so(log):
    nameless = RawLog(log.path, records=log.records, library="")
    assert nameless.rewritten_by == raw_log.UNKNOWN_PROGRAM


@pytest.mark.parametrize(("size", "fits"), [(100, True), (101, False)])
def test_a_file_is_read_up_to_the_limit(tmp_path, monkeypatch, size, fits):
    monkeypatch.setattr(raw_log, "file_limit", lambda: 100)
    file = tmp_path / "a.mcap"
    file.write_bytes(bytes(size))
    if fits:
        assert read_file(file) == bytes(size)
        return
    with pytest.raises(LogError, match="the log contains 101 bytes, more than tetractl reads"):
        read_file(file)


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("none", "No such file or directory"),
        ("folder", "this is a folder, not a log"),
        ("empty", "the file is empty"),
        ("nul\0", "embedded null byte"),
    ],
)
def test_what_is_no_file_with_contents_is_one_line(tmp_path, name, why):
    (tmp_path / "folder").mkdir()
    (tmp_path / "empty").touch()
    with pytest.raises(LogError) as caught:
        read_file(tmp_path / name)
    message = caught.value.message
    assert message.startswith(f"{tmp_path / name}: ")
    assert message.removeprefix(f"{tmp_path / name}: ") == why or name == "nul\0"


def test_a_record_that_cannot_be_read_says_why_in_one_line(log):
    broken = RawLog(log.path, records=[Entry(RUN, 1, 1, b"\xff")])
    with pytest.raises(LogError, match="the record of the run cannot be read: Error parsing"):
        _ = broken.run
