"""`tetractl lab`: the commands around a run with real robots."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tetractl.cli import lab_emulate
from tetractl.core.errors import Exit, TetractlError, UsageError

if TYPE_CHECKING:
    from tetractl.experiment.experiment import Experiment
    from tetractl.experiment.lab import LabSpec
    from tetractl.lab.preflight import Findings

app = typer.Typer(
    name="lab",
    no_args_is_help=True,
    help="Check, calibrate, stop or emulate the lab of a spec.",
)
app.command("emulate")(lab_emulate.emulate)

Spec = Annotated[Path, typer.Argument(metavar="SPEC", help="The experiment, a YAML file.")]
Sets = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="PATH=VALUE", help="Replace a value of the spec; may be repeated."
    ),
]


@app.command()
def check(
    spec: Spec,
    sets: Sets = None,
    json: Annotated[bool, typer.Option("--json", help="Print what was found as JSON.")] = False,
) -> int:
    """Look the lab over without moving a robot: cameras, radio, robots, batteries, starts.

    Exit code 0 means that a run could start now.

    Example: tetractl lab check experiments/three_m3pi_lab.yaml
    """
    from threading import Event

    from tetractl.core.clock import MonotonicClock
    from tetractl.lab import preflight
    from tetractl.lab.rig import Session

    experiment, lab = _lab(spec, sets)
    session = Session(experiment, lab, MonotonicClock(), Event())
    try:
        session.open()
        found = preflight.inspect(session, preflight.poll(session))
        unplaced = preflight.unplaced(session, session.client.newest)
    finally:
        session.close()
    problems = [*found.all_problems, *(line for line in unplaced if "not tracked" not in line)]
    if json:
        _print_json(found, problems)
    else:
        _print_findings(found)
        for warning in found.all_warnings:
            typer.echo(f"warning: {warning}")
        for problem in problems:
            typer.echo(f"problem: {problem}")
        typer.echo("not ready" if problems else "ready")
    return Exit.FAILED if problems else Exit.DONE


@app.command()
def stop(
    spec: Annotated[
        Path | None, typer.Argument(metavar="SPEC", help="The experiment, for its radio.")
    ] = None,
    sets: Sets = None,
    port: Annotated[
        str | None, typer.Option(metavar="PORT", help="The radio's port, in place of a spec.")
    ] = None,
    baud: Annotated[int, typer.Option(metavar="N", help="Its rate, with --port.")] = 57600,
    mode: Annotated[
        str, typer.Option(metavar="MODE", help="api2, api1 or transparent, with --port.")
    ] = "api2",
) -> int:
    """Stop every robot in reach for good: those with the mbed firmware until they are switched off.

    Robots that run the 3pi's serial-slave program are told to stop, at every address of the spec,
    or by a broadcast with --port. Needs no cameras, and the port free of other programs.

    Example: tetractl lab stop --port /dev/ttyUSB0
    """
    from tetractl.lab.actuators.m3pi.stop import stop_all

    if (spec is None) == (port is None):
        raise UsageError("name a SPEC or a --port")
    addresses: list[int] = []
    if spec is not None:
        _, lab = _lab(spec, sets)
        radio = lab.radio
        addresses = [robot.address for robot in lab.robots if robot.address is not None]
    else:
        radio = _radio(port or "", baud, mode)
    sent = stop_all(radio, addresses)
    typer.echo(f"sent {sent} stops on {radio.port}; switch the robots off and on to free them")
    return Exit.DONE


@app.command()
def calibrate(
    spec: Spec,
    sets: Sets = None,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="Where the calibration goes.")
    ] = Path("calibration.yaml"),
    robot: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Only this robot; may be repeated.  [all]"),
    ] = None,
    limit: Annotated[
        int, typer.Option(min=10, max=80, metavar="N", help="Greatest wheel count, of 127.")
    ] = 45,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask before robots move.")] = False,
) -> int:
    """Measure each robot's wheels, wheel distance and heading offset, by moving it a little.

    Robots move one after another, each on some 0.3 m; space or Esc stops them. Name the file in the
    spec as `lab.calibration`.

    Example: tetractl lab calibrate experiments/three_m3pi_lab.yaml -o m3pi.calibration.yaml
    """
    import sys
    from threading import Event

    from tetractl.experiment.plants import calibration_yaml
    from tetractl.lab.actuators.m3pi.calibrate import calibrate_robots
    from tetractl.view.terminal.stopkey import SAYS, StopKey

    if output.exists():
        raise UsageError(f"{output}: exists already", "name another with --output")
    experiment, lab = _lab(spec, sets)
    names = robot or [each.name for each in experiment.robots]
    for name in names:
        if name not in {each.name for each in experiment.robots}:
            raise UsageError(f"--robot {name}: the spec has no such robot")
    if not yes:
        if not sys.stdin.isatty():
            raise UsageError("robots would move", "add --yes where nobody can be asked")
        typer.confirm(f"{', '.join(names)} will move up to 0.3 m each. Go on?", abort=True)
    operator = Event()
    with StopKey(operator.set, lambda: None) as key:
        if key.listening:
            typer.echo(SAYS, err=True)
        found = calibrate_robots(
            experiment, lab, names, limit, operator, lambda line: typer.echo(line, err=True)
        )
    try:
        output.write_text(calibration_yaml(found), encoding="utf-8")
    except OSError as error:
        raise TetractlError(f"{output}: cannot be written: {error.strerror}") from error
    for each in found.robots:
        typer.echo(
            f"{each.name}: r {each.radius_mm:.1f} mm, heading offset {each.heading_offset:+.3f} rad"
            f", left {each.left.gain_mm:.2f} mm/s a count from {each.left.dead_zone}"
            f", right {each.right.gain_mm:.2f} from {each.right.dead_zone}"
            f"{', swapped' if each.swap else ''}"
        )
    typer.echo(f"wrote {output}; name it in the spec: lab.calibration", err=True)
    return Exit.DONE


def _lab(spec: Path, sets: list[str] | None) -> "tuple[Experiment, LabSpec]":
    from tetractl.cli.spec import load
    from tetractl.experiment.lab import LabSpec
    from tetractl.experiment.plants import on_plant

    experiment = on_plant(load(spec, sets or []), "lab").experiment
    assert isinstance(experiment.plant, LabSpec)
    return experiment, experiment.plant


def _radio(port: str, baud: int, mode: str):
    from pydantic import ValidationError

    from tetractl.experiment.lab import Radio

    try:
        return Radio.model_validate({"port": port, "baud": baud, "mode": mode})
    except ValidationError as error:
        field = error.errors()[0]["loc"][0]
        raise UsageError(f"--{field}: {error.errors()[0]['msg']}") from None


def _print_findings(found: "Findings") -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, header_style="bold")
    for name in ("robot", "off its start", "off its heading", "battery", "answers"):
        table.add_column(name, justify="left" if name == "robot" else "right")
    for robot in found.robots:
        table.add_row(
            robot.name,
            "not tracked" if robot.off_mm is None else f"{robot.off_mm:.0f} mm",
            "" if robot.off_heading is None else f"{robot.off_heading:+.2f} rad",
            "" if robot.battery_v is None else f"{robot.battery_v:.2f} V",
            "yes" if robot.answer else "no",
        )
    console = Console()
    console.print(table)
    rate = "unknown" if found.camera_rate_hz is None else f"{found.camera_rate_hz:.1f} Hz"
    console.print(f"cameras: {rate}", highlight=False)
    if found.latency_ms is not None:
        console.print(
            f"age of frames on arrival: {found.latency_ms[0]:.1f} ms, "
            f"at most {found.latency_ms[1]:.1f} ms",
            highlight=False,
        )


def _print_json(found: "Findings", problems: list[str]) -> None:
    from json import dumps

    robots = [
        {
            "name": robot.name,
            "tracked": robot.off_mm is not None,
            "off_mm": robot.off_mm,
            "off_heading": robot.off_heading,
            "placed": robot.placed,
            "answers": robot.answer is not None,
            "battery_v": robot.battery_v,
        }
        for robot in found.robots
    ]
    latency = found.latency_ms
    print(
        dumps(
            {
                "ready": not problems,
                "problems": problems,
                "warnings": list(found.all_warnings),
                "camera_rate_hz": found.camera_rate_hz,
                "latency_ms": None if latency is None else {"p50": latency[0], "max": latency[1]},
                "clock_round_trip_ms": found.round_trip_ms,
                "robots": robots,
            },
            indent=2,
            allow_nan=False,
        )
    )
