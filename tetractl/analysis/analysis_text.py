"""The result of `tetractl analyze` as tables and as JSON."""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from tetractl.analysis.analyze import TOO_ALIKE, WORTH, Analysis
from tetractl.core.poses import ellipse
from tetractl.core.table.table import Column, Table, fixed

NO_PLAN = "no plan found"
SAYS = "errors predicted by a linearised closed loop; no trial was run"


def tables(found: Analysis) -> list[Table]:
    """Return the tables of an analysis, without the line from `advice`."""
    setup, here, unit = found.setup, found.steering, found.setup.unit
    reaching = 0 if here is None else len(here.errors)
    names, robots = setup.names, f"{len(setup.names)} robot{'s' * (len(setup.names) > 1)}"
    facts = [
        ("noise assumed", _noise(found)),
        ("plans that reach", f"{reaching} of {found.plans}, to {found.tolerance:g} {unit}"),
        ("fewest signals that reach", _shortest(found)),
    ]
    if found.reach:
        facts.insert(0, ("reach of the signal", str(found.reach)))
    if found.alike:
        facts.append(
            ("smallest difference of a", f"{100 * found.gap:.3g} % ({', '.join(found.alike)})")
        )
    if setup.hold is not None and setup.wheel_radius is None:
        least = setup.speed / setup.a.min()
        circles = ", ".join(f"{name} {r:.3g}" for name, r in zip(names, least, strict=True))
        facts.append((f"radii of the smallest circles, v / least a [{unit}]", circles))
    title = f"{setup.name}: {robots}, {SAYS}"
    if here is None:
        return [Table.of_texts(title, ("figure", "value"), facts), *_maps(found)]
    shares = zip(names, here.weakest, strict=True)
    facts += [
        (
            f"singular values of d(ends)/d({here.signals} signals) [{unit}/rad]",
            " ".join(f"{value:.3g}" for value in here.singular),
        ),
        ("hardest to correct", ", ".join(f"{name} {100 * share:.0f} %" for name, share in shares)),
    ]
    plans = f"{len(here.errors)} plan{'s' * (len(here.errors) > 1)}"
    errors = (here.errors, here.open_loop, here.planned)
    axes = [ellipse(one) for one in here.covariance]
    found_tables = [
        Table.of_texts(title, ("figure", "value"), facts),
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
            f"Plan with the median error ({here.signals} signals), with 95 % ellipses",
            (
                Column("robot", names),
                Column("mean error", here.robot_errors, unit, fixed(3)),
                Column("long half axis", [one[0] for one in axes], unit, "{:.3g}".format),
                Column("short half axis", [one[1] for one in axes], unit, "{:.3g}".format),
                Column("angle", [math.degrees(one[2]) for one in axes], "deg", fixed(0)),
            ),
        ),
    ]
    return [*found_tables, *_maps(found)]


def _maps(found: Analysis) -> list[Table]:
    """Return tables of the predicted error for other turning rates a, and for fewer robots."""
    if not found.by_gap:
        return []

    def column(errors: Iterable[tuple[float, float]]) -> Column:
        texts = [NO_PLAN if math.isnan(error) else f"{error:.4g}" for _, error in errors]
        return Column("mean total error", texts, found.setup.unit)

    gaps = [gap for gap, _ in found.by_gap]
    gap = Column("smallest relative difference", gaps, "", lambda gap: f"{100 * gap:g} %")
    count = Column("robots", [count for count, _ in found.by_count])
    return [
        Table("With other turning rates a, in equal ratios", (gap, column(found.by_gap))),
        Table("With only the first robots of the spec", (count, column(found.by_count))),
    ]


def as_json(found: Analysis) -> dict[str, Any]:
    """Return an analysis as the items of a JSON object; unknown values are None."""
    setup, here, noise = found.setup, found.steering, found.noise
    columns: dict[str, Iterable[Any]] = {"name": setup.names, "a": setup.a, "speed": setup.speed}
    if here is not None:
        columns["mean_error"] = here.robot_errors
        columns["end_covariance"] = here.covariance
        columns["end_covariance_without_feedback"] = here.free_covariance
        columns["share_of_weakest_direction"] = here.weakest
    rows = zip(*columns.values(), strict=True)
    robots = [dict(zip(columns, one, strict=True)) for one in rows]
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
        "reach": found.reach and found.reach.fields,
        "plans": found.plans,
        "plans_that_reach": 0 if here is None else len(here.errors),
        "tolerance": found.tolerance,
        "fewest_signals": here and here.shortest,
        "signal_s": here and here.signal_s,
        "mean_total_error": here and here.error,
        "mean_total_error_by_plan": here and here.errors,
        "without_feedback_by_plan": here and here.open_loop,
        "without_noise_by_plan": here and here.planned,
        "signals": here and here.signals,
        "singular_values": here and here.singular,
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


def _noise(found: Analysis) -> str:
    noise, unit = found.noise, found.setup.unit
    known = [
        (noise.a, f"a {100 * noise.a:.2g} %"),
        (noise.speed, f"speed {100 * noise.speed:.2g} %"),
        (noise.walk, f"heading {noise.walk:.3g} rad/sqrt(s)"),
        (noise.position, f"measured position {noise.position:.3g} {unit}"),
        (noise.heading, f"measured heading {noise.heading:.3g} rad"),
    ]
    words = ", ".join(text for value, text in known if value) or "none"
    if found.left_out:
        words += f" (without {', '.join(found.left_out)}, which the plant also has)"
    return words


def _shortest(found: Analysis) -> str:
    here = found.steering
    if here is None or here.shortest is None:
        return NO_PLAN
    return f"{here.shortest}, {here.shortest * here.signal_s:.3g} s"


def advice(found: Analysis) -> str:
    """Return the advice on the spec, in one line."""
    unit, here = found.setup.unit, found.steering
    if here is None and found.change is None:
        return f"advice: {NO_PLAN}; raise controller.horizon_max, or choose nearer targets"
    if found.alike is None:
        return "advice: none is needed for a single robot"
    low, high = found.alike
    change = found.change
    if change:
        was, new = f"{change.old:g}", f"{change.new:g}"
        now = NO_PLAN if here is None else f"{here.error:.4g}"
        return (
            f"advice: {low} and {high} are too alike; change a of {change.robot} from {was} to "
            f"{new}: predicted mean total error {change.error:.4g} {unit} in place of {now}"
        )
    if found.looked:
        return (
            f"advice: {low} and {high} are alike, but changing a of either lowers the predicted "
            f"error by less than {100 * (1 - WORTH):.0f} %"
        )
    return f"advice: none; every two robots differ in a by {100 * TOO_ALIKE:.0f} % or more"
