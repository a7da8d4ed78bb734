"""The parts of the nodes that need no second process."""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: pip install '.[ros]'")

import rclpy
from ros_harness import jpeg_message
from sensor_msgs.msg import CompressedImage

from compass import YawIncrement
from compass.errors import ConfigError
from fusion import GyroSample, YawEstimate
from fusion.messages import stamp_to_ns
from nodes.compass_node import CompassNode
from nodes.filter_figures import fusion_finding
from nodes.fusion_node import FusionNode
from nodes.health import Level, SequenceGaps, StreamHealth
from nodes.names import compressed_topic, raw_topic
from nodes.newest_worker import NewestWorker
from nodes.parameters import describe, settings_specs
from nodes.sample_queue import SampleQueue
from nodes.throttled_log import REPEAT_S, ThrottledLog
from nodes.transforms import transform_broadcaster


def estimate(yaw=0.0):
    return YawEstimate(1_500_000_000_123_456_789, yaw, 1e-4, 0.5, 1e-6, 0.0, 1e-6, 1.0, 1e-2)


@pytest.mark.parametrize("frames", [("odom", "odom"), ("", "base_link"), ("odom", "/base_link")])
def test_frames_that_no_tree_can_have_are_refused(frames):
    with pytest.raises(ConfigError, match="without a leading slash"):
        transform_broadcaster(None, frames)


def test_complaint_is_said_once_and_counted():
    said, now = [], [0.0]
    complain = ThrottledLog(said.append, lambda: now[0])
    for k in range(100):
        complain("/camera", f"step {k} of 'encoding{k}' is wrong")
    assert said == ["/camera: step 0 of 'encoding0' is wrong"]
    assert list(complain.figures("/camera").values()) == ["100"]
    assert complain.figures("/cam") == {}
    now[0] = REPEAT_S
    complain("/camera", "step 7 of 'x' is wrong")
    assert said[1:] == ["/camera: step 7 of 'x' is wrong (101 times so far)"]


def test_complaint_is_named_without_remedy_and_what_varies():
    complain = ThrottledLog(lambda line: None)
    complain("/cam", "step 3 is shorter than a row of 16 pixels in bgr8, -48.5e0 bytes; give the true step")
    assert complain.figures("/cam") == {"fault: step * is shorter than a row of * pixels in bgr8, * bytes": "1"}


