"""Makes the report of logs: one HTML file that needs no network and no other file."""

import hashlib
import json
import math
import re
from base64 import b64encode
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tetractl.core.errors import LogError, unit_of
from tetractl.core.table.table import NONE, Column, Table
from tetractl.core.table.table_files import plain
from tetractl.core.table.terminal_table import html
from tetractl.log.read.find import without_others
from tetractl.log.read.reader import read_trial
from tetractl.log.read.trial_log import TrialLog
from tetractl.report.trial_data import packed, trial_data
from tetractl.results.as_json import comparison_items
from tetractl.results.batch_rows import texts_by_label
from tetractl.results.contrast import BatchComparison, contrast
from tetractl.results.describe import BatchStatistics, describe
from tetractl.results.open_batch import counts, sources
from tetractl.results.outcomes import SAFETY, counted_by
from tetractl.results.tables import error_format, finest, page_trials, tables

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ASSETS = files("tetractl.report") / "assets"
MANY, CARRIED = 100, 61
"""With more than MANY trials, the page carries about CARRIED of them, without plans and searches,
to stay below 5 MB; its tables have all."""
SCRIPTS = ("data.js", "scene.js", "chart.js", "player.js")


def report(
    paths: Sequence[Path], title: str | None, progress: Callable[[int, int], None]
) -> tuple[str, list[str]]:
    """Return the HTML page of logs, folders or patterns, and what is wrong with logs.

    Each folder and each arm of a study is a batch; logs given one by one are one batch together.
    Trials of a study without a log are only in the tables. `progress` is called with the number of
    results read and the number of all logs. Raises UsageError if there is no log, or if the trials
    of a batch belong to several experiments.
    """
    groups, unread = _groups(paths, progress)
    count = sum(len(group.batch.logs) for group in groups)
    shown = list[tuple[str, str, dict[str, Any]]]()
    first: TrialLog | None = None
    drawn: list[str] = []
    for group in groups:
        logs = []
        for path in group.batch.logs if count <= MANY else carried(group, len(groups)):
            try:
                log = read_trial(path)
            except LogError as error:
                unread.append(error.message)
                continue
            first = first or log
            logs.append(lean(log))
            name = f"{group.name}, {path.name}" if len(groups) > 1 else path.name
            shown.append((str(path), name, trial_data(log, path.name, count <= MANY)))
        which = [group.name] if len(groups) > 1 else []
        which += [f"the {len(logs)} trials on this page"] if count > MANY else []
        drawn.append(of_batch(", ".join(which), logs))
    numbers = {path: number for number, (path, _, _) in enumerate(shown, 1)}
    name = title or _title(paths, groups)
    compared = contrast(groups)
    body = [_header(name, compared, numbers), _statistics(compared, numbers)]
    if any(drawn):
        body.insert(1, f"<section><h2>Errors</h2>{''.join(drawn)}</section>")
    if first is not None:
        body.insert(1, _player([trial for _, *trial in shown], groups[0].unit, count))
        body.append(f"<section><h2>Figures of the first trial</h2>{of_trial(first)}</section>")
        body.append(_provenance(first))
    scripts = "".join((ASSETS / script).read_text() for script in SCRIPTS) if shown else ""
    return _page(name, "".join(body), scripts), unread


