"""The study: what is swept, which controllers are compared, and how often."""

from typing import Annotated, Any

from pydantic import Field

from tetractl.core.registries import SWEEPS
from tetractl.experiment.base import Model, Name
from tetractl.experiment.experiment import Trials
from tetractl.experiment.registry_fields import KindSection
from tetractl.study.sweep import Path, Sweep


class Study(Model):
    """One study, as read from a YAML file. Each point of the sweep is run with each controller;
    every such arm has the same seeds, so that trials of one number are pairs."""

    name: str = Field(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")
    """Name of the study, which its folder is called after: letters without accents
    (a to z, A to Z), digits, dots, underscores and hyphens, starting with a letter or digit."""
    description: str = ""
    """Description in one or two sentences."""
    base: str = Field(min_length=1, max_length=1000)
    """File of the spec that every arm starts from, by its path from the study's file."""
    sweep: Annotated[Sweep, KindSection(SWEEPS)] | None = None
    """The fields that take several values, and which; without it the base's values are kept."""
    controllers: dict[Name, dict[Path, Any]] = Field(default={}, max_length=1000)
    """By name, the alternatives to compare: each a mapping of paths to values, set before those of
    the sweep."""
    trials: Trials = Trials()
    """Trials of each arm, in place of the base's own."""
