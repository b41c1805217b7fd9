"""The report: logs in, one HTML file out that needs no network and no other file."""

import hashlib
import json
from base64 import b64encode
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

from tetractl.core.errors import LogError
from tetractl.log.read.find import find_logs
from tetractl.log.read.reader import read_trial
from tetractl.log.read.trial_log import TrialLog
from tetractl.report import figures
from tetractl.report.errors_svg import Row, errors_svg
from tetractl.report.trial_data import Detail, trial_data
from tetractl.stats import export
from tetractl.stats.rows import Grid, grids
from tetractl.stats.summary import Summary, summarise
from tetractl.stats.text import lengths
from tetractl.stats.trials import load_trials

ASSETS = files("tetractl.report") / "assets"
SCRIPTS = ("data.js", "scene.js", "chart.js", "player.js")


@dataclass(frozen=True, slots=True)
class Batch:
    """The logs of one path and their statistics."""

    name: str
    summary: Summary
    paths: tuple[Path, ...]


def report(
    paths: Sequence[Path], title: str | None, progress: Callable[[int, int], None]
) -> tuple[str, list[str]]:
    """Return the page of some logs, folders or patterns, and the logs that could not be read.

    Each folder is a batch of its own; logs named one by one are a batch together. `progress` is
    called with the number of logs read and of all. Raises UsageError where there is no log, or
    where the trials of a batch belong to several experiments.
    """
    batches = _batches(paths)
    detail, shown = Detail.of(sum(len(batch.paths) for batch in batches)), []
    unread: list[str] = []
    first: TrialLog | None = None
    read: list[list[TrialLog]] = [[] for _ in batches]
    numbered = [
        (batch, path) for batch, trials in zip(read, batches, strict=True) for path in trials.paths
    ]
    for number, (logs, path) in enumerate(numbered, 1):
        progress(number, len(numbered))
        try:
            log = read_trial(path)
        except LogError as error:
            unread.append(str(error))
            continue
        first = first or log
        logs.append(figures.lean(log))
        shown.append((path, trial_data(log, path.name, detail)))
    if first is None:
        raise LogError(f"none of the logs can be read: {unread[0]}")
    numbers = {str(path): number for number, (path, _) in enumerate(shown, 1)}
    body = [
        _header(title or batches[0].summary.experiment.name, batches),
        _player(shown, batches[0].summary.unit),
        _errors(batches, numbers, read),
        *(_tables(batch, numbers, len(batches) > 1) for batch in batches),
        f"<section><h2>Figures of the first trial</h2>{figures.of_trial(first)}</section>",
        _provenance(first),
    ]
    scripts = "".join((ASSETS / name).read_text() for name in SCRIPTS)
    return _page(title or batches[0].summary.experiment.name, "".join(body), scripts), unread


def _batches(paths: Sequence[Path]) -> list[Batch]:
    folders = [path for path in paths if path.is_dir()]
    single = [path for path in paths if not path.is_dir()]
    groups: list[tuple[str, list[Path]]] = [(str(folder), [folder]) for folder in folders]
    if single:
        groups.insert(0, ("logs" if len(single) > 1 else single[0].name, single))
    return [
        Batch(name, summarise(*load_trials(group)), tuple(find_logs(group)))
        for name, group in groups
    ]


def _page(title: str, body: str, scripts: str) -> str:
    """Return the whole page; its policy allows this style and this script, and no address."""
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


def _header(title: str, batches: Sequence[Batch]) -> str:
    cards = []
    for batch in batches:
        summary = batch.summary
        total, unit = summary.total, summary.unit.replace("um", "µm")
        show = lengths(total.mean)
        interval = ""
        if total.ci95.known:
            interval = f"95 % {show(total.ci95.low)} to {show(total.ci95.high)}, "
        entered = sum(trial.result.entered_obstacle for trial in summary.trials)
        name = f"{escape(batch.name)}: " if len(batches) > 1 else ""
        cards += [
            f"<div>{name}mean total error<b>{show(total.mean)} {unit}</b>"
            f'<span class="quiet">{interval}n {total.n}, {summary.origin}</span></div>',
            f"<div>entered an obstacle<b>{entered} of {len(summary.trials)}</b>"
            '<span class="quiet">trials</span></div>',
        ]
    about = escape(batches[0].summary.experiment.description)
    return (
        f"<header><div><h1>{escape(title)}</h1><p>{about}</p></div>"
        '<button id="theme" aria-label="Light or dark">◐</button></header>'
        f'<div class="figures">{"".join(cards)}</div>'
    )


