"""The commands of the command line, and the report of their errors.

Modules that are slow to import are imported inside the commands that need them, so that `--help`
answers at once.
"""

import re
import sys
from collections.abc import Callable
from inspect import cleandoc
from typing import Annotated, Any

import typer
import typer.main
from typer.core import TyperCommand, TyperGroup, TyperOption
from typer.exceptions import TyperException

from tetractl import __version__
from tetractl.cli import ui
from tetractl.core.errors import Exit, TetractlError, UsageError, describe_error
from tetractl.core.registries import COMMANDS, LAB_COMMANDS
from tetractl.core.registry import PluginError, Registry
from tetractl.spec.packages import explain_missing
from tetractl.tools.plugin_fault import UNIX_MODULES, PluginTrialError

EXTRAS = {
    "dask_jobqueue": ("dask-jobqueue", "dask"),
    "distributed": ("Dask's distributed", "dask"),
    "pandas": ("pandas", "dataframe"),
    "websockets": ("websockets", "serve"),
}
"""The package of each optional module, and the extra of tetractl that installs the package."""

PANELS = {
    "An experiment": ("init", "run", "replay", "stats", "verify", "plot"),
    "More trials": ("play", "validate", "rerun", "study", "analyze", "reproduce", "warm"),
    "Logs": ("report", "open", "export", "info", "recover"),
    "Robots and cells": ("identify", "track", "lab"),
    "This program": ("schema", "kinds"),
}
"""The groups of commands in the help, in order.

A command that is in no group belongs to another package.
"""
OTHER_PACKAGES_PANEL = "From other packages"
PANEL_BY_COMMAND = {name: panel for panel, names in PANELS.items() for name in names}

_LINE_BREAK = re.compile(r"(?<!\n)\n(?!\n|[a-z]+: )")
"""A break of a docstring inside a paragraph, and not before a line of a list."""


def _hide_switch_types(params: list[Any]) -> list[Any]:
    """Change a command's parameters so that the help shows no type next to a switch."""
    for param in params:
        if isinstance(param, TyperOption) and param.is_flag:
            param.metavar = ""
    return params


class _Command(TyperCommand):
    """A command of typer whose help shows no type next to a switch, an option without a value."""

    def get_params(self, ctx: Any) -> Any:
        return _hide_switch_types(super().get_params(ctx))


class _Group(TyperGroup):
    """The commands of `tetractl` or of `tetractl lab`. Each is imported when it is needed."""

    def __init__(self, **attrs: Any) -> None:
        super().__init__(**attrs)
        self.registry = LAB_COMMANDS if self.name == "lab" else COMMANDS
        registered = dict.fromkeys(self.registry.names())  # None until they are imported
        commands: dict[str, Any] = {**registered, **self.commands}
        names = [name for name in PANEL_BY_COMMAND if name in commands]
        self.commands = {name: commands[name] for name in (*names, *commands)}

    def get_params(self, ctx: Any) -> Any:
        return _hide_switch_types(super().get_params(ctx))

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return the command with the name `cmd_name`. None if there is none.

        Raises:
            UsageError: If its package is not installed.
        """
        if cmd_name not in self.commands:
            missing = explain_missing(self.registry.group, cmd_name)
            if missing:
                problem, hint = missing
                raise UsageError(f"'{ctx.command_path} {cmd_name}' {problem}", hint)
            return None
        if self.commands[cmd_name] is None:
            self.commands[cmd_name] = _load_command(self.registry, cmd_name)
        return self.commands[cmd_name]


def _load_command(registry: Registry, name: str) -> Any:
    """Load the command for a function in a registry.

    If the function of another package cannot be used, the returned command reports the reason.
    """
    panel = None if registry is LAB_COMMANDS else PANEL_BY_COMMAND.get(name, OTHER_PACKAGES_PANEL)
    try:
        function = registry.load(name)
        try:
            help_text = _LINE_BREAK.sub(" ", cleandoc(function.__doc__ or ""))
            return _create_typer_command(name, function, panel, help=help_text)
        except Exception as error:  # typer cannot make a command of it
            if name in registry.builtin:
                raise
            raise registry.create_unusable_error(
                name, f"{type(error).__name__}: {error}"
            ) from error
    except PluginError as error:
        plugin_error = error

    from rich.markup import escape

    def fail() -> None:
        raise plugin_error

    any_arguments = {"allow_extra_args": True, "ignore_unknown_options": True}
    help_text = f"Cannot be used: {escape(plugin_error.message)}"
    return _create_typer_command(
        name, fail, panel, help=help_text, context_settings=any_arguments, add_help_option=False
    )


def _create_typer_command(
    name: str, function: Callable[..., object], panel: str | None, **settings: Any
) -> Any:
    """Create typer's command for a function, listed in a panel of the help."""
    single_command_app = typer.Typer(add_completion=False)
    single_command_app.command(name, cls=_Command, rich_help_panel=panel, **settings)(function)
    return typer.main.get_command(single_command_app)


