"""`tetractl lab survey`: finds the cells in a dish and proposes which cells to steer."""

import math
import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tetractl.cli import ui
from tetractl.cli.lab import save_calibration, watched_by_operator
from tetractl.cli.options import AsJson, Lab, Sets, Spec, Yes, option, out_option
from tetractl.core.errors import Exit, UsageError
from tetractl.tools.files import write_atomically
from tetractl.tools.table.table_files import format_json

if TYPE_CHECKING:
    from tetractl_microscope.choice.candidate import RobotCandidate
    from tetractl_microscope.choice.ranked import RankedChoice


FILE_FIELDS = (
    ("identified",),
    ("lab", "calibration"),
    ("plant", "calibration"),
    ("plant", "faults"),
    ("controller", "weights"),
)
"""Paths of the fields of a spec that name a file relative to the spec's folder."""


def survey(
    spec: Spec,
    sets: Sets = None,
    out: Annotated[
        Path | None,
        out_option(
            "FILE",
            "YAML file to write a spec for trials to. With --micrometer, the file gets the "
            "calibration, by default calibration.yaml.",
        ),
    ] = None,
    plans: Annotated[
        int,
        option(
            "N", "Number of plans to search for each of the best choices of cells.", min=1, max=1000
        ),
    ] = 96,
    micrometer: Annotated[
        str | None,
        option(
            "C,R,C,R,UM",
            "Only measure the scale and rotation of the image. Give the column and row of two "
            "places in the image (px), and their distance along the spec's x axis (um).",
        ),
    ] = None,
    plant: Lab = "lab",
    yes: Yes = False,
    as_json: AsJson = False,
) -> int:
    """Find the cells in a dish, measure how each responds to the field, and propose which to steer.

    The field rotates for the time `robots.seconds` of the spec. The command then lists every cell
    in view, with the 95 % intervals of its turning rate and speed. It prints whether the cells turn
    towards the field, or towards its mirror image. In the second case, the image is mirrored, or a
    coil pair is reversed.

    Below, it lists choices of cells to steer, ranked by the error that is predicted with the noise
    of the spec's simulation. They contain only cells that follow the field and can be
    distinguished.

    With -o, the command writes a spec. A trial of this spec finds the best cells again, by their
    turning rates a and speeds.

    With --micrometer, the command opens no device. It computes the scale and rotation of the image
    from two marks of a stage micrometer, or from one speck before and after the stage was moved.
    Enter the name of the file that it writes in the spec as `lab.calibration`.

    Example: tetractl lab survey experiments/tetrahymena_dish.yaml -o dish.yaml
    """
    from tetractl.core.protocols import LabSupervision
    from tetractl.spec.plants import get_lab, select_plant
    from tetractl.spec.yaml.core_yaml import format_yaml
    from tetractl.spec.yaml.document import parse_document
    from tetractl.spec.yaml.settings import with_settings
    from tetractl_microscope.cells.section import CellsSection
    from tetractl_microscope.choice.closed_loop import Noise
    from tetractl_microscope.choice.first_plans import compute_cost_tolerance, select_planner
    from tetractl_microscope.choice.ranked import find_similar_pairs, rank_choices
    from tetractl_microscope.choice.section import Choice
    from tetractl_microscope.handedness import describe_handedness, watch_turning

    loaded = ui.load_spec_file(spec, sets)
    experiment = select_plant(loaded, plant).experiment
    if micrometer is not None:
        out = Path("calibration.yaml") if out is None else out
        ui.refuse_existing(out)
        camera = get_lab(experiment, loaded.name).camera
        if not isinstance(camera, CellsSection):
            raise UsageError(
                f"a camera of type {camera.type} cannot be calibrated with a micrometer"
            )
        return save_calibration(out, camera.measured_by(*_parse_micrometer(micrometer)))
    choice = experiment.chosen
    unit = experiment.units.length
    if not isinstance(choice, Choice) or not experiment.must_choose_robots:
        raise UsageError(
            f"{spec}: the spec lists its robots, so the survey has no cells to choose from",
            "to let a survey choose the cells, write `robots: {choose: N, ...}` into the spec",
        )
    ui.refuse_existing(out)
    if experiment.plant.real_time:
        ui.require_consent(yes, f"The magnetic field will turn the cells for {choice.seconds:g} s.")
    supervision = LabSupervision()
    with (
        watched_by_operator(supervision, experiment.plant.real_time),
        ui.build_rig_of(experiment, supervision) as rig,
    ):
        cells, turned = watch_turning(rig, choice, experiment.trials.seed, supervision)
    problems, turning = describe_handedness(turned)
    ui.print_messages(*(f"warning: {problem}" for problem in problems))
    cell_pairs = list(find_similar_pairs(cells))
    if not as_json:
        _print_cells(cells, cell_pairs, unit)
        print(f"turning: {turning}")

    def report_progress(count: int, total: int) -> None:
        ui.print_messages(f"prediction {count} of {total}")

    choices = rank_choices(
        experiment, cells, Noise.from_plant(loaded.experiment.plant), plans, report_progress
    )
    if as_json:
        listed_choices = [
            {"cells": proposal.numbers, "error": proposal.error} for proposal in choices
        ]
        numbers = [[first.number, second.number] for first, second in cell_pairs]
        listed = [{**asdict(cell), "magnetised": cell.magnetised} for cell in cells]
        print(
            format_json(
                {
                    "unit": unit,
                    "cells": listed,
                    "alike": numbers,
                    "turning": turning,
                    "choices": listed_choices,
                }
            )
        )
    else:
        for proposal in choices:
            print(_format_choice(proposal, unit))
    if not choices or not math.isfinite(choices[0].error):
        control = select_planner(experiment)
        responding_count = sum(cell.magnetised for cell in cells)
        horizon_s = control.horizon_max * control.signal_periods * control.period
        if choices:
            reason = (
                f"plans may last up to {horizon_s:g} s (controller.horizon_max), but none of them "
                f"brings the cells within {compute_cost_tolerance(control):g} {unit} of the targets"
            )
        elif responding_count < choice.choose:
            reason = (
                f"only {responding_count} of {len(cells)} cells respond to the field, but "
                f"{choice.choose} are needed"
            )
        else:
            reason = (
                f"every choice of {choice.choose} cells contains two that cannot be distinguished "
                "after they have met"
            )
        ui.print_messages(f"no choice of these cells can be steered to the targets: {reason}")
        return Exit.FAILED
    if out is not None:
        data = with_settings(parse_document(loaded.text, str(spec)), sets or []).data
        wanted_cells = [
            {"a": round(cell.a, 4), "speed": round(cell.speed, 2)} for cell in choices[0].cells
        ]
        data["robots"]["wanted"] = wanted_cells
        _rebase_file_names(data, spec.parent, out.parent)
        write_atomically(out, format_yaml(data).encode())
        ui.print_messages(f"wrote {out}: a trial of this spec finds the same cells again")
    return Exit.DONE


