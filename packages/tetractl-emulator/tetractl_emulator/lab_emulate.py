"""`tetractl lab emulate`: runs an emulated lab, to which another process connects."""

from json import dumps
from pathlib import Path
from typing import Annotated, Any

from tetractl.cli import ui
from tetractl.cli.options import Sets, Spec, option, switch, tcp_port
from tetractl.core.errors import Exit
from tetractl.run.interrupt import STOP_SIGNALS

TEXT_BY_ROBOT_EVENT = {
    "run": "first command of a run",
    "moving": "moving",
    "rest": "standing still",
    "placed": "put back on their starts",
}
"""The text to print for each event of the robots."""


def emulate(
    spec: Spec,
    sets: Sets = None,
    script: Annotated[
        Path | None,
        option("FILE", "YAML file with the faults to inject and the devices' true properties."),
    ] = None,
    address: Annotated[
        str, option("IP", "Network address at which the emulated camera serves.")
    ] = "127.0.0.1",
    command_port: Annotated[
        int | None,
        tcp_port(
            "UDP port on which the emulated camera server receives commands. 0 "
            "chooses any free port. [spec]"
        ),
    ] = None,
    data_port: Annotated[
        int | None,
        tcp_port("UDP port to send frames to. 0 chooses any free port. [spec]"),
    ] = None,
    port_link: Annotated[
        Path | None,
        option("PATH", "Path to create for the actuator's serial port. [spec: lab.actuator.port]"),
    ] = None,
    record: Annotated[
        Path | None,
        option("FILE", "File to record the true poses and all events in, as JSON lines."),
    ] = None,
    replace_after: Annotated[
        float | None,
        option(
            "S",
            "Put the robots back at their start positions once they have stood still "
            "for S seconds. Give at least 6, because a run watches the robots for up "
            "to 5 s after an abort.",
            min=0.1,
        ),
    ] = None,
    seed: Annotated[int, option("N", "Seed of the emulation's random numbers.")] = 1,
    json: Annotated[bool, switch("Print events as JSON lines.", "--json")] = False,
) -> int:
    """Emulate an experiment's lab: its camera, its actuator, and its robots.

    NO HARDWARE is involved: a serial port of the actuator is a pseudo-terminal. The emulation runs
    in real time until Ctrl-C, and prints `ready` when programs can connect.

    Example: tetractl lab emulate experiments/three_m3pi_lab.yaml --port-link /tmp/radio
    """
    import gc
    import signal

    from tetractl.spec.plants import get_lab
    from tetractl_emulator.emulated_lab import EmulatedLab
    from tetractl_emulator.script import NO_FAULTS, load_script
    from tetractl_emulator.sides import Options

    loaded = ui.load_spec_file(spec, sets)
    lab = get_lab(loaded.experiment, loaded.name)
    fault_script = load_script(script, lab.camera.type, lab.actuator.type) if script else NO_FAULTS
    trials_choose_robots = loaded.experiment.must_choose_robots
    options = Options(
        address,
        command_port,
        data_port,
        port_link,
        record,
        replace_after,
        seed,
        trials_choose_robots,
    )

    def print_event(event: str, facts: dict[str, Any]) -> None:
        line = dumps({"event": event, **facts}) if json else _describe_event(event, facts)
        print(line, flush=True)

    emulation = EmulatedLab(lab, loaded.experiment.setup, fault_script, options, print_event)

    def end_emulation(signal_number: int, stack_frame: object) -> None:
        emulation.loop.end()

    for stop_signal in STOP_SIGNALS:
        signal.signal(stop_signal, end_emulation)
    with emulation:
        gc.freeze()  # exempts loaded objects from garbage collection: pauses would delay frames
        emulation.run()
    ui.print_messages("the emulation has stopped")
    return Exit.DONE


def _describe_event(event: str, facts: dict[str, Any]) -> str:
    """Describe an event of the emulation as a line for the terminal.

    Args:
        event: Name of the event: "ready", "client", "fault", or a key of TEXT_BY_ROBOT_EVENT.
        facts: The facts of the event, by name.
    """
    match event:
        case "ready":
            addresses = f"cameras at {facts['camera']}, {facts['actuator']}"
            return f"ready: {addresses}; this is an EMULATION, no hardware is used"
        case "client":
            return f"emulated cameras: {facts['address']} connected"
        case "run" | "moving" | "rest" | "placed":
            return f"emulated robots: {TEXT_BY_ROBOT_EVENT[event]}"
        case _:
            fault_text = " ".join(filter(None, (facts["name"], facts["robot"], facts["mark"])))
            return f"emulated fault: {fault_text}, {facts['phase']}"
