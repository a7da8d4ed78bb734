"""Which recording a file is: known by its content."""

import shutil

import pytest
from tiny_bags import TinyBag, TinyDrive, fill

from fusion.offline.source import BLOCK, BLOCKS, source_of


def test_source_is_known_by_its_content(tiny_bag, tmp_path):
    copy = tmp_path / "renamed.bag"
    shutil.copy(tiny_bag, copy)
    assert source_of(copy).same_as(source_of(tiny_bag))
    with copy.open("r+b") as file:
        file.seek(copy.stat().st_size // 2)
        file.write(b"\0\1\2\3")
    assert not source_of(copy).same_as(source_of(tiny_bag))


@pytest.mark.parametrize("at", [0, BLOCK - 1, 5 * 2**20, -1])
def test_source_of_a_large_file_tells_a_change_in_its_samples(tmp_path, at):
    size = BLOCKS * BLOCK + 16 * 2**20
    large = tmp_path / "large.mcap"
    with large.open("wb") as file:
        file.truncate(size)
    before = source_of(large)
    place = at % size
    if at == 5 * 2**20:
        place = 3 * (size - BLOCK) // (BLOCKS - 1)  # the fourth sample begins here
    with large.open("r+b") as file:
        file.seek(place)
        file.write(b"x")
    assert not source_of(large).same_as(before)
    with large.open("ab") as file:
        file.write(b"\0")
    assert source_of(large).size_bytes == size + 1


def test_source_of_a_database_has_its_log_in_it(tmp_path):
    with TinyBag(tmp_path / "bag", storage="sqlite3") as bag:
        fill(bag, TinyDrive(seconds=0.5), images="compressed")
    (database,) = (tmp_path / "bag").glob("*.db3")
    before = source_of(tmp_path / "bag")
    database.with_name(f"{database.name}-wal").write_bytes(b"more")
    assert not source_of(tmp_path / "bag").same_as(before)