def _rebase_file_names(data: dict[str, Any], folder: Path, new_folder: Path) -> None:
    """Change a spec's file names, in place, to be relative to `new_folder` instead of `folder`.

    Fields that name no file are left alone.
    """
    for *sections, field in FILE_FIELDS:
        section = data
        for name in sections:
            section = section.get(name) or {}
        file = section.get(field)
        if type(file) is str:
            section[field] = os.path.relpath(folder / file, new_folder)


def _parse_micrometer(text: str) -> tuple[tuple[float, float], tuple[float, float], float]:
    """Parse the value of the option --micrometer: two positions [px], and their distance [um].

    Raises:
        UsageError: If the value is not five finite numbers, or if the distance is not above 0.
    """
    try:
        first_column, first_row, second_column, second_row, distance_um = (
            float(number) for number in text.split(",")
        )
    except ValueError:
        first_column = first_row = second_column = second_row = distance_um = math.nan
    if not (
        math.isfinite(first_column + first_row + second_column + second_row)
        and 0 < distance_um < math.inf
    ):
        raise UsageError(
            f"--micrometer {text}: give five numbers in the form C,R,C,R,UM:"
            " column and row of two places in the image [px], and their distance [um]; for "
            "example, 112,540,901,548,2000"
        )
    return (first_column, first_row), (second_column, second_row), distance_um


def _format_choice(proposal: "RankedChoice", unit: str) -> str:
    """Format a choice of cells in one line: its predicted error, and the cells near the edge.

    If the error is infinite, it is written as "unknown, because no plan was found".
    """
    numbers = ", ".join(map(str, proposal.numbers))
    error = (
        f"{proposal.error:.0f} {unit}"
        if math.isfinite(proposal.error)
        else "unknown, because no plan was found"
    )
    near_edge = ", ".join(str(cell.number) for cell in proposal.cells if not cell.free)
    doubt_note = f"; less certain, because of cells near the edge: {near_edge}" if near_edge else ""
    return f"cells {numbers}: predicted mean total error {error}{doubt_note}"


def _print_cells(
    cells: "Sequence[RobotCandidate]",
    cell_pairs: "Sequence[tuple[RobotCandidate, RobotCandidate]]",
    unit: str,
) -> None:
    """Print each cell with the 95 % intervals of its turning rate a and its speed.

    Then print the pairs of cells whose turning rates a are too similar to tell the cells apart.
    """
    from tetractl.statistics.estimate import NORMAL_QUANTILE

    for cell in cells:
        response_note = "" if cell.magnetised else ", does not respond to the field"
        edge_note = "" if cell.free else ", was near the edge, so its turning rate a is unreliable"
        print(
            f"cell {cell.number} at ({cell.pose.x:.0f}, {cell.pose.y:.0f}) {unit}: "
            f"a {cell.a:.2f} ± {NORMAL_QUANTILE * cell.a_sd:.2f} rad/s, speed {cell.speed:.0f} "
            f"± {NORMAL_QUANTILE * cell.speed_sd:.0f} {unit}/s{response_note}{edge_note}"
        )
    for first, second in cell_pairs:
        print(f"cells {first.number} and {second.number} cannot be distinguished after they meet")
