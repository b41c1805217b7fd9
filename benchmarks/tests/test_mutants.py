"""Tests of planted defects: patches for rehearsals fit the sources, random ones are valid."""

import ast
import subprocess
from pathlib import Path

import pytest
from mutants.random_defects import ROOT, choose_sites, find_sites, groups_of_tests, product_files

PATCHES = sorted((ROOT / "benchmarks" / "mutants").glob("*.patch"))


@pytest.mark.parametrize("patch", PATCHES, ids=lambda path: path.stem)
def test_a_planted_defect_applies_to_the_present_sources(patch):
    done = subprocess.run(
        ["git", "apply", "--check", patch], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


def test_there_are_33_patches():
    assert len(PATCHES) == 33


def test_every_kind_of_operator_is_changed_and_names_and_strings_are_not(tmp_path):
    source = tmp_path / "sample.py"
    source.write_text(
        "def f(a, b):\n"
        "    if a:\n"
        "        return min(a, b) + 1\n"
        "    c = not b or a <= b  # a < b\n"
        "    return 'é' + str(c) if a is b else a * b\n"
    )
    sites = find_sites(source)
    changes = {(site.line, site.old, site.new) for site in sites}
    assert changes == {
        (2, "", "not "),
        (3, "min", "max"),
        (3, "+", "-"),
        (4, "not ", ""),
        (4, "or", "and"),
        (4, "<=", ">"),
        (5, "is", "is not"),
        (5, "*", "/"),
    }
    for site in sites:
        ast.parse(site.changed())


def test_a_seed_always_chooses_the_same_defects_of_the_product():
    sites = choose_sites(["tetractl/run"], seed=1, count=5)
    assert sites == choose_sites(["tetractl/run"], seed=1, count=5)
    assert sites != choose_sites(["tetractl/run"], seed=2, count=5)
    for site in sites:
        compile(site.changed(), site.path, "exec")


def test_the_closest_tests_of_a_file_run_first_and_none_runs_twice():
    groups = list(groups_of_tests(ROOT / "tetractl" / "run" / "motion_at_rest.py"))
    assert groups[0] == ["tests/unit/run/test_motion_at_rest.py"]
    names = [name for group in groups for name in group]
    assert len(names) == len(set(names))


def test_generated_code_and_tests_are_not_changed():
    names = [str(path.relative_to(ROOT)) for path in product_files(["tetractl", "packages"])]
    assert not [name for name in names if "_pb2" in name or "tests" in Path(name).parts]
