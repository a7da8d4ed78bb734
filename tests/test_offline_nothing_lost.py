"""Nothing of the user's is lost: whose place results take, what they repeat, what remains where a run breaks off."""

import errno
import json
import shutil
from pathlib import Path

import pytest
from tiny_bags import START_NS, TinyBag, TinyDrive

from fusion.offline import atomic_output
from fusion.offline.atomic_output import OutputError, staged_folder
from fusion.offline.bag import Bag, BagError
from fusion.offline.cli import main
from fusion.offline.topics import TopicRequest, choose_topics, settings_as_asked
from fusion.settings import TopicSettings, load_settings

pytestmark = pytest.mark.usefixtures("without_plot")


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    """Two recordings of one name in two folders, without images: fused at once."""
    folder = tmp_path_factory.mktemp("bags")
    for name, rate in (("a", 0.5), ("b", -0.4)):
        with TinyBag(folder / "made") as bag:
            for k in range(200):
                bag.imu("/imu/data", START_NS + k * 10**7, rate)
                bag.odometry("/odom", START_NS + k * 10**7, rate * k * 0.01, rate)
        (folder / name).mkdir()
        (folder / "made" / "made.mcap").rename(folder / name / "drive.mcap")
        shutil.rmtree(folder / "made")
    return folder


def tree(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def refused(arguments, capsys) -> str:
    assert main(list(map(str, arguments))) == 1
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    return err


def test_results_of_another_recording_of_that_name_stay(bags, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["fuse", "-q", str(bags / "a" / "drive.mcap")]) == 0
    before = tree(tmp_path)
    assert f"holds the results of {bags / 'a' / 'drive.mcap'}" in refused(["fuse", bags / "b" / "drive.mcap"], capsys)
    assert tree(tmp_path) == before
    # of the same recording, wherever it is by now, they are renewed
    shutil.copy(bags / "a" / "drive.mcap", tmp_path / "drive.mcap")
    assert main(["fuse", "-q", "drive.mcap", "--smooth"]) == 0
    assert (tmp_path / "drive_yaw" / "smoothed.tum").exists()
    assert main(["fuse", "-q", str(bags / "b" / "drive.mcap"), "--force"]) == 0
    assert not (tmp_path / "drive_yaw" / "smoothed.tum").exists()


def test_folder_with_something_else_in_it_is_refused(bags, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "config.yaml").write_text("/**: {ros__parameters: {gyro_topic: /imu/data}}")
    command = ["fuse", bags / "a" / "drive.mcap", "--config", "config.yaml", "--out", "."]
    assert "is not empty and no earlier result" in refused(command, capsys)
    # not even by force does a result take the place of what is read
    assert "which is read" in refused([*command, "--force"], capsys)
    assert "is not empty and no earlier result" in refused([*command[:-1], "/etc"], capsys)
    assert [file.name for file in tmp_path.iterdir()] == ["config.yaml"]


@pytest.mark.parametrize(
    "options",
    [
        ["--gyro-topic", "none"],
        ["--odometry-topic", "/odom", "--truth-topic", "none", "--smooth"],
        ["--gyro-topic", "/imu/data", "--start", "0.5", "--end", "1.5"],
    ],
)
def test_config_of_a_run_repeats_it_to_the_bit(bags, tmp_path, options):
    bag = str(bags / "a" / "drive.mcap")
    assert main(["fuse", "-q", bag, "--out", str(tmp_path / "one"), *options]) == 0
    config = str(tmp_path / "one" / "config.yaml")
    assert main(["fuse", "-q", bag, "--out", str(tmp_path / "two"), "--config", config]) == 0
    assert tree(tmp_path / "one") == tree(tmp_path / "two")


@pytest.fixture(scope="module")
def two_cameras(tmp_path_factory):
    path = tmp_path_factory.mktemp("cameras") / "two"
    with TinyBag(path) as bag:
        for k, t in enumerate(TinyDrive().times(10.0)[:3]):
            bag.image("/cam", START_NS + k, TinyDrive().panorama(t))
            bag.compressed("/cam/compressed", START_NS + k, TinyDrive().panorama(t))
            bag.compressed("/rear/compressed", START_NS + k, TinyDrive().panorama(t))
            bag.odometry("/odom", START_NS + k, 0.0, 0.0)
            bag.odometry("/odometry/fused", START_NS + k, 0.0, 0.0)
    return path


@pytest.mark.parametrize(
    "request_",
    [
        TopicRequest(image="/cam"),
        TopicRequest(image="/cam/compressed"),
        TopicRequest(image="/rear"),
        TopicRequest(image="/rear/compressed", odometry="/odometry/fused"),
        TopicRequest(image="none", truth="/odom", odometry="/odometry/fused"),
    ],
)
@pytest.mark.parametrize("transport", ["raw", "compressed"])
def test_settings_written_choose_the_topics_that_were_asked_for(two_cameras, request_, transport):
    settings = TopicSettings(image_transport=transport)
    with Bag(two_cameras) as bag:
        asked = choose_topics(bag, settings, request_)
        assert choose_topics(bag, settings_as_asked(settings, request_)) == asked


def test_truth_that_is_fused_is_refused(two_cameras):
    same = TopicRequest(image="/cam", odometry="/odom", truth="/odom")
    with Bag(two_cameras) as bag, pytest.raises(BagError, match="as odometry and as truth"):
        choose_topics(bag, TopicSettings(), same)


def test_start_and_end_take_a_part(tiny_bag, tmp_path):
    out = tmp_path / "out"
    assert main(["fuse", "-q", str(tiny_bag), "--start", "1.05", "--end", "2.5", "--out", str(out)]) == 0
    summary = json.loads((out / "summary.json").read_text())
    drive = TinyDrive()
    # images at 10 Hz: the first at 1.1 s; the last row is at 2.5 s
    assert summary["images"]["first_frame"] + summary["images"]["ok"] == 15
    assert summary["start_ns"] == START_NS + 1_050_000_000
    assert summary["duration_s"] == pytest.approx(1.45)
    turned = float(drive.yaw(2.5) - drive.yaw(1.05))
    assert summary["truth_turned_deg"] == pytest.approx(57.29578 * turned, abs=0.01)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--start", "9"], "lasts 2.0 s"),
        (["--start", "-1"], "offline.start: -1.0 is outside"),
        (["--start", "1", "--end", "1"], "is not after the start"),
        (["--end", "nan"], "offline.end: nan is outside"),
        (["--end", "0"], "--end: 0 s is not after the start"),
    ],
)
def test_start_and_end_that_mean_nothing_are_refused(bags, tmp_path, options, says, capsys):
    assert says in refused(["fuse", bags / "a" / "drive.mcap", "--out", tmp_path / "out", *options], capsys)
    assert not list(tmp_path.iterdir())


