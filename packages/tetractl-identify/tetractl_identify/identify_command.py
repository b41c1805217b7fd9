"""`tetractl identify`: estimates the robots' motion, delays and noise from recorded trials."""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tetractl.cli import ui
from tetractl.cli.options import AsJson, argument, out_option, switch
from tetractl.core.errors import Exit, UsageError, printable
from tetractl.log.read.find import find_logs
from tetractl.tools.files import write_atomically

if TYPE_CHECKING:
    from tetractl.log.read.trial_log import TrialLog
    from tetractl_identify.identify import IdentifiedRobots
    from tetractl_identify.tracks import Track


def identify(
    logs: Annotated[
        list[Path],
        argument(
            "LOG...",
            "Logs of the same robots (files, folders or globs), or CSV files of poses and "
            "commands.",
        ),
    ],
    out: Annotated[
        Path | None,
        out_option(
            "FILE",
            "YAML file to write the values to. A spec can then name this file in its "
            "field `identified`.",
        ),
    ] = None,
    wheels: Annotated[
        bool,
        switch(
            "Fit how the robots follow the speeds of their wheels, instead of how "
            "they follow directions. Works only with logs."
        ),
    ] = False,
    as_json: AsJson = False,
) -> int:
    """Identify turning rate a, speed, heading bias, dead time and noise, with 95 % intervals.

    All logs, simulated or from a lab, must show the same robots; their data is pooled. The command
    does not use the true poses in a simulation's log. The dead time counts from the sending of a
    direction.

    From CSV files with speeds and turning rates, or with --wheels, the command identifies how
    robots on two wheels follow these: gains, lags, dead time and noise of each robot.

    Example: tetractl identify logs/batch -o m3pi.identified.yaml

    Example: tetractl identify tables/poses.csv tables/steps.csv
    """
    ui.refuse_existing(out)
    tables = [path for path in logs if path.suffix.lower() == ".csv"]
    if tables and len(tables) < len(logs):
        log_path = next(path for path in logs if path not in tables)
        raise UsageError(
            f"{printable(str(log_path))}: the name does not end in .csv, and logs cannot be "
            "combined with CSV files"
        )
    if tables:
        return _identify_tables(tables, out, as_json)
    return _identify_logs(find_logs(logs), wheels, out, as_json)


def _identify_tables(tables: list[Path], output_path: Path | None, as_json: bool) -> int:
    """Identify robots from CSV files of directions or of speeds, and print the values.

    The first table decides which of the two it is. `out` is refused for speeds.
    """
    from tetractl_identify.csv_tracks import read_csv_tracks
    from tetractl_identify.identify import identify as identify_robots

    tracks = read_csv_tracks(tables)
    for track in tracks:
        ui.print_messages(*(f"warning: {remark}" for remark in track.remarks))
    has_speeds = tracks[0].twists.size > 0
    if has_speeds:
        _refuse_file_of_response(output_path)
        _show_response(tracks, as_json)
    else:
        _show_robots(identify_robots(tracks, a=None, dead_time=None), output_path, as_json)
    return Exit.DONE


def _identify_logs(
    paths: Sequence[Path], wheels: bool, output_path: Path | None, as_json: bool
) -> int:
    """Identify robots from logs, print the values, and return the exit code.

    The spec in the first log gives the expected values. The exit code is FAILED if a log is
    damaged. `out` is refused with `wheels`.
    """
    from tetractl_identify.identify import identify as identify_robots

    if wheels:
        _refuse_file_of_response(output_path)
    tracks, first_log, any_damaged = _read_logs(paths, wheels)
    if wheels:
        _show_response(tracks, as_json)
    else:
        expected_a = first_log.start.setup.a
        dead_time_s = first_log.experiment.controller.dead_time
        _show_robots(identify_robots(tracks, expected_a, dead_time_s), output_path, as_json)
    return Exit.FAILED if any_damaged else Exit.DONE


def _refuse_file_of_response(output_path: Path | None) -> None:
    """Check that no output file is given together with --wheels.

    Raises:
        UsageError: If a file is given, because a spec has no place for a response to speeds.
    """
    if output_path is not None:
        raise UsageError(
            "--out cannot be combined with --wheels, because a spec has no field for the "
            "response of wheels",
            hint="leave out --out, and put the printed lag into the spec as lab.lag",
        )


def _read_logs(paths: Sequence[Path], wheels: bool) -> "tuple[list[Track], TrialLog, bool]":
    """Read the tracks of all logs in which directions were sent.

    With `wheels`, the tracks hold the commanded speeds of the wheels instead of directions.

    Returns:
        The tracks, the first of these logs, and whether a log is damaged.

    Raises:
        UsageError: If no log has directions.
    """
    from tetractl_identify.tracks import extract_track, extract_wheel_track

    first_log: TrialLog | None = None
    tracks: list[Track] = []
    any_damaged = False
    for path in paths:
        trial = ui.open_trial(path)
        if trial.damage is not None:
            any_damaged = True
        if not any(command.direction is not None for command in trial.commands):
            ui.print_messages(f"warning: {path}: this log has no direction that was sent")
            continue
        tracks.append(extract_wheel_track(trial) if wheels else extract_track(trial))
        if first_log is None:
            first_log = trial
    if first_log is None:
        raise UsageError(
            "no direction was sent in any of the logs",
            "give logs of trials in which the robots were steered",
        )
    return tracks, first_log, any_damaged


def _show_response(tracks: "list[Track]", as_json: bool) -> None:
    """Print how robots follow speeds and turning rates.

    All tracks must have the same robots, length unit and field strength, otherwise a
    `UsageError` is raised.
    """
    from tetractl_identify.response import fit_responses
    from tetractl_identify.robot_response import create_response_table
    from tetractl_identify.tracks import require_same

    require_same(tracks)
    responses = fit_responses(tracks)
    n_commands = sum(len(track.sent_s) for track in tracks)
    origin = ", ".join(dict.fromkeys(track.origin for track in tracks))
    title = f"{n_commands} commands: {origin}; 95 % intervals"
    ui.print_results(as_json, responses, [create_response_table(responses, title, tracks[0].unit)])


def _show_robots(robots: "IdentifiedRobots", output_path: Path | None, as_json: bool) -> None:
    """Print the identified values; if a file is named, write them to it for use in specs."""
    from tetractl.spec.yaml.core_yaml import format_yaml
    from tetractl_identify.identify import (
        create_spec_section,
        remove_unsure_intervals,
        tables,
    )

    robots = remove_unsure_intervals(robots)
    ui.print_results(as_json, robots, tables(robots))
    if output_path is None:
        return
    identified_at = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    section = create_spec_section(robots, identified_at).model_dump(mode="json", exclude_none=True)
    write_atomically(output_path, format_yaml(section).encode())
    if not as_json:
        print(
            f"wrote {output_path}; to use it, add this line to the spec: "
            f"identified: {output_path.name}"
        )
