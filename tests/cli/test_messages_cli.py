"""What users type wrong, and what they are answered: one line, a hint where useful, a code."""

import re

import pytest
from support.cli import tetractl
from support.studies import SMALL, write

from tetractl.cli.ui import announce_compiling


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a spec, a study and what the study left in `out`, and a file that is no log."""
    place = tmp_path_factory.mktemp("messages")
    write(place, SMALL)
    run = ("study", "study.yaml", "--out", "out", "--jobs", 1, "-q")
    assert tetractl(place, *run).returncode == 0
    (place / "noise.mcap").write_bytes(b"no log")
    return place


def test_a_pattern_of_the_shell_may_catch_the_tables_of_a_study(folder, tmp_path):
    """`report` takes what `stats` takes; a log that cannot be read is named with its cause."""
    inside = sorted(f"out/{path.name}" for path in (folder / "out").iterdir())
    assert "out/trials.csv" in inside
    one, other = (tetractl(folder, "stats", *paths) for paths in (["out"], inside))
    assert one == other
    assert (one.returncode, one.stderr) == (0, "")
    page = tmp_path / "page.html"
    done = tetractl(folder, "report", "noise.mcap", "-o", page)
    assert done.returncode == 1
    assert done.stderr == "error: none of the logs can be read: noise.mcap: not an MCAP file\n"
    done = tetractl(folder, "report", *inside, "noise.mcap", "-o", page)
    assert (done.returncode, done.stderr) == (1, "warning: noise.mcap: not an MCAP file\n")
    assert "dead_time=0.1" in page.read_text()


def test_a_full_disk_leaves_the_picture_before(folder, tmp_path, monkeypatch):
    """Half of a page or a picture stayed, under its final name."""
    file = tmp_path / "a.png"
    file.write_text("the one before")

    def full(path, data):
        path.write_text("half")
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr("pathlib.Path.write_bytes", full)
        done = tetractl(folder, "plot", "out/dead_time=0", "-o", file)
    assert done.returncode == 1
    assert done.stderr == f"error: {file}: cannot be written: No space left on device\n"
    assert [path.name for path in tmp_path.iterdir()] == [file.name]
    assert file.read_text() == "the one before"


@pytest.mark.parametrize("words", [["run"], ["stats"], ["study"], ["lab", "check"], []])
def test_help_names_no_types_of_python(folder, words):
    shown = tetractl(folder, *words, "--help").stdout
    assert not re.search("<(bool|int|str|float|path|list)", shown), shown


def test_warm_compiles_what_specs_and_studies_name(folder):
    done = tetractl(folder, "warm", "spec.yaml", "study.yaml")
    assert done.returncode == 0
    kinds, seconds = done.stdout.split(": ")
    assert kinds == "pso-mpc, pso, euler"
    assert float(seconds.removesuffix(" s\n")) >= 0
    assert done.stderr.startswith("kept in /")
    done = tetractl(folder, "warm", "spec.yaml", "--set", "controller.motion=exact")
    assert done.stdout.startswith("pso-mpc, pso, exact: ")


def test_on_a_terminal_compiling_is_said_even_to_who_asked_for_quiet(capsys, monkeypatch):
    for terminal, quiet, said in ((True, True, True), (False, True, False), (False, False, True)):
        monkeypatch.setattr("sys.stderr.isatty", lambda terminal=terminal: terminal)
        announce_compiling(quiet, "compiling")
        assert capsys.readouterr().err == ("compiling\n" if said else "")
