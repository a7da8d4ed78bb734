"""The rules by which contradicting sensors are excluded, doubted and trusted again; see `fusion.checks.isolation`."""

from __future__ import annotations

import math
from dataclasses import replace

from fusion.buffer.events import Sensor
from fusion.checks.isolation import CHANGED, Doubt, Exclusion, Isolation, Remedy, Third, contradict
from fusion.checks.windows import Claim, Window

RADIANS = (45.0, 72.0)  # ratio of turns that only degrees taken for radians explain: 57.3 but for a quarter
TURNED = 0.02  # rad in a window; a ratio to less says nothing
LONG = 6.0  # s; in longer ones errors that last are no noise any more
STUCK = 0.2  # ratio of turns; less is no scale factor
SLIPPED_ON = 3  # windows; tracks that slip for longer do not see the robot turn
TIMED = 0.95  # of squared contradictions, explained by a time offset
MOST_BIAS = 1.0  # rad/s; what is beyond is no bias
LATEST = 0.3  # s; no camera's driver takes longer than that longer than before
SUSTAINED = 1.5  # of the last window's contradiction that they must sum up to, not to be one wrong match

Judged = tuple[Isolation, Remedy]


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
    doubts = tuple(_with_window(doubt, window, bias) for doubt in iso.doubts)
    iso, remedies = replace(iso.with_turns(window, bias), doubts=doubts), []
    for rule in (_settle_doubts, _judge_excluded, _judge_trusted):
        iso, remedy = rule(iso, window, bias)
        remedies.append(remedy)
        if remedy.delay or remedy.shift:  # that is all there is to this window
            break
    remedy = Remedy.of(remedies)
    if remedy.shift or remedy.delay:
        return replace(iso, last=None, long=None), remedy
    if iso.exclusions or iso.doubts:
        return replace(iso, last=window, long=None), remedy
    iso, more = _judge_long(replace(iso, last=window), window, bias)
    return iso, Remedy.of((remedy, more))


def _judge_long(iso: Isolation, window: Window, bias: float) -> Judged:
    """Judge several windows as one, in which nothing contradicted so far."""
    before = iso.long if iso.long and iso.long.t_ns == window.start_ns else None
    long = before.plus(window) if before else window
    iso, remedy = _judge_trusted(replace(iso, last=None), long, bias) if before else (iso, Remedy())
    if remedy.shift or iso.exclusions or iso.doubts:
        return replace(iso, last=None, long=None), remedy
    return replace(iso, last=window, long=long if long.seconds < LONG else None), remedy


def surely_gyro(window: Window, turn: float) -> bool:
    """Whether the gyro errs whoever contradicts it by a `turn`: one number, turns that no robot makes, or degrees."""
    if window.gyro_repeats or window.gyro_beyond:
        return True
    return bool(window.gyro and abs(turn) > TURNED and RADIANS[0] < abs(window.gyro.turn / turn) < RADIANS[1])


def _with_window(doubt: Doubt, window: Window, bias: float) -> Doubt:
    """A doubt with one more window. Tracks slip now and then: of theirs only what contradicts counts."""
    claim = window.claim(doubt.sensor)
    if doubt.sensor is Sensor.TRACKS or claim is None:
        return replace(doubt, rate=0.0)
    turn, followed = doubt.turn(claim, window.seconds, bias), window.claim(doubt.against)
    third = doubt.third
    if contradict(replace(claim, turn=turn), followed, window.seconds) and followed:  # in others it takes no side
        third = third.plus(window.tracks, followed.turn, turn - followed.turn)
    return replace(doubt.plus(turn - window.followed, window), third=third)


