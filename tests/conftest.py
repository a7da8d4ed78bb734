"""What several test files use."""

from pathlib import Path

import pytest
from tiny_bags import TinyBag, TinyDrive, fill


@pytest.fixture(scope="session")
def tiny_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An MCAP file with everything in it."""
    folder = tmp_path_factory.mktemp("bag") / "tiny"
    with TinyBag(folder) as bag:
        fill(bag, TinyDrive())
    return folder / "tiny.mcap"