def carried(group: BatchStatistics, groups: int) -> list[Path]:
    """Return the logs of a batch, one of `groups`, that a page carries which cannot carry all:
    trials at evenly spaced ranks of the total error, from the best to the worst, and some that do
    not count, in the order of the trials.
    """
    logs = set(group.batch.logs)
    logged = [trial for trial in group.batch.trials if Path(trial.log) in logs]
    most = max(3, CARRIED // groups)
    apart = [trial for trial in logged if not counts(trial)][: most // 3]
    ranked = sorted(filter(counts, logged), key=lambda trial: trial.result.total_error)
    places = range(most - len(apart)) if len(ranked) > most - len(apart) else ()
    step = (len(ranked) - 1) / max(1, len(places) - 1)
    kept = [ranked[round(place * step)] for place in places] or ranked
    paths = {trial.log for trial in (*apart, *kept)}
    return [Path(trial.log) for trial in logged if trial.log in paths]


def _groups(
    paths: Sequence[Path], progress: Callable[[int, int], None]
) -> tuple[list[BatchStatistics], list[str]]:
    """Return a batch per folder and one for all single logs, and what is wrong with logs."""
    paths = without_others(paths)
    folders = [str(path) for path in paths if path.is_dir()]
    single = [str(path) for path in paths if not path.is_dir()]
    listed = [*(sources(single) if single else []), *(sources(folders) if folders else [])]
    batches = [(source.name, source.read(progress)) for source in listed]
    unread = [f"{log.log}: {log.problem}" for _, batch in batches for log in batch.lost]
    if not any(batch.trials for _, batch in batches):
        raise LogError(f"none of the logs can be read: {', '.join(unread[:1])}")
    unread += [
        f"{trial.log}: damaged, read as far as possible"
        for _, batch in batches
        for trial in batch.trials
        if trial.recovered
    ]
    known = [(name, batch) for name, batch in batches if batch.trials or batch.attempts]
    return [describe(batch, name) for name, batch in known], unread


def _title(paths: Sequence[Path], groups: Sequence[BatchStatistics]) -> str:
    """Return the name of a study from its folder, or the names of the experiments."""
    if len(paths) == 1 and len(groups) > 1:
        return paths[0].resolve().name
    return ", ".join(dict.fromkeys(group.experiment.name for group in groups))


def _page(title: str, body: str, scripts: str) -> str:
    """Return the whole page; its security policy allows only `scripts`, and nothing from outside
    the page.
    """
    style = (ASSETS / "page.css").read_text()
    program = f'"use strict";\n{scripts}'
    allowed = b64encode(hashlib.sha256(program.encode()).digest()).decode()
    policy = (
        f"default-src 'none'; img-src data:; style-src 'unsafe-inline';"
        f" script-src 'sha256-{allowed}'; base-uri 'none'; form-action 'none'"
    )
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n{body}"
        f"<script>{program}</script>\n</body>\n</html>\n"
    )


def _header(title: str, found: BatchComparison, numbers: Mapping[str, int]) -> str:
    """Return the HTML of the title, each batch's result, the verdicts, and every total error."""
    about = escape(found.groups[0].experiment.description)
    few = len(found.contrasts) <= 10
    compared = [one for one in tables(found) if few and one.title.startswith("Comparison")]
    return (
        f"<header><div><h1>{escape(title)}</h1><p>{about}</p></div>"
        '<button id="theme" aria-label="Light or dark">◐</button></header>'
        f'<div class="top">{_tables([_overview(found.groups), *compared])}'
        f"{of_groups(found.groups, numbers)}</div>"
    )


def _overview(groups: Sequence[BatchStatistics]) -> Table:
    """Return a table with each batch's mean total error and the numbers of its unsafe trials."""
    totals = [group.total for group in groups]
    least = min((total.mean for total in totals if total.n), default=math.nan)
    show = error_format(least, finest(groups[0].experiment))
    rows = [texts_by_label(group) for group in groups]
    counts = {label: [texts[label].partition(" (")[0] for texts in rows] for label in SAFETY}
    known = "; ".join(f"{one.name}: {one.origin}, {counted_by(one.experiment)}" for one in groups)
    return Table(
        "",
        (
            Column("batch", [group.name for group in groups]),
            Column("n", [total.n for total in totals]),
            Column("mean total error", [t.mean for t in totals], unit_of(groups[0].unit), show),
            Column("95 % interval", [t.ci95.text(show) if t.ci95.known else NONE for t in totals]),
            *(Column(label, texts) for label, texts in counts.items()),
        ),
        "Mean total error: the sum over the robots of the distance to the target. Plants, and"
        f" what was checked: {known}.",
    )


def _player(shown: Sequence[Sequence[Any]], unit: str, count: int) -> str:
    """Return the HTML of the player for trials, each given by name and data, out of `count`."""
    options = "".join(
        f'<option value="{i}">{i + 1}: {escape(name)}</option>' for i, (name, _) in enumerate(shown)
    )
    data = "".join(
        f'<script type="text/plain" id="trial-data-{i}">{packed(trial)}</script>\n'
        for i, (_, trial) in enumerate(shown)
    )
    frame = (ASSETS / "player.html").read_text()
    frame = frame.replace("@OPTIONS@", options).replace("@UNIT@", unit_of(unit))
    left_out = (
        f"<p>The page carries {len(shown)} of {count} trials, without plans and searches: of each"
        " batch those at evenly spaced ranks of the total error, from the best to the worst, and"
        " some that do not count. The tables hold all trials.</p>"
    )
    return frame.replace("@NOTE@", left_out if count > MANY else "") + data


def _json(value: Any) -> str:
    """Return JSON that is safe inside an HTML script element."""
    text = json.dumps(value, ensure_ascii=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


def _statistics(found: BatchComparison, numbers: Mapping[str, int]) -> str:
    """Return the tables of each batch and of their comparison, and the same data as JSON."""
    links = {str(number): f"#trial-{number}" for number in numbers.values()}
    parts = []
    for group in found.groups:
        name = f": {escape(group.name)}" if len(found.groups) > 1 else ""
        parts.append(
            f"<section><h2>Statistics{name}</h2>{_tables(tables(BatchComparison((group,))))}"
            "<details open><summary>All trials</summary>"
            f"{html([page_trials(group, numbers)], links)}</details></section>"
        )
    if found.contrasts:
        parts.append(f"<section><h2>Comparison</h2>{_tables(tables(found))}</section>")
    data = _json(plain(comparison_items(found)))
    return "".join(parts) + f'<script type="application/json" class="statistics">{data}</script>\n'


def _tables(shown: Sequence[Table]) -> str:
    return f'<div class="tables">{"".join(f"<div>{html([one])}</div>" for one in shown)}</div>'


def _provenance(log: TrialLog) -> str:
    rows = "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in log.facts.items())
    return (
        f"<section><h2>Provenance</h2><p>Of the first trial, seed {log.start.seed}, spec"
        f" {escape(log.start.spec_name)}, hash {escape(log.start.spec_hash[:16])}.</p>"
        f"<details><summary>Host and versions</summary><dl>{rows}</dl></details>"
        "<details><summary>Spec with every default</summary>"
        f"<pre>{escape(log.start.resolved)}</pre></details></section>"
    )


def lean(log: TrialLog) -> TrialLog:
    """Return the trial with only the data that `of_batch` draws, so that many fit into memory."""
    return replace(log, steps=log.steps[:1], truth=None, notes=())


def of_trial(log: TrialLog) -> str:
    """Return the figures of a trial; "" for a log without control steps or camera frames."""
    if not (log.steps and len(log.mocap_ns)):
        return ""
    name = Path(log.log).name
    kinds = ("trajectory", "convergence", "errors", "over-time")
    return _paper([_figure(kind, [log], f"{kind}, {name}") for kind in kinds])


def of_batch(name: str, logs: Sequence[TrialLog]) -> str:
    """Return the figures of a batch called `name`, "" for fewer than two trials with frames."""
    seen = [log for log in logs if len(log.mocap_ns)]
    if len(seen) < 2:
        return ""
    where = f": {name}" if name else ""
    text = "The error of each trial over time, the median, and the middle half of the trials"
    return _paper([_figure("errors", seen, text + where)])


def of_groups(groups: Sequence[BatchStatistics], numbers: Mapping[str, int]) -> str:
    """Return all total errors as inline SVG, each dot a link to its trial; "" without any error.

    `numbers` has each trial's number on the page, by path.
    """
    from tetractl.view.figures.batch import batch_figure
    from tetractl.view.style import svg

    if not any(group.counted for group in groups):
        return ""
    links = {path: f"#trial-{number}" for path, number in numbers.items()}
    drawing = svg(batch_figure(groups, links)).decode()
    drawing = re.sub(r"<metadata>.*?</metadata>", "", drawing, flags=re.DOTALL)
    drawing = re.sub(r'(<a xlink:href="#trial-(\d+)")>', r"\1><title>trial \2</title>", drawing)
    drawing = drawing[drawing.index("<svg") :].replace("<svg", '<svg class="errors"', 1)
    return _paper(
        [
            _captioned(
                drawing, "Every total error, a dot per trial, and how the errors are distributed"
            )
        ]
    )


def _figure(kind: str, logs: Sequence[TrialLog], text: str) -> str:
    from tetractl.view.figures.draw import draw

    return _picture(draw(kind, logs), text)


def _picture(drawing: "Figure", text: str) -> str:
    from tetractl.view.style import svg

    picture = b64encode(svg(drawing)).decode()
    shown = f'<img alt="{escape(text)}" src="data:image/svg+xml;base64,{picture}">'
    return _captioned(shown, text)


def _captioned(picture: str, text: str) -> str:
    return f"<figure>{picture}<figcaption>{escape(text)}</figcaption></figure>"


def _paper(figures: Sequence[str]) -> str:
    return f'<div class="paper">{"".join(figures)}</div>'
