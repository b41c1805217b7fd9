"""A row of each printed table of a page is what its command prints now.

README, and the pages with `console` blocks, are compared by tests/cli/test_docs.py to the last
digit. The tables here take too long for that: a row is run with 20 of its trials, or fewer
instances of the benchmark, and its mean is compared with that of the page by their intervals. So a
table of an earlier plant or controller is noticed if its error differs by more than 20 trials leave
to chance.
"""

import re
import runpy
import subprocess
import sys
from dataclasses import dataclass

import numpy as np
import pytest
from support.paths import ROOT

from tetractl.results.estimate import distributions

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


ON_BENCH = ("--bench", "three_m3pi_bench.yaml", "--dead-time", "0.06")
ROWS = [
    ("ablation", "whole", (*ON_BENCH, "--part", "ablation", "--seed", "59301")),
    ("knowledge 20", "dead time given", (*ON_BENCH, "--part", "knowledge", "--seed", "60101")),
    ("hurting", "none of these", ("--part", "hurting", "--seed", "60201")),
    ("accept", "accept 30 mm", (*ON_BENCH, "--part", "accept", "--seed", "60101")),
]


@pytest.mark.release  # README prints the first of them to the last digit, of another seed
@pytest.mark.parametrize(
    ("mark", "row", "options"), ROWS, ids=lambda row_name: str(row_name).split()[0]
)
def test_a_row_of_what_disturbs_is_as_printed(mark, row, options, monkeypatch, capsys):
    """In this process, which loads once what is compiled."""
    script = ROOT / "benchmarks" / "disturbed.py"
    words = [script.name, *options, "--only", row, "--trials", "20"]
    monkeypatch.setattr(sys, "argv", words)
    monkeypatch.setattr(sys, "path", [str(script.parent), *sys.path])
    runpy.run_path(str(script), run_name="__main__")
    now = capsys.readouterr().out
    page = printed(MEASURED, mark)
    assert mean_in(line_of(now, row)).agrees(mean_in(line_of(page, row)))


@pytest.mark.release
def test_a_row_of_the_floor_is_as_printed():
    now = run("benchmarks/floors.py", "--trials", "5", "--seed", "60201", "--rows", "0")
    row = "three_m3pi_bench.yaml", "24"
    page = printed(MEASURED, "floors")
    assert mean_in(line_of(now, *row)).agrees(mean_in(line_of(page, *row)))


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
        assert mean_in(line_of(now, arm, "20")).agrees(mean_in(line_of(page, arm, "100")))


@pytest.mark.release
def test_the_bench_without_noise_is_as_printed():
    from support.bench_agreement import bench_spec, bench_trial

    errors = [bench_trial(bench_spec(), trial).result.total_error for trial in range(20)]
    cells = line_of(BENCH.read_text("utf-8"), "bench without noise, slip and lost frames")
    assert cells.split("|")[2].strip() == "20 of 20"
    mean, deviation = map(float, re.findall(r"[\d.]+", cells.split("|")[3]))
    (distribution,) = distributions(np.array([errors]))
    assert distribution.ci95.low <= mean <= distribution.ci95.high
    assert distribution.std == pytest.approx(deviation, rel=0.5)
