"""Tests that a row of each printed table on a page agrees with what its command prints now.

tests/cli/test_docs.py compares README and the pages with `console` blocks to the last digit. The
tables here take too long for this. A row is therefore run with 20 of its trials, or with fewer
instances of the benchmark. Its mean is compared with the mean on the page, with their intervals.
This notices a table from an earlier plant or controller if its error differs by more than the
chance in 20 trials.
"""

import re
import subprocess
import sys
from dataclasses import dataclass

import disturbed
import numpy as np
import pytest
from testkit.paths import ROOT

from tetractl.statistics.estimate import distributions

pytestmark = pytest.mark.system

MEASURED = ROOT / "docs/reference/measured.md"
BENCH = ROOT / "docs/explanation/bench.md"
BENCHMARK = ROOT / "docs/reference/benchmark.md"
MEAN = re.compile(r"([\d.e+]+) \[([\d.e+-]+), ([\d.e+-]+)\]")


@dataclass(frozen=True)
class Mean:
    """A mean with the ends of its 95 % interval."""

    value: float
    low: float
    high: float

    def agrees(self, printed: "Mean") -> bool:
        return self.low <= printed.high and printed.low <= self.high


def mean_in(text: str) -> Mean:
    """Return the first mean of a line of a table."""
    match = MEAN.search(text)
    assert match, text
    return Mean(*map(float, match.groups()))


def line_of(text: str, *cells: str) -> str:
    """Return the one line of a table that begins with some cells."""
    begin = f"| {' | '.join(cells)} |"
    (line,) = [splitline for splitline in text.splitlines() if splitline.startswith(begin)]
    return line


def printed(page, mark: str) -> str:
    """Return what a page has between the marks of a table."""
    text = page.read_text("utf-8")
    return text.partition(f"<!-- {mark}: begin -->")[2].partition(f"<!-- {mark}: end -->")[0]


def run(*words: str) -> str:
    """Return what a benchmark prints."""
    done = subprocess.run(
        [sys.executable, *words], cwd=ROOT, capture_output=True, text=True, timeout=1800
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


ROWS = [
    ("ablation", "whole", "20261201"),
    ("given", "given", "20261201"),
    ("knowledge", "dead time given", "20261201"),
    ("hurting", "none of these", "20261201"),
    ("accept", "accept 30 mm", "20261201"),
    ("radio", "60 commands per second", "512306103"),
]


@pytest.mark.release  # README prints the first of them to the last digit, of another seed
@pytest.mark.parametrize(("part", "row", "seed"), ROWS, ids=[part for part, _, _ in ROWS])
def test_a_row_of_what_disturbs_is_as_printed(part, row, seed, monkeypatch, capsys):
    """In this process, which loads once what is compiled."""
    words = ["disturbed", "--part", part, "--only", row, "--seed", seed, "--trials", "20"]
    monkeypatch.setattr(sys, "argv", words)
    disturbed.main()
    now = capsys.readouterr().out
    page = printed(MEASURED, part)
    assert mean_in(line_of(now, row)).agrees(mean_in(line_of(page, row)))


@pytest.mark.parametrize(
    ("option", "arms"),
    [
        (("--ours",), ("`recommended`",)),
        pytest.param((), ("`recommended`", "`published`"), marks=pytest.mark.release),
    ],
    ids=["ours", "all"],
)
def test_the_instance_that_takes_the_least_time_is_as_printed(tmp_path, option, arms):
    """Regression: the page had 0.0482 mm where a run had 0.001, as its command failed."""
    options = (*option, "--only", "paper", "--trials", "20", "--out", str(tmp_path / "logs"))
    now = run("benchmarks/instances.py", *options)
    page = printed(BENCHMARK, "results").partition("### `paper`")[2].partition("###")[0]
    for arm in arms:
        assert mean_in(line_of(now, arm, "20")).agrees(mean_in(line_of(page, arm, "40")))


@pytest.mark.release
def test_the_bench_without_noise_is_as_printed():
    from testkit.emulator.bench_agreement import bench_spec, bench_trial

    errors = [bench_trial(bench_spec(), trial).result.total_error for trial in range(20)]
    cells = line_of(BENCH.read_text("utf-8"), "bench without noise, slip and lost frames")
    assert cells.split("|")[2].strip() == "20 of 20"
    mean, deviation = map(float, re.findall(r"[\d.]+", cells.split("|")[3]))
    (distribution,) = distributions(np.array([errors]))
    assert distribution.ci95.low <= mean <= distribution.ci95.high
    assert distribution.std == pytest.approx(deviation, rel=0.5)
