"""The HTML that a notebook shows for results of tetractl: tables of statistics, and images.

`shown` has a function for each kind of result. The HTML contains no script and nothing from a
network, and every text is escaped.
"""

import io
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import replace
from functools import singledispatch
from html import escape

import numpy as np
from PIL import Image

from tetractl.core.errors import TetractlError, unit_of
from tetractl.core.setup import Setup
from tetractl.log.read.trial_log import ResultSummary, TrialLog
from tetractl.spec.loaded_spec import LoadedSpec
from tetractl.statistics.describe import (
    BatchComparison,
    BatchStatistics,
    Contrast,
    contrast,
    describe,
)
from tetractl.statistics.open_batch import Batch, Batches
from tetractl.statistics.tables import differences_table, summary, trials_listed
from tetractl.tools.table.table import Column, Table, create_decimal_format, create_length_format
from tetractl.tools.table.terminal_table import LISTED_MAX
from tetractl.tools.table.terminal_table import format_html as html_of_tables
from tetractl.verification.verify import Verification
from tetractl.view import style
from tetractl.view.figures.draw import draw
from tetractl.view.figures.trajectory import arena_picture

PICTURE_PX = 440
"""Width at which an image is shown [px]."""


def html(value: object) -> str:
    """Return the HTML that a notebook shows for a result.

    If it cannot be shown, return the reason.
    """
    try:
        return shown(value)
    except TetractlError as error:
        return _output([f"{type(value).__name__}: {error.message}"])


@singledispatch
def shown(value: object) -> str:
    """Return the HTML for a result, according to its type.

    NotImplementedError for an unknown type.
    """
    raise NotImplementedError(type(value))


@shown.register
def _(spec: LoadedSpec) -> str:
    experiment = spec.experiment
    setup = experiment.setup
    unit = unit_of(setup.unit)
    as_fastest = create_length_format(float(np.max(setup.speed)))
    robots = Table(
        "",
        (
            Column("robot", setup.names),
            Column("start", [_place(xy) for xy in setup.starts.xy], unit),
            Column("target", [_place(xy) for xy in setup.targets], unit),
            Column("a", setup.a, "rad/s", create_decimal_format(2)),
            Column("speed", setup.speed, f"{unit}/s", as_fastest),
        ),
    )
    trials = f"{experiment.trials.count} trials, seed {experiment.trials.seed}"
    lines = [f"{spec.name}: {experiment.name}, {trials}"]
    if experiment.description:
        lines.append(experiment.description)
    return _output(lines, [robots], _arena(setup))


@shown.register
def _(trial: TrialLog) -> str:
    start = trial.start
    setup = start.setup
    result = trial.result
    lines = [f"{setup.name}, trial {start.trial}: {trial.origin}"]
    tables: list[Table] = []
    if result is None:
        lines.append("the log ends before the end of the trial")
    else:
        unit = unit_of(setup.unit)
        show = create_length_format(result.total_error)
        error = f"total error {show(result.total_error)} {unit}"
        lines.append(f"{result.summary}, {result.duration_s:.1f} s: {error}")
        if result.entered_obstacle:
            lines.append("entered an obstacle")
        if result.left_arena:
            lines.append("left the arena")
        robots = Column("robot", setup.names)
        tables.append(Table("", (robots, Column("error", result.robot_errors, unit, show))))
    if trial.damage:
        lines += [f"damaged: {problem}" for problem in trial.damage.problems]
    return _output(lines, tables, _paths(trial))


@shown.register
def _(trial: ResultSummary) -> str:
    group = describe(Batch((trial,)))
    return _output([trial.log], [trials_listed(group)])


@shown.register
def _(batch: Batch) -> str:
    group = describe(batch)
    trials = trials_listed(group)
    more = len(trials) - LISTED_MAX
    if more > 0:
        first = [replace(column, values=column.listed[:LISTED_MAX]) for column in trials.columns]
        note = f"and {more} more: to_dataframe has all; {trials.note}"
        trials = Table(trials.title, tuple(first), note)
    return _output([], [*summary(contrast([group])), trials])


@shown.register
def _(batches: Batches) -> str:
    groups = tuple(describe(batch, name) for name, batch in batches.items())
    errors, *_ = summary(BatchComparison(groups))
    return _output([], [errors])


@shown.register
def _(group: BatchStatistics) -> str:
    return _output([], summary(contrast([group])))


@shown.register
def _(comparison: BatchComparison) -> str:
    return _output([], summary(comparison))


@shown.register
def _(pair: Contrast) -> str:
    return _output([], [differences_table([pair])])


@shown.register
def _(verification: Verification) -> str:
    return _output([*verification.lines])


def _output(lines: Sequence[str], tables: Sequence[Table] = (), png: bytes = b"") -> str:
    """Return HTML that consists of lines, an image and tables.

    With an image, there must be a line.
    """
    picture = ""
    if png:
        source = f"data:image/png;base64,{b64encode(png).decode()}"
        picture = f'<br><img alt="{escape(lines[0])}" width="{PICTURE_PX}" src="{source}">'
    words = "<br>".join(map(escape, lines))
    return f"<div>{words}{picture}{html_of_tables(tables)}</div>"


def _paths(trial: TrialLog) -> bytes:
    """Draw the robots' paths, and return the bytes of a PNG file. b"" for a log that has none."""
    try:
        figure = draw("trajectory", [trial])
    except TetractlError:
        return b""
    return style.picture(figure, "png", style.SCREEN_DPI)


def _place(xy: Sequence[float]) -> str:
    """Return a position as text with four digits, without a unit."""
    return ", ".join(f"{length:.4g}" for length in xy)


def _arena(setup: Setup) -> bytes:
    """Draw the arena with the robots at their starts, and return the bytes of a PNG file."""
    file = io.BytesIO()
    Image.fromarray(arena_picture(setup, setup.starts.xy[None])).save(file, "PNG")
    return file.getvalue()
