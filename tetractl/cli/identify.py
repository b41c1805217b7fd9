"""`tetractl identify`: how robots move and commands act, from logs."""

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tetractl.cli.options import Sets, Yes, require_confirmation
from tetractl.cli.trials import PlantChoice
from tetractl.core.errors import Exit, TetractlError, UsageError

if TYPE_CHECKING:
    from tetractl.experiment.load import LoadedSpec
    from tetractl.replay.identification.design import Design
    from tetractl.replay.identification.identify import Found
    from tetractl.replay.identification.tracks import Track


def identify(
    logs: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="LOG...",
            help="Logs of the same robots, folders or globs; or CSV files of poses and commands.",
            show_default=False,
        ),
    ] = None,
    spec: Annotated[
        Path | None,
        typer.Option(
            "--design", metavar="SPEC", help="Propose an informative motion for its robots instead."
        ),
    ] = None,
    sets: Sets = None,
    seconds: Annotated[
        float, typer.Option(min=1, max=120, metavar="S", help="How long the motion is to take.")
    ] = 10.0,
    plant: Annotated[
        PlantChoice | None,
        typer.Option(help="Drive the motion proposed, and identify the robots from it."),
    ] = None,
    logs_folder: Annotated[
        Path | None,
        typer.Option(
            "--logs",
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
            help="Write a YAML file: what was found, which a spec names as `identified`; or a spec "
            "of the motion proposed.",
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> int:
    """Identify a, speed, heading bias, dead time, wheel distance and noise, with 95 % intervals.

    Logs are pooled: all of the same robots, simulated or of a lab. Nothing is read of the truth
    that a simulation's log holds. The dead time counts from the sending of a direction.

    With --design SPEC it proposes a motion that tells much, inside the arena and away from
    obstacles. --plant sim or lab drives it, in the lab with all checks of a run.

    Example: tetractl identify logs/batch -o m3pi.identified.yaml
    """
    if (logs is None or not logs) == (spec is None):
        raise UsageError("name either LOGs or, with --design, a SPEC")
    if spec is None and (sets or plant or logs_folder or yes):
        raise UsageError("--set, --plant, --logs and --yes belong to --design")
    if out is not None and out.exists():
        raise UsageError(f"{out}: exists already", "name another with --out")
    if spec is None:
        return _from_logs(logs or [], out, as_json)
    return _design(spec, sets or [], seconds, plant, logs_folder, yes, out, as_json)


def _from_logs(paths: list[Path], out: Path | None, as_json: bool) -> int:
    """Identify the robots of logs or CSV files, and print and write what was found."""
    import sys

    from tetractl.log.read.find import find_logs
    from tetractl.log.read.reader import read_trial
    from tetractl.replay.identification.csv_tracks import csv_tracks
    from tetractl.replay.identification.identify import identify as found_in
    from tetractl.replay.identification.tracks import track_of
    from tetractl.view.terminal.damage import warn_of_damage

    tables = [path for path in paths if path.suffix.lower() == ".csv"]
    if tables and len(tables) < len(paths):
        raise UsageError("logs and CSV files cannot be identified together")
    if tables:
        _show(found_in(csv_tracks(tables), None), out, as_json)
        return Exit.DONE
    tracks: list[Track] = []
    expected, dead_time, damaged = None, 0.0, False
    for path in find_logs(paths):
        log = read_trial(path)
        warn_of_damage(log)
        damaged |= log.damage is not None
        if not any(command.direction is not None for command in log.commands):
            print(f"warning: {path}: no direction was sent in it", file=sys.stderr)
            continue
        tracks.append(track_of(log))
        if expected is None:
            expected, dead_time = log.start.setup.a, log.experiment.controller.dead_time
    if not tracks:
        raise UsageError("no direction was sent in any of the logs")
    _show(found_in(tracks, expected, dead_time), out, as_json)
    return Exit.FAILED if damaged else Exit.DONE


def _design(
    spec: Path,
    sets: list[str],
    seconds: float,
    plant: PlantChoice | None,
    folder: Path | None,
    yes: bool,
    out: Path | None,
    as_json: bool,
) -> int:
    """Propose a motion; with a plant, drive it and identify the robots from its log."""
    from tetractl.cli.options import load
    from tetractl.experiment.plants import on_plant
    from tetractl.replay.identification.design import propose
    from tetractl.replay.redrive import sequence_spec

    if plant is None and (folder is not None or yes):
        raise UsageError("--logs and --yes belong to --plant")
    loaded = load(spec, sets)
    if plant is not None:
        loaded = on_plant(loaded, plant.value)
        if not loaded.experiment.plant.simulated:
            require_confirmation(yes)
    design = propose(loaded.experiment, seconds, loaded.experiment.trials.seed)
    motion = sequence_spec(loaded, design.directions, 0.0)
    if plant is None:
        _show_design(loaded, design, as_json)
        if out is not None:
            _write(out, motion.text)
        return Exit.DONE
    from tetractl.cli.trials import drive
    from tetractl.log.read.reader import read_trial
    from tetractl.replay.identification.identify import identify as found_in
    from tetractl.replay.identification.tracks import track_of
    from tetractl.run.store import default_folder

    if not as_json:
        _show_design(loaded, design, False)
        print(flush=True)
    default = default_folder(f"{loaded.experiment.name}-design", datetime.now(UTC))
    log = read_trial(drive(motion, folder or default, 0, yes))
    controller = loaded.experiment.controller
    found = found_in([track_of(log)], loaded.experiment.setup.a, controller.dead_time)
    _show(found, out, as_json)
    return Exit.DONE


def _show(found: "Found", out: Path | None, as_json: bool) -> None:
    """Print what was found, and write it as a file for specs if one is named."""
    from tetractl.core.table.data import json_text
    from tetractl.core.table.show import print_tables
    from tetractl.experiment.identified import identified_yaml
    from tetractl.replay.identification import report

    if as_json:
        print(json_text(found))
    else:
        print_tables(report.tables(found))
    if out is not None:
        when = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        _write(out, identified_yaml(report.identified(found, when)))
        if not as_json:
            print(f"wrote {out}; name it in the spec: identified: {out.name}")


def _show_design(loaded: "LoadedSpec", design: "Design", as_json: bool) -> None:
    """Print a motion: its directions, and the deviations that a fit to it is predicted to have."""
    from tetractl.core.table.data import json_text

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
    knots = [0, *(i for i in range(1, len(design.directions)) if _turns(design, i))]
    print(
        f"{len(knots)} directions in {design.seconds:g} s, {design.clearance:.1f} {setup.unit} "
        "away from edges and obstacles at least, by the spec's values"
    )
    print("  " + ", ".join(f"{design.directions[i]:.3f}" for i in knots) + " rad")
    print("predicted standard deviations of a fit to it:")
    print(f"  dead time {design.dead_time_std:.5f} s")
    for name, a, bias in zip(setup.names, design.a_std, design.heading_bias_std, strict=True):
        print(f"  {name}: a {100 * a:.2f} %, heading bias {bias:.4f} rad")


def _turns(design: "Design", i: int) -> bool:
    return bool(design.directions[i] != design.directions[i - 1])


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise TetractlError(f"{path}: cannot be written: {error.strerror}") from error
