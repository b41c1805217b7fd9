"""What may go wrong on a day of a rehearsal: one table of faults, each with its weight, its draw,
and the reasons that name it rightly; and the draw of a day's schedule.

A fault acts on an emulated device by a script's fault, so a device of another package takes part by
rows of its own.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from random import Random
from typing import Any

SIGHT = (
    r"no new camera frame|no new frames|no frames|outdated|not tracked|too rarely|old on arrival"
    r"|watched long enough|before reception|no camera frame|not known: the camera|frames came"
    r"|no message came|no camera server answers"
)
MOTION = (
    r"moves? |turns? |does not move|drift together|off its commanded speed|radio slow"
    r"|camera or its origin|swapped|pose jumped|pose repeats|still moves|from its start|turned by"
)
PLACE = r"about to leave|about to enter|too close"
CELLS = r"respond to the field|divided, or has parted|not been known which cell|are needed"
CLOCK = r"server's clock|after reception|before reception"
RADIO = r"radio|\bport\b|does not answer|no XBee module answers|battery"
STOP_SHARE = 0.1  # of the faults that begin while robots stop, in a pause or at the end
FRAME_S = 1 / 120  # between two exposures of the emulated camera
STRONG = 0.9
"""Strength from which on a fault lasts to the end."""
SLEEPS_S = (3.0, 30.0)
"""Times for which a computer sleeps: less than a run, and more [s]."""
OUR_HZ = 40.0
"""Rate at which m3pi robots are sent commands by a spec that names none."""
SPAN_S = 11.0
"""Latest begin of a fault after the first command that moves robots [s]."""


@dataclass(frozen=True, slots=True)
class Draw:
    """The draw of one fault: `strength` is uniform in [0, 1). A length or a speed is that of a
    robot of 200 mm/s times `scale`.
    """

    random: Random
    names: tuple[str, ...]
    strength: float
    scale: float = 1.0

    def between(self, low: float, high: float) -> float:
        """Return a value from `low` to `high`, both above 0, by the strength, in equal ratios."""
        return float(f"{low * (high / low) ** self.strength:.4g}")

    def way(self, low: float, high: float) -> list[float]:
        """Return a vector of a length between two, in any direction."""
        angle = self.random.uniform(-math.pi, math.pi)
        length = self.between(low, high)
        x = length * math.cos(angle)
        y = length * math.sin(angle)
        return [round(x, 5), round(y, 5)]

    def off(self, low: float, high: float) -> list[float]:
        """Return a way as `way`, in the robots' scale."""
        return self.way(low * self.scale, high * self.scale)

    def signed(self, low: float, high: float) -> float:
        """Return a value as `between`, of either sign."""
        return self.random.choice((-1, 1)) * self.between(low, high)

    def robots(self) -> dict[str, Any]:
        """Return the fields `robot` and `other`, of two robots."""
        first, second = self.random.sample(self.names, 2)
        return {"robot": first, "other": second}

    def robot(self) -> dict[str, Any]:
        """Return the field `robot`."""
        return {"robot": self.random.choice(self.names)}

    def side(self) -> str:
        """Return a wheel."""
        return self.random.choice(("left", "right", "both"))


Fields = Callable[[Draw], dict[str, Any]]


@dataclass(frozen=True, slots=True)
class FaultRow:
    """A row of the table: a script's `fault` with drawn `fields`; reasons that match `right` are.

    One `at_once` has no duration. `weight` is relative.
    """

    name: str
    fault: str
    right: str
    fields: Fields = lambda d: {}
    at_once: bool = False
    weight: float = 1.0
    start: float = 0.1  # share of the days on which it is there from the start


