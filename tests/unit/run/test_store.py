from dataclasses import replace

import pytest
from testkit import random_trials as made

from tetractl.core.errors import LogError, UsageError
from tetractl.core.plan import Outcome
from tetractl.log.read.find import find_logs
from tetractl.run import store
from tetractl.run.logged_trial import log_path
from tetractl.run.store import RecordStore, Store, set_aside_logs
from tetractl.tools.files import make_folder


def log(folder, index, outcome=Outcome.ARRIVED, **fields):
    trial = made.trial(index + 1, index=index, steps=2, frames=2, **fields)
    result = replace(trial.result, outcome=outcome)
    return made.write(replace(trial, result=result), log_path(folder, index))


def trials_to_run(experiment, folder):
    store = Store.of_batch(folder, experiment)
    store.read(resume=True)
    return store.unfinished


def spec(count=4, seed=None, **fields):
    experiment_of_trial = made.trial(1, steps=2, frames=2, **fields).experiment
    trials = experiment_of_trial.trials.model_copy(
        update={"count": count} | ({"seed": seed} if seed else {})
    )
    return experiment_of_trial.model_copy(update={"trials": trials})


def test_resuming_skips_what_is_complete_and_nothing_else(tmp_path, monkeypatch):
    log(tmp_path, 0, Outcome.SEQUENCE_COMPLETED)
    log(tmp_path, 1, Outcome.INTERRUPTED)
    log(tmp_path, 2, Outcome.STEPS_MAX)
    log(tmp_path, 3, Outcome.ABORTED)
    part = log(tmp_path, 4)
    part.rename(part.with_name(part.name + ".part"))
    cut = log(tmp_path, 5)
    cut.write_bytes(cut.read_bytes()[:-300])
    assert trials_to_run(spec(8), tmp_path) == [1, 4, 5, 6, 7]  # 3 would abort again
    assert trials_to_run(spec(3), tmp_path) == [1]
    monkeypatch.setattr(store, "code_hash", lambda experiment: "mended")
    assert trials_to_run(spec(8), tmp_path) == [1, 3, 4, 5, 6, 7]


def test_what_is_unfinished_is_set_aside_under_a_name_of_its_own(tmp_path):
    path = log_path(tmp_path, 3)
    for content in (b"one", b"two", b"three"):
        path.with_name(path.name + ".part").write_bytes(content)
        set_aside_logs(tmp_path, 3)
    path.write_bytes(b"whole")
    set_aside_logs(tmp_path, 3)
    set_aside_logs(tmp_path, 3)  # nothing left
    contents = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert contents == {
        "trial-003.attempt-1.mcap.part": b"one",
        "trial-003.attempt-2.mcap.part": b"two",
        "trial-003.attempt-3.mcap.part": b"three",
        "trial-003.attempt-4.mcap": b"whole",
    }
    assert trials_to_run(spec(), tmp_path) == [0, 1, 2, 3]  # not taken for a trial


def test_a_recovered_log_is_set_aside_with_its_source(tmp_path):
    path = log_path(tmp_path, 3)
    path.with_name(path.name + ".part").write_bytes(b"torn")
    path.with_name("trial-003.recovered.mcap").write_bytes(b"saved")
    set_aside_logs(tmp_path, 3)
    assert {path.name for path in tmp_path.iterdir()} == {
        "trial-003.attempt-1.mcap.part",
        "trial-003.attempt-1.recovered.mcap",
    }
    assert find_logs([tmp_path], attempts=True) == [tmp_path / "trial-003.attempt-1.mcap.part"]


def records(folder, identity="spec 1"):
    records = RecordStore(folder, identity, ("day", "ended"))
    with records.opened():
        return records.records


def keep(folder, number):
    records = RecordStore(folder, "spec 1", ("day", "ended"))
    with records.opened():
        records.add_record(number, {"day": number, "ended": "arrived"})


def test_records_of_another_spec_are_refused(tmp_path):
    keep(tmp_path, 3)
    with pytest.raises(UsageError, match="another spec, other settings or another seed"):
        records(tmp_path, "spec 2")


@pytest.mark.parametrize(
    "torn",
    [
        '{"of": "spec 1", "rec',
        "[" * 100_000,
        "\x00",
        "[4]",
        '{"of": "spec 1", "record": {"day": 3}}',
    ],
)
def test_a_record_that_is_torn_does_not_count(torn, tmp_path):
    """Regression: after a power cut, "a plug-in" was blamed."""
    keep(tmp_path, 3)
    keep(tmp_path, 4)
    (tmp_path / "record-000003.json").write_text(torn)
    assert [*records(tmp_path)] == [4]


def test_a_full_disk_is_one_line_that_names_the_record(tmp_path):
    (tmp_path / "record-000001.json.part").symlink_to("/dev/full")
    with pytest.raises(LogError, match=r"record-000001\.json: "):
        keep(tmp_path, 1)


