"""`tetractl design`: proposes a motion from which the robots can be identified well, and drives
it."""

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tetractl.cli.identify import show_found
from tetractl.cli.options import AsJson, Sets, Spec, Yes, refuse_existing, require_confirmation
from tetractl.cli.trials import PlantChoice
from tetractl.core.errors import Exit, UsageError
from tetractl.core.files import save_whole

if TYPE_CHECKING:
    from tetractl.experiment.load import LoadedSpec
    from tetractl.replay.identification.design import Design


def design(
    spec: Spec,
    sets: Sets = None,
    seconds: Annotated[
        float, typer.Option(min=1, max=120, metavar="S", help="Duration of the motion [s].")
    ] = 10.0,
    plant: Annotated[
        PlantChoice | None,
        typer.Option(help="Drive the proposed motion, and identify the robots from it."),
    ] = None,
    logs: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="With --plant: folder for the log.  \\[logs/<spec name>-design-<UTC time>]",
        ),
    ] = None,
    yes: Yes = False,
    out: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            metavar="FILE",
            help="YAML file to write: a spec of the motion; with --plant, the identified values, "
            "for the field `identified` of a spec.",
        ),
    ] = None,
    as_json: AsJson = False,
) -> int:
    """Propose a motion from which the robots can be identified well.

    With the spec's values, the robots stay inside the arena and away from obstacles. With --plant
    sim or lab the motion is driven, in the lab with all checks of a run, and the robots are
    identified from its log.

    Example: tetractl design experiments/three_m3pi.yaml --plant sim
    """
    from tetractl.cli.options import load
    from tetractl.experiment.plants import on_plant
    from tetractl.replay.identification.design import propose
    from tetractl.replay.redrive import sequence_spec

    if plant is None and (logs is not None or yes):
        raise UsageError("--logs and --yes need --plant")
    refuse_existing(out)
    loaded = load(spec, sets or [])
    if plant is not None:
        loaded = on_plant(loaded, plant.value)
        if loaded.experiment.plant.real_time:
            require_confirmation(yes)
    proposed = propose(loaded.experiment, seconds, loaded.experiment.trials.seed)
    motion = sequence_spec(loaded, proposed.directions, 0.0)
    if plant is None:
        _show(loaded, proposed, as_json)
        if out is not None:
            save_whole(out, motion.text.encode())
        return Exit.DONE
    from tetractl.cli.trials import drive
    from tetractl.log.read.reader import read_trial
    from tetractl.replay.identification.identify import identify as found_in
    from tetractl.replay.identification.tracks import track_of
    from tetractl.run.store import default_folder

    if not as_json:
        _show(loaded, proposed, False)
        print(flush=True)
    default = default_folder(f"{loaded.experiment.name}-design", datetime.now(UTC))
    log = read_trial(drive(motion, logs or default, 0, yes))
    controller = loaded.experiment.controller
    found = found_in([track_of(log)], loaded.experiment.setup.a, controller.dead_time)
    show_found(found, out, as_json)
    return Exit.DONE


def _show(loaded: "LoadedSpec", design: "Design", as_json: bool) -> None:
    """Print the directions of a proposed motion, and the predicted standard deviations of the
    values that will be identified from it.
    """
    from tetractl.core.table.table_files import json_text

    setup = loaded.experiment.setup
    if as_json:
        plain = {
            "directions": design.directions,
            "period": design.period_s,
            "clearance": design.clearance,
            "predicted": {
                "dead_time_std": design.dead_time_std,
                "a_std": dict(zip(setup.names, design.a_std, strict=True)),
                "heading_bias_std": dict(zip(setup.names, design.heading_bias_std, strict=True)),
            },
        }
        print(json_text(plain))
        return
    u = design.directions
    knots = [0, *(i for i in range(1, len(u)) if u[i] != u[i - 1])]
    print(
        f"{len(knots)} directions in {design.seconds:g} s, {design.clearance:.1f} {setup.unit} "
        "or more from edges and obstacles, computed with the spec's values"
    )
    print("  " + ", ".join(f"{design.directions[i]:.3f}" for i in knots) + " rad")
    print("predicted standard deviations of the values identified from this motion:")
    print(f"  dead time {design.dead_time_std:.5f} s")
    for name, a, bias in zip(setup.names, design.a_std, design.heading_bias_std, strict=True):
        print(f"  {name}: a {100 * a:.2f} %, heading bias {bias:.4f} rad")
