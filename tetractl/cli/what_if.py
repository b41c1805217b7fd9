"""`tetractl what-if`: print what another controller would have decided."""

from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tetractl.cli.options import AsJson, Logs
from tetractl.core.errors import Exit

if TYPE_CHECKING:
    from tetractl.core.table.table import Table
    from tetractl.replay.what_if import WhatIf

SAYS = (
    "a prediction on the recorded observations, not closed loop: the robots followed the recorded "
    "directions"
)


def what_if(
    logs: Logs,
    sets: Annotated[
        list[str],
        typer.Option(
            "--set",
            metavar="PATH=VALUE",
            help="Replace a value of the controller, as field=value; may be repeated.",
        ),
    ],
    as_json: AsJson = False,
) -> int:
    """Print what another controller would have decided on the recorded observations.

    For each control step it prints the recorded and the other direction, their difference, and the
    largest distance between a robot's ends as predicted by the two plans. This is an open-loop
    prediction: the robots do not follow the other controller.

    Example: tetractl what-if trial-000.mcap --set controller.horizon_max=20
    """
    from tetractl.core.errors import printable
    from tetractl.core.table.table_files import json_text
    from tetractl.core.table.terminal_table import print_tables
    from tetractl.log.read.find import find_logs
    from tetractl.log.read.reader import read_trial
    from tetractl.replay import what_if as replay

    done: list[dict[str, Any]] = []
    for path in find_logs(logs):
        log = read_trial(path)
        other = replay.other_experiment(log, sets)
        other.controller.warm_up(other.setup)
        found = replay.what_if(log, other)
        if as_json:
            items = {**asdict(found), "changed": found.changed}
            done.append({"path": str(path), "origin": log.origin.value, **items})
            continue
        print(printable(f"{path} ({log.origin.value}), with {', '.join(sets)}:"))
        print_tables(_tables(found, SAYS))
    if as_json:
        print(json_text({"prediction": SAYS, "set": list(sets), "logs": done}))
    return Exit.DONE


def _tables(found: "WhatIf", title: str) -> "list[Table]":
    """Return tables of the predicted decisions next to the recorded ones."""
    from tetractl.core.table.table import Column, Table, fixed

    unit, steps, three = found.unit, found.steps, fixed(3)
    columns = (
        Column("k", [step.k for step in steps]),
        Column("time", [step.time_s for step in steps], "s", fixed(2)),
        Column("sent", [step.recorded for step in steps], "rad", fixed(4)),
        Column("other", [step.other for step in steps], "rad", fixed(4)),
        Column("change", [step.difference for step in steps], "rad", "{:+.4f}".format),
        Column("signals", [f"{step.recorded_length}/{step.other_length}" for step in steps]),
        Column("predicted error", [step.recorded_error for step in steps], unit, three),
        Column("with other", [step.other_error for step in steps], unit, three),
        Column("ends differ", [step.apart.max() for step in steps], unit, three),
    )
    return [Table(title, columns, "\n".join(_summary(found)))]


def _summary(found: "WhatIf") -> "Iterator[str]":
    import numpy as np

    if found.ended:
        yield found.ended
    if not found.steps:
        return
    unit = found.unit
    apart = np.array([step.apart for step in found.steps])
    turned = np.abs([step.difference for step in found.steps])
    yield (
        f"{found.changed} of {len(found.steps)} steps would have sent another direction; over all "
        f"steps, it differs by {turned.mean():.4f} rad on average and {turned.max():.4f} at most"
    )
    yield (
        f"the predicted ends of a robot differ by {apart.mean():.3f} {unit} on average and "
        f"{apart.max():.3f} at most"
    )
