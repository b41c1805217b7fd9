"""The firmware core of a coil driver, compiled for this computer."""

import ctypes
import struct
from dataclasses import astuple, dataclass

from tetractl_microscope.coils.driver import UNKNOWN_TEMPERATURE, DriverStatus

from tetractl_emulator.firmware import Core, Library


@dataclass(frozen=True, slots=True)
class DriverLimits:
    """The limits built into a coil driver.

    Attributes:
        current_max_ma: Maximum current of a coil pair [mA].
        slew_ma_s: Maximum rate of change of a coil pair's current [mA/s].
        watchdog_ms: Time without a command after which the driver stops [ms].
        temperature_max_dc: Temperature at which the driver stops [0.1 degrees Celsius].
    """

    current_max_ma: int
    slew_ma_s: int
    watchdog_ms: int = 250
    temperature_max_dc: int = 800


class DriverCore(Core):
    """The firmware core of a coil driver that is switched on at a given time.

    Args:
        limits: The limits built into the driver.
        now_ms: The present time [ms].
        library: The functions of the core. None to load them.
    """

    name = "field"
    reply_size = 28
    number = ctypes.c_int32

    def __init__(
        self, limits: DriverLimits, now_ms: int = 0, library: Library | None = None
    ) -> None:
        super().__init__(library)
        self._call("init", struct.pack("@HIHh", *astuple(limits)), now_ms)  # field_limits

    def currents_ua(self, now_ms: int) -> tuple[int, int]:
        """Return the present set points of the x and y currents [uA].

        The watchdog and the limit on the rate of change are applied.
        """
        return self._pair("currents", now_ms)

    def measured(
        self, x_ma: int, y_ma: int, supply_mv: int = 0, temperature_dc: int = UNKNOWN_TEMPERATURE
    ) -> None:
        """Set the values that the driver has measured.

        If the temperature reaches its limit, the driver stops until it is power-cycled.

        Args:
            x_ma: Current of the x coils [mA].
            y_ma: Current of the y coils [mA].
            supply_mv: Supply voltage [mV].
            temperature_dc: Temperature [0.1 degrees Celsius].
        """
        self._call("measured", x_ma, y_ma, supply_mv, temperature_dc)

    def status(self, now_ms: int) -> DriverStatus:
        """Return the status flags that a reply would contain now."""
        return DriverStatus(self._call("status", now_ms))