def _settle_doubts(iso: Isolation, window: Window, bias: float) -> Judged:
    """End doubts that a third sensor decides, and those about a sensor that is as it was before."""
    remedies = []
    for doubt in iso.doubts:
        side = doubt.third.side
        gyro, compass = window.gyro, window.compass
        if doubt.sensor is not Sensor.TRACKS and gyro and compass and contradict(gyro, compass, window.seconds):
            side = doubt.sensor is Sensor.COMPASS if surely_gyro(window, compass.turn) and side is None else side
        if side is False:  # it erred: the one that is followed is right
            iso = iso.sure_of(doubt.sensor)
        elif side is True:
            iso, remedy = _follow(iso, doubt, window)
            remedies.append(remedy)
        elif not iso.excludes(doubt.sensor) and _as_before(iso, doubt, window, bias):
            iso = iso.sure_of(doubt.sensor)
            remedies.append(Remedy(fold=doubt.variance(window.t_ns)))
    return iso, Remedy.of(remedies)


def _follow(iso: Isolation, doubt: Doubt, window: Window) -> Judged:
    """Trust the doubted sensor from now on, and exclude the one that was followed instead of it."""
    iso = iso.sure_of(doubt.sensor).trusting(doubt.sensor)
    claim, wrong = window.claim(doubt.sensor), window.claim(doubt.against)
    if claim and wrong:
        iso = iso.excluding(doubt.against, window, claim.turn, wrong.turn - claim.turn)
    restored = doubt.bias if doubt.sensor is Sensor.GYRO else None
    rate = claim.turn / window.seconds if claim and doubt.against is Sensor.GYRO else None
    return iso, Remedy(doubt.offset, claim.sigma**2 if claim else 0.0, restored, rate=rate)


def _as_before(iso: Isolation, doubt: Doubt, window: Window, bias: float) -> bool:
    """Whether the doubted sensor agrees with the others, calibrated as it was before the doubt."""
    claim, reference = window.claim(doubt.sensor), iso.reference(doubt.sensor, window)
    if claim is None or reference is None:
        return False
    if doubt.sensor is Sensor.TRACKS:
        turn = abs(reference.turn)  # so much that tracks that turn otherwise, or not at all, would not be as near
        return turn > max(TURNED, 2.0 * claim.sigma) and abs(claim.turn - reference.turn) < 0.5 * turn
    off = doubt.turn(claim, window.seconds, bias) - reference.turn
    return abs(off) <= 3.0 * math.hypot(claim.sigma, reference.sigma)


def _judge_excluded(iso: Isolation, window: Window, bias: float) -> Judged:
    """Trust excluded sensors again that show they are well; give a gyro that does not another bias."""
    remedies = []
    for one in iso.exclusions:
        claim, reference = window.claim(one.sensor), iso.reference(one.sensor, window)
        if claim is None or reference is None:
            continue
        if contradict(claim, reference, window.seconds):
            iso, remedy = _errs_still(iso.noting(window), one, claim, reference, window, bias)
            remedies.append(remedy)
        elif one.shows_well(claim, reference, window):
            iso = iso.with_exclusion(replace(one, agreed=one.agreed + 1))
            if one.agreed + 1 >= iso.needed(one.sensor):
                iso, remedy = _trust_again(iso, one.sensor)
                remedies.append(remedy)
    return iso, Remedy.of(remedies)


def _errs_still(iso: Isolation, one: Exclusion, claim: Claim, reference: Claim, window: Window, bias: float) -> Judged:
    """An excluded sensor contradicts in one more window."""
    off, doubt = claim.turn - reference.turn, iso.doubt(one.sensor)
    iso = iso.with_exclusion(one.again(reference.turn, off, window))
    if one.sensor is Sensor.GYRO:
        if doubt and doubt.third.side is None and not surely_gyro(window, reference.turn):
            return _as_it_was(iso, doubt, window, bias)
        return iso, replace(_rebias(claim, reference, window, bias), rate=None)
    delay = _delay(iso, doubt) if doubt and one.sensor is Sensor.COMPASS and doubt.third.side is not True else None
    if delay is not None:
        return iso.trusting(Sensor.COMPASS).sure_of(Sensor.COMPASS), Remedy(delay=delay)
    sustained = doubt is not None and not doubt.no_bias and abs(doubt.offset) > SUSTAINED * abs(off)
    if one.sensor is Sensor.COMPASS and doubt and window.gyro and sustained:
        # no single wrong match: a gyro's bias steps more often than a camera is misled for so long
        iso, remedy = _follow(iso, doubt, window)
        swapped = doubt.third.swapped()
        iso = iso.doubting(
            Doubt(Sensor.GYRO, doubt.since_ns, -doubt.offset, bias, swapped, window.t_ns, -off / window.seconds)
        )
        return iso, Remedy.of((remedy, _rebias(window.gyro, claim, window, bias)))
    return iso, Remedy()


