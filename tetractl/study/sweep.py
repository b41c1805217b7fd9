"""What every sweep has: points, each a value for some fields of the spec."""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from tetractl.experiment.base import Model
from tetractl.experiment.yaml.problems import Loc

Path = Annotated[str, Field(min_length=1, max_length=200)]
"""A field of a spec as `--set` takes it, such as `controller.optimizer.rounds`."""


@dataclass(frozen=True, slots=True)
class Setting:
    """A value that a field takes, and where in the sweep's section that is written."""

    value: Any
    loc: Loc


class Sweep(Model):
    """The section `sweep` of a study; each kind has its own name as the `Literal` of its `type`."""

    @abstractmethod
    def draw(self, rng: np.random.Generator) -> list[Mapping[str, Setting]]:
        """Return the points, each the settings of fields by their paths.

        All draws come from `rng`, which is made from the root seed of the study.
        """
