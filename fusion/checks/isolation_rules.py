"""The rules of fault isolation: a window judged, and new contradictions; see `fusion.checks.isolation`."""

from __future__ import annotations

import math

from fusion.buffer.events import Sensor
from fusion.checks.alternative import Alternative, Third
from fusion.checks.contradiction import AGREEMENT_SIGMAS, CONTRADICTION_SIGMAS, GROSS, contradict
from fusion.checks.exclusion import UNLIKELY_BIAS
from fusion.checks.gyro_faults import TURNED, rebias, surely_gyro
from fusion.checks.isolation import Isolation, Judged, Remedy
from fusion.checks.isolation_recovery import as_it_was, judge_excluded, settle_alternatives, with_window
from fusion.checks.stillness import CREEP_RATE
from fusion.checks.windows import WINDOW_NS, Claim, Window
from fusion.record import replace

# Not derived: `LONG`, `STUCK`, `SLIPPED_ON`, `STEADY`, `STEADY_WINDOWS`, `SCALED`.
LONG = 6.0  # s; over more than that lasting errors of a sensor do not average out as its noise does
STUCK = 0.2  # ratio of turns; a smaller one is no scale factor, nor is one larger than its inverse
STEADY, STEADY_WINDOWS = 0.2, 2  # largest change of a bias as a share of it; windows that are needed to see that
SCALED = 12.0  # standard deviations of the gyro's scale factor; before it is learnt they are a tenth of the turn
# A bias so many times as large is 25 times less likely: the prior of gyros' biases has heavy tails. With 10 a robot
# that is carried round at 0.05 rad/s stays 83 deg off (docs/lab-notes/strangers-2026-11-30.md).
UNLIKELIER = 5.0
SLIPPED_ON = 3  # windows; tracks slip, but not for longer than that: then they do not measure the turn


def judge(iso: Isolation, window: Window, bias: float) -> Judged:
    """Judge a window that is over.

    Parameters
    ----------
    iso : Isolation
        As it was before.
    window : Window
    bias : float
        Gyro bias that is taken out of the window's claims, rad/s.

    Returns
    -------
    (Isolation, Remedy)
        As it is now, and what the filter has to do.
    """
    if iso.one_source:
        window = replace(window, tracks=None)
    alternatives = tuple(with_window(alternative, window, bias) for alternative in iso.alternatives)
    iso, remedies = replace(iso.with_turns(window, bias), alternatives=alternatives), []
    for rule in (settle_alternatives, judge_excluded, _judge_start, _judge_trusted):
        iso, remedy = rule(iso, window, bias)
        remedies.append(remedy)
        if remedy.delay or remedy.shift:  # that is all there is to this window
            break
    remedy = Remedy.of(remedies)
    if remedy.shift or remedy.delay:
        return replace(iso, last=None, long=None), remedy
    if iso.exclusions or iso.alternatives:
        return replace(iso, last=window, long=None), remedy
    iso, more = _judge_long(replace(iso, last=window), window, bias)
    return iso, Remedy.of((remedy, more))


def _judge_start(iso: Isolation, window: Window, bias: float) -> Judged:
    """Find images that turn while tracks stand and a gyro turns at one rate, since the robot was switched on.

    Either it turns at a crawl that the tracks do not see, or what the images show moves. How much of its rate is bias
    nobody has told the gyro yet but the images: that all of it is remains the alternative. Not so where the gyro's rate
    is that of the images, and too high for a bias: both turn.
    """
    gyro, tracks, before = window.gyro, window.tracks, iso.start
    if iso.moved or gyro is None or tracks is None:
        return iso, Remedy()
    noise = math.sqrt(max(gyro.noise**2 - (window.bias_sigma * window.seconds) ** 2, 0.0))
    window = replace(window, gyro=replace(gyro, turn=gyro.turn + bias * window.seconds, noise=noise))
    start = before.plus(window) if before and before.t_ns == window.start_ns else window
    rate, usual = (one.gyro.turn / one.seconds if one.gyro else 0.0 for one in (window, start))
    steady = abs(rate - usual) <= CONTRADICTION_SIGMAS * noise / window.seconds
    if not (tracks.rests and steady) or iso.exclusions or iso.alternatives:
        return replace(iso, moved=True, start=None), Remedy()
    images, off = start.compass, start.compass.turn if start.compass else 0.0
    if abs(off) <= GROSS * WINDOW_NS * 1e-9 or not contradict(images, start.tracks, 0.0):
        return replace(iso, start=start), Remedy()
    iso = replace(iso, moved=True, start=None)
    if abs(usual) > UNLIKELIER * math.hypot(window.bias_sigma, usual - off / start.seconds):
        return iso, Remedy()  # it turns on something that turns
    iso = iso.noting(replace(start, gyro=Claim(0.0, noise)))
    rate = -off / start.seconds
    stands = Alternative(Sensor.GYRO, start.start_ns, -off, usual, until_ns=start.t_ns, rate=rate, by_rest=True)
    return iso.with_alternative(stands), Remedy()


