"""The commands of the command line, and how their errors are reported.

Modules that are slow to import are imported inside the commands that need them, so that `--help`
answers at once.
"""

import re
import sys
from collections.abc import Callable
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.exceptions import TyperException

from tetractl import __version__
from tetractl.cli import (
    again,
    identify,
    kinds,
    lab,
    lab_survey,
    logs,
    outputs,
    replay,
    run,
    specs,
    stats,
    study,
    track,
    ui,
)
from tetractl.core.errors import Exit, TetractlError, UsageError
from tetractl.core.plugin_fault import FaultyPluginError, plugins_blamed
from tetractl.core.registry import PluginError, Registry
from tetractl.experiment.packages import not_installed

PLAIN = (  # typer's wording of a bad value, and the wording in errors of specs
    (
        "Input should be a valid integer, unable to parse string as an integer",
        "is not a whole number",
    ),
    ("Input should be a valid number, unable to parse string as a number", "is not a number"),
    ("Input should be greater than or equal to", "must be at least"),
    ("Input should be less than or equal to", "must be at most"),
    ("Input should be", "must be"),
    ("Value error, ", ""),
    ("Invalid value for ", ""),
)


EXTRAS = {
    "cv2": ("OpenCV", "vision"),
    "dask_jobqueue": ("dask-jobqueue", "dask"),
    "distributed": ("Dask's distributed", "dask"),
    "geff": ("geff", "geff"),
    "pandas": ("pandas", "dataframe"),
    "pyarrow": ("pyarrow", "parquet"),
    "pymmcore": ("pymmcore", "microscope"),
    "websockets": ("websockets", "serve"),
}
"""For each optional module, the package's name and the extra of tetractl that installs it."""

_BREAK = re.compile(r"(?<!\n)\n(?!\n|[a-z]+: )")  # a break inside a paragraph, not in a list


def _placeholders(params: Any) -> Any:
    """Let the help show an option's placeholder, and nothing for arguments, in place of types."""
    for one in params:
        text = one.metavar if one.param_type_name == "option" else ""
        one.display_type_rich = lambda ctx, text=text or "": text
    return params


class _Command(TyperCommand):
    def get_params(self, ctx: Any) -> Any:
        return _placeholders(super().get_params(ctx))


class _Group(TyperGroup):
    def get_params(self, ctx: Any) -> Any:
        return _placeholders(super().get_params(ctx))

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return the command with this name; UsageError if its package is not installed."""
        group = LAB_GROUP if self.name == "lab" else GROUP
        found = super().get_command(ctx, cmd_name)
        if found is None and (missing := not_installed(group, cmd_name)):
            raise UsageError(f"'{ctx.command_path} {cmd_name}' {missing[0]}", missing[1])
        return found


app = typer.Typer(
    name="tetractl",
    cls=_Group,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"tetractl {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Steer several robots at once with one control signal.

    Run an experiment from a YAML spec, show its trials, and compute their statistics.
    `tetractl init --example NAME` writes the files of the examples.
    """


COMMANDS = (
    specs.init,
    run.run,
    again.rerun,
    specs.validate,
    specs.warm,
    specs.schema,
    kinds.kinds,
    logs.info,
    logs.recover,
    replay.replay,
    outputs.plot,
    outputs.report,
    outputs.open_,
    outputs.export,
    logs.verify,
    stats.stats,
    stats.analyze,
    study.study,
    identify.design,
    identify.identify,
    track.track,
)
GROUP, LAB_GROUP = "tetractl.commands", "tetractl.lab_commands"
"""Groups of entry points, with which other packages add commands."""
LAB_COMMANDS = (lab.check, lab.stop, lab.calibrate, lab_survey.survey)
lab_app = typer.Typer(name="lab", no_args_is_help=True, help=lab.HELP, cls=_Group)
app.add_typer(lab_app)


def _add(group: typer.Typer, name: str, function: Callable[..., object]) -> None:
    help_text = _BREAK.sub(" ", ui.declare_options(function))
    group.command(name, cls=_Command, help=help_text)(function)


def _unusable(group: typer.Typer, name: str, error: PluginError) -> None:
    """Add a command that only says why another package's command cannot be used."""

    def fail() -> None:
        raise error

    anything = {"allow_extra_args": True, "ignore_unknown_options": True}
    text = f"Cannot be used: {error.message}"
    group.command(name, help=text, context_settings=anything, add_help_option=False)(fail)


for group, registry, functions in (
    (app, Registry(GROUP, {}), COMMANDS),
    (lab_app, Registry(LAB_GROUP, {}), LAB_COMMANDS),
):
    ours = {function.__name__.strip("_").replace("_", "-"): function for function in functions}
    for name, function in ours.items():
        _add(group, name, function)
    for name in registry.names():
        try:
            if name not in ours:
                _add(group, name, registry.load(name))
        except PluginError as error:
            _unusable(group, name, error)


def run_app() -> int:
    """Run the command that the arguments name; return one of the codes of `Exit`."""
    if "" in sys.argv[1:]:  # as a path, it would be the present folder
        return complain(Exit.USAGE, "an argument is empty", "is a variable of the shell not set?")
    try:
        with plugins_blamed():
            code = app(standalone_mode=False)
        sys.stdout.flush()  # here, so that an error of stdout is handled below
    except TetractlError as error:
        if isinstance(error, FaultyPluginError) and sys.flags.dev_mode:
            raise
        return complain(error.exit, error.message, error.hint)
    except TyperException as error:
        if not error.format_message():  # help was printed because no command was given
            return Exit.USAGE
        return complain(Exit.USAGE, _plainly(error.format_message()), _usage_hint(error))
    except (typer.Abort, KeyboardInterrupt):
        return complain(Exit.INTERRUPTED, "interrupted")
    except ModuleNotFoundError as error:
        module = (error.name or "").partition(".")[0]
        if module not in EXTRAS:
            raise
        package, extra = EXTRAS[module]
        missing = f"this needs {package}, which is not installed"
        return complain(Exit.USAGE, missing, f"pip install 'tetractl[{extra}]'")
    except BrokenPipeError:  # the reader of the output has ended, as in `tetractl stats | head`
        return Exit.DONE
    except SystemExit as end:
        if not isinstance(end.__context__, BrokenPipeError):
            raise
        return Exit.DONE  # typer also reports a closed pipe in this way
    except FileNotFoundError as error:
        return complain(Exit.USAGE, f"{error.filename}: no such file or folder")
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return complain(Exit.FAILED, f"{where}{error.strerror or error}")
    return code if isinstance(code, int) else Exit.DONE


def _plainly(message: str) -> str:
    """Return typer's message on a bad option, reworded like the errors of specs."""
    for theirs, ours in PLAIN:
        message = message.replace(theirs, ours)
    return re.sub(r"^'(--?[\w-]+)':", r"\1:", message)


def _usage_hint(error: TyperException) -> str | None:
    match error:
        case object(ctx=context) if context:  # typer's UsageError, which has no public name
            return f"try '{context.command_path} --help'"
    return None


def complain(code: Exit, message: str, hint: str | None = None) -> Exit:
    """Print `error: MESSAGE` to stderr, then `hint: HINT` if there is one; return `code`."""
    ui.tell(*f"error: {message}".split("\n"), *(f"hint: {hint}".split("\n") if hint else ()))
    return code
