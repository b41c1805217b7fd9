"""The fields of a spec that say how the planner avoids obstacles, walls and other robots."""

from pydantic import Field

from tetractl.experiment.base import Model, NonNegative


class Collision(Model):
    """How the planner avoids obstacles, the arena's edge, and other robots. Robots without wheels
    do not stop by default."""

    margin: NonNegative = 0.0
    """Distance by which obstacles are grown for the planner [length unit]."""
    walls: bool = True
    """Whether leaving the arena counts as entering an obstacle."""
    radius: NonNegative = 0.0
    """Radius of a robot, by which obstacles are grown as well [length unit]; 0 for points."""
    separation: NonNegative = Field(default_factory=lambda fields: 2 * fields.get("radius", 0.0))
    """Least distance of the centres of two robots in the plan [length unit]; 0 for robots that may
    meet. The distance is tested at the predicted positions. The default is two radii."""
    adaptive: bool = True
    """Whether the margin grows by a robot's greatest deviation from its course before the next
    command acts, given the uncertainty of its motion. If a robot or target is within the margin,
    the margin is reduced to its distance.
    """
    stop_before_collision: bool = True
    """Whether all robots rest if the best plan found leads one into an obstacle, or if a new plan
    from rest is worth more. From rest, robots of which no plan keeps clear turn on
    the spot first; the trial ends if that does not help either. Robots also end at rest,
    and drive on if their total error is then too large. Only for robots that can stand still, which
    have `wheels`."""
