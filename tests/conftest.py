"""What several test files use, and what is left out by `make check`."""

import ctypes
import gc
import os

# As the command does: matrices are small, and threads that wait for each other cost twice the time. Before numpy.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from pathlib import Path

import cv2
import pytest
from tiny_bags import TinyBag, TinyDrive, fill

cv2.setNumThreads(1)  # as many processes as cores run tests already

# Pictures of some MB come and go by the thousand. By default the C library gives their pages back to the system each
# time, and to get them anew takes as long as what is computed in them: it shall keep 256 MB, and 32 MB in one piece.
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
if hasattr(ctypes.CDLL(None), "mallopt"):  # glibc
    ctypes.CDLL(None).mallopt(M_TRIM_THRESHOLD, 1 << 28)
    ctypes.CDLL(None).mallopt(M_MMAP_THRESHOLD, 1 << 25)

# Marked `slow`, beside all that start nodes as processes of their own: five seconds of one core and more, where a
# change is seldom noticed by these alone.
SLOW = {
    *("test_consistency", "test_smoother", "test_fusion_faults", "test_fusion_abrupt", "test_image_timing"),
    *("test_turn_count", "test_tilt", "test_noise", "test_clock_offset", "test_clock_steps", "test_unconfirmed"),
    *("test_compass_gap", "test_compass_driving", "test_compass_long_baseline", "test_compass_photos"),
    *("test_compass_circle", "test_compass_part", "test_compass_projections", "test_simulation_camera"),
    *("test_simulation_drive", "test_simulation_held_out", "test_torture", "test_cases_bags", "test_cases_links"),
    *("test_cli", "test_offline_calibrate", "test_offline_circles", "test_offline_cluster", "test_offline_evaluate"),
    *("test_offline_library", "test_offline_many", "test_offline_nothing_lost", "test_offline_plot"),
    *(
        "test_offline_real",
        "test_offline_report",
        "test_offline_staging",
        "test_offline_video",
        "test_offline_warnings",
    ),
    *("test_bag_storage", "test_compass_compressed", "test_docs", "test_tools"),
}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what `make check` leaves out."""
    for item in items:
        names = vars(getattr(item, "module", None) or object).values()
        if item.path.stem in SLOW or any(getattr(value, "__module__", "") == "ros_harness" for value in names):
            item.add_marker(pytest.mark.slow)


def pytest_collection_finish() -> None:
    """Spare the garbage collector the thousands of tests and modules, which stay: it looks at all, again and again."""
    gc.collect()
    gc.freeze()


@pytest.fixture
def without_plot(monkeypatch: pytest.MonkeyPatch) -> None:
    """`fuse` in this process draws no plot, which takes as long as the fusion of a short bag; others look at that."""
    monkeypatch.setattr("fusion.offline.fuse_bag.plot_run", lambda run, path, title: path.write_bytes(b""))


@pytest.fixture(scope="session")
def tiny_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An MCAP file with everything in it."""
    folder = tmp_path_factory.mktemp("bag") / "tiny"
    with TinyBag(folder) as bag:
        fill(bag, TinyDrive())
    return folder / "tiny.mcap"