def _judge_long(iso: Isolation, window: Window, bias: float) -> Judged:
    """Judge several windows as one, in which nothing contradicted so far."""
    before = iso.long if iso.long and iso.long.t_ns == window.start_ns else None
    long = before.plus(window) if before else window
    remedy = Remedy()
    if before:
        alone = replace(iso, last=None)
        steps = _gyro_steps(alone, long, bias) or _gyro_against_rest(alone, long, bias)
        iso, remedy = steps or _judge_trusted(alone, long, bias)
        latest = iso.reference(Sensor.GYRO, window)
        if remedy.rate is not None and latest:  # in so long a window the rate may have changed
            remedy = replace(remedy, rate=latest.turn / window.seconds)
    if remedy.shift or iso.exclusions or iso.alternatives:
        return replace(iso, last=None, long=None), remedy
    return replace(iso, last=window, long=long if long.seconds < LONG else None), remedy


def _gyro_steps(iso: Isolation, long: Window, bias: float) -> Judged | None:
    """Take it for a step of the gyro's bias where gyro and compass differ by so little that only many windows show it.

    That there was none is the alternative. How large it was the filter finds out: in so long a window the rate may have
    changed, and a delay may matter. None where they do not differ so, or by what may be a factor.
    """
    gyro, compass = iso.trusted(Sensor.GYRO, long), iso.trusted(Sensor.COMPASS, long)
    if gyro is None or compass is None:
        return None
    off = gyro.turn - compass.turn
    least = max(GROSS * WINDOW_NS * 1e-9, SCALED * gyro.scale * abs(compass.turn))
    if not (least < abs(off) <= UNLIKELY_BIAS * long.seconds and contradict(gyro, compass, 0.0)):
        return None
    third = Third().plus(long.tracks, compass, gyro)
    iso = iso.noting(long).with_alternative(
        Alternative(Sensor.GYRO, long.start_ns, off, bias, third, long.t_ns, off / long.seconds)
    )
    return iso, Remedy.of((iso.following(Sensor.COMPASS, long), Remedy(bias=bias, rate=compass.turn / long.seconds)))


def _gyro_against_rest(iso: Isolation, long: Window, bias: float) -> Judged | None:
    """A gyro turns for several windows while tracks stand, by so little that one does not show it; None where not."""
    gyro, tracks = iso.trusted(Sensor.GYRO, long), iso.trusted(Sensor.TRACKS, long)
    if gyro is None or tracks is None or long.compass is not None or not tracks.rests:
        return None
    if abs(gyro.turn - tracks.turn) <= GROSS * WINDOW_NS * 1e-9 or not contradict(gyro, tracks, 0.0):
        return None
    return _tracks_against(iso.noting(long), gyro, tracks, long, bias)


