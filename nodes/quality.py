"""Quality of service of the subscriptions, and the ways to override it."""

from __future__ import annotations

from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy


def _last(depth: int, reliability: ReliabilityPolicy) -> QoSProfile:
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=reliability)


IMAGE_QOS = _last(1, ReliabilityPolicy.BEST_EFFORT)
# A packet of a video that is lost takes all pictures up to the next key frame along.
PACKET_QOS = _last(10, ReliabilityPolicy.BEST_EFFORT)
# Sensor-data profile, save that half a second of a fast gyro can wait out a pause of the process: each sample counts.
SENSOR_QOS = _last(100, ReliabilityPolicy.BEST_EFFORT)

# Of a bag that is played so that nothing is lost: one image at a time, and what lies between two of them.
EVERY_IMAGE_QOS = _last(10, ReliabilityPolicy.RELIABLE)
EVERY_SAMPLE_QOS = _last(1000, ReliabilityPolicy.RELIABLE)
