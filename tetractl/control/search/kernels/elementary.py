"""The sine, cosine and similar functions of `tetractl.core.elementary`, for use in compiled code.

They give the same result as in plain Python, to the last bit.
"""

from tetractl.core import elementary
from tetractl.tools.kernels.kernel_options import exact

sin = exact(elementary.sin)
cos = exact(elementary.cos)
exp = exact(elementary.exp)
log = exact(elementary.log)
atan = exact(elementary.atan)
atan2 = exact(elementary.atan2)
hypot = exact(elementary.hypot)
