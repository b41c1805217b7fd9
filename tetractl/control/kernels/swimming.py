"""The motion of simulated cells: `tetractl.model.motion.swimming.swim`, compiled."""

from tetractl.control.kernels.cache import compiled
from tetractl.control.kernels.options import ENTRY
from tetractl.model.motion import swimming

swim = compiled(**ENTRY)(swimming.swim)
