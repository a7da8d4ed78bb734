"""Real input: photographs that turn as a real robot turned, fused with its real gyro and wheels."""

import json
import math

import pytest
from tools.photo_drive import HUSKY, PHOTOS, STANDSTILL_BIAS, write_photo_bag

from fusion.offline.cli import main

pytestmark = pytest.mark.skipif(not HUSKY.exists(), reason="needs ../shared/data")


def fuse(bag, out) -> dict:
    assert main(["fuse", str(bag), "--out", str(out)]) == 0
    return json.loads((out / "summary.json").read_text())


def test_photograph_turning_as_the_husky_did_gives_its_yaw(tmp_path):
    """25 s with a turn of 90 deg, 5 images/s of noise sigma 2, JPEG and changing exposure."""
    write_photo_bag(tmp_path / "photo.mcap", PHOTOS / "lobby.jpg", 135.0, 160.0, hertz=5.0)
    summary = fuse(tmp_path / "photo.mcap", tmp_path / "out")
    compass, fused = summary["yaw"]["raw_compass"], summary["yaw"]["fused"]
    assert abs(summary["truth_turned_deg"]) > 80.0
    assert {outcome for outcome, count in summary["images"].items() if count} == {"first_frame", "ok"}
    # An increment is good to 0.005 deg RMS (1024 columns, noise 2); even if all 125 added up at random: 0.056 deg.
    assert abs(compass["final_error_deg"]) < 3 * 0.056
    assert compass["rms_error_deg"] < 0.056
    # The fused yaw claims its sigma, and keeps to the compass, not to the gyro, which is off by its bias of 0.43 deg.
    assert abs(fused["final_error_deg"]) < 3 * fused["sigma_deg"]
    assert abs(fused["final_error_deg"]) < 0.5 * abs(summary["yaw"]["gyro_alone"]["final_error_deg"])
    assert abs(summary["gyro_bias_rad_s"] - STANDSTILL_BIAS) < 3 * summary["gyro_bias_sigma_rad_s"]


def test_husky_without_camera_is_fused_within_its_sensors(tmp_path):
    """Gyro (bias not known) says -206 deg, wheels -198 deg, and so does the gyro less its bias at standstill."""
    summary = fuse(HUSKY, tmp_path / "out")
    assert summary["gyro_vertical"] == "orientation"  # +Y stands up: found, not assumed
    assert summary["warnings"] == []
    assert summary["vertical_words"].startswith("the orientation field")
    assert "from the IMU's +y axis" in summary["vertical_words"]
    assert 3.0 < summary["greatest_tilt_deg"] < 20.0
    assert summary["yaw"]["gyro_alone"]["turned_deg"] == pytest.approx(-206, abs=0.5)
    assert summary["yaw"]["tracks_alone"]["turned_deg"] == pytest.approx(-198, abs=0.5)
    debiased = -206.1 - math.degrees(STANDSTILL_BIAS) * summary["duration_s"]
    fused = summary["yaw"]["fused"]
    assert abs(fused["turned_deg"] - debiased) < 3 * fused["sigma_deg"]
    # A bias found to within 0.0005 rad/s leaves this much of the turn.
    assert abs(fused["turned_deg"] - debiased) < math.degrees(0.0005) * summary["duration_s"]