def _bias_at_rest(iso: Isolation, window: Window, bias: float) -> Judged | None:
    """A gyro turns at one rate beside tracks that rest and have spoken: it has another bias; None where not.

    Lifted robots turn less evenly. That it turns with what it stands on stays the alternative.
    """
    run = _steady_at_rest(iso, window, bias)
    if run is None or run.gyro is None or run.tracks is None:
        return None
    gyro, tracks, off = run.gyro, run.tracks, run.gyro.turn
    if not GROSS * WINDOW_NS * 1e-9 < abs(off) < UNLIKELY_BIAS * run.seconds or not contradict(gyro, tracks, 0.0):
        return None
    none = Alternative(Sensor.GYRO, run.start_ns, off, bias, until_ns=run.t_ns, rate=off / run.seconds, driven=False)
    iso = iso.noting(run).without_alternative(Sensor.TRACKS)
    iso = iso.excluding(Sensor.GYRO, run, tracks.turn, off).with_alternative(none)
    return iso, Remedy.of((iso.following(Sensor.TRACKS, run), rebias(gyro, tracks, run, bias)))


def _steady_at_rest(iso: Isolation, window: Window, bias: float) -> Window | None:
    """The last windows as one in which the tracks rest and a gyro that is followed turns at one rate."""
    if iso.trusted(Sensor.GYRO, window) is None or window.gyro is None or not window.tracks_spoke:
        return None
    known, claimed = window.bias_sigma * window.seconds, window.gyro.turn / window.seconds + bias
    noise = math.sqrt(max(window.gyro.noise**2 - known**2, 0.0))
    start_ns, rates = window.t_ns, list[float]()
    for one in reversed(iso.turned):
        rate = one.rate_of(Sensor.GYRO)
        if rate is None or not one.rests or one.t_ns != start_ns:
            break
        if abs(rate - claimed) > CONTRADICTION_SIGMAS * noise / window.seconds:
            break
        start_ns = one.start_ns
        rates.append(rate)
    if len(rates) < STEADY_WINDOWS:
        return None
    seconds = (window.t_ns - start_ns) * 1e-9
    turn = (sum(rates) / len(rates) - bias) * seconds
    gyro = Claim(turn, math.hypot(noise * math.sqrt(len(rates)), window.bias_sigma * seconds), window.gyro.scale)
    tracks = Claim(0.0, CREEP_RATE * seconds, rests=True)
    run = replace(window, start_ns=start_ns, gyro=gyro, tracks=tracks)
    return replace(run, followed=turn, corrected=0.0, rate_change=0.0)


def _judge_trusted(iso: Isolation, window: Window, bias: float) -> Judged:
    """Find new contradictions."""
    gyro, tracks, compass = (iso.trusted(sensor, window) for sensor in (Sensor.GYRO, Sensor.TRACKS, Sensor.COMPASS))
    if gyro and compass and contradict(gyro, compass, window.seconds):
        return _gyro_against_compass(iso.noting(window), gyro, compass, window, bias)
    if hangs := _gyro_hangs(iso, window, bias):
        return hangs
    if gyro and compass is None and (steady := _bias_at_rest(iso, window, bias)):
        return steady
    leader = compass or gyro
    if leader and tracks and contradict(leader, tracks, window.seconds):
        return _tracks_against(iso.noting(window), leader, tracks, window, bias)
    return iso, Remedy()


def _gyro_hangs(iso: Isolation, window: Window, bias: float) -> Judged | None:
    """A gyro that hangs is contradicted, by however little and whatever its scale factor; None where it is not.

    One that works never gives the same number so often.
    """
    sensor = Sensor.COMPASS if iso.trusted(Sensor.COMPASS, window) else Sensor.TRACKS
    gyro, other = iso.trusted(Sensor.GYRO, window), iso.trusted(sensor, window)
    if gyro is None or other is None or not window.gyro_hangs:
        return None
    off = gyro.turn - other.turn
    if abs(off) <= AGREEMENT_SIGMAS * math.hypot(gyro.noise, other.noise):
        return None
    follow = iso.following(sensor, window)
    iso = iso.noting(window).excluding(Sensor.GYRO, window, other.turn, off)
    return iso, Remedy.of((follow, rebias(gyro, other, window, bias)))


