"""What is said of a robot whose motion is not one that its commands allow.

A motion has three parts: the displacement along the robot's heading, that across it, and the angle
turned around. Arrays (3,) hold them in this order. `motion_check` finds motions out of bounds.
"""

import numpy as np

from tetractl.core.poses import Floats
from tetractl.lab.motion_window import BoundedMotion

STANDS_SHARE = 0.3
"""A robot that makes less than this share of the commanded motion stands still."""
MEANT_SHARE = 0.3
"""If less than this share of the motion is commanded, its direction is not wrong: a disturbance
moves the robot."""

REPEATS = "its pose repeats to the last bit though it is commanded to move: is the camera frozen?"
DOES_NOT_MOVE = (
    "does not move though commanded to: is a wheel stuck, is the robot on its back or "
    "without power or link, or is the camera frozen?"
)
BACKWARD = "moves backward: is its heading offset wrong, or its drive inverted?"
WRONG_WAY = "turns the wrong way: is its drive swapped or inverted?"
OF_CELLS = {
    DOES_NOT_MOVE: "does not swim: is it stuck or dead, or is the camera frozen?",
    BACKWARD: "moves backward: is its heading reversed, or another cell tracked in its place?",
    WRONG_WAY: "turns away from the field: is the camera's rotation or the field's sign wrong?",
}
"""What is said instead of robots without wheels."""
AS_NO_COMMAND = "as no command does"
ANOTHER = (
    f"moves {{}} {AS_NO_COMMAND}: was it pushed, or does the camera track another body as "
    "this robot?"
)
"""Holds a place for one of KINDS."""
KINDS = ("along its heading", "sideways", "around")
"""The names of a motion's three parts."""


def fault_of(motion: BoundedMotion, slack: Floats, has_wheels: bool) -> str:
    """Return the text of a motion of which a part is out of its bounds by more than `slack` (3,).

    What is commanded is the middle of the bounds. A part *stands* if it is smaller than
    STANDS_SHARE of what is commanded. It is *against* the command if their signs differ and what is
    commanded is greater than MEANT_SHARE of it. The first row that holds is said:

        it does not move             along is out of bounds and stands; or around is out of bounds
                                     and stands, and along is smaller than its slack
        it moves backward            along is out of bounds, and against the command
        it turns the wrong way       around is out of bounds, and against the command
        it moves as no command does  of along, across and around, the first that is out of bounds
    """
    along, across, around = motion.out_of_bounds(slack)
    travelled = motion.travelled
    commanded = (motion.least + motion.most) / 2
    stands = np.abs(travelled) < STANDS_SHARE * np.abs(commanded)
    is_meant = np.abs(commanded) > MEANT_SHARE * np.abs(travelled)
    is_against = (travelled * commanded < 0.0) & is_meant
    stands_along = along and stands[0]
    stands_around = around and stands[2] and abs(travelled[0]) < slack[0]
    if stands_along or stands_around:
        return of_kind(DOES_NOT_MOVE, has_wheels)
    if along and is_against[0]:
        return of_kind(BACKWARD, has_wheels)
    if around and is_against[2]:
        return of_kind(WRONG_WAY, has_wheels)
    if along:
        return ANOTHER.format(KINDS[0])
    return ANOTHER.format(KINDS[1] if across else KINDS[2])


def of_kind(fault: str, has_wheels: bool) -> str:
    """Return how a fault is said of a robot with wheels or without."""
    return fault if has_wheels else OF_CELLS[fault]
