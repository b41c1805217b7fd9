"""Collect where a log comes from: machine, time, versions, and state of the source tree.

host_facts        the facts at the start of a log. They consist of these sets, whose keys differ:
  process         started, pid
  TRIAL_CODE_KEY  a hash by which a study recognises the trials of its own code
  host            the machine
  versions        python, tetractl, libraries, and a hash of the code that decides a step
  git_state       commit and changes, if tetractl runs from a checkout
  plugins         packages that provide kinds, such as a controller
"""

import hashlib
import json
import os
import platform
import socket
import sys
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from functools import cache
from importlib import metadata
from pathlib import Path
from types import MappingProxyType

from tetractl.core import __version__
from tetractl.core.registry import find_package_files
from tetractl.tools.cache import compiler_settings
from tetractl.tools.cache import digest_files as cache_name
from tetractl.tools.children import run_tool

COMPUTING_PACKAGES = ("numpy", "numba", "llvmlite", "scipy")
PACKAGES = (*COMPUTING_PACKAGES, "pydantic", "pyyaml", "mcap", "zstandard", "protobuf")
"""Packages whose version may change a result or its log. Logs contain these versions."""

TRIAL_CODE_KEY = "trial_code"
"""Key of the hash `trial_code` in the facts of a log.

It covers all code that determines a simulated trial and its log.
"""

DECISION_CODE_KEY = "code"
"""Key of the hash of the code that determines a decision (DECISION_PARTS)."""

FILES_MAX = 200
"""Maximum number of changed files, and of untracked files, that a log names.

A checkout with many local changes therefore makes no large logs.
"""
VERSION_KEYS = frozenset(
    {"python", "tetractl", DECISION_CODE_KEY, TRIAL_CODE_KEY, "git_commit", "git_dirty", *PACKAGES}
)
"""Keys of the facts of a log that name versions of code."""

PLUGIN_PREFIX = "package."
"""Prefix of the keys for packages that provide a kind used by the spec.

The value is the version.
"""

DECISION_PARTS = ("control", "model")
"""The parts of tetractl that determine a decision."""

TRIAL_CODE_PARTS = (
    "core",
    "tools",
    "spec",
    "model",
    "control",
    "plant",
    "run",
    "log/format",
    "log/write",
)
"""The parts of tetractl that determine the content of a simulated trial's log."""

PACKAGE_FOLDER = Path(__file__).parents[1]
"""Folder of the package tetractl."""


def utc_now() -> str:
    """Return the present date and time (UTC) in ISO 8601, to the millisecond."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


@cache
def host() -> Mapping[str, str]:
    """Return facts about this machine: name, system, processor, and settings of the compiler."""
    facts = {
        "host": socket.gethostname(),
        "os": platform.platform(),
        "machine": machine(),
        "cpu": _processor_name(),
        "numba_settings": compiler_settings(),
        "cpus": str(os.cpu_count() or 0),
    }
    return MappingProxyType(facts)


def machine() -> str:
    """Return the type of processor, such as `x86_64`.

    On processors of the same type, a simulated trial has the same bits.
    """
    name = platform.machine()
    return "x86_64" if name == "AMD64" else name  # as Windows calls it


@cache
def versions() -> Mapping[str, str]:
    """Return the versions of Python, libraries and code that affect the results of a trial."""
    facts = {
        "python": platform.python_version(),
        "tetractl": __version__,
        DECISION_CODE_KEY: cache_name(_source_files(DECISION_PARTS)),
        **{name: metadata.version(name) for name in PACKAGES},
    }
    return MappingProxyType(facts)


@cache
def trial_code(packages: tuple[tuple[str, str], ...] = ()) -> str:
    """Compute 12 hex digits that identify all code that affects a simulated trial and its log.

    This code consists of the source files of TRIAL_CODE_PARTS, the numerical libraries (by their
    versions), and `packages`: name and version of each package that provides a kind used by the
    spec, with its source files.
    """
    sources = _source_files(TRIAL_CODE_PARTS).union(
        *(find_package_files(name) for name, _ in packages)
    )
    computing = [(name, metadata.version(name)) for name in COMPUTING_PACKAGES]
    return cache_name(sources, repr([*computing, *packages]))


def _source_files(subpackages: Iterable[str]) -> set[Path]:
    return {
        file for subpackage in subpackages for file in (PACKAGE_FOLDER / subpackage).rglob("*.py")
    }


def host_facts(packages: Mapping[str, str]) -> dict[str, str]:
    """Collect the facts about this computer for the start of a log: time, machine, versions.

    `packages` contains name and version of each package that provides a kind used by the spec.
    """
    by_name = tuple(sorted(packages.items()))
    return {
        "started": utc_now(),
        "pid": str(os.getpid()),
        TRIAL_CODE_KEY: trial_code(by_name),
        **host(),
        **versions(),
        **git_state(),
        **plugins(packages),
    }


def plugins(packages: Mapping[str, str]) -> dict[str, str]:
    """Return the versions of the packages that provide kinds, under the keys used in a log."""
    return {PLUGIN_PREFIX + name: version for name, version in packages.items()}


def is_version(key: str) -> bool:
    """Check whether a key of a log's host facts names a version of code."""
    return key in VERSION_KEYS or key.startswith(PLUGIN_PREFIX)


