"""What is watched so that the yaw is never confidently wrong: faults found, named and survived."""
