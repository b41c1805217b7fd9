"""Skips the tests that import it if OpenCV is not installed, and writes films."""

import numpy as np
import pytest

cv2 = pytest.importorskip("cv2", reason="pip install ./packages/tetractl-microscope")


def video(path, pictures, rate=30.0, codec="MJPG"):
    """Write grey pictures as a film; return its path. The test is skipped if none can be read."""
    for package in ("imageio.v3", "av"):
        pytest.importorskip(package, reason="pip install './packages/tetractl-microscope[films]'")
    writer = None
    for picture in pictures:
        code = cv2.VideoWriter.fourcc(*codec)
        writer = writer or cv2.VideoWriter(str(path), code, rate, picture.shape[::-1])
        writer.write(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR))
    writer.release()
    return path


def stack(path, pictures):
    """Write grey pictures as a TIFF file; return its path. It needs no decoder of videos."""
    for package in ("imageio.v3", "tifffile"):
        pytest.importorskip(package, reason="pip install './packages/tetractl-microscope[films]'")
    import tifffile

    tifffile.imwrite(path, np.stack(list(pictures)), photometric="minisblack")
    return path


finds_small_tags = pytest.mark.skipif(
    tuple(int(part) for part in cv2.__version__.split(".")[:2]) < (4, 14),
    reason="OpenCV before 4.14 misses some small tags",
)
