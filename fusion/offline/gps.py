"""The course over ground of a GPS receiver as a reference for drift: noisy, but without any drift of its own."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.stats import theilslopes

from compass import wrap_angle
from fusion.messages import MessageError
from fusion.offline.bag import Bag
from fusion.offline.scores import YawTrack, yaw_at
from fusion.offline.streams import Floats, OdometryTrack, Times

FIX = "sensor_msgs/msg/NavSatFix"
EARTH_RADIUS = 6_378_137.0  # m, at the equator; the error of the course is below the receiver's noise

BASELINE = 5.0  # m; shorter chords are all noise, longer ones cut corners
LONGEST_NS = 15_000_000_000  # a chord that takes longer was no steady drive
SLOWEST = 0.1  # m/s by the tracks, all along the chord: forward only
STRAIGHT = math.radians(15.0)  # most turning along a chord
FEWEST = 20  # chords for a drift


@dataclass(frozen=True, slots=True)
class Course:
    """Courses of chords: `start_ns`, `end_ns` (N,) and `course` (N,), rad, east 0, left positive."""

    start_ns: Times
    end_ns: Times
    course: Floats


@dataclass(frozen=True, slots=True)
class Drift:
    """Slope of yaw minus course, rad/s, with its 95 % interval."""

    slope: float
    low: float
    high: float


def read_course(bag: Bag, odometry: OdometryTrack) -> Course | None:
    """Courses of all chords the robot drove forward, from the bag's only topic of fixes; None where there is none."""
    topics = [topic for topic in bag.topics if topic.msgtype == FIX and topic.count]
    if len(topics) != 1 or not odometry.t_ns.size:
        return None
    rows = []
    for message in bag.messages(topics[0].name):
        try:
            fix = bag.deserialize(message)
        except MessageError:
            continue
        if message.stamp_ns > 0 and fix.status.status >= 0 and math.isfinite(fix.latitude + fix.longitude):
            rows.append((message.stamp_ns, fix.latitude, fix.longitude))
    if not rows:
        return None
    rows.sort()
    latitude, longitude = np.radians(np.array([row[1:] for row in rows])).T
    east = EARTH_RADIUS * np.cos(latitude[0]) * (longitude - longitude[0])
    north = EARTH_RADIUS * (latitude - latitude[0])
    return chords(np.array([row[0] for row in rows], np.int64), east, north, odometry)


def chords(t_ns: Times, east: Floats, north: Floats, odometry: OdometryTrack) -> Course:
    """From each position to the first one `BASELINE` away, where the tracks drove forward all the time."""
    found = []
    for start in range(t_ns.size):
        away = np.hypot(east[start:] - east[start], north[start:] - north[start]) >= BASELINE
        end = start + int(np.argmax(away))
        if not away.any() or t_ns[end] - t_ns[start] > LONGEST_NS:
            continue
        first, last = np.searchsorted(odometry.t_ns, (t_ns[start], t_ns[end]))
        speed = odometry.speed[first:last]
        if speed.size and speed.min() > SLOWEST:
            found.append((start, end, math.atan2(north[end] - north[start], east[end] - east[start])))
    starts, ends = (np.array([row[k] for row in found], np.int64) for k in (0, 1))
    return Course(t_ns[starts], t_ns[ends], np.array([row[2] for row in found]))


def drift(track: YawTrack, course: Course) -> Drift | None:
    """Drift of a yaw against the courses of the straight chords (Theil-Sen, which outliers cannot bend).

    The mean yaw along a chord is compared with its course; where the robot's x and its way differ by a constant, or
    the yaw starts at another angle, nothing changes. None with fewer than `FEWEST` straight chords.
    """
    inside = (course.start_ns >= track.t_ns[0]) & (course.end_ns <= track.t_ns[-1])
    times, differences = [], []
    for start, end, angle in zip(course.start_ns[inside], course.end_ns[inside], course.course[inside], strict=True):
        yaw = yaw_at(track, np.linspace(start, end, 21).astype(np.int64))
        if np.ptp(yaw) < STRAIGHT:
            times.append(0.5e-9 * float(start + end - 2 * course.start_ns[0]))
            differences.append(float(yaw.mean()) - angle)
    if len(times) < FEWEST:
        return None
    difference = np.array(differences)
    centre = np.angle(np.mean(np.exp(1j * difference)))
    slope, _, low, high = theilslopes(wrap_angle(difference - centre), times)
    return Drift(float(slope), float(low), float(high))
