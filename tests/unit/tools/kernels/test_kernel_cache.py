"""Tests that a process that compiles kernels and one that loads them compute the same bits."""

import os
import platform
import subprocess
import sys
from types import SimpleNamespace

import pytest
from testkit.durable import small_disk
from testkit.paths import ROOT

from tetractl.tools.kernels import kernel_cache as cache

SEARCH = """
import hashlib, sys
from pathlib import Path
from tetractl.core.commands import Steer
from tetractl.control.search.evaluate import compiled_prediction
from tetractl.control.search.kernels.multistart import search
from tetractl.control.search.optimizers.multistart import Multistart
from tetractl.control.search.optimizers.pso import Pso
from tetractl.core.plan import Limits
from tetractl.spec.load import load_spec

digest = hashlib.sha256()
experiment = load_spec(Path(sys.argv[1]) / "three_m3pi.yaml").experiment
problem = experiment.controller.problem(experiment.setup)
for optimizer in (Multistart(rounds=2), Pso(iterations=20)):
    found = optimizer.search(problem, 30, None, 1, Limits())
    digest.update(found.signals.tobytes() + found.history.tobytes())
    digest.update(compiled_prediction(problem, found.signals).path.tobytes())
print(sum(search.stats.cache_hits.values()), digest.hexdigest())
"""


KNOW = """
import hashlib, sys
from dataclasses import astuple
from pathlib import Path
import numpy as np
from tetractl.control.estimation.estimator import StateEstimator
from tetractl.control.estimation.kernels.filter import _follow, place
from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.commands import Steer
from tetractl.spec.load import load_spec
from tetractl.plant.simulation import SimPlant

settings = ["plant.dead_time=0.14", "plant.a_error=0.1", "plant.lost_commands=0.1"]
spec = load_spec(Path(sys.argv[1]) / "three_m3pi.yaml", settings).experiment
clock = VirtualClock()
plant = SimPlant(spec.plant, spec.setup, clock, np.random.SeedSequence(1))
plant.open()
problem = spec.controller.problem(spec.setup)
known = StateEstimator(problem, 0.2, spec.controller.prior.of(problem, 0.0, spec.setup))
command, digest = None, hashlib.sha256()
for k, u in enumerate(np.random.default_rng(1).uniform(-2, 2, 40)):
    clock.sleep_until(k * SECOND // 5)
    seen = plant.observe()
    frames = [one.observation for one in plant.samples()]
    digest.update(known.add_step(seen, command, frames[:-1]).poses.array().tobytes())
    command = plant.send(Steer(float(u)))
    numbers = [value for value in astuple(known.estimate) if value is not None]
    digest.update(b"".join(np.asarray(value, dtype=float).tobytes() for value in numbers))
hits = [sum(kernel.stats.cache_hits.values()) for kernel in (_follow, place)]
print(sum(hits), digest.hexdigest())
"""


PARTS = """
import numpy as np
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import ENTRY_FAST, PART_FAST

@compiled(**PART_FAST)
def part(x, y):
    for _ in range(3):
        x, y = x + 0.1 * np.sin(y), y * np.exp(-x) + np.hypot(x, y)
    return x - y

@compiled(**ENTRY_FAST)
def kernel(values):
    total = 0.0
    for value in values:
        total += part(value, total) / (1.0 + abs(total))
    return total

found = kernel(np.linspace(0.1, 3, 1000))
print(sum(kernel.stats.cache_hits.values()), found.hex())
"""


@pytest.mark.long
@pytest.mark.parametrize(
    ("script", "kernels"),
    [
        pytest.param(PARTS, 1, id="parts"),
        pytest.param(SEARCH, 1, id="search", marks=[pytest.mark.system, pytest.mark.release]),
        pytest.param(KNOW, 2, id="identification", marks=[pytest.mark.system, pytest.mark.release]),
    ],
)
def test_compiling_and_loading_give_the_same_bits(tmp_path, script, kernels):
    """Regression: a callee that was not inlined had two machine codes, one for each.

    The parts show it in seconds; of a search with a motion and a shape of another package see
    `test_plugin_models`.
    """
    experiments = ROOT / "experiments"
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", script, str(experiments)]
    files = [
        subprocess.run(
            command, env=environment, capture_output=True, text=True, check=True
        ).stdout.split()
        for _ in range(2)
    ]
    assert [int(hits) for hits, _ in files] == [0, kernels]
    assert files[0][1] == files[1][1]


TIMES = """
from tetractl.tools.kernels.kernel_cache import compile_times, compiled
from tetractl.tools.kernels.kernel_options import ENTRY_FAST, INLINE_FAST

@compiled(**INLINE_FAST)
def half(x):
    return x / 2

@compiled(**ENTRY_FAST)
def kernel(x):
    return half(x) + half(x + 1)

kernel(1.0), kernel(2.0), kernel(3)
for name, compile_time in compile_times().items():
    print(name, compile_time.versions, compile_time.own_s > 0)
"""


@pytest.mark.long
def test_compile_times_count_each_function_and_its_signatures(tmp_path):
    """Two calls with a float compile nothing new; an integer is another signature."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", TIMES]
    first, again = (
        subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        for _ in range(2)
    )
    assert sorted(first.stdout.splitlines()) == ["__main__.half 2 True", "__main__.kernel 2 True"]
    assert again.stdout == ""  # it came from the cache


SMALL = """
import sys
from tetractl.tools.kernels.kernel_cache import compiled, find_kernel_folder

@compiled(nogil=True)
def double(x):
    return 2 * x

