"""The rules for sensors that contradict already: alternatives decided, excluded sensors trusted again."""

from __future__ import annotations

import math

from fusion.buffer.events import Sensor
from fusion.checks.alternative import ALTERNATIVE_PROBABILITY, Alternative
from fusion.checks.contradiction import AGREEMENT_SIGMAS, CONTRADICTION_SIGMAS, contradict
from fusion.checks.exclusion import Exclusion
from fusion.checks.gyro_faults import TURNED, rebias, surely_gyro
from fusion.checks.isolation import Isolation, Judged, Remedy
from fusion.checks.recovery import Recovery
from fusion.checks.stillness import CREEP_RATE
from fusion.checks.windows import Claim, Window
from fusion.record import replace

# Not derived: `TIMED`, `UNTIMED`, `LONGEST_DELAY`, `SUSTAINED`.
TIMED = 0.95  # share of the squared contradictions that a time offset has to explain
UNTIMED = 0.5  # share of the largest contradiction of a window that it may leave of their sum
LONGEST_DELAY = 0.3  # s; by more no camera's delay changes
SUSTAINED = 1.5  # times the last window's contradiction; if their sum is less it may be one wrong match


def with_window(alternative: Alternative, window: Window, bias: float) -> Alternative:
    """An alternative with one more window. Tracks slip now and then: of theirs only what contradicts counts."""
    claim = window.claim(alternative.sensor)
    if window.tracks and not window.tracks.rests:
        alternative = replace(alternative, driven=True)
    if alternative.sensor is Sensor.TRACKS or claim is None:
        return replace(alternative, rate=0.0)
    turn, followed = alternative.turn(claim, window.seconds, bias), window.claim(alternative.against)
    third = alternative.third
    tracks = window.tracks if window.tracks_spoke else None  # whose zeros may be all that they ever say
    if contradict(replace(claim, turn=turn), followed, window.seconds) and followed:  # in others it takes no side
        third = third.plus(tracks, followed, replace(claim, turn=turn))
    return replace(alternative.plus(turn - window.followed, window), third=third)


def settle_alternatives(iso: Isolation, window: Window, bias: float) -> Judged:
    """End alternatives that a third sensor decides, and those of a sensor that is as it was before."""
    remedies = []
    for alternative in iso.alternatives:
        side = iso.side(alternative, window)
        gyro, compass = window.gyro, window.compass
        if alternative.sensor is not Sensor.TRACKS and gyro and compass:
            if contradict(gyro, compass, window.seconds) and surely_gyro(window, compass.turn):
                side = alternative.sensor is Sensor.COMPASS if side is None else side
            elif window.part and side is None:
                side = alternative.sensor is Sensor.GYRO
        if alternative.sensor is Sensor.GYRO and _other_bias_at_rest(alternative, window, bias):
            side = False
        if alternative.by_rest and _turns_at_rest(alternative, window, bias):
            iso = iso.without_alternative(alternative.sensor)
            remedies.append(Remedy(fold=alternative.variance(window.t_ns)))
        elif side is False:  # it erred: the one that is followed is right
            if iso.excludes(alternative.sensor) and alternative.third.side is False:
                iso = iso.with_alternative(replace(alternative, refuted=True))
            else:
                iso = iso.without_alternative(alternative.sensor)
        elif side is True:
            iso, remedy = _follow(iso, alternative, window)
            if window.part and alternative.third.side is None:  # images moved the yaw before, nobody knows how far
                remedy = replace(remedy, fold=alternative.variance(window.t_ns))
            remedies.append(remedy)
        elif alternative.refuted:
            iso = iso.with_alternative(replace(alternative, refuted=not alternative.third.vague))
        elif not iso.excludes(alternative.sensor):
            known, over = _as_before(iso, alternative, window, bias)
            iso = iso.without_alternative(known.sensor) if over else iso.with_alternative(known)
            if over:
                remedies.append(Remedy(fold=known.variance(window.t_ns)))
    return iso, Remedy.of(remedies)


def _other_bias_at_rest(alternative: Alternative, window: Window, bias: float) -> bool:
    """Whether a standing robot shows that a gyro's bias is not any more what it was.

    Tracks have to say that it stands: to images that do not turn with the robot, one that turns evenly does, too.
    """
    noise = CONTRADICTION_SIGMAS * window.bias_sigma
    if not (window.stood and window.tracks and alternative.driven):
        return False
    return abs(alternative.bias - bias) > max(noise, CREEP_RATE)


