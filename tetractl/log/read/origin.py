"""What a trial's robots were: simulated, emulated or real."""

from enum import StrEnum

from tetractl.core.commands import EMULATED, PlantInfo
from tetractl.experiment.experiment import Experiment

_OLD_SERVER = "EMULATED"  # in the camera server's name, where a log has no fact of its own


class Origin(StrEnum):
    """What a trial's robots were; every table and figure says it."""

    UNDISTURBED = "undisturbed simulation"
    DISTURBED = "disturbed simulation"
    EMULATED = "emulated lab"
    LAB = "lab"

    @classmethod
    def of(cls, experiment: Experiment, plant: PlantInfo) -> "Origin":
        """Return the origin of a trial, from its spec and what its plant said of itself.

        A lab is emulated where a device announced it; the addresses do not matter.
        """
        if plant.simulated:
            return cls.DISTURBED if experiment.plant.disturbed else cls.UNDISTURBED
        old = _OLD_SERVER in plant.facts.get("server", "")
        return cls.EMULATED if plant.facts.get(EMULATED) or old else cls.LAB

    @property
    def simulated(self) -> bool:
        """Whether the plant was a simulation."""
        return self in (Origin.DISTURBED, Origin.UNDISTURBED)

    @property
    def comparable(self) -> bool:
        """Whether a published result of real robots is a fair thing to compare with."""
        return self in (Origin.DISTURBED, Origin.LAB)
