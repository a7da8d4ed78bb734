"""What several test files use, and what is left out by `make check`."""

import os

# As the command does: matrices are small, and threads that wait for each other cost twice the time. Before numpy.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from pathlib import Path

import cv2
import pytest
from tiny_bags import TinyBag, TinyDrive, fill

cv2.setNumThreads(1)  # as many processes as cores run tests already

# Marked `slow`, beside all that start nodes as processes of their own: five seconds of one core and more.
SLOW = {
    *("test_consistency", "test_smoother", "test_fusion", "test_fusion_faults", "test_exposure", "test_lean"),
    *("test_compass_gap", "test_compass_driving", "test_compass_long_baseline", "test_compass_photos"),
    *(
        "test_offline_calibrate",
        "test_offline_real",
        "test_offline_report",
        "test_offline_many",
        "test_offline_cluster",
        "test_cli",
    ),
    *("test_simulation_drive", "test_simulation_held_out", "test_torture", "test_cases_bags", "test_cases_links"),
}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what `make check` leaves out."""
    for item in items:
        names = vars(getattr(item, "module", None) or object).values()
        if item.path.stem in SLOW or any(getattr(value, "__module__", "") == "ros_harness" for value in names):
            item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="session")
def tiny_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An MCAP file with everything in it."""
    folder = tmp_path_factory.mktemp("bag") / "tiny"
    with TinyBag(folder) as bag:
        fill(bag, TinyDrive())
    return folder / "tiny.mcap"
