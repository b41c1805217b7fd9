from support.work import bounded

from tetractl.experiment.consistency import contradictions
from tetractl.experiment.experiment import Arena, Robot
from tetractl.model.shapes.circle import Circle


def test_many_robots_and_obstacles_are_compared_without_a_loop_over_the_pairs():
    arena = Arena(left=0, bottom=0, width=1e4, height=1e4)
    robots = {
        i: Robot(name=f"r{i}", start=(10 * i, 10), target=(10 * i, 9000), a=2, speed=1)
        for i in range(300)
    }
    obstacles = {
        j: Circle(type="circle", center=(10 * j, 9000 if j % 100 == 7 else 5000), radius=4)
        for j in range(300)
    }
    with bounded(100_000 + 10 * 300 * 300):
        found = list(contradictions(arena, robots, obstacles))
    assert [loc for loc, _ in found] == [("robots", i, "target") for i in (7, 107, 207)]
    assert "inside obstacles.107, a circle" in found[1][1]
