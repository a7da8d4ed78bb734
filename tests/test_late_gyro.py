"""Gyros whose samples come later than they say: low-passed, stamped when they arrive, or read from a queue at once."""

import math
from dataclasses import replace

import numpy as np
import pytest
from robot_drive import Eyes, fuse, ratios_at_images, robot_drive

from compass import YawIncrement
from fusion import FusionConfig, GyroSample, YawFusion


def gyros_and_images(change, seconds=30.0):
    """A drive whose gyro samples are changed, and without odometry."""
    drive = robot_drive(0, seconds=seconds, eyes=Eyes(hold=2.0))
    gyro = change([one for one in drive.samples if isinstance(one, GyroSample)])
    images = [one for one in drive.samples if isinstance(one, YawIncrement)]
    return replace(drive, samples=sorted([*gyro, *images], key=lambda one: one.t_ns))


def low_passed(time):
    def change(gyro):
        rate, out = 0.0, []
        for one in gyro:
            rate += (one.yaw_rate - rate) * (1.0 - math.exp(-0.02 / time))
            out.append(replace(one, yaw_rate=rate))
        return out

    return change


def queued(count, apart_ns):
    """So many are read at once and stamped then, one after the other."""

    def change(gyro):
        reads = [gyro[k : k + count] for k in range(0, len(gyro) - count + 1, count)]
        return [replace(one, t_ns=read[-1].t_ns + j * apart_ns) for read in reads for j, one in enumerate(read)]

    return change


@pytest.mark.parametrize("time", [0.05, 0.1, 0.2])
def test_yaw_of_a_low_passed_gyro_beside_images_owns_up_to_its_lag(time):
    ratios, codes = ratios_at_images(YawFusion(), gyros_and_images(low_passed(time)))
    assert np.sum(ratios > 4.0) <= 5  # half a second in all, until it has shown
    assert (("sensors_disagree_time", "compass+gyro") in codes) == (time > 2.0 * FusionConfig().camera_delay_sigma)


@pytest.mark.parametrize(("count", "apart_ns"), [(10, 1000), (10, 100_000), (5, 1000)])
def test_gyro_samples_stamped_next_to_each_other_make_no_turn(count, apart_ns):
    drive = gyros_and_images(queued(count, apart_ns))
    ratios, _ = ratios_at_images(YawFusion(), drive)
    assert np.sum(ratios > 4.0) <= 5
    _, errors = fuse(drive)
    assert np.abs(errors).max() < math.radians(60.0)
    assert abs(errors[-1]) < math.radians(10.0)


def test_images_in_time_widen_nothing():
    ratios, codes = ratios_at_images(YawFusion(), gyros_and_images(lambda gyro: gyro))
    assert ratios.max() < 4.0
    assert not codes


def test_delay_that_is_configured_is_not_early():
    drive = gyros_and_images(lambda gyro: [replace(one, t_ns=one.t_ns + 100_000_000) for one in gyro])
    fusion, _ = fuse(drive, FusionConfig(camera_delay=-0.1))
    assert not [one for one in fusion.estimate().warnings if one.code == "sensors_disagree_time"]


def test_gyro_that_arrives_late_says_nothing_of_the_turn_since_an_exposure_yet():
    """Images 74 ms late, and a gyro that comes 0.4 s after its stamps: its last rate is of before the turn."""
    drive = robot_drive(2, seconds=40.0, gyro_hz=50, compass_hz=20, camera_delay=0.074)
    late = [(s.t_ns + 400_000_000 * isinstance(s, GyroSample), s) for s in drive.samples]
    fusion, ratios = YawFusion(), []
    for arrival_ns, sample in sorted(late, key=lambda one: one[0]):
        if not isinstance(sample, GyroSample | YawIncrement):
            continue
        fusion.add(sample)
        estimate = fusion.estimate()
        if arrival_ns > 10 * 10**9 and estimate.t_ns > arrival_ns - 100_000_000:
            sigma = max(math.sqrt(estimate.yaw_variance), math.radians(0.05))
            ratios.append(abs(drive.error(estimate)) / sigma)
    assert np.mean(np.array(ratios) > 4.0) < 0.01
