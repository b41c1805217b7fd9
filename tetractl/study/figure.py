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


def write_figures(loaded: LoadedStudy, store: Store) -> list[Path]:
    """Write error-arms.png, and error-FIELD.png for every swept field, and return their paths; none
    if no trial has an error. The same results give the same bytes.
    """
    drawings = {"arms": figure_by_arm(loaded, store)}
    for field in loaded.paths:
        drawings[field] = figure_by_field(loaded, store, field)
    paths: list[Path] = []
    for name, drawing in drawings.items():
        if drawing is not None:
            path = store.folder / f"error-{re.sub(r'[^A-Za-z0-9._+-]+', '_', name)}.png"
            style.save(drawing, path)
            paths.append(path)
    return paths


def figure_by_arm(loaded: LoadedStudy, store: Store) -> Figure | None:
    """Draw the total error of each trial, and the mean with its 95 % interval, of at most LISTED
    arms; None if no trial has an error."""
    arms = loaded.arms[:LISTED]
    curves = {
        controller: [group_of(store, arm.name, [arm]) for arm in of_controller]
        for controller, of_controller in _by_controller(arms).items()
    }
    return _figure(loaded, arms, curves, label="")


def figure_by_field(loaded: LoadedStudy, store: Store, field: str) -> Figure | None:
    """Draw the same against the values of a swept field, of all arms. If several arms share a
    value, each trial is represented by its mean over these arms."""
    curves = {
        controller: field_values(store, field, of_controller)
        for controller, of_controller in _by_controller(loaded.arms).items()
    }
    return _figure(loaded, loaded.arms, curves, label=field)


def _by_controller(arms: Sequence[Arm]) -> dict[str, list[Arm]]:
    """Return the arms of each controller, in their order."""
    arms_of: dict[str, list[Arm]] = {}
    for arm in arms:
        arms_of.setdefault(arm.controller, []).append(arm)
    return arms_of


def _figure(
    loaded: LoadedStudy, arms: Sequence[Arm], curves: dict[str, list[ArmErrors]], label: str
) -> Figure | None:
    """Draw the errors of each controller along an axis with a label."""
    drawn = {
        controller: [group for group in groups if group.error.n > 0]
        for controller, groups in curves.items()
    }
    all_groups = [group for groups in drawn.values() for group in groups]
    if not all_groups:
        return None
    figure = errors_by(drawn, label, loaded.unit, len(loaded.paths) == 1)
    title = [_headline(loaded, all_groups), given_note(arms)]
    style.headline(figure, "; ".join(text for text in title if text))
    return figure


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
