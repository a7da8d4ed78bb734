"""Noises of a standing gyro: found from noise of known size, refused where it did not stand."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from tiny_bags import START_NS, TinyBag

from fusion.offline.allan import AllanError, allan_curve, check_standing, longest_stretch
from fusion.offline.cli import main
from fusion.settings import Settings, load_settings

RATE = 100.0
DENSITY, WALK = 2e-4, 3e-5  # rad/s/sqrt(Hz), rad/s^2/sqrt(Hz)


def noise(seconds: float, density: float = DENSITY, walk: float = WALK, seed: int = 3) -> np.ndarray:
    """White noise and the integral of white noise, by their definitions."""
    random = np.random.default_rng(seed)
    count = int(seconds * RATE)
    steps = walk / math.sqrt(RATE) * random.normal(size=count)
    return 0.01 + density * math.sqrt(RATE) * random.normal(size=count) + np.cumsum(steps)


def test_noises_are_found_in_what_was_made_of_them():
    pytest.importorskip("allantools", reason="the Allan deviation is allantools'")
    densities, walks, lowest = [], [], []
    for seed in range(8):
        curve = allan_curve(noise(1000.0, seed=seed), RATE)
        densities.append(curve.density)
        walks.append(curve.random_walk)
        lowest.append(curve.instability)
    # 1e5 samples tell white noise to a fraction of a per cent; the walk comes from some 100 intervals of 10 s a drive
    assert np.mean(densities) == pytest.approx(DENSITY, rel=0.02)
    assert np.mean(walks) == pytest.approx(WALK, rel=0.2)
    # N^2 / tau + K^2 tau / 3 is least at sqrt(3) N / K, 11.5 s, by 2 N K / sqrt(3); the lowest of noisy points is lower
    least = math.sqrt(2.0 * DENSITY * WALK / math.sqrt(3.0)) / 0.664
    assert np.mean(lowest) == pytest.approx(least, rel=0.1)


def test_white_noise_alone_has_no_walk_and_no_lowest_point():
    pytest.importorskip("allantools", reason="needs allantools")
    curve = allan_curve(noise(300.0, walk=0.0), RATE)
    assert curve.density == pytest.approx(DENSITY, rel=0.03)
    assert curve.random_walk is None


def test_walk_that_is_not_seen_is_bounded():
    """Of white noise the longest averaging time, a tenth of the recording, leaves room for sqrt(3) N / tau."""
    pytest.importorskip("allantools", reason="needs allantools")
    curve = allan_curve(noise(300.0, walk=0.0), RATE)
    assert curve.walk_bound == pytest.approx(math.sqrt(3.0) * DENSITY / 30.0, rel=0.5)
    for share in (0.1, 0.3):
        curves = [allan_curve(noise(150.0, walk=share * WALK, seed=seed), RATE) for seed in range(6)]
        bounds = [curve.walk_bound for curve in curves if curve.random_walk is None]
        assert len(bounds) > 1
        assert min(bounds) > share * WALK


def test_kalibrs_file_holds_no_zero_which_kalibr_refuses(tmp_path):
    pytest.importorskip("allantools", reason="needs allantools")
    with TinyBag(tmp_path / "imu") as bag:
        for index, rate in enumerate(noise(70.0, walk=0.0)):
            bag.imu("/imu/data", START_NS + index * 10**7, rate)
    out, kalibr = tmp_path / "gyro.yaml", tmp_path / "imu.yaml"
    assert main(["allan", str(tmp_path / "imu"), "--out", str(out), "--kalibr", str(kalibr)]) == 0
    assert yaml.safe_load(kalibr.read_text())["gyroscope_random_walk"] > 0.0
    assert "gyroscope_random_walk" in kalibr.read_text().partition("# not seen: at most this")[0]
    assert "bias_walk" not in yaml.safe_load(out.read_text())["/**"]["ros__parameters"]["fusion"]


def test_a_gyro_that_repeats_a_number_is_refused():
    pytest.importorskip("allantools", reason="needs allantools")
    with pytest.raises(AllanError, match="one and the same number"):
        allan_curve(np.full(10_000, 0.01), RATE)


def test_standing_is_told_from_moving():
    rates = np.stack([noise(200.0, seed=seed) for seed in range(3)], axis=1)
    check_standing(rates, RATE)
    nudged = rates.copy()
    nudged[12_050:12_080, 2] += 0.1  # a third of a second
    with pytest.raises(AllanError, match=r"it moved 12[01] s from the start"):
        check_standing(nudged, RATE)
    driven = rates + 0.5 * np.sin(np.arange(len(rates)) / RATE)[:, None]
    with pytest.raises(AllanError, match="turns all the time"):
        check_standing(driven, RATE)


def test_gaps_end_a_stretch():
    t_ns = START_NS + np.arange(20_000) * 10**7
    t_ns[5_000:] += 10**10
    part, rate = longest_stretch(t_ns)
    assert (part, rate) == (slice(5_000, 20_000), pytest.approx(RATE))
    with pytest.raises(AllanError, match="50 s without a gap; record 60 s"):
        longest_stretch(t_ns[:5_000])


@pytest.fixture(scope="module")
def standing(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("allan") / "imu"
    with TinyBag(path) as bag:
        for index, rate in enumerate(noise(70.0)):
            bag.imu("/imu/data", START_NS + index * 10**7, rate)
    return path


def test_allan_writes_parameters_and_kalibrs_file_which_is_read_again(standing, tmp_path, capsys):
    pytest.importorskip("allantools", reason="needs allantools")
    out, kalibr = tmp_path / "gyro.yaml", tmp_path / "imu.yaml"
    assert main(["allan", str(standing), "--out", str(out), "--kalibr", str(kalibr)]) == 0
    assert "gyro z" in capsys.readouterr().out
    settings = load_settings(out)
    assert settings.fusion.gyro_sigma == pytest.approx(DENSITY * math.sqrt(RATE), rel=0.05)
    theirs = yaml.safe_load(kalibr.read_text())
    assert theirs["gyroscope_noise_density"] == pytest.approx(DENSITY, rel=0.05)
    assert (theirs["update_rate"], theirs["rostopic"]) == (pytest.approx(RATE, rel=1e-3), "/imu/data")
    again = tmp_path / "again.yaml"
    assert main(["allan", str(kalibr), "--out", str(again)]) == 0
    assert load_settings(again).fusion.gyro_sigma == pytest.approx(settings.fusion.gyro_sigma, rel=1e-3)
    assert load_settings(again).topics.gyro_topic == "/imu/data"


def test_kalibrs_own_example_is_read(tmp_path):
    """As its wiki shows it: comments, aligned columns, and numbers that YAML takes for text."""
    (tmp_path / "imu.yaml").write_text(
        "#Accelerometers\naccelerometer_noise_density: 1.86e-03   #continuous-time\n"
        "accelerometer_random_walk:   4.33e-04\n\n#Gyroscopes\ngyroscope_noise_density:     1.87e-04\n"
        "gyroscope_random_walk:       2e-5\n\nrostopic:                    /imu0\nupdate_rate:                 200.0\n"
    )
    assert main(["allan", str(tmp_path / "imu.yaml"), "--out", str(tmp_path / "out.yaml")]) == 0
    found = load_settings(tmp_path / "out.yaml")
    assert found.fusion.gyro_sigma == pytest.approx(1.87e-4 * math.sqrt(200.0), rel=1e-2)
    assert found.fusion.bias_walk == pytest.approx(2e-5)
    assert found.topics.gyro_topic == "/imu0"


def test_allan_of_what_cannot_be_used_is_refused_in_a_line(standing, tiny_bag, tmp_path, capsys, monkeypatch):
    (tmp_path / "broken.yaml").write_text("gyroscope_noise_density: many\ngyroscope_random_walk: 0\nupdate_rate: 1")
    (tmp_path / "other.yaml").write_text("a: 1")
    (tmp_path / "mine.yaml").write_text("mine: 1")
    out = tmp_path / "out.yaml"
    for path, said, target in (
        (tmp_path / "nothing.bag", "no such file", out),
        (tiny_bag, "without a gap; record 60 s", out),
        (tmp_path / "broken.yaml", "'many' is no positive number", out),
        (tmp_path / "other.yaml", "are wanted, as in Kalibr's imu.yaml", out),
        (standing, "exists already; give another name, or --force", tmp_path / "mine.yaml"),
    ):
        assert main(["allan", str(path), "--out", str(target)]) == 1
        error = capsys.readouterr().err
        assert said in error
        assert error.count("\n") == 1
    monkeypatch.setitem(sys.modules, "allantools", None)
    assert main(["allan", str(standing), "--out", str(out)]) == 1
    assert "visual-compass[tuning]" in capsys.readouterr().err
    assert not out.exists()
    assert (tmp_path / "mine.yaml").read_text() == "mine: 1"
    assert load_settings(None) == Settings()
