"""Compares the solver with other solvers, and prints the tables of docs/reference/measured.md.

    python benchmarks/solver.py                     everything, about 20 minutes python
    benchmarks/solver.py --quick             every row once, in seconds; for a first look only
    python benchmarks/solver.py --only a            one part

The other solvers are installed with `pip install '.[bench]' ./benchmarks/tetractl-ipopt`. Solvers
that are missing are named and skipped.
"""

import argparse
import importlib.metadata
import platform
import warnings
from collections.abc import Callable

import numba
from llvmlite import binding
from solverbench import loop, success
from solverbench.report import Report, Settings, describe_load, print_progress

PEERS = ("pyswarms", "cma", "casadi", "tetractl_ipopt")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="every row, hardly measured")
    parser.add_argument("--only", default="a,b", help="parts, such as a")
    parser.add_argument("--peers", help="rows of (a), such as PSO,pycma")
    chosen = parser.parse_args()
    warnings.simplefilter("ignore")  # of peers; figures are checked by their own J
    settings = Settings.of(chosen.quick)
    parts: dict[str, Callable[[], Report]] = {
        "a": lambda: success.step_0(settings, chosen.peers.split(",") if chosen.peers else ()),
        "b": lambda: loop.closed(settings),
    }
    wanted = [part.strip() for part in chosen.only.split(",")]
    unknown = [part for part in wanted if part not in parts]
    if unknown:
        parser.error(f"--only: no part {unknown[0]}; there are {', '.join(parts)}")
    began = describe_load()
    reports = []
    for part in wanted:
        print_progress(f"({part}) ...")
        reports.append(parts[part]())
    print("\n".join(_head(began, chosen.quick)))
    for report in reports:
        print("\n".join([f"### {report.title}", "", *report.lines]))


def _head(began: str, quick: bool) -> list[str]:
    versions = [f"{name} {_version(name)}" for name in ("tetractl", "numba", "numpy", "scipy")]
    versions += [f"{name} {_version(name)}" for name in PEERS]
    lines = [
        f"One process, {platform.python_implementation()} {platform.python_version()}, processor "
        f"{binding.get_host_cpu_name()} ({numba.config.NUMBA_NUM_THREADS} cores); "
        f"{', '.join(versions)}. {began} at the start, {describe_load()} at the end.",
        "",
    ]
    return [*lines, "**`--quick`: these figures mean little.**", ""] if quick else lines


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


if __name__ == "__main__":
    main()
