"""What is wrong, in words: one table of codes, and the warnings that carry them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

# Most serious first: what makes the yaw wrong, then what makes it uncertain, then what costs accuracy only.
# docs/warnings.md explains each code at length; a test holds the two together.
CODES: dict[str, str] = {
    "clock_mismatch": "a sensor's stamps have no time in common with the others'",
    "sensors_disagree_sign": "a sensor turns the other way than the rest",
    "images_mirrored": "the panoramas are mirrored or upside down",
    "gyro_units": "the gyro's numbers are degrees per second",
    "images_do_not_turn": "the panoramas do not turn with the robot",
    "not_full_circle": "the panoramas do not show the full circle once",
    "gyro_stuck": "the gyro repeats one value, or says zero, while the robot turns",
    "gyro_saturated": "the gyro is at its end stop",
    "odometry_stuck": "the odometry claims no turn while the robot turns",
    "sensors_disagree_scale": "a sensor's turns differ from the others' by a factor",
    "sensors_disagree_bias": "a sensor's turn rate differs from the others' by a constant",
    "sensors_disagree_time": "a sensor's turns come earlier or later than the others'",
    "sensors_disagree": "sensors contradict each other",
    "odometry_not_independent": "the odometry takes its turns from the gyro",
    "turn_lost": "nothing measured how the robot turned for a while",
    "vertical_unknown": "nothing usable tells where up is; the gyro's z axis was taken",
    "imu_moved": "the IMU sits otherwise than before, and did not turn there by its gyro",
    "orientation_wrong": "the IMU's orientation contradicts its gravity or its gyro and was left out",
    "accelerometer_units": "the accelerations are in g",
    "imu_half_messages": "IMU messages bring the gyro and the accelerometer in turn",
    "stamps_not_increasing": "stamps repeat, go back, or are cut to whole seconds",
    "stamps_wrong": "single stamps are from another time and were left out",
    "images_frozen": "the camera repeats one image",
    "images_empty": "images without content",
    "odometry_silent": "the odometry never says anything but zero",
    "sensor_silent": "a sensor stopped",
    "sensor_refused": "a sensor's samples are refused",
    "sensor_spikes": "single samples stand out from those before and after",
    "samples_lost": "messages were lost or unreadable",
}
_RANK = {code: rank for rank, code in enumerate(CODES)}


@dataclass(frozen=True, slots=True)
class Warning:
    """One thing that is wrong.

    Attributes
    ----------
    code : str
        Stable and short, one of `CODES`.
    sensor : str
        ``gyro``, ``tracks``, ``compass``, or two of them joined by ``+`` where nobody can tell which one errs;
        ``recording`` where messages of any are missing.
    since_ns : int
        Stamp from which on it was so, ns.
    text : str
        What was seen, by how much, and what to do.
    """

    code: str
    sensor: str
    since_ns: int
    text: str

    @property
    def sensors(self) -> tuple[str, ...]:
        """The sensors it is about, one by one."""
        return tuple(self.sensor.split("+"))

    def __post_init__(self) -> None:
        if self.code not in _RANK:
            raise ValueError(f"{self.code!r} is no warning's code; codes: {', '.join(CODES)}")


def most_serious_first(warnings: Iterable[Warning]) -> list[Warning]:
    """In the order of `CODES`, of one code the earliest first."""
    return sorted(warnings, key=lambda warning: (_RANK[warning.code], warning.since_ns))


class WarningLog:
    """Every warning ever given, once per code and sensor: the first time it came up, in its latest words."""

    def __init__(self) -> None:
        self._known: dict[tuple[str, str], Warning] = {}

    def note(self, warnings: Iterable[Warning]) -> list[Warning]:
        """Take in what is wrong at present; returns those that were not known before."""
        new = []
        for warning in warnings:
            key = warning.code, warning.sensor
            known = self._known.get(key)
            if known is None:
                new.append(warning)
                self._known[key] = warning
            elif known.text != warning.text:
                self._known[key] = Warning(warning.code, warning.sensor, known.since_ns, warning.text)
        return new

    def clear(self) -> None:
        """Forget all."""
        self._known.clear()

    def all(self) -> list[Warning]:
        """All so far, most serious first."""
        return most_serious_first(self._known.values())
