"""Measures planar poses of robots from an ordinary camera's images of AprilTags."""
