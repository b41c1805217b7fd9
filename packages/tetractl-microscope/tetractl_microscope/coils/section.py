"""The section of the spec for a field of two coil pairs: `actuator: {type: field, ...}`.

Along a coil pair's axis, the field is the ambient field, `offset`, plus gain * current. With c the
field in the coils' axes, and the x pair's axis turned by `rotation` from the spec's x axis,

    c = offset + gain * current,    field = R(rotation) c.
"""

import math
from collections.abc import Iterator
from typing import ClassVar, Literal, Self

from pydantic import Field, field_validator, model_validator

from tetractl.core.setup import Setup
from tetractl.spec.base import Angle, Finite, Model, NonNegative, Positive, inconsistent
from tetractl.spec.lab_section import ActuatorSection
from tetractl.spec.yaml.problems import Loc

Pair = tuple[float, float]  # x and y, in the coils' axes for currents and in the spec's for fields


def step_towards(present: Pair, target: Pair, step_max: float) -> Pair:
    """Compute the coil currents after one step straight towards the target currents.

    Args:
        present: The present currents.
        target: The wanted currents. They are returned if one step reaches them.
        step_max: Maximum change of each component.
    """
    dx = target[0] - present[0]
    dy = target[1] - present[1]
    largest_change = max(abs(dx), abs(dy))
    if largest_change <= step_max:
        return target
    return present[0] + dx * step_max / largest_change, present[1] + dy * step_max / largest_change


FRAMES_PER_WATCHDOG = 3


class CoilPair(Model):
    """A coil pair in a spec. The field along its axis is offset + gain * current."""

    gain_mt_a: Finite
    """Field per current [mT/A]; negative if the winding is reversed."""
    offset_mt: Finite = 0.0
    """Ambient field along the pair's axis [mT], such as the earth's; the current cancels it."""

    @field_validator("gain_mt_a")
    @classmethod
    def _makes_a_field(cls, gain: float) -> float:
        if gain == 0:
            raise ValueError("must not be 0, because a coil with gain 0 makes no field")
        return gain


class CoilsSection(Model):
    """The two orthogonal coil pairs that make the field."""

    x: CoilPair
    """The pair whose axis is the spec's x axis turned by `rotation`."""
    y: CoilPair
    """The coil pair whose axis is 90 degrees anticlockwise from that of pair x."""
    rotation: Angle = 0.0
    """Angle from the spec's x axis to the x pair's axis [rad]."""

    def reach(self, direction: float, current_max_a: float) -> float:
        """Compute the maximum field strength in a direction.

        Args:
            direction: Direction of the field [rad].
            current_max_a: Limit of each current [A]. It must be high enough to cancel the ambient
                field.

        Returns:
            The strength [mT].
        """
        strength_mt = math.inf
        for axis, pair in zip(self._axes(direction), (self.x, self.y), strict=True):
            offset_mt = math.copysign(pair.offset_mt, pair.offset_mt * axis)
            if axis:
                available_mt = abs(pair.gain_mt_a) * current_max_a + offset_mt
                strength_mt = min(strength_mt, available_mt / abs(axis))
        return strength_mt

    def least_reach(self, current_max_a: float) -> float:
        """Compute the field strength [mT] that can be reached in every direction.

        Args:
            current_max_a: Limit of each current [A].
        """
        pairs = self.x, self.y
        return min(abs(pair.gain_mt_a) * current_max_a - abs(pair.offset_mt) for pair in pairs)

    def currents(self, direction: float, strength: float, current_max_a: float) -> Pair:
        """Compute the coil currents (x, y) [A] for a field.

        If a current would exceed the limit, the strength is reduced and the direction is kept.

        Args:
            direction: Direction of the field [rad].
            strength: Strength of the field [mT].
            current_max_a: Limit of each current [A].
        """
        strength = min(strength, self.reach(direction, current_max_a))
        along_x, along_y = self._axes(direction)
        x = self.x
        y = self.y
        return (
            (strength * along_x - x.offset_mt) / x.gain_mt_a,
            (strength * along_y - y.offset_mt) / y.gain_mt_a,
        )

    def field(self, currents: Pair) -> Pair:
        """Compute the field (x, y) [mT] of the coil currents (x, y) [A], along the spec's axes."""
        pairs_with_currents = zip((self.x, self.y), currents, strict=True)
        x, y = (pair.offset_mt + pair.gain_mt_a * current for pair, current in pairs_with_currents)
        cos = math.cos(self.rotation)
        sin = math.sin(self.rotation)
        return cos * x - sin * y, sin * x + cos * y

    def _axes(self, direction: float) -> Pair:
        """Return the unit vector along a direction [rad] of the spec, in the coils' axes."""
        return math.cos(direction - self.rotation), math.sin(direction - self.rotation)


