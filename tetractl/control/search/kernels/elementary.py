"""The sine, cosine and similar functions of `tetractl.core.elementary`, for use in compiled code.

They give the same result as in plain Python, to the last bit.
"""

from tetractl.core import elementary
from tetractl.tools.kernels.kernel_options import exact, shared_exact

sin = shared_exact(elementary.sin)
cos = shared_exact(elementary.cos)
exp = shared_exact(elementary.exp)
log = shared_exact(elementary.log)
atan = shared_exact(elementary.atan)
atan2 = shared_exact(elementary.atan2)
hypot = exact(elementary.hypot)
