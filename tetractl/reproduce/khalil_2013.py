"""Khalil, Magdanz, Sanchez, Schmidt, Misra: Magnetotactic bacteria and microjets, IROS 2013.

Speeds and boundary frequencies are given to the specs; the diameter in which a robot is held is the
outcome. A disc of 23 um for 95 % of the time is out of the bacterium's reach at 2 mT: see the page.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.log.read.trial_log import TrialLog
from tetractl.reproduce.paper import Fate, Figure, Paper, Runs, mean

SETTLING_S = 5.0
"""Time of a hold that is not counted [s]."""
PROOF = "v / a is 14.5 um, the least mean distance of any robot that never stops (3)"


def disc(log: TrialLog) -> float:
    """Return the diameter of the disc round the target in which the first robot is for 95 % of a
    hold, of which the first SETTLING_S are left out [length unit]; true poses where known."""
    setup = log.start.setup
    held = [s.observation.sampled_ns for s in log.steps if s.plan.leg == len(setup.legs)]
    poses = log.mocap if log.truth is None else log.truth
    counted = log.mocap_ns >= held[0] + SETTLING_S * SECOND
    return 2 * float(np.quantile(setup.distances(poses[counted, :, :2])[:, 0], 0.95))


def _figures(logs: Mapping[str, Sequence[TrialLog]]) -> Iterator[Figure]:
    found = {name: [disc(log) for log in trials] for name, trials in logs.items()}
    what = "diameter of the disc of 95 % of a hold"
    yield mean(
        f"{what}, bacterium at 2 mT",
        "23 um",
        found["bacterium"],
        lambda ci: ci.high <= 23,
        Fate.OUT,
        PROOF,
        "um",
    )
    yield mean(
        f"{what}, bacterium, a of 11 mT",
        "23 um (at 2 mT)",
        found["bacterium-11mT"],
        lambda ci: ci.high <= 23,
        unit="um",
    )
    jet = found["jet"]
    yield mean(f"{what}, microjet", "417 um", jet, lambda ci: ci.high <= 417, unit="um")


PAPER = Paper(
    "Khalil and others, IROS 2013: one bacterium, one microjet held (disturbed simulation)",
    {
        "bacterium": Runs("magnetospirillum_hold"),
        "bacterium-11mT": Runs("magnetospirillum_hold", ("robots.0.a=8.14", "hold.radius=4")),
        "jet": Runs("microjet_hold"),
    },
    _figures,
)
