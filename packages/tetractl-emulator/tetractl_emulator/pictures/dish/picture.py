"""Draws synthetic images of a dish: cells, specks, a bubble, light, blur and noise.

In an image with the scale `um_px`, the pixel in column c and row r shows the point x = (c + 1/2)
um_px, y = (height - 1/2 - r) um_px [um], measured from the lower left corner of the image: y points
up.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from tetractl.core.poses import Bools, Floats, GreyImage
from tetractl.model.swimmers import Bodies, Swimmers
from tetractl_emulator.pictures.stream_side import SPARE_PX

Shades = NDArray[np.float32]

TAPER_FRACTION = 0.2
"""Fraction by which the front of a cell is narrower than its middle."""
SUB_EXPOSURES = 4
"""Number of moments over which the image of an exposure is averaged."""
LENS_PX = 0.6
"""Blur of a cell in focus [px]."""
BLUR_PER_DEFOCUS = 0.1
"""Blur [um] per defocus [um]. It corresponds to a numerical aperture of about 0.1."""


@dataclass(frozen=True, slots=True)
class RenderedSpeck:
    """A piece of debris or a bubble: an ellipse in the image.

    Attributes:
        x: x of the centre [um].
        y: y of the centre [um].
        size_um: Width [um].
        stretch: Length, as a multiple of the width.
        turn: Angle of the long axis [rad].
        shade: Contrast, as a multiple of a cell's contrast.
        drift: Velocity [um/s].
        rim: Whether the speck has a bright rim, like a bubble.
    """

    x: float
    y: float
    size_um: float
    stretch: float
    turn: float
    shade: float
    drift: tuple[float, float] = (0.0, 0.0)
    rim: bool = False


@dataclass(frozen=True, slots=True)
class PictureLook:
    """The properties of an emulated microscope's images.

    Attributes:
        width: Number of columns [px].
        height: Number of rows [px].
        um_px: Scale [um/px].
        exposure_s: Exposure time [s].
        bright: Whether cells are brighter than the medium.
        light: Grey level of the medium in the middle of the image.
        contrast: Difference between cells and medium [grey levels].
        vignetting: Fraction of the light that is lost in the corners.
        light_drift: Relative change of the light per second [1/s].
        flicker: Relative amplitude of the light's flicker at 100 Hz.
        noise: Standard deviation of the noise, which includes shot noise [grey levels].
        quality: JPEG quality. None for no JPEG compression.
        focus_um: Height in focus [um].
        corner_um: Position of the image's lower left corner in the dish [um].
        specks: Debris and bubbles.
    """

    width: int = 1024
    height: int = 1024
    um_px: float = 2.3
    exposure_s: float = 0.01
    bright: bool = False
    light: float = 160.0
    contrast: float = 60.0
    vignetting: float = 0.2
    light_drift: float = 0.0
    flicker: float = 0.0
    noise: float = 3.0
    quality: int | None = None
    focus_um: float = 0.0
    corner_um: tuple[float, float] = (0.0, 0.0)
    specks: tuple[RenderedSpeck, ...] = ()

    @classmethod
    def sample(cls, random: np.random.Generator, side_px: int, um_px: float | None = None) -> Self:
        """Generate random properties.

        The ranges are those of docs/cells-explained.md of tetractl-microscope.

        Args:
            random: The random generator.
            side_px: Side of the image [px].
            um_px: Scale [um/px]. None for a random scale.
        """
        scale = float(random.uniform(2.0, 5.0)) if um_px is None else um_px
        bright = bool(random.random() < 0.5)
        span = side_px * scale
        specks: list[RenderedSpeck] = []
        for _ in range(random.integers(5, 51)):
            x, y = random.uniform(0, span, 2).tolist()
            drift = (0.0, 0.0)
            if random.random() < 0.3:
                drift_x, drift_y = random.uniform(-8, 8, 2).tolist()
                drift = (drift_x, drift_y)
            speck = RenderedSpeck(
                x,
                y,
                size_um=float(random.uniform(5, 60)),
                stretch=float(random.uniform(1, 2.5)),
                turn=float(random.uniform(0, math.pi)),
                shade=float(random.uniform(0.3, 1.2)),
                drift=drift,
            )
            specks.append(speck)
        x, y = random.uniform(0, span, 2).tolist()
        bubble = RenderedSpeck(x, y, float(random.uniform(100, 250)), 1.0, 0.0, 0.1, rim=True)
        return cls(
            width=side_px,
            height=side_px,
            um_px=scale,
            exposure_s=float(random.uniform(0.005, 0.02)),
            bright=bright,
            light=float(random.uniform(35, 60) if bright else random.uniform(140, 190)),
            contrast=float(random.uniform(40, 90)),
            vignetting=float(random.uniform(0.1, 0.3)),
            light_drift=float(random.uniform(-0.01, 0.01)),
            flicker=float(random.uniform(0.0, 0.03)),
            noise=float(random.uniform(2.0, 8.0)),
            quality=int(random.integers(60, 96)),
            specks=(*specks, bubble),
        )


class DishPainter:
    """Draws images of a dish with cells and specks.

    Args:
        look: Properties of the images.
        seed: Seed of the noise.

    Attributes:
        look: Properties of the images.
    """

    def __init__(self, look: PictureLook, seed: int = 0) -> None:
        self.look = look
        self._random = np.random.default_rng(seed)
        self._resting_specks: Shades | None = None
        self._noise: Shades | None = None
        self._light_map: Shades | None = None

    def change(self, look: PictureLook) -> None:
        """Set the properties of the images that are drawn next.

        Size and noise must stay the same, because the noise is sampled only once.
        """
        if look != self.look:
            self.look = look
            self._resting_specks = None
            self._light_map = None

    def picture(
        self, cells: Swimmers, moments: Sequence[Bodies], is_shown: Bools, seconds: float
    ) -> GreyImage:
        """Draw a grey image of N cells, shape (height, width).

        Args:
            cells: The cells.
            moments: Bodies of the cells at times that are spread evenly over the exposure.
            is_shown: Whether to draw each cell, shape (N,).
            seconds: Time of the image [s].
        """
        look = self.look
        ink = self._specks_at_rest().copy()
        for speck in look.specks:
            if speck.drift != (0.0, 0.0):
                moved_speck = replace(
                    speck,
                    x=speck.x + speck.drift[0] * seconds,
                    y=speck.y + speck.drift[1] * seconds,
                )
                self._draw_speck(ink, moved_speck)
        for i in np.flatnonzero(is_shown):
            self._draw_cell(ink, cells, moments, int(i))
        light = 1 + look.light_drift * seconds
        light *= 1 + look.flicker * math.sin(2 * math.pi * 100 * seconds + 0.3)
        sign = look.contrast if look.bright else -look.contrast
        shades = self._relative_light() * ((look.light + sign * ink) * light)
        shades += self._sample_noise() * np.sqrt(np.maximum(shades, 1.0) / look.light)
        grey = np.clip(shades + 0.5, 0, 255).astype(np.uint8)
        if look.quality is None:
            return grey
        coded = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, look.quality])[1]
        return np.asarray(cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE), np.uint8)

    def _relative_light(self) -> Shades:
        """Return the relative light at each pixel, shape (height, width): 1 in the middle."""
        if self._light_map is None:
            rows, columns = np.ogrid[-1 : 1 : 1j * self.look.height, -1 : 1 : 1j * self.look.width]
            shade = 1 - self.look.vignetting * (rows**2 + columns**2) / 2
            self._light_map = shade.astype(np.float32)
        return self._light_map

    def _sample_noise(self) -> Shades:
        """Sample noise, shape (height, width) [grey levels], as a part of a larger array."""
        if self._noise is None:
            size = self.look.height + SPARE_PX, self.look.width + SPARE_PX
            self._noise = self._random.normal(0, self.look.noise, size).astype(np.float32)
        first_row, first_column = self._random.integers(0, SPARE_PX, 2)
        return self._noise[
            first_row : first_row + self.look.height, first_column : first_column + self.look.width
        ]

    def _specks_at_rest(self) -> Shades:
        """Draw all specks that do not drift. The result is cached."""
        if self._resting_specks is None:
            self._resting_specks = np.zeros((self.look.height, self.look.width), np.float32)
            for speck in self.look.specks:
                if speck.drift == (0.0, 0.0):
                    self._draw_speck(self._resting_specks, speck)
        return self._resting_specks

    def _to_pixel(self, x: float, y: float) -> tuple[float, float]:
        """Convert a position [um] to a column and a row [px], which need not lie in the image.

        Rows count downwards from the top, and pixel centres have integer coordinates.
        """
        look = self.look
        right_um = x - look.corner_um[0]
        up_um = y - look.corner_um[1]
        return right_um / look.um_px - 0.5, look.height - 0.5 - up_um / look.um_px

    def _region_around(
        self, x: float, y: float, reach_px: float
    ) -> tuple[tuple[slice, slice], Floats, Floats] | None:
        """Find the part of the image around a position.

        Args:
            x: x of the position [um].
            y: y of the position [um].
            reach_px: Distance from the position to the edge of the part [px].

        Returns:
            The slices of rows and columns, and x and y (pointing up) of their pixels relative to
            the position [px]. None if the part is outside the image.
        """
        column, row = self._to_pixel(x, y)
        left = max(0, int(column - reach_px))
        right = min(self.look.width, int(column + reach_px) + 2)
        top = max(0, int(row - reach_px))
        bottom = min(self.look.height, int(row + reach_px) + 2)
        if left >= right or top >= bottom:
            return None
        right_px = np.arange(left, right, dtype=float) - column
        up_px = row - np.arange(top, bottom, dtype=float)
        return (slice(top, bottom), slice(left, right)), right_px[None, :], up_px[:, None]

    def _draw_speck(self, ink: Shades, speck: RenderedSpeck) -> None:
        """Add a speck or a bubble to `ink`, an image of floats. Nothing is added outside it."""
        half_width_px = speck.size_um / 2 / self.look.um_px
        patch = self._region_around(speck.x, speck.y, half_width_px * speck.stretch + 4)
        if patch is None:
            return
        region, right_px, up_px = patch
        cos = math.cos(speck.turn)
        sin = math.sin(speck.turn)
        along_px = right_px * cos + up_px * sin
        aside_px = up_px * cos - right_px * sin
        radius = np.hypot(along_px / speck.stretch, aside_px) - half_width_px
        if speck.rim:  # bright, even if the cells are dark
            sign = 0.8 if self.look.bright else -0.8
            ink[region] += (sign * np.exp(-(radius**2) / 8)).astype(np.float32)
        ink[region] += (speck.shade / (1 + np.exp(np.clip(radius / 0.7, -30, 30)))).astype(
            np.float32
        )

    def _draw_cell(self, ink: Shades, cells: Swimmers, moments: Sequence[Bodies], i: int) -> None:
        """Add the cell with index `i` to the image `ink`, averaged over its bodies in `moments`.

        Nothing is added if the cell is outside the image.
        """
        scale = self.look.um_px
        middle = moments[len(moments) // 2]
        half_long = cells.length[i] / 2 / scale
        half_wide = cells.width[i] / 2 / scale
        defocus = BLUR_PER_DEFOCUS * abs(middle.height[i] - self.look.focus_um) / scale
        blur_px = math.hypot(LENS_PX, defocus)
        patch = self._region_around(middle.x[i], middle.y[i], half_long + 3 * blur_px + 6)
        if patch is None:
            return
        region, right_px, up_px = patch
        coverage_sum = np.zeros((up_px.size, right_px.size))
        for body in moments:
            cos = math.cos(body.axis[i])
            sin = math.sin(body.axis[i])
            half_length = math.hypot(
                half_long * math.cos(body.tilt[i]), half_wide * math.sin(body.tilt[i])
            )
            x = right_px - (body.x[i] - middle.x[i]) / scale
            y = up_px - (body.y[i] - middle.y[i]) / scale
            # the taper moves the middle of the area back by a quarter of the taper
            along = (x * cos + y * sin) / half_length - TAPER_FRACTION / 4
            aside = (y * cos - x * sin) / half_wide
            relative_width = np.maximum(1 - TAPER_FRACTION * np.clip(along, -1, 1), 0.1)
            inside = 1 - np.hypot(along, aside / relative_width)
            coverage_sum += 1 / (1 + np.exp(-np.clip(1.7 * inside * half_wide / blur_px, -30, 30)))
        coverage = (coverage_sum / len(moments)).astype(np.float32)
        # two overlapping bodies are not twice as dark
        ink[region] = ink[region] * (1 - 0.5 * coverage) + coverage
