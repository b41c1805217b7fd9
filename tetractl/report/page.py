"""Creates the report of recorded trials: one HTML file that needs no network and no other file.

`report` reads the logs, and puts the parts of the page together in their order: header, player of
the trials, errors over time, statistics, figures of the first trial, its provenance.
"""

import json
import math
import re
from base64 import b64encode
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from typing import Any

from tetractl.core.errors import LogError, format_unit
from tetractl.log.read.find import without_other_files
from tetractl.log.read.reader import read_trial
from tetractl.log.read.trial_log import TrialLog
from tetractl.report.html_page import THEME, FramedPage, asset, html_page, script_json
from tetractl.report.trial_data import pack_trial, trial_data
from tetractl.statistics.as_json import comparison_items
from tetractl.statistics.describe import BatchComparison, BatchStatistics, contrast, describe
from tetractl.statistics.flagged import SAFETY
from tetractl.statistics.open_batch import Source, find_sources, is_counted
from tetractl.statistics.tables import (
    decimals_shown,
    differences_table,
    error_format,
    tables,
    texts_by_label,
    trials_listed,
)
from tetractl.tools.table.table import UNKNOWN_TEXT, Column, Table
from tetractl.tools.table.table_files import convert_to_plain
from tetractl.tools.table.terminal_table import format_html

COMPLETE_TRIALS_MAX = 100
"""Maximum number of trials for a page that contains all trials with their plans and searches."""
CARRIED_TRIALS_MAX = 61
"""Approximate number of trials on a page that cannot contain all trials.

They are shown without plans and searches, so that the page stays below 5 MB. The tables on the page
have all trials.
"""
CARRIED_PER_BATCH_MIN = 3
"""Minimum number of trials of a batch that the page contains."""
SELECTION_NOTE = (
    "<p>This page contains {} of {} trials, without their plans and searches. From "
    "each batch, it has trials at evenly spaced ranks of the total error, from the "
    "best to the worst, and some trials that do not count in the means. The tables "
    "contain all trials.</p>"
)
EXCLUDED_RATIO = 3
"""At most one of this many trials on a page is a trial that the means exclude."""
CONTRASTS_MAX = 10
"""Maximum number of comparisons that are shown at the top of the page."""
TRIAL_FIGURES = ("trajectory", "convergence", "errors", "over-time")
"""The figures of the first trial, in their order."""
PLAYER_PX = 740
"""Height of the player in a notebook.

The style `framed` fits the arena and its controls into it at any width, and lets the numbers next
to them scroll.
"""
SCRIPTS = ("data.js", "clock.js", "legend.js", "scene.js", "chart.js", "player.js")
"""The scripts of a page with a player, in the order in which they need each other."""


@dataclass(frozen=True, slots=True)
class _CarriedTrial:
    """A trial that the page contains: the path of its log, its name in the player, and its data."""

    path: str
    name: str
    data: dict[str, Any]


def report(
    paths: Sequence[Path], title: str | None, progress: Callable[[int, int], None]
) -> tuple[str, list[str]]:
    """Create the report of trials, an HTML page, and list the faults found in their logs.

    Each folder and each arm of a study (one combination of its settings) is a batch. Logs that are
    given one by one form one batch together. Trials of a study without a log are only in the
    tables.

    Args:
        paths: Logs, folders or patterns.
        title: Title of the page. None for the experiment's name.
        progress: Called with the number of results read and the number of all logs.

    Raises:
        UsageError: If there is no log, or if the trials of a batch belong to several experiments.
        LogError: If no log can be read.
    """
    groups, unread = _read_batches(paths, progress)
    log_count = sum(len(group.batch.logs) for group in groups)
    contains_all = log_count <= COMPLETE_TRIALS_MAX
    carried = _CarriedLogs(contains_all)
    for group in groups:
        carried.add(group, len(groups))
    trials = carried.trials
    first_log = carried.first
    number_by_log = {trial.path: number for number, trial in enumerate(trials, 1)}
    experiments = dict.fromkeys(group.experiment.name for group in groups)
    is_study = len(paths) == 1 and len(groups) > 1
    name = title or (paths[0].resolve().name if is_study else ", ".join(experiments))
    comparison = contrast(groups)
    sections = [_header_html(name, comparison, number_by_log)]
    if first_log is not None:
        note = "" if contains_all else SELECTION_NOTE.format(len(trials), log_count)
        sections.append(_player_html(trials, groups[0].unit, note))
    if carried.errors:
        sections.append(f"<section><h2>Errors</h2>{carried.errors}</section>")
    sections.append(_statistics_html(comparison, number_by_log))
    if first_log is not None:
        figures = figures_of_trial(first_log)
        sections.append(f"<section><h2>Figures of the first trial</h2>{figures}</section>")
        sections.append(_provenance_html(first_log))
    page = html_page(name, "".join(sections), SCRIPTS if trials else ())
    return page, [*unread, *carried.unread]


