"""The faults: name, who is at fault, what is done, and what is expected of estimate and warnings."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from torture import changes as do
from torture import image_changes as see
from torture.changes import Change

BEGINS, LASTS = 14.0, 1e6  # s; a fault begins in the middle of the drive and lasts
CLOSE, ANY = 3.0, math.inf  # deg of final sigma: two sound sensors remain; nobody can know
FOUND = 30.0  # deg; of 90 that the tracks did not see, should they be right
DARK, SEEN = 2.2, 1.5  # s without images while the robot is lifted; until two images after them
NAMED, MAY, NONE = "named", "may", "none"  # a warning of the faulty sensor is required, allowed, or a false alarm


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes
    ----------
    name : str
    faulty : str
        Letters (G, T, C) of the sensors at fault; "" for a control.
    make : callable
        Gives a new `Change`; it may have a state of its own.
    codes : tuple of str
        Codes that name the fault well; any warning that names the sensor passes.
    who : str
        Sensors that speak.
    since, seconds : float
        When the fault begins and how long it lasts, s.
    words : str
        NAMED, MAY or NONE.
    most_sigma : float
        What the final sigma may be, deg.
    lifted : bool
        Whether the robot is lifted and turned by 90 deg when the fault begins.
    blind : float
        For how long from its beginning nobody could know of the fault, s: the ratio does not count.
    """

    name: str
    faulty: str
    make: Callable[[], Change]
    codes: tuple[str, ...] = ()
    who: str = "GTC"
    since: float = BEGINS
    seconds: float = LASTS
    words: str = NAMED
    most_sigma: float = CLOSE
    lifted: bool = False
    blind: float = 0.0

    @property
    def until(self) -> float:
        return self.since + self.seconds


SIGN, BIAS, SCALE, TIME = (f"sensors_disagree_{kind}" for kind in ("sign", "bias", "scale", "time"))
DISAGREE, SILENT, LOST, STAMPS = "sensors_disagree", "sensor_silent", "samples_lost", "stamps_not_increasing"
STUCK = ("gyro_stuck", DISAGREE)
CLOCK = ("clock_mismatch", "stamps_wrong", STAMPS, TIME)


def _nothing() -> Change:
    return lambda ride, stream, since, until: stream


def _gyro() -> Iterable[Row]:
    yield Row("silent", "G", lambda: do.silent("G"), (SILENT,))
    yield Row("silent for 5 s", "G", lambda: do.silent("G"), (SILENT,), seconds=5.0)
    yield Row("drop-outs, 0.3 s every 2 s", "G", lambda: do.drop_outs("G"), (LOST, SILENT))
    yield Row("stuck at its last value", "G", lambda: do.held("G"), STUCK)
    yield Row("stuck at zero", "G", lambda: do.gyro(lambda w, t: 0.0), STUCK)
    yield Row("stuck at zero for 8 s", "G", lambda: do.gyro(lambda w, t: 0.0), STUCK, seconds=8.0)
    yield Row("noise only", "G", do.gyro_noise_only, STUCK)
    yield Row("single spikes of 5 rad/s", "G", do.gyro_spikes, words=MAY)
    for step in (0.005, 0.02, 0.05, 0.1, 0.5):
        words = NAMED if step >= 0.05 else MAY  # a smaller one the filter learns as it does at the start
        yield Row(f"bias steps by {step} rad/s", "G", lambda b=step: do.gyro(lambda w, t: w + b), (BIAS,), words=words)
    yield Row("bias of 0.1 rad/s for 10 s", "G", lambda: do.gyro(lambda w, t: w + 0.1), (BIAS,), seconds=10.0)
    yield Row("sign reversed", "G", lambda: do.gyro(lambda w, t: -w), (SIGN,))
    yield Row("sign reversed from the start", "G", lambda: do.gyro(lambda w, t: -w), (SIGN,), since=0.0)
    yield Row("deg/s", "G", lambda: do.gyro(lambda w, t: math.degrees(w)), ("gyro_units",))
    yield Row("deg/s from the start", "G", lambda: do.gyro(lambda w, t: math.degrees(w)), ("gyro_units",), since=0.0)
    yield Row("scale 1.3", "G", lambda: do.gyro(lambda w, t: 1.3 * w), (SCALE,))
    yield Row("scale 1.02", "G", lambda: do.gyro(lambda w, t: 1.02 * w), (SCALE,), words=MAY)
    yield Row("doubled samples", "G", lambda: do.doubled("G"), words=MAY)
    yield Row(
        "clipped at 0.5 rad/s",
        "G",
        lambda: do.gyro(lambda w, t: max(-0.5, min(w, 0.5))),
        ("gyro_saturated",),
        words=MAY,
    )
    yield Row("stamped 0.5 s too early", "G", lambda: do.stamped("G", lambda t: t - 0.5), (TIME,))
    yield Row("stamped 0.5 s too late", "G", lambda: do.stamped("G", lambda t: t + 0.5), (TIME,))
    yield Row("arrives 0.5 s late", "G", lambda: do.delayed("G", 0.5), words=MAY)
    yield Row("clock back by 3 s", "G", lambda: do.stamped("G", lambda t: t - 3.0), CLOCK)
    yield Row("clock ahead by 1 h", "G", lambda: do.stamped("G", lambda t: t + 3600.0), CLOCK)
    yield Row("clock ahead by 1 h for 2 s", "G", lambda: do.stamped("G", lambda t: t + 3600.0), CLOCK, seconds=2.0)
    yield Row("hangs for 1.2 s every 8 s, then delivers", "G", lambda: do.hangs("G"), (LOST, SILENT), words=MAY)
    yield Row("axes swapped", "G", do.gyro_other_axis, (DISAGREE, *STUCK))


