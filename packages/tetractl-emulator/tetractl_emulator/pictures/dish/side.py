"""The emulated camera of type `cells`: a microscope above the emulated dish."""

import math
from collections.abc import Sequence
from dataclasses import replace
from random import Random
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field
from tetractl_microscope.cells.section import CellsSection

from tetractl.core.clock import SECOND
from tetractl.core.errors import SpecError
from tetractl.core.poses import Floats, GreyImage
from tetractl.core.setup import Setup
from tetractl.model.swimmers import Bodies, bodies
from tetractl.spec.base import Finite, Model, Name, NonNegative, Positive
from tetractl.spec.lab_section import LabSection
from tetractl_emulator.fault_rows import (
    SEEN_REASONS,
    FaultRow,
    random_vector,
    signed_value,
    value_between,
)
from tetractl_emulator.faults import Fault, Visible, fault_kind
from tetractl_emulator.pictures.dish.live_dish import CellBody
from tetractl_emulator.pictures.dish.picture import (
    SUB_EXPOSURES,
    DishPainter,
    PictureLook,
    RenderedSpeck,
)
from tetractl_emulator.pictures.stream_side import STREAM_FAULTS, StreamedCamera, StreamSettings
from tetractl_emulator.sides import Body, Stage


class MicroscopeSettings(StreamSettings):
    """Properties of the emulated microscope; scale and latency come from the spec."""

    width: int = Field(default=0, ge=0, le=8192)
    """Columns of an image [px]; with 0, the image shows the whole width of the arena."""
    height: int = Field(default=0, ge=0, le=8192)
    """Rows of an image [px]; with 0, the image shows the whole height of the arena."""
    noise: NonNegative = 3.0
    """Standard deviation of each pixel [grey levels]."""
    exposure: Positive = 0.01
    """Exposure time of an image [s]."""
    bright: bool = False
    """Whether cells are brighter than the medium."""
    contrast: Annotated[float, Field(gt=0, le=255)] = 60.0
    """Difference between cells and medium [grey levels]."""
    mirrored: bool = False
    """Whether the images are mirrored left to right, as behind an odd number of mirrors."""
    specks: int = Field(default=12, ge=0, le=200)
    """Number of debris particles."""


