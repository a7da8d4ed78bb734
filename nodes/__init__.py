"""Thin ROS 2 nodes over the pipeline; nothing imports this package."""
