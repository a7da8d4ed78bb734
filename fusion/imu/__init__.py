"""What an IMU measures: where up is, the rate about it, and what is wrong with either."""