app = typer.Typer(
    name="tetractl",
    cls=_Group,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"tetractl {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    """Steer several robots at once with one control signal.

    Run an experiment from a YAML spec, show its trials, and compute their statistics.
    `tetractl init --example NAME` writes the files of the examples.
    """


lab_help = "Check, calibrate, survey, stop or emulate the lab of a spec."
lab = typer.Typer(name="lab", no_args_is_help=True, help=lab_help, cls=_Group)
app.add_typer(lab, rich_help_panel="Robots and cells")


def run_app() -> int:
    """Run the command that the program's arguments name, and return one of the codes of `Exit`.

    A command returns its code, or raises an error that `_report_error` can explain to the user.
    Other exceptions are defects of the program, and are not caught.
    """
    if "" in sys.argv[1:]:  # as a path, it would be the present folder
        return print_error(
            Exit.USAGE,
            "an argument of the command is empty",
            "does the command use a shell variable that is not set?",
        )
    try:
        code = app(standalone_mode=False)
        sys.stdout.flush()  # here, so that an error of stdout is handled below
    except (Exception, KeyboardInterrupt, SystemExit) as error:
        exit_code = _report_error(error)
        if exit_code is None:
            raise
        return exit_code
    return code if isinstance(code, int) else Exit.DONE


def _report_error(error: BaseException) -> Exit | None:
    """Print an error with a hint for the user, and return the exit code.

    The result is None for an error that no user can cause, and nothing is printed. The first case
    that fits is used: OSError comes after its subclasses.
    """
    match error:
        case PluginTrialError() if sys.flags.dev_mode:
            return None
        case TetractlError():
            return print_error(error.exit, error.message, error.hint)
        case TyperException():
            if not error.format_message():  # help was printed because no command was given
                return Exit.USAGE
            return print_error(Exit.USAGE, error.format_message(), _suggest_usage(error))
        case typer.Abort(__cause__=EOFError() as cause):  # typer takes any for Ctrl-D
            return print_error(Exit.FAILED, describe_error(cause))
        case typer.Abort() | KeyboardInterrupt():
            return print_error(Exit.INTERRUPTED, "interrupted")
        case ModuleNotFoundError():
            return _report_missing_module((error.name or "").partition(".")[0])
        case BrokenPipeError() | SystemExit(__context__=BrokenPipeError()):
            return Exit.DONE  # the reader of the output has ended, as in `tetractl stats | head`
        case FileNotFoundError():
            return print_error(Exit.USAGE, f"{error.filename}: there is no such file or folder")
        case OSError():
            file_prefix = f"{error.filename}: " if error.filename else ""
            return print_error(Exit.FAILED, f"{file_prefix}{error.strerror or error}")
    return None


def _report_missing_module(module: str) -> Exit | None:
    """Print how to install a missing module, and return the exit code.

    If the module is neither optional nor one that only Windows lacks, nothing is printed, and the
    result is None.
    """
    if module in UNIX_MODULES:
        problem = (
            f"this command does not run on Windows, because Python has no module '{module}' there"
        )
        return print_error(Exit.USAGE, problem, "simulations, tables and reports run on Windows")
    if module in EXTRAS:
        package, extra = EXTRAS[module]
        problem = f"this command needs {package}, which is not installed"
        return print_error(
            Exit.USAGE,
            problem,
            f"install it in your copy of the tetractl repository with: pip install '.[{extra}]'",
        )
    return None


def _suggest_usage(error: TyperException) -> str | None:
    """Suggest how to correct a wrong argument, or where to find the list of options."""
    context = getattr(error, "ctx", None)  # of typer's UsageError, which has no public name
    if context is None:
        return None
    return _suggest_equals_sign() or f"try '{context.command_path} --help'"


def _suggest_equals_sign() -> str | None:
    """Suggest the missing equals sign of `--set PATH VALUE`.

    None if every `--set` has an equals sign.
    """
    arguments = sys.argv[1:]
    for option, path, value in zip(arguments, arguments[1:], arguments[2:], strict=False):
        if option == "--set" and "=" not in path:
            return f"write --set {path}={value}"
    return None


def print_error(code: Exit, message: str, hint: str | None = None) -> Exit:
    """Print an error message and a hint to stderr, and return the exit code.

    The lines begin with `error: ` and `hint: `.

    Args:
        code: The exit code.
        message: The message.
        hint: The hint. None if there is none.
    """
    ui.print_messages(*f"error: {message}".split("\n"))
    if hint:
        ui.print_messages(*f"hint: {hint}".split("\n"))
    return code
