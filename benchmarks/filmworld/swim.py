"""Swimming cells of the second renderer: rigid bodies that turn in three dimensions.

A cell swims along e1 of its own frame at V and turns with a fixed vector w of angular velocity in
that frame (Crenshaw), so that its path is a helix about w. Its body's long axis is fixed in the
frame, too: somewhere between e1 (a body that points where it swims) and w (one that does not sway).
The field turns w about the vertical at a sin(u - th - bias), where th is the direction of w in the
picture. Nothing here is taken from tetractl. Lengths in um, times in s.
"""

import math
from dataclasses import dataclass

import numpy as np

STEPS_S = 240  # steps a second
LN_PULSE_HZ = math.log(0.15), math.log(3.0)  # least and greatest
NEARBY_UM = 90.0  # width beyond the picture's edge from which cells come in


@dataclass(slots=True)
class Fauna:
    """Constants of N cells: speed along the helix, its radius and frequency, pulses of the speed
    (share, frequency), turning rate `a`, `bias`, `walk` [rad/sqrt(s)], length and width; the body's
    axis lies from e1 (`steady` 0) towards w (1), and by the angle `slant` [rad] off their plane.
    """

    speed: np.ndarray
    radius: np.ndarray
    hertz: np.ndarray
    pulse: np.ndarray
    pulse_hz: np.ndarray
    a: np.ndarray
    bias: np.ndarray
    walk: np.ndarray
    length: np.ndarray
    width: np.ndarray
    steady: np.ndarray
    slant: np.ndarray

    @classmethod
    def drawn(cls, random: np.random.Generator, cells: int, strangers: int, pulse) -> "Fauna":
        count = cells + strangers
        a = random.gamma(14.0, 0.28, count)
        a[cells:] = 0.0
        length = np.clip(random.normal(53, 8, count), 36, 76)
        return cls(
            speed=np.clip(random.lognormal(math.log(390), 0.28, count), 180, 800),
            radius=random.uniform(4.0, 12.0, count),
            hertz=random.uniform(1.7, 3.4, count) * random.choice([-1, 1], count),
            pulse=random.uniform(*pulse, count),
            pulse_hz=np.exp(random.uniform(*LN_PULSE_HZ, count)),
            a=a,
            bias=random.normal(0, 0.12, count),
            walk=random.uniform(0.03, 0.15, count),
            length=length,
            width=length * random.uniform(0.42, 0.66, count),
            steady=random.uniform(-0.1, 1.0) + random.normal(0, 0.1, count),
            slant=random.normal(0, 0.15, count),
        )


@dataclass(slots=True)
class Swum:
    """S + 1 states of N cells: place (S + 1, N, 3), body's direction `along` and a second axis
    `side` of its frame (unit vectors, same shape), `heading`, `speed` and `resting` (S + 1, N).
    """

    place: np.ndarray
    along: np.ndarray
    side: np.ndarray
    heading: np.ndarray
    speed: np.ndarray
    resting: np.ndarray