@cache
def environment() -> str:
    """Describe the computer, the versions and the code of a run as JSON text.

    Returns:
        An object with the `host`, the `versions` of tetractl and its dependencies, the `python`
        version, and the installed `packages`. If the checkout has uncommitted changes, it also has
        these changes.
    """
    facts: dict[str, object] = {
        "host": dict(host()),
        "versions": {**versions(), **git_state()},
        "python": sys.version,
        "packages": _installed_packages(),
    }
    if git_state().get("git_dirty") == "true":
        facts |= _local_changes()
    return json.dumps(facts, indent=1) + "\n"


def _installed_packages() -> dict[str, str]:
    """Return name and version of each installed package, sorted by name."""
    # read once: each access to `metadata` reads a file
    installed = [distribution.metadata for distribution in metadata.distributions()]
    packages = {package["Name"]: package["Version"] for package in installed if package["Name"]}
    return {name: packages[name] for name in sorted(packages, key=str.lower)}


def _local_changes() -> dict[str, object]:
    """Return a hash of the local changes in tetractl's git checkout, and the changed files."""
    diff = _git("diff", "HEAD") or ""
    changed = _git("diff", "HEAD", "--name-only") or ""
    untracked = _git("ls-files", "--others", "--exclude-standard", ":/") or ""
    return {
        "git_diff_sha256": hashlib.sha256(diff.encode()).hexdigest(),
        "git_changed": changed.splitlines()[:FILES_MAX],
        "git_untracked": untracked.splitlines()[:FILES_MAX],
    }


@cache
def git_state() -> Mapping[str, str]:
    """Return the commit of tetractl's git checkout, and whether it has local changes.

    The result is empty if tetractl does not run from a checkout, or git is not installed.
    """
    facts: dict[str, str] = {}
    # else no checkout, or the checkout of another project around an installed package
    if _git("ls-files", "--error-unmatch", "__init__.py") is not None:
        commit = _git("rev-parse", "HEAD")
        changes = _git("status", "--porcelain", ":/")
        if commit is not None and changes is not None:
            facts["git_commit"] = commit.strip()
            facts["git_dirty"] = "true" if changes.strip() else "false"
    return MappingProxyType(facts)


def _git(*arguments: str) -> str | None:
    """Run git in tetractl's own folder, and return its output.

    The result is None if git fails.
    """
    try:
        process = run_tool(["git", "-C", str(PACKAGE_FOLDER), *arguments], timeout_s=5.0)
    except OSError:
        return None
    return process.stdout.decode(errors="replace") if process.returncode == 0 else None


def _processor_name() -> str:
    """Return the processor's name.

    The kernel's name is preferred, because `platform` is less exact.
    """
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