def test_a_file_in_place_of_the_folder_of_records_is_one_line(tmp_path):
    """Regression: "a plug-in" was blamed."""
    file = tmp_path / "file"
    file.touch()
    for folder in (file, file / "days"):
        with pytest.raises(UsageError, match="not a folder"):
            records(folder)


def test_a_folder_is_made_with_its_parents(tmp_path):
    make_folder(tmp_path / "a" / "b")
    make_folder(tmp_path / "a" / "b")
    assert (tmp_path / "a" / "b").is_dir()
    (tmp_path / "file").write_text("")
    with pytest.raises(LogError, match="the folder cannot be created: Not a directory"):
        make_folder(tmp_path / "file" / "b")


def test_records_are_kept_from_one_command_to_the_next(tmp_path):
    keep(tmp_path / "days", 3)
    assert records(tmp_path / "days") == {3: {"day": 3, "ended": "arrived"}}


# ---- Which trials count as finished, and in which folders ----


def test_a_trial_of_another_spec_or_seed_is_refused_and_more_trials_are_not(tmp_path):
    log(tmp_path, 1)
    assert trials_to_run(spec(9), tmp_path) == [0, *range(2, 9)]
    with pytest.raises(UsageError, match=r"trial-001\.mcap: this trial was run with another spec"):
        trials_to_run(spec(4, seed=7), tmp_path)
    with pytest.raises(UsageError, match="another spec or seed"):
        trials_to_run(spec(4, hold={"time": 8, "radius": 30}), tmp_path)


def test_a_trial_beyond_the_number_of_trials_is_not_looked_at(tmp_path):
    log(tmp_path, 5)
    assert trials_to_run(spec(4, seed=7), tmp_path) == [0, 1, 2, 3]


@pytest.mark.parametrize("outcome", Outcome)
def test_an_abort_counts_only_in_virtual_time_and_by_the_same_code(tmp_path, monkeypatch, outcome):
    log(tmp_path, 0, outcome)
    experiment = spec(1)
    finished = outcome.complete or outcome is Outcome.ABORTED
    opened = Store.of_batch(tmp_path, experiment)
    opened.read()
    assert opened.unfinished == ([] if finished else [0])
    assert opened.aborted == ([0] if outcome is Outcome.ABORTED else [])
    real = type("RealTime", (), {"real_time": True})()
    folder = opened.batches[""]
    monkeypatch.setattr(folder, "experiment", experiment.model_copy(update={"plant": real}))
    folder.read()
    assert folder.unfinished == ([] if outcome.complete else [0])


def test_trials_that_other_code_has_run_are_outdated(tmp_path, monkeypatch):
    log(tmp_path, 0)
    log(tmp_path, 2)
    opened = Store.of_batch(tmp_path, spec(4))
    opened.read()
    assert opened.batches[""].outdated == []
    monkeypatch.setattr(store, "code_hash", lambda experiment: "newer")
    newer = Store.of_batch(tmp_path, spec(4))
    newer.read()
    assert newer.batches[""].outdated == [0, 2]
    assert newer.unfinished == [1, 3]


@pytest.mark.parametrize(
    ("name", "refused"),
    [("trial-000.mcap", True), ("other.mcap.part", True), ("notes.txt", False), ("a.mcapx", False)],
)
def test_a_folder_with_logs_is_refused_unless_they_are_resumed(tmp_path, name, refused):
    (tmp_path / name).write_bytes(b"")
    opened = Store.of_batch(tmp_path, spec())
    opened.read(resume=True)
    if not refused:
        opened.read(resume=False)
        return
    with pytest.raises(UsageError, match="holds logs already"):
        opened.read(resume=False)


def test_a_refused_run_creates_no_folder_and_an_opened_one_has_it(tmp_path):
    file = tmp_path / "file"
    file.touch()
    with pytest.raises(UsageError, match="this is not a folder"):
        Store.of_batch(file, spec()).read()
    new = tmp_path / "new"
    Store.of_batch(new, spec()).read(resume=False)
    assert not new.exists()
    with Store.of_batch(new, spec()).opened(resume=False):
        assert new.is_dir()


def test_the_place_of_a_trial_is_free_of_its_earlier_log_and_its_result_is_kept(tmp_path):
    log(tmp_path, 0, Outcome.INTERRUPTED)
    opened = Store.of_batch(tmp_path / "x", spec())
    assert opened.prepare_folder("", 3) == tmp_path / "x"
    assert (tmp_path / "x").is_dir()
    opened = Store.of_batch(tmp_path, spec())
    opened.read()
    assert 0 in opened.unfinished
    folder = opened.prepare_folder("", 0)
    assert not log_path(folder, 0).exists()
    assert (folder / "trial-000.attempt-1.mcap").exists()
    log(folder, 0)
    opened.add_result("", 0)
    assert 0 not in opened.unfinished
    opened.add_result("", 1)  # it has no log
    assert 1 in opened.unfinished
