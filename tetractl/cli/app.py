"""The commands of the command line, and how their errors are reported.

Modules that are slow to import are imported inside the commands that need them, so that `--help`
answers at once.
"""

import re
import sys
from collections import UserDict
from collections.abc import Callable, Mapping
from inspect import cleandoc
from typing import Annotated, Any

import typer
import typer.main
from typer.core import TyperCommand, TyperGroup, TyperOption
from typer.exceptions import TyperException

from tetractl import __version__
from tetractl.cli import ui
from tetractl.core.errors import UNIX_MODULES, Exit, TetractlError, UsageError, text_of
from tetractl.core.plugin_fault import FaultyPluginError, plugins_blamed
from tetractl.core.registries import COMMANDS, LAB_COMMANDS
from tetractl.core.registry import PluginError, Registry
from tetractl.core.retired import INSTEAD, refuse_retired
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
    "dask_jobqueue": ("dask-jobqueue", "dask"),
    "distributed": ("Dask's distributed", "dask"),
    "pandas": ("pandas", "dataframe"),
    "websockets": ("websockets", "serve"),
}
"""For each optional module, the package's name and the extra of tetractl that installs it."""

_BREAK = re.compile(r"(?<!\n)\n(?!\n|[a-z]+: )")  # a break inside a paragraph, not in a list


class _Commands(UserDict[str, Any]):
    """Commands by name: those of a registry, each imported when it is needed, and `groups`."""

    def __init__(self, registry: Registry, groups: Mapping[str, Any]) -> None:
        super().__init__(dict.fromkeys(registry.names()), **groups)
        self.registry = registry

    def __getitem__(self, name: str) -> Any:
        if self.data[name] is None:
            self.data[name] = _command(self.registry, name)
        return self.data[name]


def _placeholders(params: list[Any]) -> list[Any]:
    """Let the help show no type next to a switch."""
    for one in params:
        if isinstance(one, TyperOption) and one.is_flag:
            one.metavar = ""
    return params


class _Command(TyperCommand):
    def get_params(self, ctx: Any) -> Any:
        return _placeholders(super().get_params(ctx))


class _Group(TyperGroup):
    """The group of the commands of a registry."""

    def __init__(self, **attrs: Any) -> None:
        super().__init__(**attrs)
        self.registry = LAB_COMMANDS if self.name == "lab" else COMMANDS
        self.commands = _Commands(self.registry, self.commands)

    def get_params(self, ctx: Any) -> Any:
        return _placeholders(super().get_params(ctx))

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return the command with this name; UsageError if its package is not installed, or if
        only earlier versions have it."""
        found = super().get_command(ctx, cmd_name)
        if found is None:
            refuse_retired(self.registry.group, cmd_name)
        if found is None and (missing := not_installed(self.registry.group, cmd_name)):
            raise UsageError(f"'{ctx.command_path} {cmd_name}' {missing[0]}", missing[1])
        return found


def _command(registry: Registry, name: str) -> Any:
    """Return the command of a registry's function, or, if the function of another package cannot
    be used, a command that says why."""
    try:
        function = registry.load(name)
        try:
            return _made(name, function, help=_BREAK.sub(" ", cleandoc(function.__doc__ or "")))
        except Exception as error:  # typer cannot make a command of it
            if name in registry.builtin:
                raise
            raise registry.unusable(name, f"{type(error).__name__}: {error}") from error
    except PluginError as error:
        broken = error

    from rich.markup import escape

    def fail() -> None:
        raise broken

    anything = {"allow_extra_args": True, "ignore_unknown_options": True}
    text = f"Cannot be used: {escape(broken.message)}"
    return _made(name, fail, help=text, context_settings=anything, add_help_option=False)


def _made(name: str, function: Callable[..., object], **settings: Any) -> Any:
    """Return typer's command of a function."""
    one = typer.Typer(add_completion=False)
    one.command(name, cls=_Command, **settings)(function)
    return typer.main.get_command(one)


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


lab_help = "Check, calibrate, survey, stop or emulate the lab of a spec."
app.add_typer(typer.Typer(name="lab", no_args_is_help=True, help=lab_help, cls=_Group))


def run_app() -> int:
    """Run the command that the arguments name; return one of the codes of `Exit`."""
    if "" in sys.argv[1:]:  # as a path, it would be the present folder
        return complain(Exit.USAGE, "an argument is empty", "is a variable of the shell not set?")
    try:
        with plugins_blamed(spared=(TyperException, typer.Abort)):
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
    except (typer.Abort, KeyboardInterrupt) as error:
        if isinstance(error.__cause__, EOFError):  # typer takes it for Ctrl-D, whatever it is of
            return complain(Exit.FAILED, text_of(error.__cause__))
        return complain(Exit.INTERRUPTED, "interrupted")
    except ModuleNotFoundError as error:
        module = (error.name or "").partition(".")[0]
        if module in UNIX_MODULES:
            hint = "simulations, tables and reports need none of it"
            return complain(
                Exit.USAGE, f"this does not run on Windows: Python has no '{module}' here", hint
            )
        if module not in EXTRAS:
            raise
        package, extra = EXTRAS[module]
        missing = f"this needs {package}, which is not installed"
        return complain(Exit.USAGE, missing, f"in the clone of tetractl: pip install '.[{extra}]'")
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
        case object(ctx=context, option_name=option) if context and (
            instead := INSTEAD.get((context.info_name, option))
        ):
            return instead
        case object(ctx=context) if context:  # typer's UsageError, which has no public name
            return f"try '{context.command_path} --help'"
    return None


def complain(code: Exit, message: str, hint: str | None = None) -> Exit:
    """Print `error: MESSAGE` to stderr, then `hint: HINT` if there is one; return `code`."""
    ui.tell(*f"error: {message}".split("\n"), *(f"hint: {hint}".split("\n") if hint else ()))
    return code
