"""The figures of a study: total error by arm and, for each swept field, against its value, in the
shades of the controllers.
"""

import re
from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from tetractl.results.estimate import ArmErrors
from tetractl.run.store import Store
from tetractl.study.arm_table import LISTED, field_values, given_note, group_of, origins
from tetractl.study.load_study import LoadedStudy
from tetractl.view import style
from tetractl.view.figures.sweep import errors_by

ARMS = "arms"  # in place of a field: the figure by arm


def write_figures(loaded: LoadedStudy, store: Store) -> list[Path]:
    """Write error-arms.png, and error-FIELD.png for every swept field; the same results
    give the same bytes.
    """
    paths = []
    for field in (ARMS, *loaded.paths):
        drawing = error_figure(loaded, store, field)
        if drawing is not None:
            name = re.sub(r"[^A-Za-z0-9._+-]+", "_", field)
            paths.append(store.folder / f"error-{name}.png")
            style.save(drawing, paths[-1])
    return paths


def error_figure(loaded: LoadedStudy, store: Store, field: str) -> Figure | None:
    """Draw the total error of each trial, and the mean with its 95 % interval, against a field, or
    by arm for the field ARMS, at most LISTED arms; None if no trial has an error.

    If several arms share a value, each trial is represented by its mean over these arms.
    """
    by_arm = field == ARMS
    shown = loaded.arms[:LISTED] if by_arm else loaded.arms
    curves = dict[str, list[ArmErrors]]()
    for name in dict.fromkeys(arm.controller for arm in shown):
        arms = [arm for arm in shown if arm.controller == name]
        groups = field_values(loaded, store, field, arms)
        if by_arm:
            groups = [group_of(loaded, store, arm.name, [arm]) for arm in arms]
        curves[name] = [group for group in groups if group.error.n > 0]
    every = [group for found in curves.values() for group in found]
    if not every:
        return None
    figure = errors_by(curves, "" if by_arm else field, loaded.unit, len(loaded.paths) == 1)
    title = [_headline(loaded, every), given_note(shown)]
    style.headline(figure, "; ".join(filter(None, title)))
    return figure


def _headline(loaded: LoadedStudy, found: Sequence[ArmErrors]) -> str:
    """Return the title: study, plants, the statistic drawn, and the number of trials."""
    plants = sorted(set(origins(loaded)))
    counts = sorted({group.error.n for group in found})
    n = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    pooled = " over the other fields" if any(group.arms > 1 for group in found) else ""
    return (
        f"{loaded.study.name}, {' and '.join(plants)}: mean{pooled} and its 95 % interval,"
        f" n = {n} trials, each a dot"
    )
