"""The true path of simulated robots on wheels: `tetractl.model.motion.arc.chain`, compiled."""

from tetractl.control.kernels.cache import compiled
from tetractl.control.kernels.options import ENTRY
from tetractl.model.motion import arc

chain = compiled(**ENTRY)(arc.chain)
