"""`tetractl lab`: the commands around a run with real robots."""

import typer

from tetractl.cli import lab_emulate

app = typer.Typer(
    name="lab",
    no_args_is_help=True,
    help="Check, calibrate, stop or emulate the lab of a spec.",
)
app.command("emulate")(lab_emulate.emulate)
