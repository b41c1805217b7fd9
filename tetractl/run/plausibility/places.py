"""Checks of where robots stand: obstacles on their way, and other robots beside them."""

from collections.abc import Iterator

import numpy as np

from tetractl.core.poses import Floats
from tetractl.model.free_space import clearance, shut_out
from tetractl.run.plausibility.case import Case, Doubt


def walled_off(case: Case) -> Iterator[Doubt]:
    """Targets with no way to them past the obstacles, or none that keeps the margin."""
    if not case.experiment.obstacles:
        return
    apart = shut_out(case.setup, 0.0, case.walls)
    for i in np.flatnonzero(apart > 0):
        yield Doubt(
            ("robots", int(i), "target"),
            f"is walled off: past the obstacles, the robot comes within {apart[i]:.4g} {case.unit}",
            "open a gap between the obstacles",
        )
    if case.margin > 0:
        squeezed = shut_out(case.setup, case.margin, case.walls)
        ends = np.minimum(
            *(_clearances(case, xy) for xy in (case.setup.starts.xy, case.setup.targets))
        )
        for i in np.flatnonzero((squeezed > 0) & (apart == 0) & (ends > case.margin)):
            yield Doubt(
                ("robots", int(i), "target"),
                f"has no way to it that keeps {case.margin:.4g} {case.unit} from the obstacles: "
                f"the robot comes within {squeezed[i]:.4g} {case.unit}",
                "lower controller.collision.margin or radius, or widen the gap",
            )


def inside_margin(case: Case) -> Iterator[Doubt]:
    """Starts and targets nearer to an obstacle than the planner's paths may come."""
    if case.margin == 0 or case.yields:
        return
    for field, points in (("start", case.setup.starts.xy), ("target", case.setup.targets)):
        gaps = _clearances(case, points)
        for i in np.flatnonzero(gaps <= case.margin):
            yield Doubt(
                ("robots", int(i), field),
                f"is {gaps[i]:.4g} {case.unit} from the nearest obstacle or wall; the plans keep "
                f"{case.margin:.4g}",
                "move it, or lower controller.collision.margin or radius",
            )


def _clearances(case: Case, points: Floats) -> Floats:
    return clearance(case.setup, points[:, 0], points[:, 1], case.walls)


def too_close(case: Case) -> Iterator[Doubt]:
    """Starts or targets nearer to each other than the lab lets robots come."""
    setup = case.setup
    for section in ("plant", "lab"):
        limits = getattr(getattr(case.experiment, section), "limits", None)
        if limits is None:
            continue
        per_mm = 1e-3 / setup.metres
        least = limits.separation_mm * per_mm
        for field, points in (("start", setup.starts.xy), ("target", setup.targets)):
            for i in range(1, len(points)):
                gaps = np.linalg.norm(points[:i] - points[i], axis=1)
                if gaps.min() < least:
                    yield Doubt(
                        ("robots", i, field),
                        f"is {gaps.min() / per_mm:.4g} mm from the {field} of "
                        f"{setup.names[int(gaps.argmin())]}; the lab aborts when robots "
                        f"come nearer than {limits.separation_mm:.4g} mm",
                        f"move them apart, or lower {section}.limits.separation_mm",
                    )
