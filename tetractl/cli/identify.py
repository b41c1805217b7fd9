"""`tetractl identify`: turning rate, speed, heading bias, dead time and noise from logs."""

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tetractl.cli import ui
from tetractl.cli.options import AsJson, argument, out_option, switch
from tetractl.core.errors import Exit, UsageError
from tetractl.core.files import save_whole
from tetractl.log.read.find import find_logs

if TYPE_CHECKING:
    from tetractl.replay.identification.identify import IdentifiedRobots
    from tetractl.replay.identification.tracks import Track


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
        show_found(found_in(tracks, None, None), out, as_json)
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
            hint="put the lag that is printed into the spec, as lab.lag",
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