def _kinds() -> Iterator[FaultRow]:
    sight = f"{SIGHT}|{PLACE}"
    moved = f"{MOTION}|{PLACE}|{SIGHT}"
    yield FaultRow("frames lost", "no_frames", SIGHT)
    yield FaultRow("server silent", "no_server", f"{SIGHT}|{CLOCK}")
    late = f"{sight}|{CLOCK}|{MOTION}"
    yield FaultRow("frames late", "late_frames", late, lambda d: {"by": d.between(0.003, 0.4)})
    yield FaultRow("frames doubled", "doubled_frames", r"$.", weight=0.5)
    yield FaultRow("frames reordered", "reordered", late, lambda d: {"by": d.between(0.002, 0.3)})
    yield FaultRow("frames frozen", "freeze", SIGHT)
    yield FaultRow(
        "frames slow", "slow_frames", moved, lambda d: {"rate": d.between(0.01, 1) ** -1}
    )
    yield FaultRow(
        "frames damaged",
        "bad_datagrams",
        f"damaged|{sight}",
        lambda d: {"share": min(1.0, d.between(0.005, 1.3))},
    )
    yield FaultRow(
        "frames of the past", "outdated", late, lambda d: {"by": d.between(0.05, 30), "frames": 50}
    )
    yield FaultRow(
        "other version",
        "other_version",
        f"damaged|{SIGHT}",
        lambda d: {"version": d.random.choice(("2.9", "3.0"))},
    )
    yield FaultRow("counter back", "counter_back", "counter", lambda d: {"frames": 30})
    yield FaultRow("edit mode", "edit_mode", "edit mode")
    for name in ("untracked", "nan", "bad_quaternion"):
        yield FaultRow(name, name, SIGHT, Draw.robot)
    part = "half_tracked"
    yield FaultRow("tracked in part", part, SIGHT, lambda d: d.robot() | _lost(d))
    yield FaultRow("pose frozen", "repeat", moved, Draw.robot)
    yield FaultRow("picture frozen", "repeat", moved)
    yield FaultRow("lifted", "lifted", SIGHT, lambda d: d.robot() | {"height": d.between(80, 2e3)})
    yield FaultRow("tipped", "tipped", SIGHT, lambda d: d.robot() | {"angle": d.signed(0.05, 3.1)})
    yield FaultRow("identities swapped", "swap", moved, Draw.robots)
    yield FaultRow("twin ids", "twin_id", "2 rigid bodies", Draw.robots)
    yield FaultRow("pose jumps", "jump", moved, lambda d: d.robot() | {"by": d.off(5, 500)})
    yield FaultRow(
        "plate slips",
        "slip",
        moved,
        lambda d: d.robot() | {"by": d.off(2, 60), "turn": d.signed(0.02, 1.5)},
    )
    yield FaultRow("ghost drives", "ghost", moved, lambda d: _ghost(d, 0.0))
    yield FaultRow("ghost slides", "ghost", moved, lambda d: _ghost(d, math.pi / 2))
    yield FaultRow("ghost drifts", "ghost", moved, lambda d: _ghost(d, None))
    yield FaultRow("ghost turns", "ghost", moved, _turning)
    yield FaultRow("origin jumps", "picture", moved, lambda d: {"by": d.off(3, 300)})
    yield FaultRow("scale jumps", "picture", moved, lambda d: {"scale": 1 + d.signed(2e-3, 0.2)})
    yield FaultRow("axes jump", "picture", moved, lambda d: {"turn": d.signed(2e-3, 1)})
    yield FaultRow("origin creeps", "picture", moved, lambda d: _creeps(by=_slow(d.off(2, 300))))
    yield FaultRow(
        "scale creeps", "picture", moved, lambda d: _creeps(scale=1 + d.signed(2e-3, 0.2) * FRAME_S)
    )
    yield FaultRow(
        "axes creep", "picture", moved, lambda d: _creeps(turn=d.signed(0.02, 2) * FRAME_S)
    )
    clock = f"{CLOCK}|{sight}|{MOTION}"
    yield FaultRow("camera's clock jumps", "clock_jump", clock, lambda d: {"by": d.signed(5e-4, 5)})
    yield FaultRow(
        "camera's clock drifts", "clock_rate", clock, lambda d: {"rate": 1 + d.signed(2e-4, 0.5)}
    )
    yield FaultRow("pushed", "pushed", moved, lambda d: _pushed(d, 3, 200, False), at_once=True)
    yield FaultRow(
        "put elsewhere", "pushed", moved, lambda d: _pushed(d, 10, 600, True), at_once=True
    )
    yield FaultRow("wheel stuck", "wheel_stuck", moved, lambda d: d.robot() | {"wheel": d.side()})
    yield FaultRow("wheel weak", "weak_wheel", moved, lambda d: d.robot() | _weak(d))
    yield FaultRow(
        "battery low",
        "low_battery",
        "battery",
        lambda d: d.robot() | {"millivolts": round(4700 - 1200 * d.strength)},
        start=0.9,
    )
    link = f"{RADIO}|{moved}"
    yield FaultRow("brown-out", "off", link, Draw.robot)
    yield FaultRow(
        "late after a reboot", "reboots", link, lambda d: d.robot() | {"by": d.between(0.05, 3)}
    )
    yield FaultRow("radio unplugged", "unplug", RADIO)
    yield FaultRow("radio stuck", "stuck_port", RADIO)
    yield FaultRow("radio silent", "loss", link, _lost)
    yield FaultRow("robot deaf", "deaf", link, lambda d: d.robot() | _lost(d))
    numbers = "swapped_numbers"
    yield FaultRow("numbers swapped", numbers, moved, Draw.robots, at_once=True, start=1.0)
    yield FaultRow("radio late", "late_radio", link, lambda d: {"by": d.between(0.005, 1)})
    overtaken = "overtaken_packets"
    yield FaultRow("packets overtaken", overtaken, link, lambda d: {"by": d.between(0.005, 0.3)})
    stopped = f"emergency-stopped|{link}"  # if a run then begins
    yield FaultRow("stopped elsewhere", "stopped_elsewhere", stopped, at_once=True)
    elsewhere = f"only an emergency stop|{MOTION}|{PLACE}"
    yield FaultRow("second sender", "driven_elsewhere", elsewhere, lambda d: _driven(d, 100.0))
    yield FaultRow(
        "sender at our rate", "driven_elsewhere", elsewhere, lambda d: _driven(d, OUR_HZ)
    )
    yield FaultRow("packets doubled", "doubled_packets", r"$.", weight=0.5)
    yield FaultRow("radio resets", "radio_resets", link)
    yield FaultRow("other baud rate", "baud", link, lambda d: {"baud": 9600})
    yield FaultRow("bad bytes", "bad_bytes", link, lambda d: {"share": d.between(2e-4, 0.5)})
    yield FaultRow(
        "host's clock jumps",
        "host_clock",
        f"stood still|late|{CELLS}|{clock}",  # cells seem to stand still meanwhile
        lambda d: {"by": d.between(0.02, 6)},
        at_once=True,
    )
    yield FaultRow(
        "host busy", "busy", f"late|silent|{moved}", lambda d: {"seconds": d.between(0.01, 6)}
    )
    at_times = "host busy at times"
    yield FaultRow(
        at_times,
        "busy",
        f"late|silent|{moved}",
        lambda d: {"seconds": d.between(0.05, 0.45), "every": d.random.randint(2, 4)},
        weight=0.5,
    )
    asleep = f"stood still|late|{CELLS}|{clock}|{moved}"
    yield FaultRow("suspended", "stopped", asleep, lambda d: {"for": d.between(0.02, 5)})
    yield FaultRow(
        "computer sleeps", "stopped", asleep, lambda d: {"for": d.random.choice(SLEEPS_S)}
    )
    yield FaultRow("disk full", "disk_full", "cannot write the log", at_once=True)
    yield FaultRow("killed", "signal", r"$.", lambda d: {"signal": "KILL"}, at_once=True)
    yield FaultRow(
        "signal",
        "signal",
        "interrupted|cancelled",
        lambda d: {"signal": d.random.choice(("INT", "TERM", "HUP", "QUIT"))},
        True,
    )
    yield FaultRow("second run", "second_run", r"$.", at_once=True, weight=0.5)
    yield FaultRow("emergency stop", "emergency", "emergency stop", at_once=True)


