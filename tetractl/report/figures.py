"""The figures of a report, drawn as `tetractl plot` draws them: of one trial, and of a batch."""

import re
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import replace
from html import escape
from pathlib import Path

from tetractl.log.read.trial_log import TrialLog
from tetractl.results.describe import Group

OF_A_TRIAL = ("trajectory", "convergence", "error", "timing")
OF_A_BATCH = {
    "errors": "The error of each trial over time, the median, and the middle half of the trials",
    "scatter": "Where each robot ended round its target, a dot per trial, with the covariance",
}
FEWEST = 2  # least number of trials for the figures of a batch


def lean(log: TrialLog) -> TrialLog:
    """Return the trial with only the data that `of_batch` draws, so that many fit into memory."""
    return replace(log, steps=log.steps[:1], truth=None, notes=())


def of_trial(log: TrialLog) -> str:
    """Return the figures of a trial; "" for a log without control steps or camera frames."""
    if not (log.steps and len(log.mocap_ns)):
        return ""
    name = Path(log.path).name
    return _row("paper", [_figure(kind, [log], f"{kind}, {name}") for kind in OF_A_TRIAL])


def of_batch(name: str, logs: Sequence[TrialLog]) -> str:
    """Return the figures of a batch called `name`, "" for fewer than two trials with frames."""
    seen = [log for log in logs if len(log.mocap_ns)]
    if len(seen) < FEWEST:
        return ""
    where = f": {name}" if name else ""
    drawn = [_figure(kind, seen, text + where) for kind, text in OF_A_BATCH.items()]
    return _row("paper wide", drawn)


def of_groups(groups: Sequence[Group], numbers: Mapping[str, int]) -> str:
    """Return every total error as inline SVG, its dot a link to its trial, "" without any error.

    `numbers` are those of the trials on the page by path.
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
    text = "Every total error, a dot per trial, and the errors of each robot"
    return _row("paper wide", [f"<figure>{drawing}<figcaption>{text}</figcaption></figure>"])


def _row(kind: str, figures: Sequence[str]) -> str:
    return f'<div class="{kind}">{"".join(figures)}</div>'


def _figure(kind: str, logs: Sequence[TrialLog], text: str) -> str:
    from tetractl.view.figures.draw import draw
    from tetractl.view.style import svg

    picture = b64encode(svg(draw(kind, logs))).decode()
    return (
        f'<figure><img alt="{escape(text)}" src="data:image/svg+xml;base64,{picture}">'
        f"<figcaption>{escape(text)}</figcaption></figure>"
    )
