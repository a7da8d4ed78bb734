"""Measurements in the order of their stamps, replayed when one comes late."""
