"""Finds AprilTags in the images of an ordinary camera, and measures the robots' poses."""
