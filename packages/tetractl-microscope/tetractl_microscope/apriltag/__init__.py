"""Planar poses of robots from an ordinary camera's pictures of AprilTags."""
