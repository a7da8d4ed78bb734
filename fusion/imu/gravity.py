"""Where up is, from the accelerometer: averaged over time, and only if what it measures is as long as gravity."""

from __future__ import annotations

import math
from collections.abc import Sequence

from compass.tilt import Vector
from fusion.checks.silence import RATE_SILENT_NS
from fusion.imu.orientation import Following
from fusion.imu.vectors import cross, dot, turned, unit, vector

_YOUNG = 3.0  # s; from less a start would be taken for a bias; not derived
# What gravity measures in the units that drivers use; milli-g and cm/s^2 differ by less than accelerometers err.
_UNITS = ((9.80665, "m/s^2"), (1.0, "g"), (1000.0, "milli-g or cm/s^2"), (9806.65, "mm/s^2"))
# A cheap accelerometer errs by 0.5 m/s^2 and 3 %, a robot's own acceleration by little once averaged.
_LENGTH_ERROR = 0.2
# A gyro with other axes, or in deg/s, tips the vertical over. It is looked at every so many s, where it tips by so much
# (rad^2, squared chord; robots do so in a fall), beside the accelerometer's mean over so many s. Not derived.
_BLOCK, _TIPPED, _SHAKEN = 1.0, 0.5**2, 0.2
_NEAR = 0.25**2  # rad^2; up to there what the accelerometer sees is what is believed; not derived
_PROVEN = 0.25  # s; before, a bump of 1 m/s^2 on an accelerometer without gravity would be taken for 1 g