def _tracks() -> Iterable[Row]:
    yield Row("silent", "T", lambda: do.silent("T"), (SILENT,))
    yield Row("drop-outs, 0.3 s every 2 s", "T", lambda: do.drop_outs("T"), (LOST, SILENT))
    yield Row("stuck", "T", do.tracks_stuck, ("odometry_stuck",))
    yield Row("last sample again and again", "T", lambda: do.held("T"), ("odometry_stuck", DISAGREE))
    yield Row("slip, 0.5 rad/s for 10 s", "T", lambda: do.tracks(lambda w: w + 0.5), (DISAGREE, BIAS), seconds=10.0)
    yield Row("sign reversed", "T", lambda: do.tracks(lambda w: -w), (SIGN,))
    yield Row("sign reversed from the start", "T", lambda: do.tracks(lambda w: -w), (SIGN,), since=0.0)
    yield Row("another ground: scale times 0.52", "T", lambda: do.tracks(lambda w: w * 0.7 / 1.35), (SCALE,))
    zeros = lambda: do.each("T", lambda s, t: replace(s, yaw_rate=0.0, speed=0.0, yaw=0.0))  # noqa: E731
    yield Row("never say anything but zero", "T", zeros, ("odometry_silent",), since=0.0)
    yield Row("stamps run backwards", "T", lambda: do.backwards("T"), CLOCK)
    yield Row("stamped 0.5 s too early", "T", lambda: do.stamped("T", lambda t: t - 0.5), (TIME,), words=MAY)
    yield Row("stamped 0.5 s too late", "T", lambda: do.stamped("T", lambda t: t + 0.5), (TIME,), words=MAY)
    yield Row("arrive 0.5 s late", "T", lambda: do.delayed("T", 0.5), words=MAY)
    yield Row("clock back by 3 s", "T", lambda: do.stamped("T", lambda t: t - 3.0), CLOCK)
    yield Row("clock ahead by 1 h", "T", lambda: do.stamped("T", lambda t: t + 3600.0), CLOCK)
    yield Row("hang for 1.2 s every 8 s, then deliver", "T", lambda: do.hangs("T"), (LOST, SILENT), words=MAY)
    yield Row("doubled samples", "T", lambda: do.doubled("T"), words=MAY)


def _compass() -> Iterable[Row]:
    yield Row("silent", "C", lambda: do.silent("C"), (SILENT,))
    yield Row("dark for 10 s, nothing found again", "C", see.dark, (SILENT, "turn_lost"), seconds=10.0)
    yield Row("frozen: no turn, and sure of it", "C", see.frozen, ("images_frozen", "images_do_not_turn"))
    yield Row("mirrored", "C", see.mirrored, ("images_mirrored",))
    yield Row("mirrored from the start", "C", see.mirrored, ("images_mirrored",), since=0.0)
    yield Row("stabilised: does not turn", "C", see.stabilised, ("images_do_not_turn",))
    yield Row("stabilised from the start", "C", see.stabilised, ("images_do_not_turn",), since=0.0)
    for rate in (0.05, 0.1):
        name = f"crowd walks one way, {rate} rad/s for 15 s"
        yield Row(name, "C", lambda r=rate: see.crowd(r), (DISAGREE, BIAS), seconds=15.0)
    yield Row("single wrong matches", "C", see.wrong_matches, (DISAGREE,), words=MAY)
    yield Row("jump by 180 deg: a symmetric corridor", "C", lambda: see.jump(math.pi), (DISAGREE,), words=MAY)
    yield Row("claims 1/100 of its variance", "C", lambda: see.overconfident(100.0), (DISAGREE,), words=MAY)
    yield Row(
        "images 80 ms later than their stamps said before", "C", lambda: see.exposed_earlier(0.08), (TIME,), words=MAY
    )
    yield Row("remounted: keyframes anew", "C", lambda: do.between(0.0, 0.0, see.anew()), ("turn_lost",), words=MAY)
    yield Row("look back off by 0.2 rad, and sure of it", "C", lambda: see.far_increments(0.2), (DISAGREE,), words=MAY)
    yield Row("arrives 0.5 s late", "C", lambda: do.delayed("C", 0.5), words=MAY)
    yield Row("clock back by 3 s", "C", lambda: do.stamped("C", lambda t: t - 3.0), CLOCK)
    yield Row("clock ahead by 1 h", "C", lambda: do.stamped("C", lambda t: t + 3600.0), CLOCK)
    yield Row("hangs for 1.2 s every 8 s, then delivers", "C", lambda: do.hangs("C"), (LOST, SILENT), words=MAY)


