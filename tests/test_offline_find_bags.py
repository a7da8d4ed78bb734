"""Many recordings from few words, and a folder's name for the results of each."""

import os
import shutil
from pathlib import Path

import pytest
from gyro_bags import three_bags
from hypothesis import given
from hypothesis import strategies as st

from fusion.offline.cli import main
from fusion.offline.earlier_results import EarlierResult
from fusion.offline.find_bags import find_bags, name_folders
from fusion.offline.fuse_bag import fuse_bag
from fusion.offline.source import Source, source_of
from fusion.offline.storage import BagError
from fusion.settings import Settings


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    return three_bags(tmp_path_factory.mktemp("bags"))


# ---------------------------------------------------------------- found


def test_bags_are_found_by_folder_pattern_and_name_each_once(bags, tmp_path):
    everything = [str(bags / name) for name in ("mon/drive.mcap", "tue/drive.mcap", "tue/dusk.mcap")]
    assert find_bags([str(bags)]) == everything
    assert find_bags([f"{bags}/*/d*.mcap", str(bags), everything[1]]) == everything
    assert find_bags([f"{bags}/**/dusk*"]) == everything[2:]
    with pytest.raises(BagError, match="no file of that pattern"):
        find_bags([f"{bags}/*.bag"])
    with pytest.raises(BagError, match="no bag in it or below it"):
        find_bags([str(tmp_path)])


def test_folder_that_is_one_recording_is_one_bag(bags, tmp_path):
    for name in ("single/drive.mcap", "parts/drive_0.mcap", "parts/drive_1.mcap", "listed/a.mcap", "listed/b.mcap"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(bags / "mon" / "drive.mcap", tmp_path / name)
    (tmp_path / "listed" / "metadata.yaml").write_text("rosbag2_bagfile_information: {}")
    (tmp_path / "empty.mcap").touch()  # named like a bag: to be told, not passed over
    (tmp_path / ".hidden").mkdir()
    shutil.copy(bags / "mon" / "drive.mcap", tmp_path / ".hidden")
    (tmp_path / "notes.txt").touch()
    (tmp_path / "DRIVE.BAG").touch()  # as of a card with a FAT file system
    found = [str(tmp_path / name) for name in ("DRIVE.BAG", "empty.mcap", "listed", "parts", "single/drive.mcap")]
    assert find_bags([str(tmp_path)]) == found
    for name in ("single", "parts", "listed"):
        assert find_bags([str(tmp_path / name)]) == [str(tmp_path / name)]


def test_results_are_not_taken_for_bags(bags, tmp_path):
    shutil.copytree(bags, tmp_path / "in")
    assert main(["fuse", "-q", str(tmp_path / "in" / "mon" / "drive.mcap"), "--out", str(tmp_path / "in" / "r")]) == 0
    assert (tmp_path / "in" / "r" / "result.mcap").exists()
    assert len(find_bags([str(tmp_path / "in")])) == 3
    for words in ([f"{tmp_path}/in/r/*.mcap"], [str(tmp_path / "in" / "r")]):
        with pytest.raises(BagError, match=r"nothing but results|no bag in it"):
            find_bags(words)


# ---------------------------------------------------------------- named


def test_names_have_parents_where_they_must(tmp_path):
    named = name_folders(["/x/a/drive.mcap", "/x/b/drive.mcap", "/x/b/dusk.mcap", "s3://x/c/dawn.mcap?v=1"], {})
    assert list(named.values()) == ["a_drive_yaw", "b_drive_yaw", "dusk_yaw", "dawn_yaw"]
    named = name_folders(["/x/drive.mcap", "/x/drive.bag", "/x/Drive.bag"], {})
    assert len({name.lower() for name in named.values()}) == 3


def test_name_stays_when_more_bags_come_and_is_never_that_of_something_else(tmp_path):
    first = EarlierResult(Source("/x/a/drive.mcap", 1, "1"), "", {})
    there = {"drive_yaw": first, "b_drive_yaw": None}
    named = name_folders(["/x/a/drive.mcap", "/x/b/drive.mcap"], there)
    assert named["/x/a/drive.mcap"] == "drive_yaw"
    assert named["/x/b/drive.mcap"] not in there
    # a folder that somebody gave a name of its own stays theirs
    assert name_folders(["/x/a/drive.mcap"], {"best": first}) == {"/x/a/drive.mcap": "drive_yaw"}


def test_name_stays_when_the_bag_has_moved(bags):
    bag = bags / "mon" / "drive.mcap"
    before = source_of(bag)
    there = {"drive_yaw": EarlierResult(Source("/elsewhere/drive.mcap", before.size_bytes, before.content), "", {})}
    assert name_folders([str(bag)], there) == {str(bag): "drive_yaw"}


_PART = st.sampled_from(["a", "A", "b", "a_b", "drive", "drive.mcap", "drive.bag", "x"])


@given(st.lists(st.lists(_PART, min_size=1, max_size=4).map(lambda parts: "/" + "/".join(parts)), unique=True))
def test_names_never_collide(paths):
    names = list(name_folders(paths, {"drive_yaw": None}).values())
    assert len({name.casefold() for name in [*names, "drive_yaw"]}) == len(paths) + 1
    assert all(name.endswith("_yaw") and "/" not in name for name in names)


def test_links_in_a_circle_and_folders_that_cannot_be_read_are_passed_over(tmp_path, monkeypatch, caplog):
    for name in ("a", "lost+found"):
        (tmp_path / name).mkdir()
    (tmp_path / "a" / "x.mcap").write_bytes(b"")
    (tmp_path / "loop.mcap").symlink_to(tmp_path / "loop.mcap")
    scandir = os.scandir

    def refused(folder):
        if Path(folder).name == "lost+found":
            raise PermissionError(13, "Permission denied")
        return scandir(folder)

    monkeypatch.setattr(os, "scandir", refused)
    assert find_bags([str(tmp_path)]) == [str(tmp_path / "a" / "x.mcap")]
    assert "lost+found: passed over: Permission denied" in caplog.text
    with pytest.raises(BagError, match=r"lost\+found: cannot be read: Permission denied"):
        find_bags([str(tmp_path / "lost+found")])
    with pytest.raises(BagError, match="cannot be read: Too many levels of symbolic links"):
        fuse_bag(tmp_path / "loop.mcap", None, Settings())


def test_one_bag_named_in_several_ways_is_one(tmp_path, monkeypatch):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "x.mcap").write_bytes(b"")
    (tmp_path / "link.mcap").symlink_to(tmp_path / "a" / "x.mcap")
    (tmp_path / "elsewhere").symlink_to("/")
    monkeypatch.chdir(tmp_path)
    words = ["a/x.mcap", "./a/../a/x.mcap", "a//x.mcap", str(tmp_path / "a" / "x.mcap"), "a/x.mca*"]
    assert find_bags(words) == [str(tmp_path / "a" / "x.mcap")]
    assert find_bags(["link.mcap"]) == [str(tmp_path / "link.mcap")]  # names its results
    # what is above a link is not what its name says
    assert find_bags(["elsewhere/../a"]) == [str(tmp_path / "elsewhere" / ".." / "a")]


@pytest.mark.parametrize("word", ["", " "])
def test_word_that_is_empty_names_nothing(tmp_path, monkeypatch, word):
    """Not the working folder, with all that is below it: `fuse "$BAG"` where that is not set."""
    (tmp_path / "x.mcap").write_bytes(b"")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(BagError, match="names nothing"):
        find_bags([word])