def swim(
    random: np.random.Generator,
    fauna: Fauna,
    seconds: float,
    turns: np.ndarray,
    rest: tuple[int, float, float] | None,
    backs: float,
) -> Swum:
    """Integrate the cells in open water from the origin; `turns` (T, 2) is the field, `rest` a cell
    and the time for which it rests. A cell backs away now and then, `backs` times a second, and
    then turns by an angle of its own (an avoiding reaction).
    """
    count = len(fauna.speed)
    dt = 1 / STEPS_S
    steps = math.ceil(seconds * STEPS_S) + STEPS_S // 20
    turning = 2 * np.pi * fauna.hertz
    lean = np.arctan2(np.abs(turning) * fauna.radius, fauna.speed)
    # the helix's axis in the body's frame, at the angle `lean` to e1
    forward = np.zeros((count, 3))
    forward[:, 0] = np.cos(lean)
    forward[:, 1] = np.sin(lean)
    body = np.array([1.0, 0.0, 0.0]) * (1 - fauna.steady)[:, None] + forward * fauna.steady[:, None]
    body[:, 2] += fauna.slant
    body /= np.linalg.norm(body, axis=1)[:, None]
    frame = _start_frames(random, lean)
    place = np.zeros((count, 3))
    place[:, 2] = random.normal(0, 12, count)
    recorded = [np.empty((steps + 1, count, 3)) for _ in range(3)]
    flat = [np.empty((steps + 1, count)) for _ in range(2)]
    resting = np.zeros((steps + 1, count), bool)
    start = random.uniform(0, 2 * np.pi, count)
    noise = np.zeros(count)
    current = np.append(random.uniform(-4, 4, 2), 0.0)
    remaining_s = np.zeros(count)
    swerve = np.zeros(count)
    depth = random.normal(0, 12, count)
    for k in range(steps + 1):
        t = k * dt
        axis = np.einsum("nij,nj->ni", frame, forward)
        heading = np.arctan2(axis[:, 1], axis[:, 0])
        noise += -noise * dt / 0.4 + 0.4 * fauna.pulse * math.sqrt(2 * dt / 0.4) * (
            random.standard_normal(count)
        )
        beat = 1 + 1.3 * fauna.pulse * np.sin(2 * np.pi * fauna.pulse_hz * t + start) + noise
        going = np.ones(count)
        if rest is not None and rest[1] <= t < rest[2]:
            going[rest[0]] = 0.0
            resting[k, rest[0]] = True
        backing = remaining_s > 0
        ahead = fauna.speed * beat * going * np.where(backing, -0.6, 1.0)
        recorded[0][k] = place
        recorded[1][k] = np.einsum("nij,nj->ni", frame, body)
        recorded[2][k] = frame[:, :, 2]
        flat[0][k] = heading
        flat[1][k] = ahead
        begins = (random.random(count) < backs * dt) & ~backing & (going > 0)
        remaining_s = np.where(begins, random.uniform(0.2, 0.5, count), remaining_s - dt)
        swerve = np.where(begins, random.normal(0, 4.0, count), swerve)
        place = place + frame[:, :, 0] * (ahead / np.cos(lean))[:, None] * dt + current * dt
        depth += -depth * dt / 4 + 12 * math.sqrt(2 * dt / 4) * random.standard_normal(count)
        place[:, 2] += (depth - place[:, 2]) * dt / 0.5
        u = turns[max(int(np.searchsorted(turns[:, 0], t + dt / 2, "right")) - 1, 0), 1]
        pull = fauna.a * np.sin(u - heading - fauna.bias) * going
        pull += fauna.walk * going * random.standard_normal(count) / math.sqrt(dt)
        pull += np.where(backing, swerve, 0.0)
        spin = axis * (turning * going)[:, None]
        # cells between a slide and its cover keep to the plane
        spin -= np.cross(axis, np.array([0.0, 0.0, 1.0])) * (3.0 * axis[:, 2])[:, None]
        spin[:, 2] += pull
        frame = _turned(frame, spin * dt)
    return Swum(recorded[0], recorded[1], recorded[2], flat[0], flat[1], resting)


def _start_frames(random: np.random.Generator, lean: np.ndarray) -> np.ndarray:
    """Return frames (N, 3, 3), whose columns are the bodies' axes, with w level."""
    frames = []
    for angle in lean:
        th = random.uniform(-np.pi, np.pi)
        roll = random.uniform(-np.pi, np.pi)
        w = np.array([math.cos(th), math.sin(th), 0.0])
        leftwards = np.array([-math.sin(th), math.cos(th), 0.0])
        out = math.cos(roll) * leftwards + math.sin(roll) * np.array([0.0, 0.0, 1.0])
        e1 = math.cos(angle) * w - math.sin(angle) * out
        e2 = math.sin(angle) * w + math.cos(angle) * out
        frames.append(np.stack([e1, e2, np.cross(e1, e2)], 1))
    return np.array(frames)


def _turned(frame: np.ndarray, by: np.ndarray) -> np.ndarray:
    """Return frames turned by rotation vectors (N, 3) [rad], by Rodrigues' formula."""
    angle = np.linalg.norm(by, axis=1)
    x, y, z = (by / np.maximum(angle, 1e-12)[:, None]).T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], 1).reshape(-1, 3, 3)
    sine = np.sin(angle)[:, None, None]
    rest = (1 - np.cos(angle))[:, None, None]
    return frame + (sine * cross + rest * (cross @ cross)) @ frame
