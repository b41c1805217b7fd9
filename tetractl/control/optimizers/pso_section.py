"""The section `type: pso`; its search imports and runs the compiled Algorithm 1."""

from tetractl.control.optimizers.pso import PsoFields
from tetractl.core.plan import Limits, Problem, Search
from tetractl.core.poses import Floats


class Pso(PsoFields):
    """Particle swarm of the paper's Algorithm 1, equations (14)-(19)."""

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Search sequences of `length` signals by Algorithm 1, compiled."""
        from tetractl.control.optimizers import compiled_pso

        return compiled_pso.pso(self, problem, length, warm, key, limits)
