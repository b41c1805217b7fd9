"""The commands of the command line, and what becomes of their errors.

Heavy modules are imported inside the command that needs them, so that `--help` answers at once.
"""

import sys
from typing import Annotated

import typer
from typer.exceptions import TyperException

from tetractl import __version__
from tetractl.cli import (
    analyze,
    export,
    identify,
    info,
    init,
    kinds,
    lab,
    open_log,
    plot,
    recover,
    redrive,
    replay,
    report,
    rerun,
    run,
    schema,
    stats,
    study,
    track,
    validate,
    verify,
    what_if,
)
from tetractl.core.errors import Exit, TetractlError
from tetractl.core.text import printable

app = typer.Typer(
    name="tetractl",
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
    """


app.command("init")(init.init)
app.command("run")(run.run)
app.command("rerun")(rerun.rerun)
app.command("validate")(validate.validate)
app.command("schema")(schema.schema)
app.command("kinds")(kinds.kinds)
app.command("info")(info.info)
app.command("recover")(recover.recover)
app.command("replay")(replay.replay)
app.command("plot")(plot.plot)
app.command("report")(report.report)
app.command("export")(export.export)
app.command("open")(open_log.open_logs)
app.command("verify")(verify.verify)
app.command("what-if")(what_if.what_if)
app.command("redrive")(redrive.redrive)
app.command("stats")(stats.stats)
app.command("analyze")(analyze.analyze)
app.command("study")(study.study)
app.command("identify")(identify.identify)
app.command("track")(track.track)
app.add_typer(lab.app, name="lab")


def run_app() -> int:
    """Run the command that the arguments name; return one of the codes of `Exit`."""
    try:
        code = app(standalone_mode=False)
        sys.stdout.flush()  # here, so that what fails is handled below
    except TetractlError as error:
        complain(str(error), error.hint)
        return error.exit
    except TyperException as error:
        if error.format_message():  # else help was printed, for want of a command
            complain(error.format_message(), _usage_hint(error))
        return Exit.USAGE
    except (typer.Abort, KeyboardInterrupt):
        complain("interrupted")
        return Exit.INTERRUPTED
    except BrokenPipeError:  # the reader of the output has ended, as in `tetractl stats | head`
        return Exit.DONE
    except SystemExit as end:
        if not isinstance(end.__context__, BrokenPipeError):
            raise
        return Exit.DONE  # the same; typer makes it another exception
    except FileNotFoundError as error:
        complain(f"{error.filename}: no such file or folder")
        return Exit.USAGE
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        complain(f"{where}{error.strerror or error}")
        return Exit.FAILED
    return code if isinstance(code, int) else Exit.DONE


def _usage_hint(error: TyperException) -> str | None:
    context = getattr(error, "ctx", None)
    return f"try '{context.command_path} --help'" if context else None


def complain(message: str, hint: str | None = None) -> None:
    """Print an error to stderr: `error:` and its line or lines, then the hint."""
    lines = [f"error: {message}", *([f"hint: {hint}"] if hint else [])]
    for line in "\n".join(lines).split("\n"):
        print(printable(line), file=sys.stderr)
