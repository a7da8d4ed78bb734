"""A camera that starts seconds after the tracks: what the images say of the tracks' scale is no contradiction."""

import math

import numpy as np
import pytest
from robot_drive import robot_drive

from compass import YawIncrement
from fusion import GyroSample, YawFusion


@pytest.mark.parametrize("starts", [4.0, 9.0, 15.0])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_images_that_start_late_beside_tracks_of_an_unknown_scale_are_no_contradiction(seed, starts):
    """The yaw of before is of the tracks alone: learnt later, their scale moves it by tens of degrees."""
    drive = robot_drive(seed, seconds=40.0)
    drive = drive.changed(lambda s: None, GyroSample).changed(lambda s: None, YawIncrement, 0.0, starts)
    drive = drive.changed(lambda s: s if s.t_ref_ns * 1e-9 >= starts else None, YawIncrement)
    fusion, told, turned, before = YawFusion(), set(), 0.0, 0.0
    for sample in drive.samples:
        fusion.add(sample)
        told |= {one.code for one in fusion.warnings()}
        if sample.t_ns * 1e-9 < starts:
            turned, before = turned + abs(fusion.estimate().yaw - before), fusion.estimate().yaw
    estimate = fusion.estimate()
    assert told == set()
    assert abs(drive.error(estimate)) < 3.0 * math.sqrt(estimate.yaw_variance)
    assert math.sqrt(estimate.yaw_variance) < 0.3 * turned + np.radians(2.0)