def _player(shown: Sequence[tuple[Path, dict[str, Any]]], unit: str) -> str:
    options = "".join(
        f'<option value="{i}">{i + 1}: {escape(path.name)}</option>'
        for i, (path, _) in enumerate(shown)
    )
    data = "".join(
        f'<script type="application/json" id="trial-data-{i}">{_json(trial)}</script>\n'
        for i, (_, trial) in enumerate(shown)
    )
    frame = (ASSETS / "player.html").read_text()
    unit = unit.replace("um", "µm")
    return frame.replace("@OPTIONS@", options).replace("@UNIT@", unit) + data


def _json(value: Any) -> str:
    """Return JSON that may stand inside a script element."""
    text = json.dumps(value, ensure_ascii=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


def _errors(
    batches: Sequence[Batch], numbers: Mapping[str, int], logs: Sequence[Sequence[TrialLog]]
) -> str:
    rows = [
        Row(
            batch.name if len(batches) > 1 else "this batch",
            [
                (trial.result.total_error, numbers[trial.path])
                for trial in batch.summary.trials
                if trial.outcome.complete and not trial.recovered and trial.path in numbers
            ],
            batch.summary,
        )
        for batch in batches
    ]
    picture = errors_svg(rows) + "".join(
        figures.of_batch(batch.name if len(batches) > 1 else "", trials)
        for batch, trials in zip(batches, logs, strict=True)
    )
    return f"<section><h2>Errors</h2>{picture}</section>" if picture else ""


def _tables(batch: Batch, numbers: Mapping[str, int], several: bool) -> str:
    name = f": {escape(batch.name)}" if several else ""
    tables = "".join(f"<div>{_grid(grid)}</div>" for grid in grids(batch.summary))
    data = _json(export.as_json(batch.summary))
    return (
        f'<section><h2>Statistics{name}</h2><div class="tables">{tables}</div>'
        f"{_trials(batch, numbers)}</section>"
        f'<script type="application/json" class="statistics">{data}</script>\n'
    )


def _grid(grid: Grid) -> str:
    head = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in grid.header)
    rows = "".join(
        f'<tr><th scope="row">{escape(row[0])}</th>'
        + "".join(f"<td>{escape(cell)}</td>" for cell in row[1:])
        + "</tr>"
        for row in grid.rows
    )
    kind = ' class="words"' if grid.words else ""
    return (
        f'<div class="scroll"><table{kind}><caption>{escape(grid.title)}</caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>"
    )


def _trials(batch: Batch, numbers: Mapping[str, int]) -> str:
    unit = batch.summary.unit.replace("um", "µm")
    show = lengths(batch.summary.total.mean)
    rows = "".join(
        f'<tr data-total-error="{trial.result.total_error!r}">'
        f'<th scope="row">{_link(numbers.get(trial.path))}</th>'
        f"<td>{escape(Path(trial.path).name)}</td><td>{show(trial.result.total_error)}</td>"
        f"<td>{trial.result.duration_s:.2f}</td><td>{trial.result.steps}</td>"
        f"<td>{'yes' if trial.result.entered_obstacle else 'no'}</td>"
        f"<td>{escape(trial.outcome.value)}</td></tr>"
        for trial in batch.summary.trials
    )
    return (
        '<details open><summary>All trials</summary><div class="scroll"><table class="trials">'
        f'<thead><tr><th scope="col">trial</th><th scope="col">log</th>'
        f'<th scope="col">total error [{unit}]</th><th scope="col">duration [s]</th>'
        '<th scope="col">steps</th><th scope="col">entered</th><th scope="col">outcome</th></tr>'
        f"</thead><tbody>{rows}</tbody></table></div></details>"
    )


def _link(number: int | None) -> str:
    return f'<a href="#trial-{number}">{number}</a>' if number else ""


def _provenance(log: TrialLog) -> str:
    facts = {**log.provenance, **log.host}
    rows = "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in facts.items())
    return (
        f"<section><h2>Provenance</h2><p>Of the first trial, seed {log.start.seed}, spec"
        f" {escape(log.start.spec_name)}, hash {escape(log.start.spec_hash[:16])}.</p>"
        f"<details><summary>Host and versions</summary><dl>{rows}</dl></details>"
        "<details><summary>Spec with every default</summary>"
        f"<pre>{escape(log.start.resolved)}</pre></details></section>"
    )