def _lost(d: Draw) -> dict[str, Any]:
    """Return a share from 5 to 98 %, near 98 % as often as near 5 %; a strong one is 1."""
    share = 1.0 / (1.0 + math.exp(3.0 - 7.0 * d.strength / STRONG))
    return {"share": round(share, 4) if d.strength < STRONG else 1.0}


def _slow(way: list[float]) -> list[float]:
    """Return a velocity [mm/s] as a step in each frame [mm]."""
    return [round(value * FRAME_S, 6) for value in way]


def _ghost(d: Draw, angle: float | None) -> dict[str, Any]:
    speed = d.signed(3, 600) * d.scale * FRAME_S
    direction = angle
    if direction is None:
        return d.robot() | {"by": _slow(d.off(3, 600))}
    x = speed * math.cos(direction)
    y = speed * math.sin(direction)
    step = [round(x, 6), round(y, 6)]
    return d.robot() | {"by": step, "axes": "robot"}


def _turning(d: Draw) -> dict[str, Any]:
    return d.robot() | {"by": [0, 0], "turn": round(d.signed(0.02, 4) * FRAME_S, 7)}


def _creeps(**fields: Any) -> dict[str, Any]:
    return fields | {"creeps": True}


def _pushed(d: Draw, low: float, high: float, at_once: bool) -> dict[str, Any]:
    turn = round(d.signed(0.01, 2), 4)
    return d.robot() | {"by": d.off(low, high), "turn": turn, "at_once": at_once}