# ---------------------------------------------------------------- all or nothing


def test_replacement_that_breaks_off_leaves_what_was_there(tmp_path, monkeypatch):
    target = tmp_path / "out"
    (target / "notes").mkdir(parents=True)
    (target / "notes" / "a.txt").write_text("mine")
    (target / "yaw.csv").write_text("old")
    before = tree(tmp_path)
    rename = Path.rename

    def fails_at_the_second(self, other):
        if other == target and self.suffix == ".part":
            raise OSError(28, "No space left on device")
        return rename(self, other)

    monkeypatch.setattr(Path, "rename", fails_at_the_second)
    with pytest.raises(OutputError, match="No space left"), staged_folder(target) as staging:
        (staging / "yaw.csv").write_text("new")
    monkeypatch.undo()
    assert tree(tmp_path) == before
    with staged_folder(target) as staging:
        (staging / "yaw.csv").write_text("new")
    assert tree(tmp_path) == {"out/yaw.csv": b"new", "out/notes/a.txt": b"mine"}


def test_what_cannot_be_kept_leaves_all_as_it_was(tmp_path, monkeypatch):
    """Such as a folder of another user among the results, which may not be read."""
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "notes.txt").write_text("mine")

    def refuse(*_):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(atomic_output, "_link", refuse)
    with (
        pytest.raises(
            OutputError, match=r"results: what else is in it cannot be kept: Permission denied; give another"
        ),
        staged_folder(tmp_path / "results") as staging,
    ):
        (staging / "yaw.csv").write_text("new")
    assert [path.name for path in tmp_path.rglob("*")] == ["results", "notes.txt"]


def test_folder_that_a_killed_run_had_moved_away_comes_back(tmp_path):
    (tmp_path / ".out.0123456789abcdef.old").mkdir()
    (tmp_path / ".out.0123456789abcdef.old" / "thesis.tex").write_text("mine")
    with staged_folder(tmp_path / "out") as staging:
        (staging / "yaw.csv").write_text("new")
    assert tree(tmp_path) == {"out/yaw.csv": b"new", "out/thesis.tex": b"mine"}


def test_folder_in_the_place_of_a_result_is_not_replaced(tmp_path):
    (tmp_path / "out" / "yaw.csv").mkdir(parents=True)
    with pytest.raises(OutputError, match="is a folder where a result has to go"), staged_folder(tmp_path / "out") as s:
        (s / "yaw.csv").write_text("new")
    assert (tmp_path / "out" / "yaw.csv").is_dir()


