"""Draw the figures of a study: total errors by arm, and against each swept field.

The colours distinguish the controllers.
"""

import re
from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from tetractl.run.store import Store
from tetractl.statistics.estimate import ArmErrors
from tetractl.study.arm_table import (
    ARMS_LISTED_MAX,
    arm_origins,
    given_directions_note,
    group_by_value,
    group_errors,
)
from tetractl.study.load_study import Arm, LoadedStudy
from tetractl.view import style
from tetractl.view.figures.sweep import study_errors_figure


def write_figures(loaded: LoadedStudy, store: Store) -> list[Path]:
    """Write the figures of a study, and return their paths.

    The figures are error-arms.png, and error-FIELD.png for every swept field. If no trial has an
    error, no figure is written. The same results give the same bytes.
    """
    paths: list[Path] = []
    for field in ("", *loaded.paths):
        drawing = study_figure(loaded, store, field)
        if drawing is not None:
            name = re.sub(r"[^A-Za-z0-9._+-]+", "_", field or "arms")
            path = store.folder / f"error-{name}.png"
            style.save(drawing, path)
            paths.append(path)
    return paths


def study_figure(loaded: LoadedStudy, store: Store, field: str = "") -> Figure | None:
    """Draw the total error of each trial, and the mean with its 95 % interval.

    If several arms share a value, each trial is represented by its mean over these arms.

    Args:
        loaded: The study.
        store: Its folder.
        field: A swept field, to draw all arms against its values. Empty to draw at most
            ARMS_LISTED_MAX arms.

    Returns:
        The figure. None if no trial has an error.
    """
    arms = loaded.arms if field else loaded.arms[:ARMS_LISTED_MAX]
    curves: dict[str, list[ArmErrors]] = {}
    for controller, controller_arms in _by_controller(arms).items():
        if field:
            groups = group_by_value(store, field, controller_arms)
        else:
            groups = [group_errors(store, arm.name, [arm]) for arm in controller_arms]
        curves[controller] = [group for group in groups if group.error.n > 0]
    all_groups = [group for groups in curves.values() for group in groups]
    if not all_groups:
        return None
    figure = study_errors_figure(curves, field, loaded.unit, len(loaded.paths) == 1)
    title = [_headline(loaded, all_groups), given_directions_note(arms)]
    style.headline(figure, "; ".join(text for text in title if text))
    return figure


def _by_controller(arms: Sequence[Arm]) -> dict[str, list[Arm]]:
    """Group the arms of a study by their controller, in the order of the arms."""
    arms_by_controller: dict[str, list[Arm]] = {}
    for arm in arms:
        arms_by_controller.setdefault(arm.controller, []).append(arm)
    return arms_by_controller


def _headline(loaded: LoadedStudy, groups: Sequence[ArmErrors]) -> str:
    """Format the title: study, plants, the statistic drawn, and the number of trials."""
    plants = sorted(set(arm_origins(loaded)))
    counts = sorted({group.error.n for group in groups})
    n = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    pooled = " over the other fields" if any(group.arms > 1 for group in groups) else ""
    return (
        f"{loaded.study.name}, {' and '.join(plants)}: mean{pooled} and its 95 % interval,"
        f" n = {n} trials, each a dot"
    )
