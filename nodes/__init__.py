"""Thin ROS 2 nodes over the pipeline; nothing imports this package."""

import os
import signal
import sys

__distribution__ = "visual-compass"  # so that another package of this name is told apart

# Both are read when the libraries are loaded, so they stand before every other import.
# A corrupt image is a complaint of ours, said once; OpenCV would print a line for every one.
os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
# The matrices are small: threads of OpenBLAS that spin for each other cost a loaded robot thirtyfold (96 against 3 ms).
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

if sys.argv[:1] == ["-m"]:  # so it is while `python -m nodes.fusion_node` looks for the module that it is to run
    from visual_compass import check_packages

    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C while the libraries load ends it without a traceback
    check_packages("compass", "fusion")
