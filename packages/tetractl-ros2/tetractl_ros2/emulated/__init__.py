"""The emulated tracker and robots, at the other end of the ROS 2 topics."""
