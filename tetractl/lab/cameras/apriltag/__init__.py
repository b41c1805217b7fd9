"""AprilTags seen by an ordinary camera: pictures to the planar poses of robots."""
