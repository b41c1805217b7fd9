"""What `recover` says of a log, and its exit code: 0 if nothing is lost, 3 if something is."""

import json

import pytest
from testkit.random_trials import trial, write

from tetractl.cli.verify import recover
from tetractl.core.errors import Exit
from tetractl.log.read.recover import recovered_path

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """A whole log."""
    return write(trial(steps=34), tmp_path_factory.mktemp("log") / "trial.mcap").read_bytes()


@pytest.fixture
def log(tmp_path):
    return tmp_path / "trial.mcap"


def recovery_of(log, capsys, out=None):
    """The exit code, what is printed, and the items of JSON, which must have the same code."""
    path = out or recovered_path(log)
    code = recover(log, out)
    text = capsys.readouterr().out
    path.unlink(missing_ok=True)
    assert recover(log, out, as_json=True) == code
    items = json.loads(capsys.readouterr().out)
    assert items["whole"] == (code == Exit.DONE)
    return code, text, items


def test_a_whole_log_needs_nothing_and_may_be_copied(log, data, tmp_path, capsys):
    log.write_bytes(data)
    code, text, items = recovery_of(log, capsys)
    assert (code, items["path"]) == (Exit.DONE, None)
    assert "nothing to recover" in text
    assert not recovered_path(log).exists()
    code, text, items = recovery_of(log, capsys, tmp_path / "copy.mcap")
    assert (code, items["path"]) == (Exit.DONE, str(tmp_path / "copy.mcap"))
    assert "lost:" not in text


def test_damage_by_which_nothing_is_lost_is_no_loss(log, data, capsys):
    log.write_bytes(data[:-2000])  # without the end of its index
    code, text, items = recovery_of(log, capsys)
    assert items["damage"]["problems"]
    assert items["damage"]["lost"] == []
    assert code == Exit.DONE
    assert "lost:" not in text
    assert "nothing is lost" in text


def test_each_loss_is_named(log, data, capsys):
    log.write_bytes(data[: len(data) // 2])
    code, text, items = recovery_of(log, capsys)
    assert code == Exit.LOSSY
    assert items["damage"]["lost"]
    for lost in items["damage"]["lost"]:
        assert f"lost: {lost}" in text
    assert "nothing is lost" not in text


def test_what_a_recovered_log_lacks_is_lost_though_its_file_is_sound(log, data, tmp_path, capsys):
    log.write_bytes(data[: len(data) // 2])
    recover(log)
    capsys.readouterr()
    code, text, items = recovery_of(recovered_path(log), capsys, tmp_path / "twice.mcap")
    assert code == Exit.LOSSY
    assert items["damage"]["lost"]
    assert "nothing is lost" not in text
