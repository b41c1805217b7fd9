"""Options of the command line, declared as `Annotated` types for the library typer.

The module contains options that several commands have, and short ways to declare others. Commands
of other packages also use them.
"""

from pathlib import Path
from typing import Annotated, Any

import typer

from tetractl.core.registries import PLANTS


def argument(metavar: str, description: str) -> Any:
    """Declare an argument of a command for typer, which the help shows as `metavar`."""
    return typer.Argument(metavar=metavar, help=_escape_markup(description))


def option(
    metavar: str, description: str, *names: str, min: float | None = None, max: float | None = None
) -> Any:
    """Declare an option of a command for typer.

    Args:
        metavar: Name of the option's value in the help.
        description: Help text of the option.
        *names: Names of the option. Not needed if the option is named after its parameter.
        min: Minimum value. None for no limit.
        max: Maximum value. None for no limit.
    """
    return typer.Option(*names, metavar=metavar, help=_escape_markup(description), min=min, max=max)


def switch(description: str, *names: str) -> Any:
    """Declare an option without a value for typer.

    Without `names`, it is named after its parameter, and has a second form with --no-.
    """
    return typer.Option(*names, help=_escape_markup(description))


def out_option(metavar: str, description: str) -> Any:
    """Declare the option -o, for the file or folder to write."""
    return option(metavar, description, "-o", "--out")


def tcp_port(description: str) -> Any:
    """Declare an option for the number of a TCP or UDP port."""
    return option("N", description, min=0, max=65535)


def plant_option(description: str) -> Any:
    """Declare the option --plant, whose values a shell completes."""
    return typer.Option(
        metavar="sim|lab|emulated", help=_escape_markup(description), autocompletion=PLANTS.names
    )


def _escape_markup(description: str) -> str:
    return description.replace("[", "\\[")  # which rich would read as markup


Log = Annotated[Path, argument("LOG", "The log of the trial.")]
Logs = Annotated[
    list[Path], argument("LOG|FOLDER...", "Trial logs: files, folders or glob patterns.")
]
Spec = Annotated[Path, argument("SPEC", "The experiment, a YAML file.")]
Sets = Annotated[
    list[str] | None,
    option(
        "PATH=VALUE", "Replace a value of the spec, given as field=value. Can be repeated.", "--set"
    ),
]
AsJson = Annotated[bool, switch("Print one JSON object.", "--json")]
LikeFormatJson = Annotated[bool, switch("The same as --format json.", "--json")]
Strict = Annotated[bool, switch("Exit with code 2 if a spec has warnings.", "--strict")]
Yes = Annotated[
    bool, switch("Move robots without asking first. Needed if there is no terminal.", "--yes")
]
Lab = Annotated[
    str,
    option(
        "lab|emulated",
        "lab: use the spec's lab. emulated: emulate this lab in virtual time.",
        "--plant",
    ),
]

Unattended = Annotated[
    bool,
    switch(
        "Keep running if the terminal closes, or if no process reads the output any "
        "more. Without this option, the robots then stop. Only for a lab, and only "
        "with --yes.",
        "--unattended",
    ),
]
Seed = Annotated[int | None, option("S", "Seed of all random numbers. [spec: trials.seed]", min=0)]
LogFolder = Annotated[
    Path | None, out_option("DIR", "Folder for the logs. [logs/<spec name>-<UTC time>]")
]
DryRun = Annotated[
    bool,
    switch(
        "Run nothing. Print the spec, its limits and the trials that would be run.", "--dry-run"
    ),
]
Quiet = Annotated[bool, switch("Do not show a live view or progress.", "--quiet", "-q")]
Serve = Annotated[
    bool,
    switch("Print a link that shows the trial in Foxglove or Lichtblick as it runs.", "--serve"),
]
ServePort = Annotated[
    int | None,
    tcp_port("TCP port of the server that --serve starts. 0 chooses any free port. [8765]"),
]
StatsJson = Annotated[
    bool, switch("Print the statistics as JSON, like `stats --format json`.", "--json")
]
