"""A ray-cast world, a tracked robot and its sensors, with known truth."""