def _gyro_against_compass(iso: Isolation, gyro: Claim, compass: Claim, window: Window, bias: float) -> Judged:
    """Exclude one of the two: whom the tracks contradict, else the compass, which stays the alternative.

    Of images that say themselves that they show less than the full circle it is no alternative, either.
    """
    off = gyro.turn - compass.turn
    third = Third().plus(window.tracks, gyro, compass)
    before = [one.compass.turn - one.gyro.turn for one in iso.joined(window)[:-1] if one.compass and one.gyro]
    images = Alternative(Sensor.COMPASS, window.start_ns, sum(before), third=third)
    side = False if window.part and not surely_gyro(window, compass.turn) else iso.side(images, window)
    alternative = iso.alternative(Sensor.GYRO)
    if alternative is not None and side is None and not surely_gyro(window, compass.turn):
        return as_it_was(iso, alternative, window, bias)
    if side is True or (side is None and surely_gyro(window, compass.turn)):
        iso = iso.excluding(Sensor.GYRO, window, compass.turn, off)
        return iso, Remedy.of((iso.following(Sensor.COMPASS, window), rebias(gyro, compass, window, bias)))
    iso = iso.excluding(Sensor.COMPASS, window, gyro.turn, off)
    if not window.part:
        iso = iso.with_alternative(replace(images.plus(-off, window), refuted=side is False))
    return iso, iso.following(Sensor.GYRO, window)


def _no_scale_explains(iso: Isolation) -> bool:
    """Whether the tracks have claimed next to nothing of several turns, the opposite, or many times as much."""
    turns = [(other.turn, window.tracks.turn) for window in iso.evidence if (other := window.compass) and window.tracks]
    turns = [(x, y) for x, y in turns if abs(x) > TURNED]
    seen, claimed = sum(x * x for x, _ in turns), sum(x * y for x, y in turns)
    return len(turns) >= SLIPPED_ON and not STUCK * seen <= claimed <= seen / STUCK


def _gyro_against_silence(iso: Isolation, gyro: Claim, tracks: Claim, window: Window, bias: float) -> Judged:
    """A gyro turns while tracks have not said anything yet: it has another bias, or they do not work.

    A robot stands when it is switched on. A gyro that has turned at one rate ever since has a bias; if the rate
    changes, the tracks are dead.
    """
    off = tracks.turn - gyro.turn
    rates = [one.gyro.turn / one.seconds for one in iso.evidence if one.gyro]
    if max(rates) - min(rates) > max(STEADY * max(map(abs, rates)), GROSS):
        return iso.excluding(Sensor.TRACKS, window, gyro.turn, off), Remedy()
    if len(rates) < STEADY_WINDOWS:
        return iso, Remedy()
    iso = iso.excluding(Sensor.GYRO, window, tracks.turn, -off)
    return iso, Remedy.of((iso.following(Sensor.TRACKS, window), rebias(gyro, tracks, window, bias)))


def _tracks_against(iso: Isolation, leader: Claim, tracks: Claim, window: Window, bias: float) -> Judged:
    """The tracks slip, or err for good, or the only other sensor errs.

    Slip that two others see is for the filter's gate. Tracks that turn the other way, not at all, or many times as far
    are excluded.
    """
    gyro, compass = iso.trusted(Sensor.GYRO, window), iso.trusted(Sensor.COMPASS, window)
    off = tracks.turn - leader.turn
    if gyro and not compass and not window.tracks_spoke:
        return _gyro_against_silence(iso, gyro, tracks, window, bias)
    if not window.tracks_spoke or (gyro and compass):
        broken = not window.tracks_spoke or _no_scale_explains(iso)
        return (iso.excluding(Sensor.TRACKS, window, leader.turn, off) if broken else iso), Remedy()
    if gyro and surely_gyro(window, tracks.turn):
        iso = iso.excluding(Sensor.GYRO, window, tracks.turn, -off)
        return iso, Remedy.of((iso.following(Sensor.TRACKS, window), rebias(gyro, tracks, window, bias)))
    alternative = iso.alternative(Sensor.TRACKS) or Alternative(Sensor.TRACKS, window.start_ns, 0.0)
    remedy = iso.following(Sensor.COMPASS, window) if compass else Remedy()
    return iso.with_alternative(alternative.plus(off, window)), remedy
