"""Images to strips: decoding and grey values, region of interest, mask of the robot, check for the full circle."""