def player(logs: Sequence[TrialLog]) -> FramedPage:
    """Create a page that plays recorded trials, in their order.

    More than COMPLETE_TRIALS_MAX trials are shown without plans and searches. The title names the
    experiment and the origin of the first trial.
    """
    title = f"{logs[0].experiment.name}: {logs[0].origin}"
    header = f"<header><h1>{escape(title)}</h1>{THEME}</header>"
    trials: list[_CarriedTrial] = []
    for log in logs:
        name = Path(log.log).name
        data = trial_data(log, name, len(logs) <= COMPLETE_TRIALS_MAX)
        trials.append(_CarriedTrial(log.log, name, data))
    contents = header + _player_html(trials, logs[0].experiment.units.length)
    body = f'<div class="framed">{contents}</div>'
    return FramedPage(html_page(title, body, SCRIPTS), PLAYER_PX)


# ---- Reading ----


class _CarriedLogs:
    """The logs whose data the page contains.

    Args:
        complete: Whether the page contains all logs of its batches.

    Attributes:
        trials: The trials to play.
        errors: HTML of the figures of errors over time.
        first: The first trial. None if no log could be read.
        unread: The faults found in logs.
    """

    def __init__(self, complete: bool) -> None:
        self._complete = complete
        self.trials: list[_CarriedTrial] = []
        self.errors = ""
        self.first: TrialLog | None = None
        self.unread: list[str] = []

    def add(self, group: BatchStatistics, group_count: int) -> None:
        """Read the logs of one batch, and add their data.

        A log that cannot be read is left out, and its error is added to `unread`.

        Args:
            group: The batch.
            group_count: Number of batches on the page.
        """
        logs: list[TrialLog] = []
        for path in group.batch.logs if self._complete else logs_to_carry(group, group_count):
            try:
                log = read_trial(path)
            except LogError as error:
                self.unread.append(error.message)
                continue
            self.first = self.first or log
            logs.append(without_details(log))
            name = f"{group.name}, {path.name}" if group_count > 1 else path.name
            data = trial_data(log, path.name, self._complete)
            self.trials.append(_CarriedTrial(str(path), name, data))
        descriptions = [group.name] if group_count > 1 else []
        if not self._complete:
            descriptions.append(f"the {len(logs)} trials on this page")
        self.errors += errors_over_time(", ".join(descriptions), logs)


