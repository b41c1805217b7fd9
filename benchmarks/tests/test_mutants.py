"""The planted defects fit the sources in which the rehearsal is to find them."""

import subprocess
from pathlib import Path

import pytest
from mutants.forty import TABLE

ROOT = Path(__file__).parents[2]
PATCHES = sorted((ROOT / "benchmarks" / "mutants").glob("*.patch"))


@pytest.mark.parametrize("patch", PATCHES, ids=lambda path: path.stem)
def test_a_planted_defect_applies_to_the_present_sources(patch):
    done = subprocess.run(
        ["git", "apply", "--check", patch], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


def test_a_defect_of_the_forty_stands_once_in_its_file():
    rows = [row.split(" | ") for row in TABLE.strip().splitlines()]
    assert len(rows) == 40
    assert [name for name, old, *_ in rows if (ROOT / name).read_text().count(old) != 1] == []


def test_there_are_33_of_them():
    assert len(PATCHES) == 33
