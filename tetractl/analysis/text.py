"""An analysis as tables and as JSON."""

import math
from typing import Any

import numpy as np

from tetractl.analysis.analyze import TOO_ALIKE, WORTH, Analysis
from tetractl.core.poses import Floats
from tetractl.core.table.numbers import fixed
from tetractl.core.table.table import Column, Table

SAYS = "predicted by a linearised closed loop along good plans; nothing was run"
INSIDE = math.sqrt(2 * math.log(20))
"""Deviations to the edge of the ellipse that holds 95 % of a normal distribution in the plane."""


def tables(found: Analysis) -> list[Table]:
    """Return the tables of an analysis; `advice` belongs below them."""
    setup, here, unit = found.setup, found.steering, found.setup.unit
    names, robots = setup.names, f"{len(setup.names)} robot{'s' * (len(setup.names) > 1)}"
    shares = zip(names, here.weakest, strict=True)
    facts = [
        ("noise assumed", _noise(found)),
        (
            "plans that reach",
            f"{here.reaching} of {len(here.errors)}, to {found.tolerance:g} {unit}",
        ),
        ("fewest signals that reach", _shortest(found)),
    ]
    if found.alike:
        facts.append(
            ("smallest difference of a", f"{100 * found.gap:.3g} % ({', '.join(found.alike)})")
        )
    facts += [
        (
            f"singular values of the ends by the {here.signals} signals [{unit}/rad]",
            " ".join(f"{value:.3g}" for value in here.singular),
        ),
        ("hardest to correct", ", ".join(f"{name} {100 * share:.0f} %" for name, share in shares)),
    ]
    plans = f"{len(here.errors)} plan{'s' * (len(here.errors) > 1)}"
    errors = (here.errors, here.open_loop, here.planned)
    axes = [ellipse(one) for one in here.covariance]
    found_tables = [
        Table.of_texts(f"{setup.name}: {robots}, {SAYS}", ("figure", "value"), facts),
        Table(
            f"Mean total error of {plans}",
            (
                Column("error", ["with feedback", "without feedback", "without noise"], unit),
                Column("median", [float(np.median(values)) for values in errors], "", fixed(3)),
                Column("min", [float(values.min()) for values in errors], "", fixed(3)),
                Column("max", [float(values.max()) for values in errors], "", fixed(3)),
            ),
        ),
        Table(
            f"Along the plan of the median error, {here.signals} signals, with 95 % ellipses",
            (
                Column("robot", names),
                Column("mean error", here.robot_errors, unit, fixed(3)),
                Column("long half axis", [one[0] for one in axes], unit, "{:.3g}".format),
                Column("short half axis", [one[1] for one in axes], unit, "{:.3g}".format),
                Column("angle", [math.degrees(one[2]) for one in axes], "deg", fixed(0)),
            ),
        ),
    ]
    if found.by_gap:
        gaps, by_gap = zip(*found.by_gap, strict=True)
        counts, by_count = zip(*found.by_count, strict=True)
        error = "mean total error"
        found_tables += [
            Table(
                "With other values of a, the same ratio between neighbours",
                (
                    Column("smallest relative difference", gaps, "", _percent),
                    Column(error, by_gap, unit, "{:.4g}".format),
                ),
            ),
            Table(
                "The first robots of the spec alone",
                (Column("robots", counts), Column(error, by_count, unit, "{:.4g}".format)),
            ),
        ]
    return found_tables


def _percent(share: float) -> str:
    return f"{100 * share:g} %"


def as_json(found: Analysis) -> dict[str, Any]:
    """Return an analysis as the items of a JSON object; what is not known is None."""
    setup, here, noise = found.setup, found.steering, found.noise
    robots = [
        {
            "name": name,
            "a": setup.a[i],
            "speed": setup.speed[i],
            "mean_error": here.robot_errors[i],
            "end_covariance": here.covariance[i],
            "end_covariance_without_feedback": here.free_covariance[i],
            "share_of_weakest_direction": here.weakest[i],
        }
        for i, name in enumerate(setup.names)
    ]
    change = found.change
    return {
        "name": setup.name,
        "unit": setup.unit,
        "prediction": SAYS,
        "noise": {
            "a_std": noise.a,
            "speed_std": noise.speed,
            "heading_walk": noise.walk,
            "position_std": noise.position,
            "heading_std": noise.heading,
        },
        "not_in_the_prediction": list(found.left_out),
        "plans": len(here.errors),
        "plans_that_reach": here.reaching,
        "tolerance": found.tolerance,
        "fewest_signals": here.shortest,
        "signal_s": here.signal_s,
        "mean_total_error": here.error,
        "mean_total_error_by_plan": here.errors,
        "without_feedback_by_plan": here.open_loop,
        "without_noise_by_plan": here.planned,
        "signals": here.signals,
        "singular_values": here.singular,
        "robots": robots,
        "smallest_gap": found.gap if found.alike else None,
        "most_alike": list(found.alike or ()),
        "by_gap": [{"gap": gap, "mean_total_error": error} for gap, error in found.by_gap],
        "by_robots": [{"robots": n, "mean_total_error": error} for n, error in found.by_count],
        "change": change
        and {
            "robot": change.robot,
            "a": change.old,
            "a_advised": change.new,
            "mean_total_error": change.error,
        },
    }


def ellipse(covariance: Floats) -> tuple[float, float, float]:
    """Return half axes [length unit] and angle [rad] of the ellipse that holds 95 % of a normal
    distribution of a covariance (2, 2).
    """
    values, vectors = np.linalg.eigh(covariance)
    short, long = INSIDE * np.sqrt(np.maximum(values, 0.0))
    along = vectors[:, 1]
    angle = float(np.arctan2(along[1], along[0]))
    return float(long), float(short), math.remainder(angle, math.pi)


def _noise(found: Analysis) -> str:
    noise, unit = found.noise, found.setup.unit
    told = [
        (noise.a, f"a {100 * noise.a:.2g} %"),
        (noise.speed, f"speed {100 * noise.speed:.2g} %"),
        (noise.walk, f"heading {noise.walk:.3g} rad/sqrt(s)"),
        (noise.position, f"measured position {noise.position:.3g} {unit}"),
        (noise.heading, f"measured heading {noise.heading:.3g} rad"),
    ]
    words = ", ".join(text for value, text in told if value) or "none"
    if found.left_out:
        words += f" (not {', '.join(found.left_out)}, which the plant has too)"
    return words


def _shortest(found: Analysis) -> str:
    signals = found.steering.shortest
    if signals is None:
        return "none does"
    return f"{signals}, {signals * found.steering.signal_s:.3g} s"


def advice(found: Analysis) -> str:
    """Return what to change in the spec, in one line."""
    unit, error = found.setup.unit, found.steering.error
    if found.alike is None:
        return "advice: none is needed; one robot is alone"
    low, high = found.alike
    change = found.change
    if change:
        was, now = f"{change.old:g}", f"{change.new:g}"
        return (
            f"advice: {low} and {high} are too alike; change a of {change.robot} from {was} to "
            f"{now}: predicted mean total error {change.error:.4g} {unit} in place of {error:.4g}"
        )
    if found.looked:
        return (
            f"advice: {low} and {high} are alike, but no other a of one of them lowers the "
            f"predicted error by {100 * (1 - WORTH):.0f} %"
        )
    return f"advice: none; every two robots differ in a by {100 * TOO_ALIKE:.0f} % or more"
