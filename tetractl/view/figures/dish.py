"""The microscope's picture of the dish under what is drawn of a trial."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.transforms import Affine2D

from tetractl.log.read.trial_log import TrialLog
from tetractl.replay.dish_pictures import DishPictures

FAINT = 0.55  # opacity of the picture, so that paths and marks stand out


class DishGround:
    """Shows the picture of a time under the axes of a trial; nothing for a log without pictures."""

    def __init__(self, axes: Axes, log: TrialLog) -> None:
        self._pictures, self._shown, self._image = DishPictures(log), -1, None
        if not self._pictures.times:
            return
        low, right, up = self._pictures.corners
        place = Affine2D(np.vstack([np.column_stack([right - low, up - low, low]), [0, 0, 1]]))
        limits = axes.axis()
        self._image = axes.imshow(
            self._pictures.grey(0), cmap="gray", vmin=0, vmax=255, alpha=FAINT, zorder=0,
            extent=(0, 1, 0, 1), interpolation="bilinear", transform=place + axes.transData,
        )  # fmt: skip
        axes.axis(limits)

    def show(self, when_ns: int) -> bool:
        """Show the picture of a time on the trial's clock; return whether it is another one."""
        which = self._pictures.at(when_ns)
        if which is None or which == self._shown:
            return False
        assert self._image is not None, "with a picture there is an image"
        self._image.set_data(self._pictures.grey(which))
        self._shown = which
        return True
