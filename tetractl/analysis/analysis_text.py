"""The result of `tetractl analyze` as tables, as JSON, and as a line of advice."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from tetractl.analysis.analyze import TOO_ALIKE, WORTH, Analysis
from tetractl.analysis.steering import Steering
from tetractl.core.poses import Floats
from tetractl.tools.table.table import Column, Table, fixed, plural

NO_PLAN = "no plan found"
PREDICTED = "errors predicted by a linearised closed loop; no trial was run"
INSIDE = 0.95
"""The fraction of a normal distribution that lies in the ellipse that `_ellipse` returns."""
DEVIATIONS = math.sqrt(-2 * math.log(1 - INSIDE))
"""Distance from the ellipse's centre to its edge, in standard deviations."""

Fact = tuple[str, str]
"""A figure of the analysis, and its value as text."""


def tables(analysis: Analysis) -> list[Table]:
    """Return the tables of an analysis, without the line from `advice`."""
    names = analysis.setup.names
    title = f"{analysis.setup.name}: {len(names)} {plural('robot', len(names))}, {PREDICTED}"
    facts = list(_facts(analysis))
    steering = analysis.steering
    if steering is None:
        return [Table.of_texts(title, ("figure", "value"), facts), *_maps(analysis)]
    facts += _facts_of_steering(analysis, steering)
    return [
        Table.of_texts(title, ("figure", "value"), facts),
        _errors(analysis, steering),
        _ellipses(analysis, steering),
        *_maps(analysis),
    ]


def _facts(analysis: Analysis) -> Iterator[Fact]:
    """Yield what is known even if no plan reaches the targets."""
    setup = analysis.setup
    unit = setup.unit
    if analysis.reach:
        yield "reach of the signal", str(analysis.reach)
    yield "noise assumed", _noise(analysis)
    reaching = f"{_reaching(analysis)} of {analysis.plans}, to {analysis.tolerance:g} {unit}"
    yield "plans that reach", reaching
    yield "fewest signals that reach", _shortest(analysis)
    if analysis.alike:
        pair = ", ".join(analysis.alike)
        yield "smallest difference of a", f"{100 * analysis.gap:.3g} % ({pair})"
    if setup.hold is not None and not setup.on_wheels:
        radii = setup.speed / setup.a.min()
        circles = [f"{name} {r:.3g}" for name, r in zip(setup.names, radii, strict=True)]
        yield f"radii of the smallest circles, v / least a [{unit}]", ", ".join(circles)


def _facts_of_steering(analysis: Analysis, steering: Steering) -> Iterator[Fact]:
    """Yield in which directions the ends can be corrected."""
    unit = analysis.setup.unit
    values = " ".join(f"{value:.3g}" for value in steering.singular)
    yield f"singular values of d(ends)/d({steering.signals} signals) [{unit}/rad]", values
    shares = zip(analysis.setup.names, steering.weakest, strict=True)
    yield "hardest to correct", ", ".join(f"{name} {100 * share:.0f} %" for name, share in shares)


def _errors(analysis: Analysis, steering: Steering) -> Table:
    """Return the table of the predicted total errors, over all plans that reach."""
    plans = len(steering.errors)
    rows = {
        "with feedback": steering.errors,
        "without feedback": steering.open_loop,
        "without noise": steering.planned,
    }
    medians = [float(np.median(errors)) for errors in rows.values()]
    least = [float(errors.min()) for errors in rows.values()]
    most = [float(errors.max()) for errors in rows.values()]
    return Table(
        f"Mean total error of {plans} {plural('plan', plans)}",
        (
            Column("error", list(rows), analysis.setup.unit),
            Column("median", medians, "", fixed(3)),
            Column("min", least, "", fixed(3)),
            Column("max", most, "", fixed(3)),
        ),
    )


def _ellipses(analysis: Analysis, steering: Steering) -> Table:
    """Return the table of where the robots end by the plan with the median error."""
    unit = analysis.setup.unit
    axes = [_ellipse(covariance) for covariance in steering.covariance]
    long_axes = [long_axis for long_axis, _, _ in axes]
    short_axes = [short_axis for _, short_axis, _ in axes]
    angles = [math.degrees(angle) for _, _, angle in axes]
    return Table(
        f"Plan with the median error ({steering.signals} signals), with 95 % ellipses",
        (
            Column("robot", analysis.setup.names),
            Column("mean error", steering.robot_errors, unit, fixed(3)),
            Column("long half axis", long_axes, unit, "{:.3g}".format),
            Column("short half axis", short_axes, unit, "{:.3g}".format),
            Column("angle", angles, "deg", fixed(0)),
        ),
    )


def _ellipse(covariance: Floats) -> tuple[float, float, float]:
    """Return the longer and the shorter half axis [length unit], and the angle of the longer [rad],
    of the ellipse that contains the fraction INSIDE of a normal distribution with `covariance` (2,
    2).
    """
    variances, directions = np.linalg.eigh(covariance)  # the lesser variance first
    short, long = DEVIATIONS * np.sqrt(np.maximum(variances, 0.0))
    along_x, along_y = directions[:, 1].tolist()
    angle = math.atan2(along_y, along_x)
    return float(long), float(short), math.remainder(angle, math.pi)


