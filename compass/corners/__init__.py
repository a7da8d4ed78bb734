"""Yaw from tracked corners, whose parallax has one sign: see `method`."""