def logs_to_carry(group: BatchStatistics, group_count: int) -> list[Path]:
    """Select which logs of a batch go into a page that cannot contain all of them.

    These are trials at evenly spaced ranks of the total error, from the best to the worst, and some
    trials that do not count.

    Args:
        group: The batch.
        group_count: Number of batches on the page.

    Returns:
        The logs, in the order of the trials.
    """
    logs = set(group.batch.logs)
    logged = [trial for trial in group.batch.trials if Path(trial.log) in logs]
    trials_max = max(CARRIED_PER_BATCH_MIN, CARRIED_TRIALS_MAX // group_count)
    not_counted = [trial for trial in logged if not is_counted(trial)][
        : trials_max // EXCLUDED_RATIO
    ]
    counted = [trial for trial in logged if is_counted(trial)]
    counted.sort(key=lambda trial: trial.result.total_error)
    counted_max = trials_max - len(not_counted)
    if len(counted) > counted_max:
        step = (len(counted) - 1) / max(1, counted_max - 1)
        ranks = [round(rank * step) for rank in range(counted_max)]
        counted = [counted[rank] for rank in ranks]
    chosen = {trial.log for trial in (*not_counted, *counted)}
    return [Path(trial.log) for trial in logged if trial.log in chosen]


def _read_batches(
    paths: Sequence[Path], progress: Callable[[int, int], None]
) -> tuple[list[BatchStatistics], list[str]]:
    """Read the logs: those of each folder as a batch, and all single logs as one more batch.

    Returns:
        The statistics of the batches, and the faults found in logs.

    Raises:
        LogError: If no log can be read.
    """
    paths = without_other_files(paths)
    folders = [str(path) for path in paths if path.is_dir()]
    single_logs = [str(path) for path in paths if not path.is_dir()]
    listed: list[Source] = []
    if single_logs:
        listed += find_sources(single_logs)
    if folders:
        listed += find_sources(folders)
    batches = [source.read(progress) for source in listed]
    unread = [f"{log.log}: {log.problem}" for batch in batches for log in batch.lost]
    if not any(batch.trials for batch in batches):
        raise LogError(f"none of the logs can be read: {', '.join(unread[:1])}")
    groups: list[BatchStatistics] = []
    for source, batch in zip(listed, batches, strict=True):
        damaged = [trial.log for trial in batch.trials if trial.recovered]
        unread += [f"{log}: damaged, read as far as possible" for log in damaged]
        if batch.trials or batch.attempts:
            groups.append(describe(batch, source.name))
    return groups, unread


# ---- Parts of the page ----


def _header_html(title: str, comparison: BatchComparison, number_by_log: Mapping[str, int]) -> str:
    """Compose the page's head: title, results, verdicts, and a figure of all errors.

    Verdicts are left out if there are more than CONTRASTS_MAX comparisons.
    """
    groups = comparison.groups
    description = escape(groups[0].experiment.description)
    tables_at_top = [_overview_table(groups)]
    if 0 < len(comparison.contrasts) <= CONTRASTS_MAX:
        tables_at_top.append(differences_table(comparison.contrasts))
    return (
        f"<header><div><h1>{escape(title)}</h1><p>{description}</p></div>"
        f"{THEME}</header>"
        f'<div class="top">{_tables_html(tables_at_top)}{total_errors(groups, number_by_log)}</div>'
    )


def _overview_table(groups: Sequence[BatchStatistics]) -> Table:
    """Create a table with one row per batch: mean total error, and the numbers of unsafe trials.

    An unknown interval is shown as "-".
    """
    totals = [group.total for group in groups]
    means = [total.mean for total in totals]
    smallest_mean = min((total.mean for total in totals if total.n), default=math.nan)
    format_error = error_format(smallest_mean, decimals_shown(groups[0].experiment))
    intervals = [
        total.ci95.text(format_error) if total.ci95.known else UNKNOWN_TEXT for total in totals
    ]
    columns = [
        Column("batch", [group.name for group in groups]),
        Column("n", [total.n for total in totals]),
        Column("mean total error", means, format_unit(groups[0].unit), format_error),
        Column("95 % interval", intervals),
    ]
    texts_of_batches = [texts_by_label(group) for group in groups]
    for label in SAFETY:
        numbers_of_unsafe = [
            text_by_label[label].partition(" (")[0] for text_by_label in texts_of_batches
        ]
        columns.append(Column(label, numbers_of_unsafe))
    plants: list[str] = []
    for group in groups:
        radius = group.experiment.controller.body_radius
        checked = f"bodies of radius {radius:g} {group.unit}" if radius else "centres"
        plants.append(f"{group.name}: {group.origin}, {checked}")
    return Table(
        "",
        tuple(columns),
        "Mean total error: the sum over the robots of the distance to the target. Plants, and"
        f" what was checked: {'; '.join(plants)}.",
    )


def _player_html(trials: Sequence[_CarriedTrial], unit: str, note: str = "") -> str:
    """Compose the HTML of the player, with the compressed data of the trials.

    Args:
        trials: The trials.
        unit: The length unit.
        note: HTML that is shown in the player.
    """
    options: list[str] = []
    data_scripts: list[str] = []
    for index, trial in enumerate(trials):
        name = escape(trial.name)
        options.append(f'<option value="{index}">{index + 1}: {name}</option>')
        packed_trial = pack_trial(trial.data)
        data_scripts.append(
            f'<script type="text/plain" id="trial-data-{index}">{packed_trial}</script>\n'
        )
    # the names are filled in last, because a name may contain the text of a placeholder
    player_html = asset("player.html").replace("@UNIT@", format_unit(unit))
    player_html = player_html.replace("@NOTE@", note).replace("@OPTIONS@", "".join(options))
    return player_html + "".join(data_scripts)


def _statistics_html(comparison: BatchComparison, number_by_log: Mapping[str, int]) -> str:
    """Compose the HTML of the tables of statistics, and the same data as JSON.

    Args:
        comparison: The batches.
        number_by_log: The number of each trial in the player, by the path of its log. The trial's
            row in the table links to the player.
    """
    links = {str(number): f"#trial-{number}" for number in number_by_log.values()}
    sections: list[str] = []
    for group in comparison.groups:
        name = f": {escape(group.name)}" if len(comparison.groups) > 1 else ""
        tables_of_group = tables(BatchComparison((group,)))
        trials_table = trials_listed(group)
        number = Column("trial", [number_by_log.get(trial.log) for trial in group.batch.trials])
        trials = format_html(
            [replace(trials_table, columns=(number, *trials_table.columns))], links
        )
        sections.append(
            f"<section><h2>Statistics{name}</h2>{_tables_html(tables_of_group)}"
            f"<details open><summary>All trials</summary>{trials}</details></section>"
        )
    if comparison.contrasts:
        sections.append(f"<section><h2>Comparison</h2>{_tables_html(tables(comparison))}</section>")
    items = convert_to_plain(comparison_items(comparison))
    json_text = json.dumps(items, ensure_ascii=False, separators=(",", ":"))
    sections.append(
        f'<script type="application/json" class="statistics">{script_json(json_text)}</script>\n'
    )
    return "".join(sections)


def _tables_html(listed: Sequence[Table]) -> str:
    """Compose the HTML of tables, which are side by side if the page is wide enough."""
    cells = [f"<div>{format_html([table])}</div>" for table in listed]
    return f'<div class="tables">{"".join(cells)}</div>'


def _provenance_html(log: TrialLog) -> str:
    """Compose the HTML that shows how a trial was made: seed, spec, host and versions."""
    start = log.start
    facts = [f"<dt>{escape(key)}</dt><dd>{escape(fact)}</dd>" for key, fact in log.facts.items()]
    spec_name = escape(start.spec_name)
    spec_hash = escape(start.spec_hash[:16])
    return (
        f"<section><h2>Provenance</h2><p>The first trial used the seed {start.seed} and the spec"
        f" {spec_name} with the hash {spec_hash}.</p>"
        f"<details><summary>Host and versions</summary><dl>{''.join(facts)}</dl></details>"
        "<details><summary>Spec with every default</summary>"
        f"<pre>{escape(start.resolved)}</pre></details></section>"
    )


# ---- Figures ----


def without_details(log: TrialLog) -> TrialLog:
    """Return a copy of a trial with only the data that `errors_over_time` draws, to save memory.

    The copy has the first control step, and neither true poses nor notes.
    """
    return replace(log, steps=log.steps[:1], truth=None, notes=())


def figures_of_trial(log: TrialLog) -> str:
    """Return the HTML of a trial's figures.

    The result is empty if the log has no control step or no frame.
    """
    if not (log.steps and len(log.mocap_ns)):
        return ""
    name = Path(log.log).name
    figures = [
        _figure_html(figure_name, [log], f"{figure_name}, {name}") for figure_name in TRIAL_FIGURES
    ]
    return _side_by_side(figures)


def errors_over_time(name: str, logs: Sequence[TrialLog]) -> str:
    """Return the HTML of a figure of a batch's errors over time.

    Trials without a frame are left out. The result is empty if fewer than two trials remain.
    """
    with_frames = [log for log in logs if len(log.mocap_ns)]
    if len(with_frames) < 2:
        return ""
    batch_text = f": {name}" if name else ""
    caption = "The error of each trial over time, the median, and the middle half of the trials"
    return _side_by_side([_figure_html("errors", with_frames, caption + batch_text)])


def total_errors(groups: Sequence[BatchStatistics], number_by_log: Mapping[str, int]) -> str:
    """Draw all total errors as inline SVG, in which each dot links to its trial.

    Args:
        groups: The batches.
        number_by_log: The number of each trial on the page, by the path of its log.

    Returns:
        The HTML. Empty if there are no errors.
    """
    from tetractl.view.figures.batch import batch_figure
    from tetractl.view.style import svg

    if not any(group.counted for group in groups):
        return ""
    links = {path: f"#trial-{number}" for path, number in number_by_log.items()}
    drawing = svg(batch_figure(groups, links, narrow=True)).decode()
    drawing = re.sub(r"<metadata>.*?</metadata>", "", drawing, flags=re.DOTALL)
    drawing = re.sub(r'(<a xlink:href="#trial-(\d+)")>', r"\1><title>trial \2</title>", drawing)
    drawing = drawing[drawing.index("<svg") :].replace("<svg", '<svg class="errors"', 1)
    caption = "Every total error, a dot per trial, and how the errors are distributed"
    return _side_by_side([_with_caption(drawing, caption)])


def _figure_html(figure_name: str, logs: Sequence[TrialLog], caption: str) -> str:
    """Draw a figure, given by its name such as `errors`, and return its HTML with a caption."""
    from tetractl.view.figures.draw import draw
    from tetractl.view.style import svg

    drawing = draw(figure_name, logs)
    picture = b64encode(svg(drawing)).decode()
    image = f'<img alt="{escape(caption)}" src="data:image/svg+xml;base64,{picture}">'
    return _with_caption(image, caption)


def _with_caption(image: str, caption: str) -> str:
    """Return the HTML of an image with its caption."""
    return f"<figure>{image}<figcaption>{escape(caption)}</figcaption></figure>"


def _side_by_side(figures: Sequence[str]) -> str:
    """Return the HTML of figures next to each other, on a white background also in a dark page."""
    return f'<div class="paper">{"".join(figures)}</div>'