def _turns_at_rest(alternative: Alternative, window: Window, bias: float) -> bool:
    """Whether tracks rest while gyro and images turn, whatever the gyro's bias: then their rest says nothing."""
    gyro, tracks, seconds = window.gyro, window.tracks, window.seconds
    if gyro is None or window.compass is None or tracks is None or not tracks.rests:
        return False
    turn = alternative.turn(gyro, seconds, bias)
    return contradict(replace(gyro, turn=turn), tracks, seconds) and not contradict(gyro, window.compass, seconds)


def _follow(iso: Isolation, alternative: Alternative, window: Window) -> Judged:
    """Trust the alternative's sensor from now on, and exclude the one that was followed instead of it."""
    iso = iso.without_alternative(alternative.sensor).trusting(alternative.sensor)
    claim, wrong = window.claim(alternative.sensor), window.claim(alternative.against)
    if claim and wrong:
        iso = iso.excluding(alternative.against, window, claim.turn, wrong.turn - claim.turn)
    restored = alternative.bias if alternative.sensor is Sensor.GYRO else None
    rate = claim.turn / window.seconds if claim and alternative.against is Sensor.GYRO else None
    return iso, Remedy(alternative.offset, claim.sigma**2 if claim else 0.0, restored, rate=rate)


def _as_before(iso: Isolation, alternative: Alternative, window: Window, bias: float) -> tuple[Alternative, bool]:
    """With what a window says of the alternative's sensor, and whether it is as before the contradiction again."""
    claim, seconds = window.claim(alternative.sensor), window.seconds
    reference = iso.reference(alternative.sensor, window)
    if claim is None or reference is None:
        return alternative, False
    off, now = alternative.turn(claim, seconds, bias) - reference.turn, claim.turn - reference.turn
    if alternative.sensor is Sensor.TRACKS:
        turn = abs(reference.turn)  # so much that tracks that turn otherwise, or not at all, would not be as near
        return alternative, turn > max(TURNED, 2.0 * claim.sigma) and abs(off) < 0.5 * turn
    variance = claim.sigma**2 + reference.sigma**2
    erred_for = max((window.t_ns - alternative.since_ns) * 1e-9, seconds)
    recovery = alternative.recovery or Recovery.begun(alternative.offset / erred_for)
    recovery = recovery.weighed(math.copysign(1.0, alternative.offset) * off, variance, seconds)
    agrees = abs(off) <= min(AGREEMENT_SIGMAS * math.sqrt(variance), abs(now))
    return replace(alternative, recovery=recovery), recovery.well and agrees


def judge_excluded(iso: Isolation, window: Window, bias: float) -> Judged:
    """Trust excluded sensors again that show they are well; give a gyro that does not another bias."""
    remedies = []
    for one in iso.exclusions:
        if one.silent and window.tracks_spoke:
            iso = iso.trusting(one.sensor)
            continue
        claim, reference = window.claim(one.sensor), iso.reference(one.sensor, window)
        if claim is None or reference is None or (one.sensor is Sensor.GYRO and window.gyro_hangs):
            continue  # one number is right now and then
        if contradict(claim, reference, window.seconds):
            iso, remedy = _errs_still(iso.noting(window), one, claim, reference, window, bias)
            remedies.append(remedy)
        else:
            weighed = one.weighed(claim, reference, window)
            iso = iso.with_exclusion(weighed)
            if weighed.over >= iso.needed(one.sensor):
                iso, remedy = _trust_again(iso, one.sensor)
                remedies.append(remedy)
    return iso, Remedy.of(remedies)


