"""Claims of a paper by Khalil and others (2013) about bacteria and microjets held in place.

The paper by Khalil, Magdanz, Sanchez, Schmidt and Misra is from IROS 2013. Its speeds and boundary
frequencies are inputs of the specs. The diameter of the disc in which a robot is held is the
result. No controller can hold the bacterium at 2 mT in a disc of 23 um for 95 % of the time: see
the README of this package.
"""

import json

from tetractl.log.read.trial_log import TrialLog
from tetractl.statistics.built_in_statistics import discs
from tetractl_papers.claim import Claim, Fate, at_most, mean_of, not_judged
from tetractl_papers.paper import Paper, Runs

DISC_FIGURE = "diameter of the disc of 95 % of a hold"
DISC_RATIO_MAX = 1.15
"""Maximum diameter of the disc in our criterion, as a multiple of 2 v / a. We chose this value.

The minimum is about 1.14, for a robot whose pose, a and v are known (see the README).
"""


def measure_disc(log: TrialLog) -> float:
    """Measure the diameter of the disc that contains the robot for 95 % of a hold [length unit].

    The trial must have only one robot.
    """
    return float(discs(log)[0])


def measure_disc_ratio(log: TrialLog) -> float:
    """Measure how much larger a disc is than 2 v / a, twice the radius of a robot's tightest bend.

    The disc contains the robot for 95 % of a hold. The trial must have only one robot.
    """
    plant_facts = log.start.plant.facts
    (a,) = json.loads(plant_facts["true_a"])
    (speed,) = json.loads(plant_facts["true_speed"])
    return measure_disc(log) * a / (2 * speed)


CLAIMS = [
    Claim(
        figure=f"{DISC_FIGURE}, bacterium at 2 mT",
        published="23 um",
        arm="bacterium",
        measure=measure_disc,
        unit="um",
        asked=not_judged(mean_of),
        expected=Fate.NOT_JUDGED,
        why="v / a is 14.5 um, the least mean distance of any robot that never stops (3)",
    ),
    Claim(
        figure=f"{DISC_FIGURE}, bacterium at 2 mT, over its true 2 v / a",
        published=f"none; at most {DISC_RATIO_MAX}",
        arm="bacterium",
        measure=measure_disc_ratio,
        asked=at_most(DISC_RATIO_MAX),
        expected=Fate.MISSED,
        why="the least is about 1.14, with pose, a and v known exactly"
        " (benchmarks/least_disc.py of commit 7c1384f3)",
    ),
    Claim(
        figure=f"{DISC_FIGURE}, bacterium, a of 11 mT",
        published="23 um (at 2 mT)",
        arm="bacterium-11mT",
        measure=measure_disc,
        unit="um",
        asked=not_judged(mean_of),
        expected=Fate.NOT_JUDGED,
    ),
    Claim(
        figure=f"{DISC_FIGURE}, microjet",
        published="417 um",
        arm="jet",
        measure=measure_disc,
        unit="um",
        asked=not_judged(mean_of),
        expected=Fate.NOT_JUDGED,
    ),
]

PAPER = Paper(
    source="Khalil and others, IROS 2013: one bacterium, one microjet held (disturbed simulation)",
    arms={
        "bacterium": Runs("magnetospirillum_hold"),
        "bacterium-11mT": Runs("magnetospirillum_hold", ("robots.0.a=8.14", "hold.radius=4")),
        "jet": Runs("microjet_hold"),
    },
    claims=CLAIMS,
)
