"""Skips the tests that import it where OpenCV is not installed."""

import pytest

cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed: pip install 'tetractl[vision]'")
