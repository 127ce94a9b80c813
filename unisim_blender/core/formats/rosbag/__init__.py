"""A run as a ROS 2 bag."""
