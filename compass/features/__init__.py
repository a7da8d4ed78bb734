"""Corners: found, tracked or matched, and the rotation and direction of travel that explain where they went."""
