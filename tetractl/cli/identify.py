"""`tetractl identify`: estimates turning rate, speed, heading bias, dead time, noise from logs."""

import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tetractl.cli.options import AsJson, open_trial, refuse_existing
from tetractl.core.errors import Exit, UsageError
from tetractl.core.files import save_whole

if TYPE_CHECKING:
    from tetractl.replay.identification.identify import IdentifiedRobots
    from tetractl.replay.identification.tracks import Track

NewFile = Annotated[
    Path | None,
    typer.Option(
        "-o",
        "--out",
        metavar="FILE",
        help="YAML file to write the values to; a spec names it in its field `identified`.",
    ),
]


def identify(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG...",
            help="Logs of the same robots, folders or globs; or CSV files of poses and commands.",
        ),
    ],
    out: NewFile = None,
    as_json: AsJson = False,
) -> int:
    """Identify turning rate a, speed, heading bias, dead time and noise, with 95 % intervals.

    All logs, simulated or from a lab, must be of the same robots; their data is pooled. The true
    poses in a simulation's log are not used. The dead time counts from the sending of a direction.

    `tetractl design SPEC` proposes a motion from which robots can be identified well.

    Example: tetractl identify logs/batch -o m3pi.identified.yaml
    """
    from tetractl.log.read.find import find_logs
    from tetractl.replay.identification.identify import identify as found_in
    from tetractl.replay.identification.tracks import csv_tracks, track_of

    refuse_existing(out)
    tables = [path for path in logs if path.suffix.lower() == ".csv"]
    if tables and len(tables) < len(logs):
        raise UsageError("logs and CSV files cannot be combined; give either logs or CSV files")
    if tables:
        show_found(found_in(csv_tracks(tables), None), out, as_json)
        return Exit.DONE
    tracks: list[Track] = []
    expected, dead_time, damaged = None, 0.0, False
    for path in find_logs(logs):
        log = open_trial(path)
        damaged |= log.damage is not None
        if not any(command.direction is not None for command in log.commands):
            print(f"warning: {path}: no direction was sent in this log", file=sys.stderr)
            continue
        tracks.append(track_of(log))
        if expected is None:
            expected, dead_time = log.start.setup.a, log.experiment.controller.dead_time
    if not tracks:
        raise UsageError("no direction was sent in any of the logs")
    show_found(found_in(tracks, expected, dead_time), out, as_json)
    return Exit.FAILED if damaged else Exit.DONE


def show_found(found: "IdentifiedRobots", out: Path | None, as_json: bool) -> None:
    """Print the identified values; if a file is named, write them to it for use in specs."""
    from tetractl.core.table.table_files import json_text
    from tetractl.core.table.terminal_table import print_tables
    from tetractl.experiment.identified import identified_yaml
    from tetractl.replay.identification.identify import identified, tables

    if as_json:
        print(json_text(found))
    else:
        print_tables(tables(found))
    if out is not None:
        when = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        save_whole(out, identified_yaml(identified(found, when)).encode())
        if not as_json:
            print(f"wrote {out}; name it in the spec: identified: {out.name}")