def _maps(analysis: Analysis) -> list[Table]:
    """Return tables of the predicted error for other turning rates a, and for fewer robots."""
    if not analysis.by_gap:
        return []
    gaps = [gap for gap, _ in analysis.by_gap]
    counts = [count for count, _ in analysis.by_count]
    gap = Column("smallest relative difference", gaps, "", lambda gap: f"{100 * gap:g} %")
    unit = analysis.setup.unit
    by_gap = _predicted([error for _, error in analysis.by_gap], unit)
    by_count = _predicted([error for _, error in analysis.by_count], unit)
    return [
        Table("With other turning rates a, in equal ratios", (gap, by_gap)),
        Table("With only the first robots of the spec", (Column("robots", counts), by_count)),
    ]


def _predicted(errors: list[float], unit: str) -> Column:
    """Return a column of predicted errors, NaN where no plan was found."""
    texts = [NO_PLAN if math.isnan(error) else f"{error:.4g}" for error in errors]
    return Column("mean total error", texts, unit)


def _reaching(analysis: Analysis) -> int:
    """Return how many plans reach the targets."""
    return 0 if analysis.steering is None else len(analysis.steering.errors)


def _noise(analysis: Analysis) -> str:
    """Return the noise that is assumed as text."""
    noise = analysis.noise
    texts: list[str] = []
    if noise.a_std:
        texts.append(f"a {100 * noise.a_std:.2g} %")
    if noise.speed_std:
        texts.append(f"speed {100 * noise.speed_std:.2g} %")
    if noise.heading_walk:
        texts.append(f"heading {noise.heading_walk:.3g} rad/sqrt(s)")
    if noise.position_std:
        texts.append(f"measured position {noise.position_std:.3g} {analysis.setup.unit}")
    if noise.heading_std:
        texts.append(f"measured heading {noise.heading_std:.3g} rad")
    text = ", ".join(texts) or "none"
    if analysis.left_out:
        text += f" (without {', '.join(analysis.left_out)}, which the plant also has)"
    return text


def _shortest(analysis: Analysis) -> str:
    steering = analysis.steering
    if steering is None:
        return NO_PLAN
    return f"{steering.shortest}, {steering.shortest * steering.signal_s:.3g} s"


def as_json(analysis: Analysis) -> dict[str, Any]:
    """Return an analysis as the items of a JSON object; unknown values are None."""
    steering = analysis.steering
    return {
        "name": analysis.setup.name,
        "unit": analysis.setup.unit,
        "prediction": PREDICTED,
        "noise": analysis.noise,
        "not_in_the_prediction": list(analysis.left_out),
        "reach": analysis.reach and analysis.reach.fields,
        "plans": analysis.plans,
        "plans_that_reach": _reaching(analysis),
        "tolerance": analysis.tolerance,
        "fewest_signals": steering and steering.shortest,
        "signal_s": steering and steering.signal_s,
        "mean_total_error": steering and steering.error,
        "mean_total_error_by_plan": steering and steering.errors,
        "without_feedback_by_plan": steering and steering.open_loop,
        "without_noise_by_plan": steering and steering.planned,
        "signals": steering and steering.signals,
        "singular_values": steering and steering.singular,
        "robots": [_robot(analysis, i) for i in range(len(analysis.setup.names))],
        "smallest_gap": analysis.gap if analysis.alike else None,
        "most_alike": list(analysis.alike or ()),
        "by_gap": [{"gap": gap, "mean_total_error": error} for gap, error in analysis.by_gap],
        "by_robots": [{"robots": n, "mean_total_error": error} for n, error in analysis.by_count],
        "change": analysis.change,
    }


def _robot(analysis: Analysis, i: int) -> dict[str, Any]:
    """Return the items of robot i."""
    setup = analysis.setup
    items: dict[str, Any] = {"name": setup.names[i], "a": setup.a[i], "speed": setup.speed[i]}
    steering = analysis.steering
    if steering is not None:
        items["mean_error"] = steering.robot_errors[i]
        items["end_covariance"] = steering.covariance[i]
        items["end_covariance_without_feedback"] = steering.free_covariance[i]
        items["share_of_weakest_direction"] = steering.weakest[i]
    return items


def advice(analysis: Analysis) -> str:
    """Return the advice on the spec, in one line."""
    steering = analysis.steering
    change = analysis.change
    if steering is None and change is None:
        return f"advice: {NO_PLAN}; raise controller.horizon_max, or choose nearer targets"
    if analysis.alike is None:
        return "advice: none is needed for a single robot"
    low, high = analysis.alike
    if change is not None:
        now = NO_PLAN if steering is None else f"{steering.error:.4g}"
        return (
            f"advice: {low} and {high} are too alike; change a of {change.robot} from "
            f"{change.a:g} to {change.a_advised:g}: predicted mean total error "
            f"{change.mean_total_error:.4g} "
            f"{analysis.setup.unit} in place of {now}"
        )
    if analysis.looked:
        return (
            f"advice: {low} and {high} are alike, but changing a of either lowers the predicted "
            f"error by less than {100 * (1 - WORTH):.0f} %"
        )
    return f"advice: none; every two robots differ in a by {100 * TOO_ALIKE:.0f} % or more"
