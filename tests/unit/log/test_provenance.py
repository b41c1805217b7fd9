"""Tests of facts about the computer and the source tree."""

import hashlib
import json
import subprocess
import sys

import numpy as np
import pytest

from tetractl import __version__
from tetractl.log import provenance


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A git checkout in whose tetractl/log/provenance.py we pretend to be."""
    package = tmp_path / "tetractl"
    (package / "log").mkdir(parents=True)
    (package / "__init__.py").write_text("")
    monkeypatch.setattr(provenance, "PACKAGE_FOLDER", package)
    for cached in (provenance.versions, provenance.git_state, provenance.environment):
        cached.cache_clear()
    yield tmp_path
    for cached in (provenance.versions, provenance.git_state, provenance.environment):
        cached.cache_clear()


def _git(folder, *arguments):
    names = ("-c", "user.name=a", "-c", "user.email=a@example.org")
    done = subprocess.run(
        ["git", *names, *arguments], cwd=folder, capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


@pytest.fixture
def committed(checkout):
    """The checkout with all of it in a commit."""
    _git(checkout, "init", "-q")
    _git(checkout, "add", ".")
    _git(checkout, "commit", "-q", "-m", "one")
    return checkout


def test_a_clean_checkout_is_its_commit(committed):
    facts = {**provenance.versions(), **provenance.git_state()}
    assert facts["git_commit"] == _git(committed, "rev-parse", "HEAD")
    assert facts["git_dirty"] == "false"
    assert facts["tetractl"] == __version__
    assert facts.keys() <= provenance.VERSION_KEYS
    listed = json.loads(provenance.environment())
    assert "git_changed" not in listed
    assert listed["packages"]["numpy"] == np.__version__
    assert listed["host"] == provenance.host()


def test_a_changed_checkout_names_its_changes(committed):
    (committed / "tetractl" / "__init__.py").write_text("changed = True\n")
    assert provenance.git_state()["git_dirty"] == "true"
    changed = json.loads(provenance.environment())
    assert changed["git_changed"] == ["tetractl/__init__.py"]
    diff = _git(committed, "diff", "HEAD") + "\n"
    assert changed["git_diff_sha256"] == hashlib.sha256(diff.encode()).hexdigest()


def test_the_code_of_a_trial_covers_what_makes_its_digest():
    """Rows by the same code must have digests that can be compared."""
    modules = subprocess.run(
        [
            sys.executable,
            "-c",
            "import sys, tetractl.log.write.writer\n"
            "print(*(name for name in sys.modules if name.startswith('tetractl.')))",
        ],
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
    parts = {part.replace("/", ".") for part in provenance.TRIAL_CODE_PARTS}
    mine = {name for name in modules if name.startswith("tetractl.log.")}
    packages = {"tetractl.log.format", "tetractl.log.read"}
    undigested = {"tetractl.log.provenance"}  # only the host records, which no digest covers
    of_a_part = tuple(f"tetractl.{part}" for part in parts)
    assert [name for name in mine - packages - undigested if not name.startswith(of_a_part)] == []


@pytest.mark.parametrize("part", [*provenance.TRIAL_CODE_PARTS, *provenance.DECISION_PARTS])
def test_each_part_of_the_code_is_a_folder_with_code(part):
    """Regression: a renamed folder was no longer part of the hash, and nothing said so."""
    assert [*(provenance.PACKAGE_FOLDER / part).rglob("*.py")]


def test_a_package_inside_a_foreign_checkout_has_no_commit(checkout):
    _git(checkout, "init", "-q")
    (checkout / "theirs.txt").write_text("theirs")
    _git(checkout, "add", "theirs.txt")
    _git(checkout, "commit", "-q", "-m", "theirs")
    assert "git_commit" not in provenance.versions()


def test_without_git_there_is_no_commit(checkout, monkeypatch):
    monkeypatch.setenv("PATH", str(checkout))
    facts = provenance.versions()
    assert "git_commit" not in facts
    assert facts["numpy"] == np.__version__


@pytest.mark.parametrize(
    ("key", "is_one"),
    [
        *((key, True) for key in ("python", "numpy", "git_commit", provenance.TRIAL_CODE_KEY)),
        ("package.tetractl-toio", True),
        *((key, False) for key in ("host", "machine", "started", "pid", "cpus", "a package.x")),
    ],
)
def test_versions_of_code_are_told_from_other_facts_of_a_host(key, is_one):
    assert provenance.is_version(key) == is_one


def test_packages_of_a_spec_are_facts_under_keys_of_versions_and_change_the_code():
    facts = provenance.host_facts({"numpy": "9.9"})
    assert facts["package.numpy"] == "9.9"
    assert facts[provenance.TRIAL_CODE_KEY] == provenance.trial_code((("numpy", "9.9"),))
    assert facts[provenance.TRIAL_CODE_KEY] != provenance.trial_code()
    assert {"started", "pid", "host", "machine", "numpy"} <= facts.keys()


def test_the_processor_has_one_name_on_every_system(monkeypatch):
    for named, machine in (("AMD64", "x86_64"), ("x86_64", "x86_64"), ("arm64", "arm64")):
        monkeypatch.setattr(provenance.platform, "machine", lambda name=named: name)
        assert provenance.machine() == machine


def test_at_most_so_many_changed_files_are_named(committed, monkeypatch):
    monkeypatch.setattr(provenance, "FILES_MAX", 3)
    for number in range(5):
        (committed / f"new-{number}.txt").write_text("")
    named = json.loads(provenance.environment())["git_untracked"]
    assert [name.rpartition("/")[2] for name in named] == [f"new-{n}.txt" for n in range(3)]
