"""Tests of typing mistakes in commands: one line, a hint where useful, and an exit code."""

import contextlib
import os
import re
import shutil
import subprocess
import sys
from unittest import mock

import pytest
from testkit.cli import tetractl
from testkit.paths import ROOT
from testkit.running import QUICK
from testkit.studies import SMALL, write
from testkit.usage import command_of, refused_in_one_line

from tetractl.cli.lab import save_calibration
from tetractl.spec.lab_section import Measured

pytestmark = pytest.mark.slow

# A command, what its one line says and, where it matters, how its hint begins.
USAGE = r"""
run study.yaml | study.yaml: this is a study, not a spec | run it with: tetractl study study.yaml
study spec.yaml | spec.yaml: is a spec, not a study | run it with: tetractl run spec.yaml; a study
replay spec.yaml | spec.yaml: this is not a log (*.mcap) | run it with: tetractl run spec.yaml
stats out/trials.csv | out/trials.csv: this is not a log (*.mcap) | name the folder instead: out
report out/trials.csv | out/trials.csv: this is not a log (*.mcap) | name the folder instead: out
replay picture.png | picture.png: this is not a log (*.mcap)
replay logs/figure.png | not a log (*.mcap) | name the log of a trial, such as logs/trial-0
run | SPEC
run nowhere.yaml | nowhere.yaml: there is no such file
run spec.yml | spec.yml: there is no such file; did you mean 'spec.yaml'?
run . | .: is a folder
run empty.yaml | empty.yaml: is empty
run binary.yaml | binary.yaml: is a binary file
run wrong.yaml | wrong.yaml:3:
run huge.yaml | huge.yaml:9:45: reference.std: 1.0e+308: must be at most 1e+09
run spec.yaml --trials 0 | Invalid value for '--trials': Input should be greater than or | try
run spec.yaml --seed -1 | Invalid value for '--seed': Input should be greater than or | try
run spec.yaml --seed x | Invalid value for '--seed': Input should be a valid integer | try
run spec.yaml --jobs 0 | Invalid value for '--jobs': Input should be greater | try
run spec.yaml --set controler.period=1 | did you mean 'controller'?
run spec.yaml --set trials.count 5 | unexpected extra argument | write --set trials.count=5
run spec.yaml --set robots.x.a=1 | has no entry 'x'
run spec.yaml --set controller.period=1e-9 | controller.period: 1e-9: must be at least 0.001
run spec.yaml --set robots.0.name=Kä | robots.0.name: Kä: must be letters without accents
run spec.yaml --out empty.yaml | empty.yaml: this is not a folder
run spec.yaml --out logs | logs: this folder holds logs already | name another folder with --out
run spec.yaml --out logs --resume --seed 8 | this trial was run with another spec or seed
run spec.yaml --resume | --resume needs --out
run spec.yaml --port 1 | --port needs --serve
run spec.yaml --serve --jobs 2 | --serve shows only one trial at a time
run spec.yaml --rate 1 --serve | --rate shows only one trial at a time
run spec.yaml --rate 1 --jobs 2 | --rate shows only one trial at a time
run spec.yaml --rate 0 | Invalid value for '--rate'
run lab.yaml --plant lab --rate 1 | --rate works only in virtual time
run lab.yaml --plant lab --jobs 2 | one trial at a time
rerun LOG --seed 3 | No such option
study circular.yaml | circular.yaml:2:7: base: circular.yaml: is a study, but the base
study of-a-study.yaml | of-a-study.yaml:2:7: base: study.yaml: is a study, but the base
stats nowhere | nowhere: there is no such file or folder
stats empty | empty: this folder contains no logs
stats '' | an argument of the command is empty | does the command use a shell variable
export logs -o '' | an argument of the command is empty | does the command use a shell variable
stats '*.nothing' | no log matches this pattern
stats logs --plot batch.gif | batch.gif: cannot write '.gif' pictures
stats out --format yaml | 'yaml' is not one of 'table', 'json' | try
stats out/dead_time=0 --against out | out: this folder holds 2 batches
info logs | logs: 3 logs | name one of its logs, such as logs/trial-000.mcap
report logs -o empty | empty: this is a folder, but | name a file in this folder
report logs -o no/where.html | no/where.html: the folder no
replay | LOG
replay LOG --rate 0 | --rate must be above 0
replay LOG --rate nan | --rate must be above 0
replay LOG --rate fast | Invalid value for '--rate': Input should be a valid number | try
replay LOG --start 99 | which lasts
replay LOG --paused | --paused needs a terminal
replay LOG --yes | No such option
replay logs --loop | without a terminal, --loop accepts
plot LOG -o a.bmp | a.bmp: cannot write '.bmp' pictures | use one of the endings .png, .svg, .pdf
plot LOG -o a | the ending of the file name must state the format of the picture
plot LOG -o folder.png | folder.png: this is a folder, but | name a file in this folder
plot LOG --kind video -o folder.gif | folder.gif: this is a folder, but | name a file in this folder
plot LOG -o nowhere/a.png | nowhere/a.png: the folder nowhere
plot LOG --kind pie | there is no figure named 'pie'
plot logs --kind over-time | shows a single trial, but 3
plot logs --kind video | a video shows a single trial, but 3
plot LOG --kind video -o video.avi | video.avi: cannot write '.avi' videos
export logs -o x.csv | a single file can hold only one table
export logs -o x --table no | there is no table named 'no'
export logs -o x --format csv | No such option: --format
export logs -o picture.png | picture.png: this is not a folder | choose another folder with --out
export logs -o empty.yaml/x | empty.yaml: this is not a folder | choose another folder with --out
export logs -o empty.yaml/x.csv --table steps | not a folder | choose another folder with --out
export missing -o x | missing: there is no such file or folder
run lab.yaml --plant lab | there is no terminal to ask | add --yes
rerun LOG --plant lab --yes | lab
rerun LOG --set plant.deadtime=1 | did you mean 'dead_time'
analyze no.yaml | no.yaml: there is no such file
analyze spec.yaml --trials 0 | Invalid value for '--trials'
kinds --set x=1 | --set and --spec can be used only together with --check
lab stop | give either a spec or --port, and only one of them
lab stop --port x --baud 7 | --baud
lab check spec.yaml | has no lab
lab check lab.yaml --plant sim | this plant has no camera and | choose --plant lab
lab calibrate lab.yaml --plant sim | this plant has no camera and | choose --plant lab
lab calibrate lab.yaml --yes -o no/found.yaml | no/found.yaml: the folder no
lab calibrate lab.yaml | robots would move
lab calibrate lab.yaml --robot pink --yes | has no robot with this name
init Käse | 'Käse' cannot be the name of an experiment | use up to 64 characters: a to z, A to Z
init no/first | no/first.yaml: cannot be written: No such file or directory
init spec | spec.yaml: exists already | give another NAME
init mine --example three_m3pi | --example writes a file exactly as shipped
init --example three_m3p | there is no example named 'three_m3p'; did you mean 'three_m3pi'?
validate | SPEC
schema -o no/such/new.json | no/such/new.json: there is no such file or folder
"""
FAILED = """
info noise.mcap | noise.mcap: this is not an MCAP file
recover noise.mcap | noise.mcap: this is not an MCAP file
stats noise.mcap | none of its 1 logs can be read
report noise.mcap | none of the logs can be read: noise.mcap: this is not an MCAP file
lab stop --port empty | empty: this is not a serial port
lab stop --port spec.yaml | spec.yaml: this is not a serial port
lab stop --port nowhere | nowhere: there is no such port
run spec.yaml --out empty.yaml/logs | empty.yaml/logs: the folder cannot be created: Not a directory
"""
STUDY = "name: study-of-a-study\nbase: {base}\n"
LOG = "logs/trial-000.mcap"
ROWS = [(2, row) for row in USAGE.strip().splitlines()]
ROWS += [(1, row) for row in FAILED.strip().splitlines()]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with specs, good and bad, a study and its logs, three logs, and no log."""
    place = tmp_path_factory.mktemp("usage")
    write(place, SMALL)
    for words in (
        ("study", "study.yaml", "--out", "out", "--jobs", 1, "-q"),
        ("run", "spec.yaml", "--out", "logs", "-q"),
    ):
        assert tetractl(place, *words).returncode == 0
    shutil.copy(ROOT / "experiments" / "three_m3pi_lab.yaml", place / "lab.yaml")
    for name, content in {
        "circular.yaml": STUDY.format(base="circular.yaml").encode(),
        "of-a-study.yaml": STUDY.format(base="study.yaml").encode(),
        "tables/poses.csv": b"time_s,robot,x_mm,y_mm,heading_rad\n0,green,0,0,0\n",
        "noise.mcap": b"no log",
        "empty.yaml": b"",
        "picture.png": b"",
        "logs/figure.png": b"",
        "binary.yaml": bytes(range(256)) * 4,
        "wrong.yaml": QUICK.replace("speed: 200", "speed: -1").encode(),
        "huge.yaml": f"{QUICK}\nreference: {{source: x, n: 20, mean: 6, std: 1.0e+308}}\n".encode(),
    }.items():
        (place / name).parent.mkdir(exist_ok=True)
        (place / name).write_bytes(content)
    for name in ("empty", "folder.png", "folder.gif"):
        (place / name).mkdir()
    return place


@pytest.mark.parametrize(("code", "row"), ROWS, ids=[command_of(row) for _, row in ROWS])
def test_it_is_one_line_with_a_hint_and_changes_nothing(folder, code, row):
    command = re.sub(r"\bLOG\b", LOG, command_of(row))
    refused_in_one_line(folder, code, command + row.removeprefix(command_of(row)))


MISSING = """
import sys
from unittest import mock
sys.modules[sys.argv.pop(1)] = None  # as if it were not installed
from tetractl.cli.app import run_app
sys.exit(run_app())
"""


@pytest.mark.long
def test_a_missing_extra_is_named_in_one_line(folder):
    words = "study study.yaml --cluster tcp://localhost:1"
    done = subprocess.run(
        [sys.executable, "-c", MISSING, "distributed", *words.split()],
        cwd=folder, capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    error, hint = done.stderr.splitlines()[-2:]
    assert error.startswith("error: ")
    assert error.endswith("which is not installed")
    assert "pip install '.[dask]'" in hint
    assert done.returncode in (1, 2)
    assert "Traceback" not in done.stderr


def test_an_error_of_the_disk_is_one_line_and_a_failure(tmp_path):
    full = OSError(28, "No space left on device", "logs")
    with mock.patch("tetractl.cli.app.app", side_effect=full):
        done = tetractl(tmp_path, "kinds")
    assert (done.returncode, done.stderr) == (1, "error: logs: No space left on device\n")


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


def test_a_calibration_is_written_although_nobody_reads_stdout(tmp_path, capsys, monkeypatch):
    """Regression: `lab calibrate | true` moved all robots, wrote no file, and exited with 0."""
    reading, writing = os.pipe()
    os.close(reading)
    unread = os.fdopen(writing, "w")
    monkeypatch.setattr("sys.stdout", unread)
    out = tmp_path / "calibration.yaml"
    save_calibration(out, Measured(lines=("green: radius 40.1 mm",)))
    monkeypatch.undo()
    with contextlib.suppress(BrokenPipeError):
        unread.close()
    assert "measured:" in out.read_text()
    assert capsys.readouterr().err.startswith("green: radius 40.1 mm\nwrote ")


@pytest.mark.parametrize("words", [["run"], ["stats"], ["study"], ["lab", "check"], []])
def test_help_of_options_names_no_types_of_python(folder, words):
    options = tetractl(folder, *words, "--help").stdout.partition(" Options ")[2]
    assert options
    assert not re.search("<(bool|int|str|float|path|list)", options), options


def test_warm_compiles_what_specs_and_studies_name(folder):
    done = tetractl(folder, "warm", "spec.yaml", "study.yaml").ok()
    kinds, seconds = done.stdout.split(": ")
    assert kinds == "pso-mpc, pso, euler"
    assert float(seconds.removesuffix(" s\n")) >= 0
    assert done.stderr.startswith("kept in /")
    done = tetractl(folder, "warm", "spec.yaml", "--verbose").ok()
    total = done.stdout.splitlines()[1]
    assert re.fullmatch(r"\d+ functions compiled in \d+\.\d s of processor time", total)
    done = tetractl(folder, "warm", "spec.yaml", "--set", "controller.motion=exact")
    assert done.stdout.startswith("pso-mpc, pso, exact: ")
    done = tetractl(folder, "warm", "study.yaml", "--set", "controller.motion=exact")
    assert done.stdout.startswith("pso-mpc, pso, exact: ")  # it was compiled for the motion euler


def test_the_end_of_a_file_does_not_read_as_an_interruption(tmp_path, monkeypatch):
    """Regression: typer takes every EOFError for Ctrl-D, as that of a killed process."""

    def cut(*_):
        raise EOFError("the pipe has ended")

    monkeypatch.setattr("tetractl.spec.yaml.document.read_document", cut)
    done = tetractl(tmp_path, "lab", "check", "first.yaml")
    assert done.returncode == 1
    assert done.stderr.endswith("error: EOFError: the pipe has ended\n")
