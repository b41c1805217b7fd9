"""What a current driver's reply says before a run, against the section of the spec."""

from tetractl.core.commands import Health
from tetractl.lab.actuators.field.protocol import (
    UNKNOWN_TEMPERATURE,
    VERSION,
    DriverStatus,
    FieldReply,
)
from tetractl.lab.actuators.field.section import FieldSection


def inspect(reply: FieldReply | None, section: FieldSection) -> Health:
    """Return what keeps a run from starting, what to warn of, and facts; None is no reply."""
    if reply is None:
        where = f"{section.port} at {section.baud} baud"
        return Health((f"no current driver answers on {where}: is it on?",))
    if reply.version != VERSION:
        text = f"the current driver speaks version {reply.version} of its protocol, not {VERSION}"
        return Health((text,))
    facts = {
        "field_driver_version": str(reply.version),
        "field_driver_current_max_a": f"{reply.current_max_ma / 1000:g}",
        "field_driver_slew_a_s": f"{reply.slew_ma_s / 1000:g}",
        "field_driver_watchdog_s": f"{reply.watchdog_ms / 1000:g}",
        "field_driver_frames_rejected": str(reply.rejected),
    }
    if reply.supply_mv:
        facts["field_driver_supply_v"] = f"{reply.supply_mv / 1000:g}"
    if reply.temperature_dc != UNKNOWN_TEMPERATURE:
        facts["field_driver_temperature_c"] = f"{reply.temperature_dc / 10:g}"
    problems = [*_limits(reply, section), *_state(reply, section)]
    return Health(tuple(problems), tuple(_warnings(reply, section)), facts)


def _limits(reply: FieldReply, section: FieldSection) -> list[str]:
    found: list[str] = []
    if reply.current_max_ma < round(1000 * section.current_max_a):
        allowed = f"{reply.current_max_ma / 1000:g} A, the spec {section.current_max_a:g} A"
        found.append(f"the current driver allows {allowed}: lower current_max_a")
    if reply.slew_ma_s < round(1000 * section.slew_max_a_s):
        allowed = f"{reply.slew_ma_s / 1000:g} A/s, the spec {section.slew_max_a_s:g} A/s"
        found.append(f"the current driver allows {allowed}: lower slew_max_a_s")
    if reply.watchdog_ms != round(1000 * section.watchdog):
        has = f"{reply.watchdog_ms / 1000:g} s, the spec's {section.watchdog:g} s"
        found.append(f"the current driver's watchdog is {has}")
    return found


def _state(reply: FieldReply, section: FieldSection) -> list[str]:
    found: list[str] = []
    if DriverStatus.HOT in reply.status:
        found.append("the current driver was stopped by its temperature: let the coils cool down")
    if DriverStatus.EMERGENCY_STOPPED in reply.status:
        found.append("the current driver is emergency-stopped: switch it off and on again")
    if reply.supply_mv and reply.supply_mv < 1000 * section.supply_min_v:
        found.append(f"the current driver's supply is at {reply.supply_mv / 1000:.2f} V")
    if UNKNOWN_TEMPERATURE != reply.temperature_dc >= 10 * section.temperature_max_c:
        found.append(f"the coils are at {reply.temperature_dc / 10:.0f} °C: let them cool down")
    return found


def _warnings(reply: FieldReply, section: FieldSection) -> list[str]:
    found: list[str] = []
    reach = section.calibrated_coils().least_reach()
    if reach < section.strength_mt:
        found.append(
            f"only {reach:.3g} of {section.strength_mt:g} mT can be had in every direction; in "
            "some, cells turn more slowly"
        )
    if reply.current_max_ma > round(1000 * section.current_max_a):
        found.append(
            f"the current driver itself allows {reply.current_max_ma / 1000:g} A: only this "
            f"program keeps to {section.current_max_a:g} A"
        )
    if section.supply_min_v and not reply.supply_mv:
        found.append("the current driver does not know its supply voltage")
    return found