class FieldSection(ActuatorSection):
    """A magnetic field steers all cells; a current driver on a serial port feeds the coils."""

    device: ClassVar[str] = "tetractl_microscope.coils.actuator:FieldActuator"
    checks: ClassVar[str] = "tetractl_microscope.cell_checks:cell_checks"
    stopping: ClassVar[str] = "tetractl_microscope.coils.actuator:stop_all"
    settles: ClassVar[bool] = True
    type: Literal["field"]
    port: str = Field(min_length=1, max_length=500)
    """The serial port, such as /dev/ttyACM0."""
    baud: Literal[9600, 19200, 38400, 57600, 115200] = 115200
    """Bits per second on the port."""
    rate: float = Field(default=40.0, ge=10, le=120, allow_inf_nan=False)
    """Rate of commands [Hz]."""
    strength_mt: Positive | None = None
    """Field strength at which cells turn at the rate `a` [mT], unless the spec states its
    `strength`. The current limit may reduce it.
    """
    coils: CoilsSection
    """The coils, as measured with a field probe at the position of the cells."""
    current_max_a: float = Field(gt=0, le=32, allow_inf_nan=False)
    """Maximum magnitude of the current in each coil pair [A]."""
    slew_max_a_s: float = Field(ge=1, le=10_000, allow_inf_nan=False)
    """Maximum rate of change of each current [A/s]."""
    watchdog: float = Field(default=0.25, ge=0.05, le=5, allow_inf_nan=False)
    """Time without a command after which the driver's firmware switches the field off [s]."""
    supply_min_v: NonNegative = 0.0
    """A run does not start below this supply voltage of the driver [V]; 0 disables the test."""

    @model_validator(mode="after")
    def _limits_agree(self) -> Self:
        for name, pair in (("x", self.coils.x), ("y", self.coils.y)):
            if abs(pair.offset_mt) >= abs(pair.gain_mt_a) * self.current_max_a:
                message = f"is too small to cancel the ambient field coils.{name}.offset_mt"
                raise inconsistent("current_max_a", message)
        if self.rate * self.watchdog < FRAMES_PER_WATCHDOG:
            watchdog_min_s = FRAMES_PER_WATCHDOG / self.rate
            raise inconsistent(
                "watchdog", f"must be {watchdog_min_s:.3g} s or more at {self.rate:g} Hz"
            )
        return self

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield the location and a message for each contradiction with the spec's strength."""
        if setup.strength is not None and setup.strength_unit != "mT":
            yield (
                (),
                (
                    "needs a strength in mT, because coils make a magnetic field; the spec's "
                    f"strength is in {setup.strength_unit}"
                ),
            )
        if setup.strength is None and self.strength_mt is None:
            yield (), "needs the field's strength: add strength [mT] to the spec"
        if setup.strength is not None and self.strength_mt is not None:
            yield (
                ("strength_mt",),
                "repeats a value that the spec's strength already gives; remove one of them",
            )

    def reference_mt(self, setup: Setup) -> float:
        """Return the field strength at which cells turn at the setup's rates [mT].

        The setup's strength comes first, then the section's `strength_mt`. NaN if neither
        is given.
        """
        return setup.strength or self.strength_mt or math.nan

    def require_port(self) -> None:
        """Check that the serial port of the driver exists.

        Raises:
            AbortError: If it does not exist.
        """
        from tetractl.lab.serial_port import require_port

        require_port(self.port, "the current driver")

    def bounds(self) -> dict[str, str]:
        """Describe the driver and its limits for display.

        Returns:
            Two entries: "current driver" maps to the port and the command rate, and "coil currents"
            to the maximum current.
        """
        return {
            "current driver": f"{self.port}, {self.rate:g} commands per second",
            "coil currents": f"at most {self.current_max_a:g} A",
        }