class Gravity:
    """Complementary filter: the last vertical turned with the gyro, then drawn towards the accelerometer.

    What the gyro's bias does to it time after time is learnt (Mahony, Hamel & Pflimlin 2008,
    doi:10.1109/TAC.2008.923738): it would be off by the bias times `seconds`.

    Parameters
    ----------
    seconds : float
        Time over which accelerations average out to gravity, s.
    any_length : bool
        Take the accelerometer's word whatever the length of what it measures.

    Attributes
    ----------
    length : float
        Mean acceleration along the vertical, as the driver gives it; 0 before the first. Without gravity, noise.
    moved : bool
        Whether the IMU was found by the last reading to sit otherwise than before, and the vertical forgotten.
    """

    def __init__(self, seconds: float, any_length: bool = False) -> None:
        self._seconds = seconds
        self._any_length = any_length
        self._direction: Vector | None = None
        self._age = 0.0
        self._drift: Vector = (0.0, 0.0, 0.0)  # bias of the gyro across the vertical, rad/s
        self._silence = 0.0
        self._heard = 0.0
        self.length = 0.0
        self._follows, self._block = Following(_TIPPED), 0.0
        self._lately: Vector | None = None  # mean acceleration
        self._misled = False  # whether the gyro turns otherwise than the accelerometer sees
        self._agreed: Vector | None = None  # where the accelerometer last saw up while it agreed
        self._astray = 0.0  # s, since it has jumped from there, and the gyro did not turn along
        self.moved = False

    @property
    def unit(self) -> str | None:
        """The unit in which `length` is gravity; None where it is in none."""
        known = _UNITS if self._heard >= _PROVEN else _UNITS[:1]
        return next((name for g, name in known if abs(self.length / g - 1.0) <= _LENGTH_ERROR), None)

    @property
    def silent(self) -> bool:
        """Whether the accelerometer has been silent for longer than the gyro alone can hold the vertical."""
        return self._direction is None or self._silence > self._seconds

    @property
    def up(self) -> Vector | None:
        """The vertical in the IMU's frame, a unit vector; None where the accelerometer does not measure it."""
        return self._direction if not self.silent and (self._any_length or self.unit) else None

    @property
    def doubtful(self) -> bool:
        """Whether the IMU may just have moved in its mount."""
        return self._astray > 0.0

    @property
    def settled(self) -> bool:
        """Whether it has been averaged for long enough to outlive its source."""
        return self._heard >= min(_YOUNG, self._seconds)

    def follow(self, step_ns: int, rate: Vector, acceleration: Sequence[float] | None) -> None:
        """Take in a reading: time since the last, ns; angular velocity, rad/s; specific force, any unit."""
        force = unit(acceleration)
        self._watch(step_ns, rate, acceleration if force else None)
        self._turn(step_ns, (0.0, 0.0, 0.0) if self._misled else rate, force)
        seconds = min(max(step_ns, 0), RATE_SILENT_NS) * 1e-9
        self._silence = 0.0 if force else self._silence + seconds
        if force and acceleration is not None and self._direction:
            along = dot(vector(acceleration), self._direction)
            gain = seconds / (self._heard + seconds) if self._heard else 1.0
            self.length += gain * (along - self.length)
            self._heard = min(self._heard + max(seconds, 1e-3), self._seconds)

    def _watch(self, step_ns: int, rate: Vector, acceleration: Sequence[float] | None) -> None:
        """Look whether what the gyro turns is what the accelerometer sees of it."""
        if acceleration is None or not 0 <= step_ns <= RATE_SILENT_NS:
            return
        dt, force = step_ns * 1e-9, vector(acceleration)
        gain = min(dt / _SHAKEN, 1.0)
        self._lately = vector([(1.0 - gain) * a + gain * b for a, b in zip(self._lately or force, force, strict=True)])
        self._follows.carry(rate, dt)
        self._block += dt
        seen = unit(self._lately)
        self._look_for_jump(dt, seen)
        if self._block < _BLOCK or seen is None or self.doubtful:
            return
        self._block = 0.0
        if not _is_gravity(self._lately, _UNITS[:1]):
            return
        self._follows.end(seen)
        if self._follows.lost != self._misled:
            self._misled = self._follows.lost
            self._begin_anew()

    def _look_for_jump(self, dt: float, seen: Vector | None) -> None:
        """Whether the accelerometer sees up elsewhere than before, for good, while the gyro did not turn there.

        An IMU that comes loose, or a driver that gives other axes. The mean of both would be a vertical that is none.
        """
        self.moved = False
        if self._lately is None or seen is None or self._direction is None or _near(seen, self._direction, _NEAR):
            self._agreed, self._astray = seen, 0.0
        elif _near(seen, self._direction, _TIPPED) or self._agreed is None or _near(seen, self._agreed, _NEAR):
            self._astray = 0.0
        else:
            self._astray = self._astray + dt if _is_gravity(self._lately, _UNITS) else 0.0
            self.moved = self._astray >= _BLOCK
            if self.moved:
                self._begin_anew()
                self._follows, self._agreed, self._astray = Following(_TIPPED), None, 0.0

    def _begin_anew(self) -> None:
        self._direction, self._drift, self._heard = None, (0.0, 0.0, 0.0), 0.0

    def _turn(self, step_ns: int, rate: Vector, force: Vector | None) -> None:
        if self._direction is None or not 0 <= step_ns <= RATE_SILENT_NS:
            self._direction, self._age = force or self._direction, 0.0
            return
        dt = step_ns * 1e-9
        (wx, wy, wz), (bx, by, bz) = rate, self._drift
        now = turned(self._direction, (wx - bx, wy - by, wz - bz), dt)
        # A plain mean while young, then a mean that forgets.
        gain = dt / (self._age + 2.0 * dt) if force and dt > 0.0 else 0.0
        self._age = min(self._age + dt, self._seconds)
        if force and gain > 0.0 and not self.doubtful:
            pull = dt / max(self._age, _YOUNG) ** 2
            across = cross(now, force)
            self._drift = vector([drift + pull * a for drift, a in zip(self._drift, across, strict=True)])
            now = vector([(1.0 - gain) * a + gain * b for a, b in zip(now, force, strict=True)])
        self._direction = unit(now)


def _near(a: Vector, b: Vector, limit: float) -> bool:
    """Whether two directions differ by no more than a limit, rad^2."""
    return 2.0 - 2.0 * dot(a, b) <= limit


def _is_gravity(force: Vector, units: Sequence[tuple[float, str]]) -> bool:
    length = math.sqrt(dot(force, force))
    return any(abs(length / gravity - 1.0) <= _LENGTH_ERROR for gravity, _ in units)
