"""The response of a robot to commands of speed and turning rate, and a table of responses.

Values are printed with their 95 % intervals. Sentences below the table name values that the data do
not determine, and values that are unusual (`unusual`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.tools.likelihood import SampleInterval
from tetractl.tools.table.table import Column, Table
from tetractl_identify.explained import Explained
from tetractl_identify.identify import cell, create_row_labels
from tetractl_identify.unusual import (
    GAINS,
    USUAL_RANGES,
    describe_undetermined_values,
    describe_unusual_values,
    may_be_usual,
)

LAG_ERROR_MAX_S = 0.02
"""Maximum error of a lag that is useful in a spec [s]."""
LAG_MIN_S = 1e-3
"""Minimum of a fitted lag, and of an interval's width in the weight of a lag [s]."""
LAG_MAX_S = 10.0
"""Maximum of a fitted lag, and of an interval's width in the weight of a lag [s]."""
DRIFT_MIN_S = 0.1
"""Minimum difference of two clocks at the end of a recording that the table reports [s]."""
CHECKED_VALUES = ("dead_time", "turning_lag", "speed_lag", *GAINS, "veer")
"""Names of the values for which the table reports whether the data determine them."""


@dataclass(frozen=True, slots=True)
class RobotResponse:
    """How one robot follows its commands. For the noise, see the fields of `FittedRobot`.

    Attributes:
        name: The robot.
        turning_gain: Turning rate, divided by the commanded one.
        speed_gain: Speed, divided by the commanded one.
        veer: Turn per distance travelled when the commanded turning rate is 0 [rad/length unit].
        heading_offset: Angle from the heading to the motion when the robot drives straight ahead
            [rad].
        clock_drift: How fast the clock of the commands gains on the clock of the poses [s/s]. None
            if both have the same clock.
        turning_explained: How much of the turning the commands explain.
        distance_explained: How much of the distance travelled the commands explain.
        duration_s: Duration of the recording, or of the longest if there are several [s].
        intervals: Number of steps used.
        left_out: Number of steps left out because they are too far off.
    """

    name: str
    dead_time: SampleInterval
    turning_lag: SampleInterval
    speed_lag: SampleInterval
    turning_gain: SampleInterval
    speed_gain: SampleInterval
    veer: SampleInterval
    heading_offset: SampleInterval
    heading_walk: SampleInterval
    heading_noise: SampleInterval
    way_walk: SampleInterval
    position_noise: SampleInterval
    clock_drift: SampleInterval | None
    turning_explained: Explained
    distance_explained: Explained
    duration_s: float
    intervals: int
    left_out: int

    @property
    def quantities(self) -> dict[str, SampleInterval]:
        """The values by name, in the order of a table's rows. Values that are None are left out."""
        values = {name: getattr(self, name) for name in UNITS}
        return {name: value for name, value in values.items() if value is not None}

    @property
    def problem(self) -> str:
        """Description of the motion that contradicts the commands. Empty if none does."""
        turns = self.turning_explained.is_contradicted(
            may_be_usual("turning_gain", self.turning_gain)
        )
        drives = self.distance_explained.is_contradicted(
            may_be_usual("speed_gain", self.speed_gain)
        )
        turning_problem = f"{self.turning_explained} of the turning" if turns else ""
        distance_problem = f"{self.distance_explained} of the distance travelled" if drives else ""
        return " and ".join(filter(None, (turning_problem, distance_problem)))


UNITS = {
    "dead_time": "s",
    "turning_lag": "s",
    "speed_lag": "s",
    "turning_gain": "",
    "speed_gain": "",
    "veer": "rad/{unit}",
    "heading_offset": "rad",
    "heading_walk": "rad/sqrt(s)",
    "heading_noise": "rad",
    "way_walk": "{unit}/sqrt(s)",
    "position_noise": "{unit}",
    "clock_drift": "s/s",
}
"""The units of `quantities`; {unit} is the tracks' unit of length."""


def create_response_table(responses: Sequence[RobotResponse], title: str, unit: str) -> Table:
    """Create a table of the identified values, with a column per robot and a row per value.

    Each value has its 95 % interval. Three more rows have none: how much of the turning and of the
    distance the commands explain, and how many steps were left out. Notes below the table give a
    lag for the spec, and list undetermined and unusual values.

    Args:
        responses: The robots' responses, at least one. All must have a clock drift, or none.
        title: The title of the table.
        unit: The length unit.
    """
    units = {name: UNITS[name] for name in responses[0].quantities}
    labels = [
        *create_row_labels(units, unit),
        "turning explained",
        "distance explained",
        "left out",
    ]
    columns = [Column("quantity", labels)]
    for robot in responses:
        values = [cell(value) for value in robot.quantities.values()]
        left_out = f"{robot.left_out} of {robot.left_out + robot.intervals}"
        explained_cells = [str(robot.turning_explained), str(robot.distance_explained)]
        columns.append(Column(robot.name, [*values, *explained_cells, left_out]))
    values_by_robot = [(robot.name, robot.quantities) for robot in responses]
    drift_min = DRIFT_MIN_S / max(robot.duration_s for robot in responses)
    usual_range_by_name = USUAL_RANGES | {"clock_drift": (-drift_min, drift_min)}
    notes = [
        _describe_lag_for_spec(responses),
        describe_undetermined_values(values_by_robot, CHECKED_VALUES),
        describe_unusual_values(values_by_robot, usual_range_by_name),
    ]
    return Table(title, tuple(columns), "\n".join(note for note in notes if note))


def _describe_lag_for_spec(responses: Sequence[RobotResponse]) -> str:
    """Describe the value of a spec's lag that fits all robots.

    The value is the mean lag of turning, weighted by precision, because a host steers by turning.
    The text is empty if the lag is not known well enough to be useful.
    """
    lags_s = np.array([robot.turning_lag.value for robot in responses])
    widths_s = np.array([robot.turning_lag.high - robot.turning_lag.low for robot in responses])
    weights = 1 / np.clip(widths_s, LAG_MIN_S, LAG_MAX_S)
    mean_lag_s = float(np.average(lags_s, weights=weights))
    if not (widths_s / 2 <= LAG_ERROR_MAX_S).all():
        return ""
    if not (abs(lags_s - mean_lag_s) <= LAG_ERROR_MAX_S).all():
        return (
            f"the robots' lags differ by more than {LAG_ERROR_MAX_S:g} s, so that no single lag "
            "fits them all"
        )
    return f"lag of turning, to put into a spec: lab.lag={mean_lag_s:.3f} (simulated: wheels.lag)"
