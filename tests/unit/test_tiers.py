"""Tests that a test file which starts many processes is marked accordingly."""

import re
import signal
import subprocess
import sys

import pytest
from testkit.paths import ROOT

PLACES = ("tests", "packages/*/tests", "benchmarks/tests")
FILES = sorted(path for place in PLACES for path in ROOT.glob(f"{place}/**/test_*.py"))
TAKEN = re.compile(r"^from testkit\.([\w.]+ import (?:\([^)]*\)|.*))", re.M)
STARTS = {  # what a file takes from `testkit`: the marks of which it needs one
    "lab_processes import.*(Emulator|play)": "system",  # the lab in real time
    "import.*(Killed|Running|Started|TETRACTL|chromium)": "slow|system",
}
CHILD = """
import signal, subprocess, sys
sys.path.insert(0, {!r})
from testkit.running import take_signals
take_signals()
ask = "import signal; print([signal.getsignal(n) == signal.SIG_IGN for n in ({}, {}, {})])"
subprocess.run([sys.executable, "-c", ask], check=True)
"""
DEAF = (signal.SIGHUP, signal.SIGINT, signal.SIGQUIT)  # under `nohup`, and behind `&`


@pytest.mark.parametrize(("names", "marks"), STARTS.items(), ids=STARTS.values())
def test_files_that_start_much_are_marked(names, marks):
    texts = {path: path.read_text("utf-8") for path in FILES}
    starts = re.compile(rf"\b{names}\b", re.S)
    starting = [path for path in FILES if any(map(starts.search, TAKEN.findall(texts[path])))]
    assert starting
    marked = re.compile(rf"mark\.({marks})\b|first_of")
    assert [path for path in starting if not marked.search(texts[path])] == []


@pytest.mark.long
def test_processes_that_tests_start_take_signals_that_the_tests_ignore():
    program = CHILD.format(str(ROOT / "tests"), *map(int, DEAF))
    done = subprocess.run(
        [sys.executable, "-c", program],
        preexec_fn=lambda: [signal.signal(number, signal.SIG_IGN) for number in DEAF],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "[False, False, False]\n"