print(double(21), sum(double.stats.cache_hits.values()), find_kernel_folder())
"""


def small(tmp_path, before="", **changes):
    """Compile and call a function in a process of its own; return what it printed, and stderr."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")} | changes
    done = subprocess.run(
        [sys.executable, "-c", before + SMALL], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split(), done.stderr


DAMAGES = {
    "empty": lambda data: b"",
    "garbage": lambda data: b"no pickle at all" * 10,
    "cut short": lambda data: data[: len(data) // 2],
    "a bit flipped": lambda data: data[:3000] + bytes([data[3000] ^ 1]) + data[3001:],
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES.keys())
def test_a_damaged_cache_is_compiled_again(tmp_path, monkeypatch, capsys, damage):
    """Regression: an empty file ended the run as interrupted, any other with a traceback."""
    assert loaded(tmp_path, monkeypatch) == 0
    (file,) = tmp_path.rglob("*.kernel")
    file.write_bytes(damage(file.read_bytes()))
    assert loaded(tmp_path, monkeypatch) == 0
    notes = capsys.readouterr().err
    assert notes.count("\n") == 1
    assert "damaged, so its code is compiled again" in notes
    assert loaded(tmp_path, monkeypatch) == 1


@pytest.mark.long
@pytest.mark.skipif(os.geteuid() != 0, reason="only root mounts file systems")
def test_a_full_disk_only_costs_the_cache(tmp_path):
    with small_disk(tmp_path / "disk", "8k") as disk:
        (tmp_path / "cache").symlink_to(disk)
        said, notes = small(tmp_path)
        assert said[:2] == ["42", "0"]
        assert notes.count("\n") == 1
        assert "compiled code cannot be kept" in notes
        assert list(disk.rglob("tmp*")) == []


@pytest.mark.long
def test_a_cache_that_others_can_write_to_is_never_read(tmp_path):
    """Regression: the index in it is a pickle, which runs what its writer likes."""
    shared = tmp_path / "cache"
    shared.mkdir()
    shared.chmod(0o777)
    said, notes = small(tmp_path, XDG_CACHE_HOME=str(tmp_path / "own"))
    assert said[2].startswith(str(tmp_path / "own"))
    assert list(shared.rglob("*.kernel")) == []
    assert "NUMBA_CACHE_DIR is not used: others can write to" in notes


SHIPPED = """
from pathlib import Path
from types import SimpleNamespace
from tetractl.tools.kernels import kernel_cache
kernel_cache.SHIPPED = Path({folder!r})
"""
OLD = "kernel_cache.binding = SimpleNamespace(get_host_cpu_features=lambda: {'avx': True})"


@pytest.mark.long
@pytest.mark.skipif(platform.machine() != "x86_64", reason="such code is for x86-64 alone")
def test_code_in_the_package_runs_where_the_processor_and_the_settings_allow(tmp_path):
    level = {"NUMBA_CPU_NAME": cache.SHIPPED_LEVEL, "NUMBA_CPU_FEATURES": ""}
    built = {"NUMBA_CACHE_DIR": str(tmp_path / "built")}
    assert small(tmp_path, **level, **built)[0][:2] == ["42", "0"]
    (file,) = (tmp_path / "built").rglob("*.kernel")
    before = SHIPPED.format(folder=str(file.parent))
    assert small(tmp_path, before)[0][:2] == ["42", "1"]
    assert list((tmp_path / "cache").rglob("*.kernel")) == []
    assert small(tmp_path, before, NUMBA_OPT="1")[0][:2] == ["42", "0"]
    assert small(tmp_path, before + OLD)[0][:2] == ["42", "0"]
    file.write_bytes(b"")
    assert small(tmp_path, before + OLD)[0][:2] == ["42", "1"]  # from the user's own cache


def loaded(folder, monkeypatch):
    """Return whether a function comes from a cache in a folder; it is called and checked."""

    def doubled(value):
        return 2 * value

    monkeypatch.setattr(cache, "find_kernel_folder", lambda: folder)
    kernel = cache.compiled()(doubled)
    assert kernel(21) == 42
    return sum(kernel.stats.cache_hits.values())


def test_another_python_compiles_afresh(tmp_path, monkeypatch):
    """Regression: Python 3.13 ran what 3.11 had compiled for its own structures."""
    for tag, hits in (("cpython-311", 0), ("cpython-311", 1), ("cpython-313", 0)):
        monkeypatch.setattr(sys.implementation, "cache_tag", tag)
        assert loaded(tmp_path, monkeypatch) == hits


def test_the_time_of_compiling_counts_once_in_the_whole_and_once_with_its_function(monkeypatch):
    """`outer` compiles `first`, which compiles `inner`, and then `second`, each for some time."""
    now_s = 0.0
    monkeypatch.setattr(cache.time, "thread_time", lambda: now_s)
    listener = cache._CompileListener()

    def compiling(name, own_s, *called):
        nonlocal now_s
        function = SimpleNamespace(__module__="m", __name__=name)
        compiled = SimpleNamespace(data={"dispatcher": SimpleNamespace(py_func=function)})
        listener.on_start(compiled)
        now_s += own_s
        for call in called:
            compiling(*call)
        listener.on_end(compiled)

    monkeypatch.setattr(cache, "compile_listeners", ())
    compiling("outer", 1.0, ("first", 2.0, ("inner", 4.0)), ("second", 8.0))
    now_s += 100.0  # nothing is compiled
    compiling("inner", 16.0)
    times = {name: (time.versions, time.own_s) for name, time in listener.times.items()}
    assert times == {
        "m.outer": (1, 1.0), "m.first": (1, 2.0), "m.inner": (2, 20.0), "m.second": (1, 8.0),
    }  # fmt: skip
    assert listener.spent_s == 31.0
    assert listener.spent_s == sum(time.own_s for time in listener.times.values())
