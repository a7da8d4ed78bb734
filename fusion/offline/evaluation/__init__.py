"""``visual-compass evaluate``: every method and sensor scored on simulated drives, or on a bag that holds the truth."""
