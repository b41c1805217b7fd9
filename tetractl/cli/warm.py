"""`tetractl warm`: compile the code that specs need before they are run."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tetractl.cli.options import Sets, load
from tetractl.core.errors import Exit

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tetractl.experiment.experiment import Experiment


def warm(
    specs: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[SPEC|STUDY]...",
            help="Specs and studies to compile for.  \\[the specs that `tetractl init` writes]",
        ),
    ] = None,
    sets: Sets = None,
) -> int:
    """Compile the code that specs and studies need, with progress, so that their runs start at
    once.

    Compiled code is kept on this machine, for each kind of processor and each combination of
    controller, optimiser and motion. Run this command again after a change of one of these.

    Example: tetractl warm three-m3pi.yaml studies/slip.yaml
    """
    from time import perf_counter

    from rich.console import Console

    from tetractl.control.build import compiled_for, warm_up
    from tetractl.core.cache import cache_folder

    wanted: dict[str, list[Experiment]] = {}
    for experiment in _experiments(specs or [], sets or []):
        wanted.setdefault(compiled_for(experiment), []).append(experiment)
    console = Console(stderr=True)
    for number, (kinds, experiments) in enumerate(wanted.items(), start=1):
        began_s = perf_counter()
        with console.status(f"{number} of {len(wanted)}: compiling for {kinds}"):
            for experiment in experiments:  # the first spec compiles most of the code
                warm_up(experiment, lambda text: None)
        print(f"{kinds}: {perf_counter() - began_s:.1f} s", flush=True)
    print(f"kept in {cache_folder()}", file=sys.stderr)
    return Exit.DONE


def _experiments(files: list[Path], sets: list[str]) -> "Iterator[Experiment]":
    """Yield the experiments to compile for: the specs, one arm per controller of each study, or,
    without files, the templates of `tetractl init`.
    """
    from tetractl.cli.init import template
    from tetractl.experiment.load import parse_spec
    from tetractl.study.load_study import is_study, load_study

    if not files:
        for kind in ("robots", "cells"):
            yield parse_spec(template("warm", "warm", kind), "warm", sets).experiment
    for file in files:
        if is_study(file):
            arms = load_study(file).arms
            yield from {arm.controller: arm.spec.experiment for arm in arms}.values()
        else:
            yield load(file, sets).experiment
