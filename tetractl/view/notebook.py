"""The HTML that a notebook shows for results of tetractl: tables of statistics, and images.

`result_html` has one implementation for each kind of result. The HTML contains no script and
nothing from a network, and all text is escaped.
"""

import io
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import replace
from functools import singledispatch
from html import escape

import numpy as np
from PIL import Image

from tetractl.core.errors import TetractlError, format_unit
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
from tetractl.view.figures.trajectory import draw_arena_picture

PICTURE_PX = 440
"""Width at which an image is shown [px]."""


def html(value: object) -> str:
    """Create the HTML that a notebook shows for a result, or that says why it cannot be shown."""
    try:
        return result_html(value)
    except TetractlError as error:
        return _compose_html([f"{type(value).__name__}: {error.message}"])


@singledispatch
def result_html(value: object) -> str:
    """Create the HTML for a result, according to the result's type.

    Raises:
        NotImplementedError: If there is no implementation for the type.
    """
    raise NotImplementedError(type(value))


@result_html.register
def _(spec: LoadedSpec) -> str:
    experiment = spec.experiment
    setup = experiment.setup
    unit = format_unit(setup.unit)
    format_speed = create_length_format(float(np.max(setup.speed)))
    robots = Table(
        "",
        (
            Column("robot", setup.names),
            Column("start", [_format_position(xy) for xy in setup.starts.xy], unit),
            Column("target", [_format_position(xy) for xy in setup.targets], unit),
            Column("a", setup.a, "rad/s", create_decimal_format(2)),
            Column("speed", setup.speed, f"{unit}/s", format_speed),
        ),
    )
    trials = f"{experiment.trials.count} trials, seed {experiment.trials.seed}"
    lines = [f"{spec.name}: {experiment.name}, {trials}"]
    if experiment.description:
        lines.append(experiment.description)
    return _compose_html(lines, [robots], _draw_arena(setup))


@result_html.register
def _(trial: TrialLog) -> str:
    start = trial.start
    setup = start.setup
    result = trial.result
    lines = [f"{setup.name}, trial {start.trial}: {trial.origin}"]
    tables: list[Table] = []
    if result is None:
        lines.append("the log ends before the end of the trial")
    else:
        unit = format_unit(setup.unit)
        format_error = create_length_format(result.total_error)
        error = f"total error {format_error(result.total_error)} {unit}"
        lines.append(f"{result.summary}, {result.duration_s:.1f} s: {error}")
        if result.entered_obstacle:
            lines.append("entered an obstacle")
        if result.left_arena:
            lines.append("left the arena")
        robots = Column("robot", setup.names)
        tables.append(Table("", (robots, Column("error", result.robot_errors, unit, format_error))))
    if trial.damage:
        lines += [f"damaged: {problem}" for problem in trial.damage.problems]
    return _compose_html(lines, tables, _draw_paths(trial))


@result_html.register
def _(trial: ResultSummary) -> str:
    group = describe(Batch((trial,)))
    return _compose_html([trial.log], [trials_listed(group)])


@result_html.register
def _(batch: Batch) -> str:
    group = describe(batch)
    trials = trials_listed(group)
    unlisted = len(trials) - LISTED_MAX
    if unlisted > 0:
        first = [replace(column, values=column.listed[:LISTED_MAX]) for column in trials.columns]
        note = f"and {unlisted} more: to_dataframe has all; {trials.note}"
        trials = Table(trials.title, tuple(first), note)
    return _compose_html([], [*summary(contrast([group])), trials])


@result_html.register
def _(batches: Batches) -> str:
    groups = tuple(describe(batch, name) for name, batch in batches.items())
    errors, *_ = summary(BatchComparison(groups))
    return _compose_html([], [errors])


@result_html.register
def _(group: BatchStatistics) -> str:
    return _compose_html([], summary(contrast([group])))


@result_html.register
def _(comparison: BatchComparison) -> str:
    return _compose_html([], summary(comparison))


@result_html.register
def _(pair: Contrast) -> str:
    return _compose_html([], [differences_table([pair])])


@result_html.register
def _(verification: Verification) -> str:
    return _compose_html([*verification.lines])


def _compose_html(lines: Sequence[str], tables: Sequence[Table] = (), png: bytes = b"") -> str:
    """Compose HTML from lines of text, an image and tables.

    Args:
        lines: The lines. At least one is needed with an image, which it describes.
        tables: The tables.
        png: The image, as the bytes of a PNG file. Empty for no image.
    """
    image_html = ""
    if png:
        source = f"data:image/png;base64,{b64encode(png).decode()}"
        image_html = f'<br><img alt="{escape(lines[0])}" width="{PICTURE_PX}" src="{source}">'
    lines_html = "<br>".join(map(escape, lines))
    return f"<div>{lines_html}{image_html}{html_of_tables(tables)}</div>"


def _draw_paths(trial: TrialLog) -> bytes:
    """Draw the robots' paths, and return the bytes of a PNG file.

    The result is empty if the log contains no paths.
    """
    try:
        figure = draw("trajectory", [trial])
    except TetractlError:
        return b""
    return style.picture(figure, "png", style.SCREEN_DPI)


def _format_position(xy: Sequence[float]) -> str:
    """Format a position with four digits and without a unit, for example "12.5, 300"."""
    return ", ".join(f"{length:.4g}" for length in xy)


def _draw_arena(setup: Setup) -> bytes:
    """Draw the arena with the robots at their starts, and return the bytes of a PNG file."""
    file = io.BytesIO()
    Image.fromarray(draw_arena_picture(setup, setup.starts.xy[None])).save(file, "PNG")
    return file.getvalue()
