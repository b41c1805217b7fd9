"""ROS 2 robots and trackers for tetractl, over DDS, without a ROS installation."""
