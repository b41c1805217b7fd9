"""The motion of simulated cells: `tetractl.model.motion.helix.swim`, compiled."""

from tetractl.control.kernels.cache import compiled
from tetractl.control.kernels.options import ENTRY
from tetractl.model.motion import helix

swim = compiled(**ENTRY)(helix.swim)
