"""`tetractl what-if`: what another controller would have decided."""

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tetractl.core.errors import Exit

if TYPE_CHECKING:
    from tetractl.replay.what_if import WhatIf

SAYS = (
    "a prediction on the recorded observations, not closed loop: the robots followed the recorded "
    "directions"
)


def what_if(
    logs: Annotated[list[str], typer.Argument(metavar="LOG", help="Logs, folders or globs.")],
    sets: Annotated[
        list[str],
        typer.Option(
            "--set",
            metavar="PATH=VALUE",
            help="Replace a value of the controller; may be repeated.",
        ),
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> int:
    """Print what another controller would have decided on the recorded observations.

    For each control step: the direction, its change, and how far apart the predicted ends are. That
    is a prediction, not closed loop.

    Example: tetractl what-if trial-000.mcap --set controller.horizon_max=20
    """
    from tetractl.experiment.yaml.problems import printable
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
            done.append({"path": str(path), "origin": log.origin.value, **_plain(found)})
            continue
        print(printable(f"{path} ({log.origin.value}), with {', '.join(sets)}:"))
        print(f"  {SAYS}")
        _print(found)
    if as_json:
        print(json.dumps({"prediction": SAYS, "set": list(sets), "logs": done}, indent=2))
    return Exit.DONE


def _plain(found: "WhatIf") -> dict[str, Any]:
    steps = [{**asdict(step), "apart": step.apart.tolist()} for step in found.steps]
    return {**asdict(found), "steps": steps, "changed": found.changed}


def _print(found: "WhatIf") -> None:
    import numpy as np

    unit = found.unit
    print(
        f"  {'k':>5} {'time [s]':>9} {'sent [rad]':>11} {'other':>8} {'change':>8} {'signals':>9}  "
        f"predicted total error [{unit}], ends apart [{unit}]"
    )
    for step in found.steps:
        lengths = f"{step.recorded_length}/{step.other_length}"
        print(
            f"  {step.k:5d} {step.time_s:9.2f} {step.recorded:11.4f} {step.other:8.4f} "
            f"{step.difference:+8.4f} {lengths:>9}  {step.recorded_error:.3f} / "
            f"{step.other_error:.3f}, at most {step.apart.max():.3f}"
        )
    if found.ended:
        print(f"  {found.ended}")
    if not found.steps:
        return
    apart = np.array([step.apart for step in found.steps])
    turned = np.abs([step.difference for step in found.steps])
    print(
        f"  {found.changed} of {len(found.steps)} steps would have sent another direction, by "
        f"{turned.mean():.4f} rad on average and {turned.max():.4f} at most"
    )
    print(
        f"  predicted ends of a robot are {apart.mean():.3f} {unit} apart on average and "
        f"{apart.max():.3f} at most"
    )