def _errs_still(iso: Isolation, one: Exclusion, claim: Claim, reference: Claim, window: Window, bias: float) -> Judged:
    """An excluded sensor contradicts in one more window."""
    off, alternative = claim.turn - reference.turn, iso.alternative(one.sensor)
    iso = iso.with_exclusion(one.again(reference.turn, off, window))
    if one.sensor is Sensor.GYRO:
        if alternative and alternative.third.side is None and not surely_gyro(window, reference.turn):
            return as_it_was(iso, alternative, window, bias)
        return iso, replace(rebias(claim, reference, window, bias), rate=None)
    claimed = iso.hypothesis(one.sensor)  # a delay may also be what a third sensor has refuted
    if claimed and one.sensor is Sensor.COMPASS and claimed.third.side is not True:
        delayed = _delay(iso, claimed)
        if delayed is not None and _one_sided(iso, claimed):
            return iso, Remedy()  # one bias of the gyro explains as much, until the turn rate changes otherwise
        if delayed is not None:
            return iso.trusting(Sensor.COMPASS).without_alternative(Sensor.COMPASS), delayed
    sustained = alternative is not None and not alternative.no_bias and abs(alternative.offset) > SUSTAINED * abs(off)
    if one.sensor is Sensor.COMPASS and alternative and window.gyro and sustained:
        # no single wrong match: a gyro's bias steps more often than a camera is misled for so long
        iso, remedy = _follow(iso, alternative, window)
        iso = iso.with_alternative(alternative.reversed(bias, window))
        return iso, Remedy.of((remedy, rebias(window.gyro, claim, window, bias)))
    return iso, Remedy()


def as_it_was(iso: Isolation, alternative: Alternative, window: Window, bias: float) -> Judged:
    """Follow a gyro again with the bias that it had: the one it was given does not explain what it says now, either."""
    iso = iso.without_alternative(Sensor.GYRO).trusting(Sensor.GYRO)
    gyro, compass = window.gyro, window.compass
    if gyro is None or compass is None:
        return iso, Remedy()
    before = replace(gyro, turn=alternative.turn(gyro, window.seconds, bias))
    off = compass.turn - before.turn
    if contradict(before, compass, window.seconds):
        iso = iso.excluding(Sensor.COMPASS, window, before.turn, off)
    iso = iso.with_alternative(
        Alternative(
            Sensor.COMPASS,
            alternative.since_ns,
            compass.turn - window.followed - alternative.offset,  # in this window the yaw may have followed the gyro
            third=alternative.third.swapped(),
            until_ns=window.t_ns,
            rate=off / window.seconds,
            no_bias=True,
        )
    )
    rebias = Remedy(bias=alternative.bias, bias_sigma=gyro.noise / window.seconds, rate=before.turn / window.seconds)
    return iso, Remedy.of((Remedy(alternative.offset, before.sigma**2), rebias))


def _delay(iso: Isolation, alternative: Alternative) -> Remedy | None:
    """Images are stamped later than thought, if that explains all that they contradict the gyro by.

    Window by window and in all: a bias of the gyro hides in a few windows, but adds up.
    """
    off, change = _contradictions(iso, alternative)
    by_change = sum(a * b for a, b in zip(off, change, strict=True))
    squares, total = sum(b * b for b in change), sum(a * a for a in off)
    if len(off) < 2 or squares == 0.0 or by_change**2 < TIMED * squares * total:
        return None
    delay = -by_change / squares
    left = alternative.offset + delay * alternative.change
    if abs(delay) >= LONGEST_DELAY or abs(left) > UNTIMED * max(map(abs, off)):
        return None
    return Remedy(delay=delay, fold=ALTERNATIVE_PROBABILITY[Sensor.COMPASS] * left**2)


def _contradictions(iso: Isolation, alternative: Alternative) -> tuple[list[float], list[float]]:
    """By how much gyro and compass differ in each window since, rad, and how the turn rate changed in it, rad/s."""
    windows = [one for one in iso.evidence if one.t_ns > alternative.since_ns and one.compass and one.gyro]
    off = [one.compass.turn - one.gyro.turn for one in windows if one.compass and one.gyro]
    return off, [one.rate_change for one in windows]


def _one_sided(iso: Isolation, alternative: Alternative) -> bool:
    """Whether gyro and compass differ alike in all windows since."""
    off, _ = _contradictions(iso, alternative)
    return sum(off) ** 2 > UNTIMED * len(off) * sum(one * one for one in off)


def _trust_again(iso: Isolation, sensor: Sensor) -> Judged:
    """End an exclusion. A gyro's bias may be another now: the alternative stays until a third sensor decides."""
    alternative = iso.alternative(sensor)
    iso = iso.trusting(sensor)
    if alternative is None or sensor is Sensor.GYRO:
        return iso, Remedy()
    return iso.without_alternative(sensor), Remedy(fold=alternative.variance(alternative.until_ns or 0))