def test_complaints_of_ever_new_kinds_do_not_fill_the_memory():
    said = []
    complain = ThrottledLog(said.append, lambda: 0.0)
    words = ["".join(chr(97 + k // 26**i % 26) for i in range(3)) for k in range(1000)]
    for word in words:
        complain("/camera", word)
    assert len(complain.counts) <= 52
    assert complain.counts.total() == 1000
    assert len(said) == len(complain.counts)


def feed(health, start, seconds, used_share=1.0, rate=20.0):
    """Messages at a rate, of which a share is used."""
    owed = 0.0
    for k in range(round(seconds * rate)):
        now = start + k / rate
        health.receive(now)
        owed += used_share
        if owed >= 1.0:
            owed -= 1.0
            health.use(now, round(now * 1e9))


def test_health_follows_a_sensor_that_fades_and_returns():
    health = StreamHealth()
    levels = []

    def judge(now):
        levels.append(health.judge(now, timeout=2.0)[0])

    judge(0.0)  # nothing yet
    feed(health, 0.0, 1.0)
    judge(1.0)
    feed(health, 1.0, 1.0, used_share=0.5)
    judge(2.0)
    feed(health, 2.0, 3.0, used_share=0.0)
    judge(5.0)
    judge(8.0)  # silent for three seconds
    feed(health, 8.0, 1.0)
    judge(9.0)
    assert levels == [Level.STALE, Level.OK, Level.WARN, Level.ERROR, Level.STALE, Level.OK]


def test_health_reports_the_rate():
    health = StreamHealth()
    health.judge(0.0, 2.0)
    feed(health, 0.0, 2.0, rate=30.0)
    assert health.judge(2.0, 2.0)[2]["rate [Hz]"] == "30.0"


def counted(numbers, single=True):
    """Gaps and steps back of a second in which these sequence numbers arrived."""
    gaps = SequenceGaps()
    for number in numbers:
        gaps.see(number)
    gaps.settle(single)
    return gaps.skipped, gaps.take_steps_back()


def test_gaps_in_the_sequence_of_one_publisher_are_counted():
    assert counted((5, 6, 9, None, 10, 12)) == (2 + 1, 0)
    assert counted((5, 1_000_000)) == (0, 0)  # that is another publisher


def test_gaps_beside_another_publisher_or_a_restart_are_none():
    assert counted([n for k in range(100) for n in (500 + k, k)]) == (0, 100)
    assert counted((5, 6, 500, 501, 7, 502), single=False) == (0, 1)
    assert counted((90, 91, 1, 2)) == (0, 1)


def test_worker_serves_the_newest_and_counts_the_overtaken():
    begun, go, served = threading.Event(), threading.Event(), []

    def work(item):
        begun.set()
        assert go.wait(60.0)
        served.append(item)

    worker = NewestWorker(work, "test")
    worker.offer(0)
    assert begun.wait(60.0)
    for item in range(1, 6):
        worker.offer(item)  # 1 to 4 are overtaken while 0 is in work
    go.set()
    for _ in range(6000):
        if len(served) == 2:
            break
        threading.Event().wait(0.01)
    worker.close()
    assert served == [0, 5]
    assert worker.dropped == 4


def test_parameter_descriptor_names_unit_range_and_choices():
    specs = {name: spec for name, (_, spec) in settings_specs().items()}
    rate = describe(specs["compass.max_yaw_rate"])
    assert rate.description.endswith("[rad/s]")
    assert (rate.floating_point_range[0].from_value, rate.read_only) == (0.01, False)
    columns = describe(specs["compass.columns"])
    assert (columns.integer_range[0].from_value, columns.integer_range[0].to_value) == (16, 8192)
    assert "rows" in describe(specs["compass.method"]).additional_constraints


def test_image_topic_of_either_name():
    assert raw_topic("/cam/compressed") == raw_topic("/cam") == "/cam"
    assert compressed_topic("/cam/compressed") == compressed_topic("/cam") == "/cam/compressed"


@pytest.mark.parametrize(("live", "level"), [(0, Level.STALE), (1, Level.WARN), (2, Level.WARN), (3, Level.OK)])
def test_filter_is_ok_only_where_all_sensors_feed_it(live, level):
    found, text, _ = fusion_finding(estimate(), live)
    assert found is level
    assert (text == "OK") == (live == 3)


def test_fusion_finding_before_the_first_sample_is_stale():
    assert fusion_finding(None, 3)[0] is Level.STALE


@pytest.mark.parametrize(("hertz", "published"), [(0.0, 100), (10.0, 10), (25.0, 25)])
def test_fused_yaw_is_published_at_the_rate_asked_for(hertz, published):
    """A second of a gyro at 100 Hz: each estimate, or those that are so far apart."""
    rclpy.init(args=["--ros-args", "-p", f"fused_rate:={hertz}"])
    node, stamps = FusionNode(), []
    try:
        node._publisher = SimpleNamespace(publish=lambda message: stamps.append(stamp_to_ns(message.header.stamp)))
        for k in range(100):
            node._fuse([GyroSample(10**18 + k * 10**7, 0.1)])
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    assert len(stamps) == published
    assert min(np.diff(stamps)) == 10**9 // published


def test_samples_of_one_turn_are_used_in_the_order_of_their_stamps():
    used, late = [], YawIncrement(1, 20, 0.0, 1e-4, 0.9)
    node = SimpleNamespace(create_timer=Mock(), create_guard_condition=Mock())
    queue = SampleQueue(node, used.append)
    gyro = [GyroSample(t_ns, 0.0) for t_ns in (30, 10)]
    queue.send(late)
    for sample in gyro:
        queue.append(sample)
    queue._turn()
    assert used == [[gyro[1], late, gyro[0]]]


def test_node_without_input_does_nothing_and_wakes_with_the_first_sample():
    rclpy.init(args=["--ros-args", "-p", "compass_image:=none"])
    node, turns = FusionNode(), []
    try:
        queue, used = node._queue, []
        turn, queue._use = queue._turn, used.append
        queue._timer.callback = lambda: turns.append(1) or turn()
        executor = rclpy.executors.SingleThreadedExecutor()
        executor.add_node(node)

        def spin_until(true, seconds):
            end = time.monotonic() + seconds
            while time.monotonic() < end and not true():
                executor.spin_once(timeout_sec=0.1)

        spin_until(lambda: queue._timer.is_canceled(), 60.0)
        turns.clear()
        spin_until(lambda: False, 0.3)  # thirty turns of a timer that runs
        assert turns == []
        increment = YawIncrement(1, 2, 0.0, 1e-6, 0.9)
        threading.Thread(target=queue.send, args=(increment,)).start()
        spin_until(lambda: used, 60.0)
        assert used == [[increment]]
        spin_until(lambda: queue._timer.is_canceled(), 60.0)
        assert queue._timer.is_canceled()
        assert queue._idle.can_execute(None)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def test_images_that_wait_are_all_taken_in_one_turn():
    """The newest is worked on: an executor that took one a turn, too slow for the camera, would stay a queue behind."""
    topic = "/pano/compressed"
    reliable = f"qos_overrides.{topic}.subscription.reliability:=reliable"  # only then a publisher knows that it came
    rclpy.init(args=["--ros-args", "-p", reliable, "-p", "compass_image:=/pano", "-p", "image_transport:=compressed"])
    node, offered = CompassNode(), []
    try:
        node._stream._worker.close()
        node._stream._worker = Mock(offer=lambda image: offered.append(stamp_to_ns(image.header.stamp)), dropped=0)
        camera = node.create_publisher(CompressedImage, topic, 10)
        for t_ns in range(1, 7):
            camera.publish(jpeg_message(t_ns, np.zeros((16, 32), np.uint8)))
        assert camera.wait_for_all_acked(rclpy.duration.Duration(seconds=60.0))
        executor = rclpy.executors.SingleThreadedExecutor()
        executor.add_node(node)
        while not offered:
            executor.spin_once(timeout_sec=0.1)
        assert offered == list(range(1, 7))
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


@pytest.mark.parametrize(
    ("kind", "topics", "says"),
    [
        (FusionNode, {"fused_output_topic": "''"}, "fused_output_topic: '' is no name of a topic: .*empty"),
        (FusionNode, {"odometry_topic": "a//b"}, "odometry_topic: 'a//b' is no name of a topic"),
        (FusionNode, {"compass_image": "none", "gyro_topic": "none", "odometry_topic": "''"}, "at least one sensor"),
        (CompassNode, {"compass_image": "none"}, "a compass_node has nothing else"),
    ],
)
def test_names_that_leave_nothing_to_do_are_refused(kind, topics, says):
    given = [part for name, value in topics.items() for part in ("-p", f"{name}:={value}")]
    rclpy.init(args=["--ros-args", *given])
    try:
        with pytest.raises(ConfigError, match=says) as error:
            kind()
        assert "\n" not in str(error.value)
    finally:
        rclpy.try_shutdown()
