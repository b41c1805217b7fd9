"""`tetractl lab emulate`."""

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from tetractl.cli.options import Sets
from tetractl.core.errors import Exit


def emulate(
    spec: Annotated[Path, typer.Argument(metavar="SPEC", help="The experiment, a YAML file.")],
    sets: Sets = None,
    script: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Faults and true properties, a YAML file."),
    ] = None,
    address: Annotated[
        str, typer.Option(metavar="IP", help="Address of this computer to serve from.")
    ] = "127.0.0.1",
    command_port: Annotated[
        int | None,
        typer.Option(
            min=0, max=65535, metavar="N", help="UDP port for commands; 0 for any.  [spec]"
        ),
    ] = None,
    data_port: Annotated[
        int | None,
        typer.Option(min=0, max=65535, metavar="N", help="UDP port of frames; 0 for any.  [spec]"),
    ] = None,
    port_link: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH", help="Name of the actuator's serial port.  [spec: lab.actuator.port]"
        ),
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write what truly happened, as JSON lines."),
    ] = None,
    replace_after: Annotated[
        float | None,
        typer.Option(
            min=0.1,
            metavar="S",
            help="Put robots back on their starts after they stood still for S seconds.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(metavar="N", help="Seed of jitter and loss.")] = 1,
    json: Annotated[bool, typer.Option("--json", help="Print events as JSON lines.")] = False,
) -> int:
    """Emulate the lab of an experiment: its camera, its actuator on a pseudo-terminal, robots.

    NO HARDWARE is involved. It runs in real time until Ctrl-C, and says `ready` when others can
    connect.

    Example: tetractl lab emulate experiments/three_m3pi_lab.yaml --port-link /tmp/radio
    """
    import gc
    import signal

    from tetractl.cli.options import load
    from tetractl.emulate.emulated_lab import EmulatedLab
    from tetractl.emulate.script import NOTHING, load_script
    from tetractl.emulate.sides import Options
    from tetractl.experiment.plants import lab_of
    from tetractl.run.interrupt import SIGNALS

    loaded = load(spec, sets or [])
    lab = lab_of(loaded.experiment, loaded.name)
    play = load_script(script, lab.camera.type, lab.actuator.type) if script else NOTHING
    chosen = loaded.experiment.open
    options = Options(
        address, command_port, data_port, port_link, record, replace_after, seed, chosen
    )
    report = _report_json if json else _report
    emulation = EmulatedLab(lab, loaded.experiment.setup, play, options, report)

    def end(number: int, frame: object) -> None:
        emulation.loop.end()

    for number in SIGNALS:
        signal.signal(number, end)
    with emulation:
        gc.freeze()  # what was loaded is not collected again, so no long collection delays a frame
        emulation.run()
    print("the emulation has ended", file=sys.stderr)
    return Exit.DONE


def _report_json(event: str, facts: dict[str, Any]) -> None:
    from json import dumps

    print(dumps({"event": event, **facts}), flush=True)


def _report(event: str, facts: dict[str, Any]) -> None:
    match event:
        case "ready":
            where = f"cameras at {facts['camera']}, {facts['actuator']}"
            line = f"ready: {where}; EMULATION, no hardware"
        case "client":
            line = f"emulated cameras: {facts['address']} connected"
        case "run":
            line = "emulated robots: a run starts"
        case "moving":
            line = "emulated robots: on the move"
        case "rest":
            line = "emulated robots: all stand still"
        case "placed":
            line = "emulated robots: put back on their starts"
        case _:
            what = " ".join(filter(None, (facts["name"], facts["robot"], facts["mark"])))
            line = f"emulated fault: {what}, {facts['phase']}"
    print(line, flush=True)
