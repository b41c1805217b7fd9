"""Cells in a simulation: `tetractl.model.motion.swimming.swim`, compiled, with the same bits."""

from tetractl.core.kernels.kernel_cache import compiled
from tetractl.core.kernels.kernel_options import ENTRY, exact, with_parts
from tetractl.model.motion import swimming

swim = compiled(**ENTRY)(with_parts(swimming.swim, exact))