def _weak(d: Draw) -> dict[str, Any]:
    wheel = d.side()
    lost = min(1.0, d.between(0.02, 1.2))
    return {"wheel": wheel, "share": round(1 - lost, 4)}


def _driven(d: Draw, rate_hz: float) -> dict[str, Any]:
    return {"counts": [round(d.signed(3, 60)), round(d.signed(3, 60))], "rate": rate_hz}


KINDS = tuple(_kinds())
"""The table of faults."""


def faults_of_day(
    random: Random,
    names: tuple[str, ...],
    kinds: Sequence[FaultRow] = KINDS,
    span_s: float = SPAN_S,
    scale: float = 1.0,
) -> list[dict[str, Any]]:
    """Draw a day's faults as of a script; a third of the days have one, others two to six. The key
    `kind` is the name of the row; `strength` that of the draw; `scale` that of lengths.
    """
    count = 1 if random.random() < 1 / 3 else random.randint(2, 6)
    chosen = random.choices(kinds, [kind.weight for kind in kinds], k=count)
    return [_fault(random, kind, names, span_s, scale) for kind in chosen]


def _fault(
    random: Random, kind: FaultRow, names: tuple[str, ...], span_s: float, scale: float
) -> dict[str, Any]:
    draw = Draw(random, names, random.random(), scale)
    fault = {"kind": kind.name, "strength": round(draw.strength, 3), "fault": kind.fault}
    fault |= kind.fields(draw)
    when = random.random()
    if when < kind.start:
        fault |= {"since": "start", "at": round(random.uniform(0, 1), 3)}
    elif when > 1 - STOP_SHARE:
        fault |= {"since": "stop", "at": round(random.uniform(0, 0.5), 3)}
    else:
        fault["at"] = round(random.uniform(0, span_s), 3)
    if not kind.at_once and "for" not in fault and draw.strength < STRONG:
        fault["for"] = round(0.02 * 800 ** random.random(), 3)  # from 20 ms to 16 s
    return fault
