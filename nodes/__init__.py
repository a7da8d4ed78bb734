"""Thin ROS 2 nodes over the pipeline; nothing imports this package."""

import os

# A corrupt image is a complaint of ours, said once; OpenCV would print a line for every one. Read on its import.
os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
