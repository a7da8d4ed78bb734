"""Images to strips: decoding, projections, region of interest, mask of the robot, check for the full circle."""