def _as_it_was(iso: Isolation, doubt: Doubt, window: Window, bias: float) -> Judged:
    """Follow a gyro again with the bias that it had: the one it was given does not explain what it says now, either."""
    iso = iso.sure_of(Sensor.GYRO).trusting(Sensor.GYRO)
    gyro, compass = window.gyro, window.compass
    if gyro is None or compass is None:
        return iso, Remedy()
    before = replace(gyro, turn=doubt.turn(gyro, window.seconds, bias))
    off = compass.turn - before.turn
    if contradict(before, compass, window.seconds):
        iso = iso.excluding(Sensor.COMPASS, window, before.turn, off)
    iso = iso.doubting(
        Doubt(
            Sensor.COMPASS,
            doubt.since_ns,
            -doubt.offset,
            third=doubt.third.swapped(),
            until_ns=window.t_ns,
            rate=off / window.seconds,
            no_bias=True,
        )
    )
    rebias = Remedy(bias=doubt.bias, bias_sigma=gyro.noise / window.seconds, rate=before.turn / window.seconds)
    return iso, Remedy.of((Remedy(doubt.offset, before.sigma**2), rebias))


def _delay(iso: Isolation, doubt: Doubt) -> float | None:
    """How much later the images are stamped than thought, s, if that explains all that they contradict the gyro by."""
    windows = [one for one in iso.evidence if one.t_ns > doubt.since_ns]
    off = [one.compass.turn - one.gyro.turn for one in windows if one.compass and one.gyro]
    change = [one.rate_change for one in windows if one.compass and one.gyro]
    by_change = sum(a * b for a, b in zip(off, change, strict=True))
    squares, total = sum(b * b for b in change), sum(a * a for a in off)
    if len(off) < 2 or squares == 0.0 or by_change**2 < TIMED * squares * total:
        return None
    delay = -by_change / squares
    return delay if abs(delay) < LATEST else None


def _rebias(gyro: Claim, reference: Claim, window: Window, bias: float) -> Remedy:
    """The bias that the gyro would have, were that all that is wrong with it; one that is late shows none."""
    sigma = math.hypot(gyro.noise, reference.sigma) / window.seconds
    off = (gyro.turn - reference.turn) / window.seconds
    if abs(bias + off) > MOST_BIAS or abs(window.rate_change) > CHANGED:
        return Remedy(rate=reference.turn / window.seconds)
    return Remedy(bias=bias + off, bias_sigma=sigma, rate=reference.turn / window.seconds)


def _trust_again(iso: Isolation, sensor: Sensor) -> Judged:
    """End an exclusion. A gyro's bias may be another now: its doubt goes on until somebody can tell."""
    doubt = iso.doubt(sensor)
    iso = iso.trusting(sensor)
    if doubt is None or sensor is Sensor.GYRO:
        return iso, Remedy()
    return iso.sure_of(sensor), Remedy(fold=doubt.variance(doubt.until_ns or 0))


def _judge_trusted(iso: Isolation, window: Window, bias: float) -> Judged:
    """Find new contradictions."""
    gyro, tracks, compass = (iso.trusted(sensor, window) for sensor in (Sensor.GYRO, Sensor.TRACKS, Sensor.COMPASS))
    if gyro and compass and contradict(gyro, compass, window.seconds):
        return _gyro_against_compass(iso.noting(window), gyro, compass, window, bias)
    if gyro and window.gyro_beyond and (compass or tracks):
        return _beyond(iso.noting(window), gyro, window, bias)
    leader = compass or gyro
    if leader and tracks and contradict(leader, tracks, window.seconds):
        return _tracks_against(iso.noting(window), leader, tracks, window, bias)
    return iso, Remedy()


