"""Claims of Khalil, Magdanz, Sanchez, Schmidt and Misra: bacteria and microjets held in place.

The paper is from IROS 2013. Its speeds and boundary frequencies are inputs of the specs. The
diameter of the disc in which a robot is held is the result. No controller can hold the bacterium at
2 mT in a disc of 23 um for 95 % of the time: see the page.
"""

import json

from tetractl.log.read.trial_log import TrialLog
from tetractl.statistics.built_in_statistics import discs
from tetractl_papers.claim import Claim, Fate, at_most, mean_of, not_judged
from tetractl_papers.paper import Paper, Runs

DISC = "diameter of the disc of 95 % of a hold"
OVER_LEAST = 1.15
"""Maximum of our criterion for the disc, relative to its least possible value. We chose it.

About 1.14 is the least for a robot whose pose, a and v are known (see the README).
"""


def disc(log: TrialLog) -> float:
    """Return the diameter of the disc that holds the robot for 95 % of a hold [length unit].

    The trial must have only one robot.
    """
    return float(discs(log)[0])


def disc_over_least(log: TrialLog) -> float:
    """Compute the diameter of the disc divided by 2 v / a, the minimum mean diameter of the robot.

    The disc holds the robot for 95 % of a hold.
    """
    facts = log.start.plant.facts
    (a,) = json.loads(facts["true_a"])
    (speed,) = json.loads(facts["true_speed"])
    return disc(log) * a / (2 * speed)


CLAIMS = [
    Claim(
        figure=f"{DISC}, bacterium at 2 mT",
        published="23 um",
        arm="bacterium",
        measure=disc,
        unit="um",
        asked=not_judged(mean_of),
        expected=Fate.NOT_JUDGED,
        why="v / a is 14.5 um, the least mean distance of any robot that never stops (3)",
    ),
    Claim(
        figure=f"{DISC}, bacterium at 2 mT, over its true 2 v / a",
        published=f"none; at most {OVER_LEAST}",
        arm="bacterium",
        measure=disc_over_least,
        asked=at_most(OVER_LEAST),
        expected=Fate.MISSED,
        why="the least is about 1.14, with pose, a and v known exactly"
        " (benchmarks/least_disc.py of commit 7c1384f3)",
    ),
    Claim(
        figure=f"{DISC}, bacterium, a of 11 mT",
        published="23 um (at 2 mT)",
        arm="bacterium-11mT",
        measure=disc,
        unit="um",
        asked=not_judged(mean_of),
        expected=Fate.NOT_JUDGED,
    ),
    Claim(
        figure=f"{DISC}, microjet",
        published="417 um",
        arm="jet",
        measure=disc,
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
