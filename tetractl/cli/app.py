"""The commands of the command line, and how their errors are reported.

Modules that are slow to import are imported inside the commands that need them, so that `--help`
answers at once.
"""

import inspect
import re
import sys
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.exceptions import TyperException

from tetractl import __version__
from tetractl.cli import (
    analyze,
    design,
    export,
    identify,
    info,
    init,
    kinds,
    lab,
    plot,
    recover,
    redrive,
    replay,
    report,
    rerun,
    run,
    schema,
    serve,
    stats,
    study,
    track,
    validate,
    verify,
    warm,
    what_if,
)
from tetractl.core.errors import Exit, TetractlError, printable
from tetractl.core.plugin_fault import FaultyPluginError, plugins_blamed

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
    "pandas": ("pandas", "dataframe"),
    "pyarrow": ("pyarrow", "parquet"),
    "pymmcore": ("pymmcore", "microscope"),
    "websockets": ("websockets", "serve"),
}
"""For each optional module, the package's name and the extra of tetractl that installs it."""

_BREAK = re.compile(r"(?<!\n)\n(?!\n|[a-z]+: )")  # a break inside a paragraph, not in a list


class _Plain:
    """A command whose help joins the lines of each paragraph, and shows choices or placeholders in
    place of Python types.
    """

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.help = _BREAK.sub(" ", inspect.cleandoc(self.help or ""))

    def get_params(self, ctx: Any) -> Any:
        found = super().get_params(ctx)  # type: ignore[misc]
        for one in found:
            choices = getattr(one.type_descriptor, "choices", None)
            shown = one.metavar if one.param_type_name == "option" else ""
            text = shown or ("|".join(map(str, choices)) if choices else "")
            one.display_type_rich = lambda ctx, text=text: text
        return found


class _Command(_Plain, TyperCommand):
    pass


class _Group(_Plain, TyperGroup):
    pass


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


COMMANDS = {
    "init": init.init,
    "run": run.run,
    "rerun": rerun.rerun,
    "validate": validate.validate,
    "warm": warm.warm,
    "schema": schema.schema,
    "kinds": kinds.kinds,
    "info": info.info,
    "recover": recover.recover,
    "replay": replay.replay,
    "plot": plot.plot,
    "report": report.report,
    "export": export.export,
    "open": serve.open_logs,
    "serve": serve.serve,
    "verify": verify.verify,
    "what-if": what_if.what_if,
    "redrive": redrive.redrive,
    "stats": stats.stats,
    "analyze": analyze.analyze,
    "study": study.study,
    "design": design.design,
    "identify": identify.identify,
    "track": track.track,
}
for name, function in COMMANDS.items():
    app.command(name, cls=_Command)(function)
lab_app = typer.Typer(name="lab", no_args_is_help=True, help=lab.HELP, cls=_Group)
for name, function in lab.COMMANDS.items():
    lab_app.command(name, cls=_Command)(function)
app.add_typer(lab_app)


def run_app() -> int:
    """Run the command that the arguments name; return one of the codes of `Exit`."""
    try:
        with plugins_blamed():
            code = app(standalone_mode=False)
        sys.stdout.flush()  # here, so that an error of stdout is handled below
    except TetractlError as error:
        if isinstance(error, FaultyPluginError) and sys.flags.dev_mode:
            raise
        complain(str(error), error.hint)
        return error.exit
    except TyperException as error:
        if error.format_message():  # empty if help was printed because no command was given
            complain(_plainly(error.format_message()), _usage_hint(error))
        return Exit.USAGE
    except (typer.Abort, KeyboardInterrupt):
        complain("interrupted")
        return Exit.INTERRUPTED
    except ModuleNotFoundError as error:
        module = (error.name or "").partition(".")[0]
        if module not in EXTRAS:
            raise
        package, extra = EXTRAS[module]
        complain(
            f"this needs {package}, which is not installed", f"pip install 'tetractl[{extra}]'"
        )
        return Exit.USAGE
    except BrokenPipeError:  # the reader of the output has ended, as in `tetractl stats | head`
        return Exit.DONE
    except SystemExit as end:
        if not isinstance(end.__context__, BrokenPipeError):
            raise
        return Exit.DONE  # typer also reports a closed pipe in this way
    except FileNotFoundError as error:
        complain(f"{error.filename}: no such file or folder")
        return Exit.USAGE
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        complain(f"{where}{error.strerror or error}")
        return Exit.FAILED
    return code if isinstance(code, int) else Exit.DONE


def _plainly(message: str) -> str:
    """Return typer's message on a bad option, reworded like the errors of specs."""
    for theirs, ours in PLAIN:
        message = message.replace(theirs, ours)
    return re.sub(r"^'(--?[\w-]+)':", r"\1:", message)


def _usage_hint(error: TyperException) -> str | None:
    context = getattr(error, "ctx", None)
    return f"try '{context.command_path} --help'" if context else None


def complain(message: str, hint: str | None = None) -> None:
    """Print `error: MESSAGE` to stderr, then `hint: HINT` if there is one."""
    lines = [f"error: {message}", *([f"hint: {hint}"] if hint else [])]
    for line in "\n".join(lines).split("\n"):
        print(printable(line), file=sys.stderr)
