"""Where a log comes from: the machine, the hour, the versions, the state of the source tree."""

import json
import os
import platform
import socket
import subprocess
import sys
from datetime import UTC, datetime
from functools import cache
from importlib import metadata
from pathlib import Path

from tetractl import __version__

PACKAGES = ("numpy", "numba", "scipy", "mcap", "protobuf")
"""Packages whose version may change a result or how it is stored."""

VERSION_KEYS = frozenset({"python", "tetractl", "git_commit", "git_dirty", *PACKAGES})
"""What `versions` may hold."""

DIFF_LIMIT = 50_000  # characters
_GIT_TIMEOUT_S = 5.0


def now() -> str:
    """Return the time of day, UTC, as ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


@cache
def host() -> dict[str, str]:
    """Return what is known of the machine."""
    return {
        "host": socket.gethostname(),
        "os": platform.platform(),
        "cpu": _cpu(),
        "cpus": str(os.cpu_count() or 0),
    }


@cache
def versions() -> dict[str, str]:
    """Return the versions behind a result and, from a source checkout, its git state.

    `git_commit` and `git_dirty` are left out where tetractl does not run from a git checkout or git
    is not installed.
    """
    facts = {"python": platform.python_version(), "tetractl": __version__}
    facts |= {name: metadata.version(name) for name in PACKAGES}
    return facts | _git_state()


def facts() -> dict[str, str]:
    """Return the host facts that a log states at its start, the hour among them."""
    return {"started": now(), "pid": str(os.getpid())} | host() | versions()


@cache
def environment() -> str:
    """Return machine, versions, every installed package and local changes, as JSON."""
    packages = {item.name: item.version for item in metadata.distributions() if item.name}
    facts: dict[str, object] = {
        "host": host(),
        "versions": versions(),
        "python": sys.version,
        "packages": dict(sorted(packages.items(), key=lambda item: item[0].lower())),
    }
    if versions().get("git_dirty") == "true":
        facts["git_diff"] = (_git("diff", "HEAD") or "")[:DIFF_LIMIT]
    return json.dumps(facts, indent=1) + "\n"


def _git_state() -> dict[str, str]:
    if _git("ls-files", "--error-unmatch", "__init__.py") is None:
        return {}  # not a checkout, or one of another project around an installed package
    commit, changes = _git("rev-parse", "HEAD"), _git("status", "--porcelain", ":/")
    if commit is None or changes is None:
        return {}
    return {"git_commit": commit.strip(), "git_dirty": "true" if changes.strip() else "false"}


def _git(*arguments: str) -> str | None:
    """Return the output of git in tetractl's own folder, None where it fails."""
    folder = Path(__file__).parents[1]
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *arguments],
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_GIT_TIMEOUT_S,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout


def _cpu() -> str:
    """Return the processor's name; the kernel's list knows more than `platform`."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
