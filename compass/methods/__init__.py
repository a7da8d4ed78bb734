"""The methods by which two strips are compared: one file each, found by name in `registry`."""
