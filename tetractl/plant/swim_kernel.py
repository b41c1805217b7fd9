"""Cells in a simulation: `tetractl.model.motion.swimming.swim`, compiled, with the same bits."""

from tetractl.model.motion import swimming
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import ENTRY, exact, with_parts

swim = compiled(**ENTRY)(with_parts(swimming.swim, exact))