def test_link_to_a_folder_stays_a_link(tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "disk")
    with staged_folder(tmp_path / "out") as staging:
        (staging / "yaw.csv").write_text("new")
    assert (tmp_path / "out").is_symlink()
    assert tree(tmp_path / "disk") == {"yaw.csv": b"new"}


# ---------------------------------------------------------------- single files


@pytest.mark.parametrize(
    "command",
    [
        ["simulate", "demo", "--out"],
        ["calibrate", "BAG", "--out"],
        ["inspect", "BAG", "--roi-preview"],
        ["evaluate", "BAG", "--json"],
    ],
)
def test_file_that_exists_is_replaced_by_force_alone(tiny_bag, tmp_path, command, capsys):
    mine = tmp_path / "mine"
    mine.write_text("years of work")
    line = [str(tiny_bag) if word == "BAG" else word for word in command]
    assert "exists already; give another name, or --force" in refused([*line, mine], capsys)
    assert tree(tmp_path) == {"mine": b"years of work"}


def test_demo_does_not_replace_a_bag_of_that_name(tmp_path, capsys):
    (tmp_path / "demo.mcap").write_text("years of work")
    assert "exists already" in refused(["demo", "--out", tmp_path], capsys)
    assert tree(tmp_path) == {"demo.mcap": b"years of work"}


def test_evaluation_of_before_is_replaced(tiny_bag, tmp_path):
    for _ in range(2):
        assert main(["evaluate", "-q", str(tiny_bag), "--json", str(tmp_path / "all.json")]) == 0


def test_settings_that_nodes_do_not_know_are_read(tmp_path):
    (tmp_path / "c.yaml").write_text("/**: {ros__parameters: {offline: {smooth: true, end: 2.0}, truth_topic: none}}")
    settings = load_settings(tmp_path / "c.yaml")
    assert (settings.offline.smooth, settings.offline.end, settings.topics.truth_topic) == (True, 2.0, "none")


READ = {
    "preview on the bag": ["inspect", "{bag}", "--roi-preview", "{bag}", "--force"],
    "preview on a link to it": ["inspect", "{bag}", "--roi-preview", "{link}", "--force"],
    "preview in its folder": ["inspect", "{folder}", "--roi-preview", "{bag}", "--force"],
    "settings on the bag": ["calibrate", "{bag}", "--out", "{bag}", "--force"],
    "mask on the bag": ["calibrate", "{bag}", "--out", "{new}", "--mask-preview", "{bag}", "--force"],
    "noises on the bag": ["allan", "{bag}", "--out", "{bag}", "--force"],
    "Kalibr's on the bag": ["allan", "{bag}", "--out", "{new}", "--kalibr", "{bag}", "--force"],
    "table on the bag": ["evaluate", "{bag}", "--json", "{bag}", "--force"],
}


@pytest.mark.parametrize("command", READ.values(), ids=READ)
def test_what_a_command_reads_is_not_replaced_even_by_force(tiny_bag, tmp_path, command, capsys):
    folder = tmp_path / "drive"
    shutil.copytree(tiny_bag.parent, folder)
    (bag,) = folder.glob("*.mcap")
    (tmp_path / "link").symlink_to(bag)
    before = bag.read_bytes()
    places = {"bag": bag, "folder": folder, "link": tmp_path / "link", "new": tmp_path / "new.yaml"}
    assert main([word.format(**places) for word in command]) == 1
    assert bag.read_bytes() == before
    assert "is read by this command, and would be lost; give another name" in capsys.readouterr().err
    assert not places["new"].exists()


def test_noises_take_the_place_of_none_but_their_own(tmp_path, capsys):
    """A comment in its first line makes a file of settings no earlier result."""
    imu = tmp_path / "imu.yaml"
    text = "# of the maker\ngyroscope_noise_density: 1.0e-4\ngyroscope_random_walk: 1.0e-6\nupdate_rate: 200.0\n"
    imu.write_text(text)
    (tmp_path / "mine.yaml").write_text("# my robot\n/**: {ros__parameters: {}}\n")
    for out in (imu, tmp_path / "mine.yaml"):
        assert main(["allan", str(imu), "--out", str(out)]) == 1
    assert imu.read_text() == text
    assert "mine.yaml: exists already; give another name, or --force" in capsys.readouterr().err
    for _ in range(2):
        assert main(["allan", str(imu), "--out", str(tmp_path / "new.yaml"), "--kalibr", str(tmp_path / "k.yaml")]) == 0
    assert main(["allan", str(imu), "--out", str(tmp_path / "mine.yaml"), "--force"]) == 0
