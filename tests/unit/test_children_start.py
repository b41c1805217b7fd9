"""Tests that only two modules start child processes: `children` and `worker_pool` of `tools`."""

import ast

import pytest
from testkit.paths import ROOT

HELPERS = {"tetractl/tools/children.py", "tetractl/tools/worker_pool.py"}
FORKS = {  # a copy of this process, which imports what it has imported
    "packages/tetractl-emulator/tetractl_emulator/rehearsal/day.py": {"os.fork"},
}
MODULES = {
    "subprocess", "multiprocessing", "concurrent.futures.process", "pty", "webbrowser", "pexpect",
    "pdb",
}  # fmt: skip
NAMES = {
    "concurrent.futures": {"ProcessPoolExecutor"},
    "asyncio": {"create_subprocess_exec", "create_subprocess_shell"},
    "os": {"fork", "forkpty", "system", "popen", "startfile"},
}
PREFIXES = ("exec", "spawn", "posix_spawn")  # of functions of `os`
HARMLESS = {
    "tetractl/tools/cache.py": {"multiprocessing"},  # whether this process is a worker
    "tetractl/run/executors.py": {"multiprocessing", "multiprocessing.synchronize"},
}
"""What modules other than the helpers may import, to see processes, not to start them."""
SEES = {"parent_process", "active_children", "Event", "BrokenProcessPool"}


def sources():
    folders = [ROOT / "tetractl", *sorted((ROOT / "packages").glob("*/tetractl_*"))]
    files = [path for folder in folders for path in sorted(folder.rglob("*.py"))]
    assert len(files) > 300
    return files


def starters(tree):
    """Return the names by which a module starts processes, or could."""
    starting = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            starting |= {alias.name for alias in node.names if alias.name in MODULES}
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            names = {alias.name for alias in node.names}
            if node.module in MODULES or node.module.partition(".")[0] == "multiprocessing":
                starting |= {f"{node.module}.{name}" for name in names - SEES}
            starting |= {f"{node.module}.{name}" for name in names & NAMES.get(node.module, set())}
            if node.module == "os":
                starting |= {f"os.{name}" for name in names if name.startswith(PREFIXES)}
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            module = node.value.id
            name = node.attr
            if name in NAMES.get(module, set()) or (module == "os" and name.startswith(PREFIXES)):
                starting.add(f"{module}.{name}")
            if module == "multiprocessing" and name not in SEES:
                starting.add(f"{module}.{name}")
    return starting


@pytest.mark.parametrize(
    ("code", "name"),
    [
        ("import subprocess", "subprocess"),
        ("from subprocess import Popen as P", "subprocess.Popen"),
        ("from multiprocessing import get_context", "multiprocessing.get_context"),
        ("from concurrent.futures import ProcessPoolExecutor",
         "concurrent.futures.ProcessPoolExecutor"),
        ("import os\nos.execv('a', [])", "os.execv"),
        ("import os\nos.system('a')", "os.system"),
        ("from os import popen", "os.popen"),
        ("import webbrowser", "webbrowser"),
        ("import asyncio\nasyncio.create_subprocess_exec('a')", "asyncio.create_subprocess_exec"),
    ],
)  # fmt: skip
def test_each_way_to_start_a_process_is_seen(code, name):
    assert name in starters(ast.parse(code))


@pytest.mark.long
def test_no_module_but_the_helpers_starts_a_process():
    """A process started otherwise imports what lies in the present folder (K4)."""
    wrong = {}
    for path in sources():
        name = path.relative_to(ROOT).as_posix()
        may_fork = FORKS.get(name, set())
        allowed = may_fork | HARMLESS.get(name, set())
        if name in HELPERS:
            continue
        forbidden = starters(ast.parse(path.read_text())) - allowed
        if forbidden:
            wrong[name] = forbidden
    assert wrong == {}