class EmulatedMicroscope(StreamedCamera):
    """An emulated microscope camera above cells, with synthetic images.

    When a client starts to read, the cells are scattered again, like a fresh drop.

    Args:
        stage: The data and functions that the lab's emulated devices share.
        settings: The settings of the microscope.
        bodies: The cells.

    Raises:
        SpecError: If the actuator is not of type `field`, or if the camera is rotated.
    """

    Settings: ClassVar[type[Model]] = MicroscopeSettings
    faults: ClassVar[Sequence[type[Fault]]] = (
        *STREAM_FAULTS,
        fault_kind(
            "light",
            "The light is multiplied by a factor, and flickers at 100 Hz by this fraction of "
            "its brightness.",
            Visible.EXPOSED,
            fields={
                "share": (Annotated[float, Field(ge=0, le=10)], 1.0),
                "flicker": (Annotated[float, Field(ge=0, le=1)], 0.0),
            },
            rows=[
                FaultRow("dark", SEEN_REASONS, {"share": value_between(0.95, 1 / 60)}),
                FaultRow("bright", SEEN_REASONS, {"share": value_between(1.05, 6)}),
                FaultRow("flicker", SEEN_REASONS, {"flicker": value_between(0.02, 1)}),
            ],
        ),
        fault_kind(
            "focus",
            "The focal plane is off by this height [um].",
            Visible.EXPOSED,
            fields={"by_um": Finite},
            rows=[FaultRow("blurred", SEEN_REASONS, {"by_um": signed_value(5, 300)})],
        ),
        fault_kind(
            "knocked",
            "Somebody moved the stage by this displacement [um].",
            Visible.EXPOSED,
            fields={"by_um": tuple[Finite, Finite]},
            rows=[FaultRow("knocked", SEEN_REASONS, {"by_um": random_vector(3, 800)})],
        ),
        fault_kind(
            "bubble",
            "A bubble of this diameter [um] is in the middle of the image.",
            Visible.EXPOSED,
            fields={"size_um": (Positive, 200.0)},
            rows=[FaultRow("bubble", SEEN_REASONS, {"size_um": value_between(20, 600)})],
        ),
        fault_kind(
            "untracked",
            "A cell is missing from the images.",
            Visible.EXPOSED,
            fields={"cell": Name},
            rows=[FaultRow("cell covered", SEEN_REASONS)],
        ),
    )

    def __init__(self, stage: Stage, settings: MicroscopeSettings, bodies: Sequence[Body]) -> None:
        super().__init__(stage, settings, bodies)
        section = stage.lab.camera
        assert isinstance(section, CellsSection), "the camera's section has the type cells"
        cells = [body for body in bodies if isinstance(body, CellBody)]
        if section.rotation or len(cells) < len(bodies):
            raise SpecError(
                "the emulated microscope shows only cells, and its camera cannot be rotated",
                "set lab.actuator.type to field and lab.camera.rotation to 0",
            )
        self._dish = cells[0].dish
        self._dish.held = False  # the camera would not recognise a cell that does not swim
        unit_um = stage.setup.metres * 1e6
        arena = stage.setup.arena
        corner_um = section.corner[0] * unit_um, section.corner[1] * unit_um
        sides_um = (  # the same margin beyond the arena as at the lower left
            (arena.right + arena.left) * unit_um - 2 * corner_um[0],
            (arena.top + arena.bottom) * unit_um - 2 * corner_um[1],
        )
        width, height = (math.ceil(max(side_um / section.um_px, 64)) for side_um in sides_um)
        sampled_look = PictureLook.sample(np.random.default_rng(self.seed), 1024, section.um_px)
        self.painter = DishPainter(
            PictureLook(
                width=settings.width or width,
                height=settings.height or height,
                um_px=section.um_px,
                corner_um=corner_um,
                exposure_s=settings.exposure,
                bright=settings.bright,
                light=50.0 if settings.bright else 160.0,
                contrast=settings.contrast,
                noise=settings.noise,
                specks=sampled_look.specks[: settings.specks],
            ),
            self.seed,
        )
        self._plain_look = self.painter.look
        self._mirrored = settings.mirrored

    @classmethod
    def world_of_day(cls, random: Random, lab: LabSection, setup: Setup) -> dict[str, Any]:
        """Sample the images of a randomised test run; see `tetractl_emulator.sides`."""
        noise = round(random.uniform(2, 6), 2)
        contrast = round(random.uniform(40, 80), 1)
        return {"noise": noise, "contrast": contrast, "specks": random.randint(0, 20)}

    def _joined(self) -> None:
        """Scatter the cells again when a client starts to read."""
        self._dish.drop()

    def _scene(self) -> Floats:
        """Return x, y, height [um], axis and tilt [rad] of each cell's body, shape (5, N)."""
        scene = bodies(self._dish.cells)
        return np.array([scene.x, scene.y, scene.height, scene.axis, scene.tilt])

    def _look(self) -> PictureLook:
        """Return the properties of the images, as the acting faults change them."""
        acting = self._stage.acting
        look = self._plain_look
        for light in acting.of_kind("light"):
            brightness = {
                "light": look.light * light.share,
                "contrast": look.contrast * light.share,
            }
            look = replace(look, **brightness, flicker=light.flicker)
        for focus in acting.of_kind("focus"):
            look = replace(look, focus_um=focus.by_um)
        for knock in acting.of_kind("knocked"):
            corner_um = look.corner_um[0] + knock.by_um[0], look.corner_um[1] + knock.by_um[1]
            look = replace(look, corner_um=corner_um)
        for bubble in acting.of_kind("bubble"):
            x = look.corner_um[0] + look.width * look.um_px / 2
            y = look.corner_um[1] + look.height * look.um_px / 2
            rim = RenderedSpeck(x, y, bubble.size_um, 1.0, 0.0, 0.1, rim=True)
            look = replace(look, specks=(*look.specks, rim))
        return look

    def _draw(self, exposed_ns: int) -> GreyImage:
        """Draw the image of an exposure, averaged over the motion during the exposure.

        `exposed_ns` is the middle of the exposure [ns]. A cell that divides during the exposure
        appears in the next image.
        """
        self.painter.change(self._look())
        exposure_ns = self.painter.look.exposure_s * SECOND
        offsets = (np.arange(SUB_EXPOSURES) + 0.5) / SUB_EXPOSURES - 0.5
        scenes = [self._scene_at(exposed_ns + round(offset * exposure_ns)) for offset in offsets]
        # a cell divided during the exposure appears in the next picture
        count = min(scene.shape[1] for scene in scenes)
        moments = [Bodies(*scene[:, :count]) for scene in scenes]
        cells = self._dish.cells.select(np.arange(len(self._dish.cells)) < count)
        is_shown = np.ones(count, bool)
        is_shown[: len(self._bodies)] = self._visible_now()
        picture = self.painter.picture(cells, moments, is_shown, exposed_ns / SECOND)
        return picture[:, ::-1] if self._mirrored else picture
