"""Swimming organisms that can be steered: their sizes, speeds and helices, by name.

A range (low, high) contains about 95 % of healthy swimmers that are seen from above. Sizes in an
image are less exact: blur widens a body, a tilt out of the image plane shortens it, and a cell that
divides is longer. A tracker therefore accepts an object as a swimmer up to the factor
OUTLINE_FACTOR beyond a range. Another package can add an organism with an entry point of the group
"tetractl.organisms" whose object is an `Organism`. A `guess` is a value for which no source was
found.
"""

import math
from dataclasses import dataclass

from tetractl.core.errors import UsageError
from tetractl.model.cell_numbers import BODY_LENGTH_UM, BODY_WIDTH_UM, HELIX_HZ, HELIX_UM
from tetractl_microscope.registries import ORGANISMS

# Maximum factor by which an outline in an image is longer or shorter than the body.
OUTLINE_FACTOR = 1.6
SLOW_FRACTION = 1 / 3  # an organism that swims at less than this fraction of its lowest speed rests

Range = tuple[float, float]
"""The range of a quantity: its lowest and its highest value."""


@dataclass(frozen=True, slots=True)
class Organism:
    """A swimming organism, with the usual sizes, speeds and helices of its cells.

    Attributes:
        name: Its name.
        long_um: Range of the body's length [um].
        wide_um: Range of the body's width [um].
        speed_um_s: Range of the speed [um/s].
        helix_hz: Mean and standard deviation of the turns of its helix [1/s].
        helix_um: Mean and standard deviation of the helix's radius [um].
        source: Where these values come from.
    """

    name: str
    long_um: Range
    wide_um: Range
    speed_um_s: Range
    helix_hz: Range
    helix_um: Range
    source: str

    @property
    def body_um(self) -> tuple[float, float]:
        """Length and width of a body in the middle of the ranges [um]."""
        return sum(self.long_um) / 2, sum(self.wide_um) / 2

    @property
    def outline_um(self) -> tuple[Range, Range]:
        """Ranges of length and width of an outline that may be this organism [um]."""
        length_min, length_max = self.long_um
        width_min, width_max = self.wide_um
        return (length_min / OUTLINE_FACTOR, length_max * OUTLINE_FACTOR), (
            width_min / OUTLINE_FACTOR,
            width_max * OUTLINE_FACTOR,
        )

    @property
    def outline_um2(self) -> Range:
        """Range of the area of an outline that may be this organism, an ellipse [um^2]."""
        (length_min, length_max), (width_min, width_max) = self.outline_um
        return math.pi / 4 * length_min * width_min, math.pi / 4 * length_max * width_max

    @property
    def slowest_um_s(self) -> float:
        """Speed below which an individual counts as resting [um/s]."""
        return SLOW_FRACTION * self.speed_um_s[0]

    @property
    def quickness(self) -> float:
        """Maximum speed in body lengths per second, as a multiple of that of Tetrahymena."""
        fastest = self.speed_um_s[1] / self.body_um[0]
        return fastest / (TETRAHYMENA.speed_um_s[1] / TETRAHYMENA.body_um[0])


def _range_of_95_percent(mean: float, deviation: float) -> Range:
    """Compute the range of about 95 % of normal values: the mean -/+ two standard deviations."""
    return mean - 2 * deviation, mean + 2 * deviation


TETRAHYMENA = Organism(
    name="tetrahymena",
    long_um=_range_of_95_percent(*BODY_LENGTH_UM),
    wide_um=_range_of_95_percent(*BODY_WIDTH_UM),
    speed_um_s=(180.0, 760.0),
    helix_hz=HELIX_HZ,
    helix_um=HELIX_UM,
    source=(
        "T. pyriformis: lengths and widths, n = 1504, doi:10.1101/2023.07.25.550219; the fastest "
        "fifth swim at 400 to 754 um/s at 20 C, slower ones: guess; one cell turned 2.5 times a "
        "second, same data; radius and spread of the helix: guess"
    ),
)
PARAMECIUM = Organism(
    name="paramecium",
    long_um=(170.0, 300.0),
    wide_um=(35.0, 65.0),
    speed_um_s=(500.0, 1500.0),
    helix_hz=(1.0, 0.3),
    helix_um=(40.0, 15.0),
    source=(
        "P. caudatum: length 170 to 300 um, width about 50 um: Wichterman, The Biology of "
        "Paramecium, 1986; speeds collected in BOSO-Micro, doi:10.1371/journal.pone.0252291; "
        "range of the width and the helix: guess"
    ),
)
EUGLENA = Organism(
    name="euglena",
    long_um=(35.0, 60.0),
    wide_um=(8.0, 15.0),
    speed_um_s=(50.0, 150.0),
    helix_hz=(1.5, 0.5),
    helix_um=(3.0, 1.5),
    source=(
        "E. gracilis: sizes and speeds collected in BOSO-Micro, doi:10.1371/journal.pone.0252291; "
        "it swims on a helix: Rossi et al., doi:10.1073/pnas.1708064114; numbers of the helix and "
        "ends of the ranges: guess"
    ),
)
HELICAL_MICROROBOT = Organism(
    name="helical-microrobot",
    long_um=(20.0, 60.0),
    wide_um=(2.5, 10.0),
    speed_um_s=(5.0, 60.0),
    helix_hz=(1.0, 0.5),
    helix_um=(0.5, 0.5),
    source=(
        "artificial bacterial flagella, 38 um long, up to 18 um/s at 2 mT: Zhang et al., "
        "doi:10.1063/1.3079655 and doi:10.1021/nl901869j; ends of the ranges for other designs and "
        "the wobble of the body: guess"
    ),
)
MAGNETOSPIRILLUM = Organism(
    name="magnetospirillum",
    long_um=(3.5, 6.5),
    wide_um=(0.5, 0.9),
    speed_um_s=(16.0, 64.0),
    helix_hz=(2.0, 1.0),
    helix_um=(0.1, 0.1),
    source=(
        "a magnetotactic bacterium of 5 um at 32 um/s: Khalil et al., IROS 2013; how it turns: "
        "Pichel et al., doi:10.48550/arXiv.1710.00405; ends of the ranges, width and helix: guess"
    ),
)


def find_organism(name: str) -> Organism:
    """Find an organism by its name.

    Raises:
        UsageError: If there is none.
        PluginError: If another package offers it, but it cannot be loaded.
    """
    if name not in ORGANISMS:
        raise UsageError(
            f"there is no organism named '{name}'",
            f"the known organisms are {', '.join(ORGANISMS.names())}",
        )
    return ORGANISMS.load(name)
