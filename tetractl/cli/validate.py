"""`tetractl validate`: check specs without running them."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from tetractl.cli.options import AsJson, Strict, load, warn
from tetractl.core.errors import Exit


def validate(
    specs: Annotated[list[Path], typer.Argument(metavar="SPEC", help="Spec files to check.")],
    sets: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="PATH=VALUE", help="Replace a value of every spec before the check."
        ),
    ] = None,
    strict: Strict = False,
    as_json: AsJson = False,
) -> int:
    """Check specs and report every problem at its line.

    Valid values that will probably not work as intended cause a warning on stderr.

    Example: tetractl validate experiments/*.yaml
    """
    results = [_check(spec, sets or []) for spec in specs]
    if as_json:
        print(json.dumps({"specs": [fields for fields, _ in results]}, indent=2))
    else:
        print("\n".join(line for _, lines in results for line in lines))
    good = all(fields["ok"] for fields, _ in results)
    doubtful = any(fields.get("warnings") for fields, _ in results)
    return Exit.USAGE if not good or (strict and doubtful) else Exit.DONE


def _check(path: Path, sets: list[str]) -> tuple[dict[str, Any], list[str]]:
    from tetractl.core.errors import printable
    from tetractl.experiment.load import spec_hash
    from tetractl.experiment.yaml.problems import InvalidSpecError
    from tetractl.run.plausibility import CheckContext

    shown = printable(str(path))
    try:
        loaded = load(path, sets)
    except InvalidSpecError as error:
        problems = [asdict(problem) for problem in error.problems]
        return {"path": shown, "ok": False, "problems": problems}, error.lines()
    experiment, warnings = loaded.experiment, warn(loaded, sets)
    summary = {
        "name": experiment.name,
        "robots": len(experiment.robots),
        "obstacles": len(experiment.obstacles),
        "controller": experiment.controller.type,
        "plant": experiment.plant.type,
        "trials": experiment.trials.count,
    }
    line = ", ".join(f"{key} {value}" for key, value in summary.items())
    fields = {"path": shown, "ok": True, **summary, "hash": spec_hash(experiment)}
    fields["warnings"] = [asdict(warning) for warning in warnings]
    fields["least_total_error"] = CheckContext.of(experiment).least_total_error
    return fields, [f"{shown}: ok: {line}"]
