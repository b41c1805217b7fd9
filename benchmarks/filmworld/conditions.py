"""What each level of the second renderer draws for a film. Nothing here is taken from tetractl."""

import math
from dataclasses import dataclass

import numpy as np

from .optics import Optics

SIDE_PX = 1024
UM_PX = 2.3
RATE_HZ = 30.0


@dataclass(frozen=True, slots=True)
class Conditions:
    """What is drawn for a film. `flicker` and `drift` (a second) are shares of the light, `wander`
    [um] the deviation of the focus, `knock_um` the way of the stage at `knock_s` [s], `late_s` the
    delay of the field's record, `pulse` the range of pulses of the speed, `backs` the avoiding
    reactions of a cell a second. `lookalikes` of the `specks` have the size and shape of cells,
    and drift by up to `speck_um_s`.
    """

    seconds: float
    optics: Optics
    light: float
    noise: float
    quality: int
    vignetting: float
    flicker: float
    drift: float
    exposure_s: float
    specks: int
    lookalikes: int
    speck_um_s: float
    bubbles: int
    wander: float
    texture: float
    spread: float
    pulse: tuple[float, float]
    backs: float
    knock_um: tuple[float, float]
    knock_s: float
    late_s: float
    events: bool

    @classmethod
    def drawn(cls, random: np.random.Generator, level: str) -> "Conditions":
        looks = {  # signs of the body, its halo and the line at its outline
            "dark, bright halo": (-1.0, random.uniform(0.25, 0.6), random.uniform(0.0, 0.4)),
            "bright, dark halo": (1.0, -random.uniform(0.25, 0.6), -random.uniform(0.0, 0.3)),
            "dark": (-1.0, 0.0, -random.uniform(0.0, 0.4)),
            "bright": (1.0, 0.0, random.uniform(0.0, 0.3)),
            "bright, dark outline": (random.uniform(0.3, 0.6), random.uniform(0.0, 0.3), -1.3),
        }
        share = {"easy": 0.0, "normal": 0.5, "hard": 0.75}[level]
        names = list(looks)
        plain = names[2:4]
        haloed = [*names[:2], names[4]]
        look = str(random.choice(haloed if random.random() < share else plain))
        body, halo, edge = looks[look]
        dark_field = look in ("bright", "bright, dark halo")
        light = random.uniform(60, 110) if dark_field else random.uniform(120, 190)
        angle = random.uniform(-np.pi, np.pi)
        size = float(level == "hard") * 18.0
        contrast = {
            "easy": random.uniform(40, 80) / light,
            "normal": random.uniform(30, 70) / light,
            "hard": random.uniform(0.17, 0.24),
        }[level]
        contrast = min(contrast, 0.75)
        noise = {"easy": (2.0, 4.0), "normal": (3.0, 6.0), "hard": (7.0, 8.0)}[level]
        noise = random.uniform(*noise)
        if level == "hard" and random.random() < 0.4:
            contrast = 0.17
            noise = 8.0
        seconds = float(random.uniform(10, 12)) if level != "easy" else 10.0
        hard = level == "hard"
        easy = level == "easy"
        specks_from_to = (2, 6) if easy else (25, 46)
        flicker_factor = 2 if hard else 1
        lookalikes_factor = 4 if hard else 1
        latest_s = 0.02 if hard else 0.01
        return cls(
            seconds=round(seconds * RATE_HZ) / RATE_HZ,
            optics=Optics(
                um_px=UM_PX,
                side_px=SIDE_PX,
                body=body * contrast,
                halo=halo * contrast,
                halo_um=random.uniform(2.5, 6.0),
                edge=edge * contrast,
                lens_px=random.uniform(0.5, 0.9),
                aperture=random.uniform(0.06, 0.1) if not hard else random.uniform(0.1, 0.16),
            ),
            light=light,
            noise=noise,
            quality={"easy": 95, "normal": int(random.integers(75, 91)), "hard": 60}[level],
            vignetting=random.uniform(0.0, 0.1) if easy else random.uniform(0.1, 0.35),
            flicker=0.0 if easy else random.uniform(0.005, 0.02) * flicker_factor,
            drift=0.0 if easy else random.uniform(-0.01, 0.01),
            exposure_s=random.uniform(0.003, 0.012),
            specks=int(random.integers(*specks_from_to)),
            lookalikes=0 if easy else int(random.integers(3, 6)) * lookalikes_factor,
            speck_um_s={"easy": 0.0, "normal": 15.0, "hard": 40.0}[level],
            bubbles=0 if easy else 1,
            wander={"easy": 2.0, "normal": 12.0, "hard": 25.0}[level],
            texture=random.uniform(0.2, 0.8),
            spread=0.05 if easy else 0.15,
            pulse={"easy": (0.04, 0.06), "normal": (0.05, 0.07), "hard": (0.06, 0.1)}[level],
            backs={"easy": 0.0, "normal": 0.005, "hard": 0.015}[level],
            knock_um=(size * math.cos(angle), size * math.sin(angle)),
            knock_s=seconds * random.uniform(0.35, 0.65),
            late_s=0.0 if easy else random.uniform(0.0, latest_s),
            events=not easy,
        )
