"""`tetractl design` and `identify`: propose and drive a motion that identifies robots; estimate
turning rate, speed, heading bias, dead time and noise from logs.
"""

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tetractl.cli import ui
from tetractl.cli.options import (
    AsJson,
    Sets,
    Spec,
    Yes,
    argument,
    option,
    out_option,
    plant_option,
    switch,
)
from tetractl.cli.trials import drive
from tetractl.core.errors import Exit, UsageError
from tetractl.core.files import save_whole
from tetractl.core.table.table_files import json_text
from tetractl.log.read.find import find_logs

if TYPE_CHECKING:
    from tetractl.experiment.load import LoadedSpec
    from tetractl.replay.identification.design import Design
    from tetractl.replay.identification.identify import IdentifiedRobots
    from tetractl.replay.identification.tracks import Track


def design(
    spec: Spec,
    sets: Sets = None,
    seconds: Annotated[float, option("S", "Duration of the motion [s].", min=1, max=120)] = 10.0,
    plant: Annotated[
        str | None,
        plant_option("Drive the proposed motion, and identify the robots from it."),
    ] = None,
    logs: Annotated[
        Path | None,
        option("DIR", "With --plant: folder for the log. [logs/<spec name>-design-<UTC time>]"),
    ] = None,
    yes: Yes = False,
    out: Annotated[
        Path | None,
        out_option(
            "FILE",
            "YAML file to write: a spec of the motion; with --plant, the identified values, for "
            "the field `identified` of a spec.",
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
    from tetractl.experiment.plants import on_plant
    from tetractl.log.read.reader import read_trial
    from tetractl.replay.identification.design import propose, sequence_spec
    from tetractl.replay.identification.identify import identify as found_in
    from tetractl.replay.identification.tracks import track_of
    from tetractl.run.store import default_folder

    if plant is None and (logs is not None or yes):
        raise UsageError("--logs and --yes need --plant")
    ui.refuse_existing(out)
    loaded = ui.load(spec, sets)
    if plant is not None:
        loaded = on_plant(loaded, plant)
        if loaded.experiment.plant.real_time:
            ui.require_confirmation(yes)
    proposed = propose(loaded.experiment, seconds, loaded.experiment.trials.seed)
    motion = sequence_spec(loaded, proposed.directions)
    if plant is None:
        _print_design(loaded, proposed, as_json)
        if out is not None:
            save_whole(out, motion.text.encode())
        return Exit.DONE
    if not as_json:
        _print_design(loaded, proposed, False)
        print(flush=True)
    default = default_folder(f"{loaded.experiment.name}-design", datetime.now(UTC))
    log = read_trial(drive(motion, logs or default, 0, yes))
    controller = loaded.experiment.controller
    found = found_in([track_of(log)], loaded.experiment.setup.a, controller.dead_time)
    show_found(found, out, as_json)
    return Exit.DONE


def _print_design(loaded: "LoadedSpec", design: "Design", as_json: bool) -> None:
    """Print the directions of a proposed motion, and the predicted standard deviations of the
    values that will be identified from it.
    """
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


def identify(
    logs: Annotated[
        list[Path],
        argument(
            "LOG...",
            "Logs of the same robots, folders or globs; or CSV files of poses and commands.",
        ),
    ],
    out: Annotated[
        Path | None,
        out_option(
            "FILE", "YAML file to write the values to; a spec names it in its field `identified`."
        ),
    ] = None,
    wheels: Annotated[
        bool,
        switch("Of logs, fit how robots follow the speeds of their wheels, not the directions."),
    ] = False,
    as_json: AsJson = False,
) -> int:
    """Identify turning rate a, speed, heading bias, dead time and noise, with 95 % intervals.

    All logs, simulated or from a lab, must be of the same robots; their data is pooled. The true
    poses in a simulation's log are not used. The dead time counts from the sending of a direction.

    `tetractl design SPEC` proposes a motion from which robots can be identified well.

    From CSV files with speeds and turning rates, or with --wheels, it identifies what robots on two
    wheels make of these: gains, lags, dead time and noise of each robot.

    Example: tetractl identify logs/batch -o m3pi.identified.yaml

    Example: tetractl identify tables/poses.csv tables/steps.csv
    """
    from tetractl.replay.identification.csv_tracks import csv_tracks
    from tetractl.replay.identification.identify import identify as found_in
    from tetractl.replay.identification.tracks import track_of, wheels_of

    ui.refuse_existing(out)
    tables = [path for path in logs if path.suffix.lower() == ".csv"]
    if tables and len(tables) < len(logs):
        raise UsageError("logs and CSV files cannot be combined; give either logs or CSV files")
    tracks: list[Track] = csv_tracks(tables) if tables else []
    tell_remarks(tracks)
    if tables and tracks[0].twists.size:
        return _show_response(tracks, out, as_json)
    if tables:
        show_found(found_in(tracks, None), out, as_json)
        return Exit.DONE
    expected, dead_time, damaged = None, 0.0, False
    for path in find_logs(logs):
        log = ui.open_trial(path)
        damaged |= log.damage is not None
        if not any(command.direction is not None for command in log.commands):
            ui.tell(f"warning: {path}: no direction was sent in this log")
            continue
        tracks.append(wheels_of(log) if wheels else track_of(log))
        if expected is None:
            expected, dead_time = log.start.setup.a, log.experiment.controller.dead_time
    if not tracks:
        raise UsageError("no direction was sent in any of the logs")
    if wheels:
        done = _show_response(tracks, out, as_json)
        return Exit.FAILED if damaged else done
    show_found(found_in(tracks, expected, dead_time), out, as_json)
    return Exit.FAILED if damaged else Exit.DONE


def _show_response(tracks: "list[Track]", out: Path | None, as_json: bool) -> int:
    """Print how robots follow speeds and turning rates; return the exit code."""
    from tetractl.replay.identification.response import respond, response_table
    from tetractl.replay.identification.tracks import require_same

    if out is not None:
        raise UsageError(
            "--out: a spec has no place for what wheels make of their commands",
            hint="put wheels.lag, which is printed, into the spec",
        )
    require_same(tracks)
    found = respond(tracks)
    origin = ", ".join(dict.fromkeys(track.origin for track in tracks))
    title = f"{sum(len(track.sent) for track in tracks)} commands: {origin}; 95 % intervals"
    ui.show(as_json, found, [response_table(found, title, tracks[0].unit)])
    return Exit.DONE


def tell_remarks(tracks: "list[Track]") -> None:
    """Print what is to be said of the data, on stderr."""
    for track in tracks:
        ui.tell(*(f"warning: {remark}" for remark in track.remarks))


def show_found(found: "IdentifiedRobots", out: Path | None, as_json: bool) -> None:
    """Print the identified values; if a file is named, write them to it for use in specs."""
    from tetractl.experiment.yaml.core_yaml import dump
    from tetractl.replay.identification.identify import identified, stated, tables

    found = stated(found)
    ui.show(as_json, found, tables(found))
    if out is not None:
        when = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        data = identified(found, when).model_dump(mode="json", exclude_none=True)
        save_whole(out, dump(data).encode())
        if not as_json:
            print(f"wrote {out}; name it in the spec: identified: {out.name}")