def _beyond(iso: Isolation, gyro: Claim, window: Window, bias: float) -> Judged:
    """Exclude a gyro that turns as no robot does. The camera is vague then: its stamps count at such a rate."""
    others = {one: claim for one in (Sensor.COMPASS, Sensor.TRACKS) if (claim := iso.trusted(one, window))}
    if not others:
        return iso, Remedy()
    sensor = min(others, key=lambda one: others[one].sigma)
    other, follow = others[sensor], iso.following(sensor, window)
    iso = iso.excluding(Sensor.GYRO, window, other.turn, gyro.turn - other.turn)
    return iso, Remedy.of((follow, _rebias(gyro, other, window, bias)))


def _gyro_against_compass(iso: Isolation, gyro: Claim, compass: Claim, window: Window, bias: float) -> Judged:
    """Exclude one of the two: whom the tracks contradict, else the compass, but in doubt."""
    off = gyro.turn - compass.turn
    third = Third().plus(window.tracks, gyro.turn, -off)
    side = third.side
    doubt = iso.doubt(Sensor.GYRO)
    if doubt is not None and side is None and not surely_gyro(window, compass.turn):
        return _as_it_was(iso, doubt, window, bias)
    if side is True or (side is None and surely_gyro(window, compass.turn)):
        iso = iso.excluding(Sensor.GYRO, window, compass.turn, off)
        return iso, Remedy.of((iso.following(Sensor.COMPASS, window), _rebias(gyro, compass, window, bias)))
    iso = iso.excluding(Sensor.COMPASS, window, gyro.turn, off)
    if side is None:
        iso = iso.doubting(Doubt(Sensor.COMPASS, window.start_ns, 0.0, third=third).plus(-off, window))
    return iso, iso.following(Sensor.GYRO, window)


def _against_the_turn(iso: Isolation) -> bool:
    """Whether the tracks have claimed next to nothing, or the opposite, of several turns."""
    turns = [(other.turn, window.tracks.turn) for window in iso.evidence if (other := window.compass) and window.tracks]
    turns = [(x, y) for x, y in turns if abs(x) > TURNED]
    return len(turns) >= SLIPPED_ON and sum(x * y for x, y in turns) < STUCK * sum(x * x for x, _ in turns)


def _tracks_against(iso: Isolation, leader: Claim, tracks: Claim, window: Window, bias: float) -> Judged:
    """The tracks slip, or err for good, or the only other sensor errs.

    Slip that two others see is for the filter's gate. Tracks that turn the other way, or not at all, are excluded.
    """
    gyro, compass = iso.trusted(Sensor.GYRO, window), iso.trusted(Sensor.COMPASS, window)
    off = tracks.turn - leader.turn
    hangs = gyro and window.gyro_repeats and not compass  # it turns by one number while tracks that may be sound stand
    if (not window.tracks_spoke and not hangs) or (gyro and compass):
        broken = not window.tracks_spoke or _against_the_turn(iso)
        return (iso.excluding(Sensor.TRACKS, window, leader.turn, off) if broken else iso), Remedy()
    if gyro and surely_gyro(window, tracks.turn):
        iso = iso.excluding(Sensor.GYRO, window, tracks.turn, -off)
        return iso, Remedy.of((iso.following(Sensor.TRACKS, window), _rebias(gyro, tracks, window, bias)))
    doubt = iso.doubt(Sensor.TRACKS) or Doubt(Sensor.TRACKS, window.start_ns, 0.0)
    remedy = iso.following(Sensor.COMPASS, window) if compass else Remedy()
    return iso.doubting(doubt.plus(off, window)), remedy
