"""The sections `runner` and `expect` of a fault script, for the test that plays it."""

from typing import Literal

from pydantic import Field
from tetractl_emulator import script

from tetractl.spec.base import Model, Name, NonNegative, Positive


class Runner(Model):
    """How the end-to-end test starts and disturbs the run."""

    sets: tuple[str, ...] = Field(default=(), alias="set")
    """`--set` settings for both the run and the emulator."""
    trials: int = Field(default=1, ge=1, le=20)
    """Number of trials."""


class Expect(Model):
    """The expected result of a run, which the end-to-end test checks."""

    outcome: Literal["done", "aborted", "refused", "interrupted", "killed"]
    """How the run ends; `refused` is an end before any wheel turns."""
    exit: int
    """Exit code of the run; a negative value is the signal that killed it."""
    says: str = ""
    """Regular expression that the run's output or log must match."""
    tolerance: NonNegative | None = None
    """Time for which the fault is tolerated [s]; the stop must be sent within 0.1 s after it."""
    robots: tuple[Name, ...] = ()
    """Names of the robots that have to stop; all by default."""
    still: Positive | None = None
    """Time after the fault is first visible by which all robots stand still [s]."""
    inside: bool = False
    """Whether every robot's centre must stay inside the arena."""
    apart_mm: Positive | None = None
    """Least distance that the centres of robots must keep from each other [mm]."""
    clear: bool = False
    """Whether every robot's centre must stay outside of obstacles."""


def load_script(path, camera="optitrack"):
    """Read a script with both sections; `expect` is None where it expects nothing."""
    read = script.load_script(path, camera)
    sections = {
        "runner": Runner.model_validate(read.runner, strict=True),
        "expect": Expect.model_validate(read.expect, strict=True) if read.expect else None,
    }
    return read.model_copy(update=sections)
