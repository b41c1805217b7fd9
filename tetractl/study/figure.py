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
from tetractl.study.load_study import Arm, LoadedStudy
from tetractl.view import style
from tetractl.view.figures.sweep import errors_by

ARMS = "arms"
"""In place of a field: the figure by arm."""


def write_figures(loaded: LoadedStudy, store: Store) -> list[Path]:
    """Write error-arms.png, and error-FIELD.png for every swept field; the same results
    give the same bytes.
    """
    paths: list[Path] = []
    for field in (ARMS, *loaded.paths):
        drawing = error_figure(loaded, store, field)
        if drawing is not None:
            name = re.sub(r"[^A-Za-z0-9._+-]+", "_", field)
            path = store.folder / f"error-{name}.png"
            style.save(drawing, path)
            paths.append(path)
    return paths


def error_figure(loaded: LoadedStudy, store: Store, field: str) -> Figure | None:
    """Draw the total error of each trial, and the mean with its 95 % interval, against a field, or
    by arm for the field ARMS, at most LISTED arms; None if no trial has an error.

    If several arms share a value, each trial is represented by its mean over these arms.
    """
    arms = loaded.arms[:LISTED] if field == ARMS else loaded.arms
    curves = _curves(loaded, store, field, arms)
    groups = [group for curve in curves.values() for group in curve]
    if not groups:
        return None
    label = "" if field == ARMS else field
    figure = errors_by(curves, label, loaded.unit, len(loaded.paths) == 1)
    title = [_headline(loaded, groups), given_note(arms)]
    style.headline(figure, "; ".join(text for text in title if text))
    return figure


def _curves(
    loaded: LoadedStudy, store: Store, field: str, arms: Sequence[Arm]
) -> dict[str, list[ArmErrors]]:
    """Return the errors of each controller, by the values of a field or by arm."""
    curves: dict[str, list[ArmErrors]] = {}
    for controller in dict.fromkeys(arm.controller for arm in arms):
        of_controller = [arm for arm in arms if arm.controller == controller]
        if field == ARMS:
            groups = [group_of(store, arm.name, [arm]) for arm in of_controller]
        else:
            groups = field_values(store, field, of_controller)
        curves[controller] = [group for group in groups if group.error.n > 0]
    return curves


def _headline(loaded: LoadedStudy, groups: Sequence[ArmErrors]) -> str:
    """Return the title: study, plants, the statistic drawn, and the number of trials."""
    plants = sorted(set(origins(loaded)))
    counts = sorted({group.error.n for group in groups})
    n = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    pooled = " over the other fields" if any(group.arms > 1 for group in groups) else ""
    return (
        f"{loaded.study.name}, {' and '.join(plants)}: mean{pooled} and its 95 % interval,"
        f" n = {n} trials, each a dot"
    )
