"""An emulated network camera above robots with AprilTags, which renders its images."""
