"""What a node publishes of an estimate: odometry, transform, and what it reads of set_pose."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: pip install '.[ros]'")

import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped

from fusion import OdometrySample, YawEstimate
from fusion.dead_reckoning import Place
from fusion.messages import MessageError, stamp_to_ns, yaw_of
from nodes.conversions import fused_odometry, ns_to_stamp, pose_place, pose_yaw, yaw_odometry
from nodes.fusion_node import FusionNode
from nodes.transforms import transform_of

FRAMES = ("odom", "base_link")
START_YAWS = [math.radians(a) for a in (0.0, 60.0, 180.0, -120.0)] + [math.pi - 1e-9, -math.pi + 1e-9]


def estimate(yaw=0.0):
    return YawEstimate(1_500_000_000_123_456_789, yaw, 1e-4, 0.5, 1e-6, 0.0, 1e-6, 1.0, 1e-2)


@pytest.mark.parametrize("turns", [0, 3, -2])
@pytest.mark.parametrize("yaw", START_YAWS)
def test_odometry_carries_yaw_and_nothing_else(yaw, turns):
    message = fused_odometry(estimate(yaw + turns * math.tau), FRAMES)
    q, p, twist = message.pose.pose.orientation, message.pose.pose.position, message.twist.twist
    assert q.x**2 + q.y**2 + q.z**2 + q.w**2 == pytest.approx(1.0, abs=1e-12)
    # the angle between both, free of the wrap at pi
    assert math.remainder(yaw_of(q) - yaw, math.tau) == pytest.approx(0.0, abs=1e-9)
    assert (p.x, p.y, p.z, twist.linear.x, twist.linear.y, twist.linear.z) == (0.0,) * 6
    assert (twist.angular.x, twist.angular.y, twist.angular.z) == (0.0, 0.0, 0.5)
    assert (message.header.frame_id, message.child_frame_id) == FRAMES


def test_stamp_survives_there_and_back_to_the_nanosecond():
    t_ns = 1_500_000_000_123_456_789
    assert stamp_to_ns(ns_to_stamp(t_ns)) == t_ns
    assert stamp_to_ns(fused_odometry(estimate(), FRAMES).header.stamp) == t_ns


def test_covariances_can_be_inverted_by_a_filter():
    message = yaw_odometry(1, 0.1, 2e-4, 0.3, 5e-5, FRAMES)
    for covariance, yaw_variance in ((message.pose.covariance, 2e-4), (message.twist.covariance, 5e-5)):
        matrix = np.reshape(covariance, (6, 6))
        assert matrix[5, 5] == yaw_variance
        assert np.all(np.diag(matrix)[:5] >= 1e3)  # rad^2 or m^2: says nothing of them
        np.linalg.cholesky(matrix)  # raises unless positive definite
        assert np.linalg.cond(matrix) < 1e12  # and well inside double precision


def test_transform_repeats_the_odometry():
    message = fused_odometry(estimate(0.7), FRAMES)
    transform = transform_of(message)
    assert (transform.header.frame_id, transform.child_frame_id) == FRAMES
    assert transform.header.stamp == message.header.stamp
    assert yaw_of(transform.transform.rotation) == pytest.approx(0.7)
    assert transform.transform.translation.x == 0.0


PLACE = Place(3.0, -4.0, np.array([[0.04, 0.01], [0.01, 0.09]]), 0.5, 0.01)


def test_odometry_carries_the_place_where_it_is_known():
    message = fused_odometry(estimate(0.7), FRAMES, PLACE)
    assert (message.pose.pose.position.x, message.pose.pose.position.y) == (3.0, -4.0)
    assert (message.twist.twist.linear.x, message.twist.twist.linear.y) == (0.5, 0.0)
    pose, twist = (np.reshape(part.covariance, (6, 6)) for part in (message.pose, message.twist))
    assert pose[:2, :2] == pytest.approx(PLACE.covariance, abs=1e-8)
    assert (pose[5, 5], twist[0, 0]) == (1e-4, pytest.approx(0.01))
    assert min(pose[2, 2], pose[3, 3], twist[1, 1]) >= 1e3
    np.linalg.cholesky(pose)


@pytest.mark.parametrize("yaw", START_YAWS)
def test_inverted_transform_undoes_the_other(yaw):
    message = fused_odometry(estimate(yaw), FRAMES, PLACE)
    there, back = transform_of(message), transform_of(message, inverted=True)
    assert (back.header.frame_id, back.child_frame_id) == (FRAMES[1], FRAMES[0])
    assert back.header.stamp == there.header.stamp
    matrices = []
    for transform in (there.transform, back.transform):
        turn, shift = yaw_of(transform.rotation), transform.translation
        cos, sin = math.cos(turn), math.sin(turn)
        matrices.append(np.array([[cos, -sin, shift.x], [sin, cos, shift.y], [0.0, 0.0, 1.0]]))
    assert matrices[0] @ matrices[1] == pytest.approx(np.eye(3), abs=1e-9)
    assert there.transform.translation.x == 3.0
    assert message.header.frame_id == FRAMES[0]  # the message itself is left as it is


@pytest.mark.parametrize(("position", "x"), [("dead_reckoning", 0.5), ("none", 0.0)])
def test_node_sums_up_the_speed_unless_told_not_to(position, x):
    rclpy.init(args=["--ros-args", "-p", f"position:={position}", "-p", "compass_image:=none"])
    node, published = FusionNode(), []
    try:
        node._publisher.publish = published.append
        for k in range(11):
            node._fuse([OdometrySample(10**9 + k * 10**8, 0.01, 0.5)])
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    assert len(published) == 11
    assert published[-1].pose.pose.position.x == pytest.approx(x, abs=0.01)
    assert (published[-1].pose.covariance[0] < 1.0) == (position != "none")


def test_set_pose_carries_a_position():
    message = pose()
    message.pose.pose.position.x, message.pose.covariance[0], message.pose.covariance[7] = 2.0, 0.1, 0.2
    assert pose_place(message) == (2.0, 0.0, (0.1, 0.0, 0.2))
    for index, value in ((0, -1.0), (1, 5.0), (7, math.nan)):
        wrong = pose()
        wrong.pose.covariance[index] = value
        with pytest.raises(MessageError, match="position"):
            pose_place(wrong)


def pose(w=1.0, z=0.0, variance=0.01):
    message = PoseWithCovarianceStamped()
    message.pose.pose.orientation.w, message.pose.pose.orientation.z = w, z
    message.pose.covariance[35] = variance
    return message


def test_set_pose_is_read():
    yaw, variance = pose_yaw(pose(math.cos(0.4), math.sin(0.4), 0.02))
    assert (yaw, variance) == (pytest.approx(0.8), 0.02)
    assert 0.0 < pose_yaw(pose(variance=0.0))[1] < 1e-6


@pytest.mark.parametrize("bad", [pose(w=0.0), pose(w=math.nan), pose(variance=-1.0), pose(variance=math.nan)])
def test_set_pose_that_says_nothing_is_refused(bad):
    with pytest.raises(MessageError, match=r"orientation|variance of yaw"):
        pose_yaw(bad)