def _several() -> Iterable[Row]:
    lifted = {"seconds": DARK, "lifted": True, "words": MAY}
    unseen = {**lifted, "most_sigma": FOUND, "blind": DARK + SEEN}
    yield Row("lifted by 90 deg in the dark", "T", see.dark, **{**lifted, "most_sigma": FOUND})
    yield Row("lifted by 90 deg in the dark, no gyro, place found again", "TC", see.dark_and_found, who="TC", **unseen)
    yield Row(
        "lifted by 90 deg in the dark, gyro silent meanwhile, place found again", "GTC",
        lambda: do.chain(see.dark_and_found(), do.silent("G")), **unseen,
    )  # fmt: skip
    zero = lambda: do.chain(do.gyro(lambda w, t: 0.0), do.tracks(lambda w: 0.0))  # noqa: E731
    for seconds in (0.4, 2.0):
        for who in ("GTC", "GT"):
            bound = {"most_sigma": ANY} if who == "GT" else {}
            yield Row(f"both zero for {seconds} s", "GT", zero, STUCK, who=who, since=15.0, seconds=seconds, **bound)  # type: ignore[arg-type]
    bias = lambda: do.gyro(lambda w, t: w + 0.1)  # noqa: E731
    slip = lambda: do.between(0.0, 10.0, do.tracks(lambda w: w + 0.5))  # noqa: E731
    yield Row(
        "gyro bias 0.1 rad/s and tracks slip", "GT", lambda: do.chain(bias(), slip()), (BIAS, DISAGREE), most_sigma=ANY
    )
    yield Row(
        "compass dark for 10 s while tracks slip", "TC", lambda: do.chain(do.between(0.0, 10.0, see.dark()), slip()),
        most_sigma=ANY, words=MAY,
    )  # fmt: skip
    yield Row(
        "gyro silent while tracks slip", "GT", lambda: do.chain(do.between(0.0, 10.0, do.silent("G")), slip()),
        most_sigma=ANY,
    )  # fmt: skip


def _controls() -> Iterable[Row]:
    for who in ("GTC", "GC", "GT", "TC", "G", "T", "C"):
        bound = CLOSE if who in ("GTC", "GC", "TC") else ANY
        yield Row("no fault", "", _nothing, who=who, words=NONE, most_sigma=bound)


PAIRED = {
    "G": (
        *("sign reversed", "sign reversed from the start", "deg/s", "silent", "clock back by 3 s"),
        *(
            "bias steps by 0.02 rad/s",
            "bias steps by 0.1 rad/s",
            "bias steps by 0.5 rad/s",
            "bias of 0.1 rad/s for 10 s",
        ),
        *("stuck at its last value", "stuck at zero", "noise only"),
    ),
    "T": (
        *("sign reversed", "sign reversed from the start", "stuck", "slip, 0.5 rad/s for 10 s", "silent"),
        *("another ground: scale times 0.52", "never say anything but zero"),
    ),
    "C": (
        *("mirrored", "mirrored from the start", "stabilised: does not turn", "frozen: no turn, and sure of it"),
        *("crowd walks one way, 0.1 rad/s for 15 s", "jump by 180 deg: a symmetric corridor", "silent"),
    ),
}


def _pairs(rows: Iterable[Row]) -> Iterable[Row]:
    """The faults that a third sensor decides, without a third one: sigma must cover both."""
    for row in rows:
        if row.who == "GTC" and row.name in PAIRED.get(row.faulty, ()):
            for who in ("GC", "GT", "TC"):
                if row.faulty in who:
                    yield replace(row, who=who, most_sigma=ANY)


def all_rows() -> list[Row]:
    """Controls, each sensor's faults with all sensors, several faults at once, and the same of pairs."""
    single = [*_gyro(), *_tracks(), *_compass()]
    return [*_controls(), *single, *_several(), *_pairs(single)]
