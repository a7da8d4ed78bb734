"""Many recordings from few words, and a folder's name for the results of each."""

import shutil

import pytest
from gyro_bags import three_bags
from hypothesis import given
from hypothesis import strategies as st

from fusion.offline.cli import main
from fusion.offline.earlier_results import EarlierResult
from fusion.offline.find_bags import find_bags, name_folders
from fusion.offline.source import Source, source_of
from fusion.offline.storage import BagError


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
    found = [str(tmp_path / name) for name in ("empty.mcap", "listed", "parts", "single/drive.mcap")]
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
