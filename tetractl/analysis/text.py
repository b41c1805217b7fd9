"""An analysis in words and numbers, for people and as JSON."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from tetractl.analysis.analyze import TOO_ALIKE, WORTH, Analysis
from tetractl.core.poses import Floats

SAYS = "predicted by a linearised closed loop along good plans; nothing was run"
INSIDE = math.sqrt(2 * math.log(20))
"""Deviations to the edge of the ellipse that holds 95 % of a normal distribution in the plane."""


def lines(found: Analysis) -> Iterator[str]:
    """Yield the lines of an analysis."""
    setup, here, unit = found.setup, found.steering, found.setup.unit
    count, names = len(here.errors), setup.names
    robots = f"{len(names)} robot{'s' * (len(names) > 1)}"
    yield f"{setup.name}: {robots}, {SAYS}"
    yield f"  noise assumed               {_noise(found)}"
    yield f"  plans that reach            {here.reaching} of {count}, to {found.tolerance:g} {unit}"
    yield f"  fewest signals that reach   {_shortest(found)}"
    if found.alike:
        low, high = found.alike
        yield f"  smallest difference of a    {100 * found.gap:.3g} % ({low}, {high})"
    plans = f"{count} plan{'s' * (count > 1)}"
    yield f"mean total error [{unit}], the median of {plans} and their range"
    for name, values in (
        ("with feedback", here.errors),
        ("without feedback", here.open_loop),
        ("without noise", here.planned),
    ):
        low, high = float(values.min()), float(values.max())
        yield f"  {name:<18} {np.median(values):10.3f}   {low:.3f} to {high:.3f}"
    yield f"along the plan of the median error, {here.signals} signals"
    values = " ".join(f"{value:.3g}" for value in here.singular)
    yield f"  singular values of the ends by the signals [{unit}/rad]: {values}"
    shares = zip(names, here.weakest, strict=True)
    shown = ", ".join(f"{name} {100 * share:.0f} %" for name, share in shares)
    yield f"  hardest to correct: {shown}"
    yield f"  {'robot':<12} {'mean error':>10}   95 % ellipse: half axes [{unit}], angle [deg]"
    for i, name in enumerate(names):
        long, short, angle = ellipse(here.covariance[i])
        axes = f"{long:.3g} x {short:.3g}, {math.degrees(angle):.0f}"
        yield f"  {name:<12} {here.robot_errors[i]:10.3f}   {axes}"
    if found.by_gap:
        yield f"smallest relative difference of a against the mean total error [{unit}]"
        yield "  " + "  ".join(f"{100 * gap:g} %: {error:.4g}" for gap, error in found.by_gap)
        yield f"number of robots, the first of the spec, against the mean total error [{unit}]"
        yield "  " + "  ".join(f"{n}: {error:.4g}" for n, error in found.by_count)
    yield _advice(found)


def as_json(found: Analysis) -> dict[str, Any]:
    """Return an analysis as the items of a JSON object; what is not known is None."""
    setup, here, noise = found.setup, found.steering, found.noise
    robots = [
        {
            "name": name,
            "a": float(setup.a[i]),
            "speed": float(setup.speed[i]),
            "mean_error": float(here.robot_errors[i]),
            "end_covariance": here.covariance[i].tolist(),
            "end_covariance_without_feedback": here.free_covariance[i].tolist(),
            "share_of_weakest_direction": float(here.weakest[i]),
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
        "mean_total_error_by_plan": here.errors.tolist(),
        "without_feedback_by_plan": here.open_loop.tolist(),
        "without_noise_by_plan": here.planned.tolist(),
        "signals": here.signals,
        "singular_values": here.singular.tolist(),
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


def _advice(found: Analysis) -> str:
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
