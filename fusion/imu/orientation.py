"""Where up is, from the orientation field; and whether that field is to be believed."""

from __future__ import annotations

import math
from collections.abc import Sequence

from compass.tilt import Vector
from fusion.checks.silence import RATE_SILENT_NS
from fusion.imu.vectors import dot, turned, unit

# 5 deg between orientation and gravity, as root mean square over `gravity_time`: attitude filters keep to 1 deg of it
# (0.8 deg in the Husky's log), and a vertical that is off by as much makes 0.4 % of a turn.
_AGREEMENT = 2.0 - 2.0 * math.cos(math.radians(5.0))  # squared chord
_BLOCK = 1.0  # s over which a motion is compared: long beside an attitude filter's lag, short beside a gyro's drift
_MOVED = 0.05**2  # rad^2, squared chord; by half as much a gyro's bias of 0.025 rad/s turns in a block
_KEEP = 0.8  # of what was seen, from one block with motion to the next: about five count
_UNFOLLOWED = 0.5  # share of the motion; all of it where a field never changes, or is the yaw only


class Following:
    """Whether a direction that is called fixed moves in the IMU's frame as the gyro says it should.

    Parameters
    ----------
    telling : float
        Motion that shows it, rad^2, squared chord.
    """

    def __init__(self, telling: float = _MOVED) -> None:
        self._telling = telling
        self._start: Vector | None = None
        self._carried: Vector = (0.0, 0.0, 0.0)
        self._moved = self._missed = 0.0

    @property
    def lost(self) -> bool:
        """Whether it lately missed more of the motion than it followed."""
        return self._missed > _UNFOLLOWED * self._moved

    def begin(self, seen: Vector) -> None:
        """Start a block."""
        self._start = self._carried = seen

    def carry(self, rate: Vector, seconds: float) -> None:
        """Turn with the gyro."""
        self._carried = unit(turned(self._carried, rate, seconds)) or self._carried

    def end(self, seen: Vector) -> None:
        """Close a block and begin the next."""
        if self._start is not None:
            moved = _chord2(self._start, self._carried)
            if moved > self._telling:
                self._moved = _KEEP * self._moved + moved
                self._missed = _KEEP * self._missed + _chord2(self._carried, seen)
        self.begin(seen)


class Orientation:
    """Believes the field while its vertical agrees with gravity, where that is known, and it turns as the gyro does.

    A field that never changes, that is the yaw only, or that is given in another frame fails one or the other wherever
    its vertical is wrong.

    Parameters
    ----------
    seconds : float
        Over which agreement with gravity is averaged, s.
    """

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._age = 0.0
        self._off = 0.0
        self._block = 0.0
        self._north, self._up = Following(), Following()
        self._known = False
        self.up: Vector | None = None

    @property
    def contradicts_gravity(self) -> bool:
        """Whether its vertical is elsewhere than gravity's."""
        return self._off > _AGREEMENT

    @property
    def unlike_gyro(self) -> bool:
        """Whether it does not turn as the gyro does."""
        return self._north.lost or self._up.lost

    @property
    def believed(self) -> bool:
        """Whether `up` may be used."""
        return self.up is not None and not self.contradicts_gravity and not self.unlike_gyro

    def follow(self, step_ns: int, rate: Vector, quaternion: Sequence[float] | None, gravity: Vector | None) -> None:
        """Take in a reading: time since the last, ns; angular velocity, rad/s; x, y, z, w; the vertical by gravity."""
        seen = axes_of(quaternion)
        if seen is None:
            self.up, self._known = None, False
            return
        north, self.up = seen
        dt = step_ns * 1e-9
        if not self._known or not 0 <= step_ns <= RATE_SILENT_NS:
            self._known, self._block = True, 0.0
            self._north.begin(north)
            self._up.begin(self.up)
        else:
            self._compare(dt, rate, north, self.up)
        if gravity is None:
            self._off = self._age = 0.0
            return
        off = _chord2(self.up, gravity)
        dt = min(max(dt, 0.0), 1e-9 * RATE_SILENT_NS)
        self._off += (dt / (self._age + dt) if self._age else 1.0) * (off - self._off)
        self._age = min(self._age + max(dt, 1e-3), self._seconds)

    def _compare(self, dt: float, rate: Vector, north: Vector, up: Vector) -> None:
        self._block += dt
        for one, seen in ((self._north, north), (self._up, up)):
            one.carry(rate, dt)
            if self._block >= _BLOCK:
                one.end(seen)
        if self._block >= _BLOCK:
            self._block = 0.0


def axes_of(quaternion: Sequence[float] | None) -> tuple[Vector, Vector] | None:
    """The world's x and z axes seen from the IMU: rows of the rotation matrix. None for an unusable quaternion."""
    if quaternion is None:
        return None
    x, y, z, w = (float(value) for value in quaternion)
    if not 0.9 < x * x + y * y + z * z + w * w < 1.1:  # false for NaN too
        return None
    north = unit((w * w + x * x - y * y - z * z, 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)))
    up = unit((2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z))
    return (north, up) if north and up else None


def _chord2(a: Vector, b: Vector) -> float:
    """Squared distance of two unit vectors: the squared angle between them, where small."""
    return max(2.0 - 2.0 * dot(a, b), 0.0)
