"""The filter's side of fault isolation: windows of turns made and judged, and what follows done to the state."""

from __future__ import annotations

import math

from compass import YawIncrement
from fusion.buffer.events import Sensor
from fusion.checks.alternative import ALTERNATIVE_PROBABILITY, FOUND_AGAIN_PROBABILITY, Alternative
from fusion.checks.claims import gyro_claim, tracks_claim
from fusion.checks.contradiction import contradict
from fusion.checks.diagnosis import warnings_of
from fusion.checks.gate import Verdict
from fusion.checks.isolation import Isolation, Remedy
from fusion.checks.isolation_rules import judge
from fusion.checks.refusal import Refusal
from fusion.checks.silence import RATE_SILENT_NS
from fusion.checks.windows import BEYOND, LONGEST_WINDOW_NS, SAME_NUMBER, WINDOW_NS, Claim, Start, Window
from fusion.config import FusionConfig
from fusion.record import replace
from fusion.state.ekf import Measurement, State
from fusion.state.filter_state import FilterState
from fusion.state.gyro_trail import Exposure, GyroTrail
from fusion.updates.image_timing import exposure_of

JUMPED_BIAS = 0.01  # rad/s; one that has jumped is no longer as its driver had calibrated it; not derived


class FaultIsolation:
    """Compares what the sensors say of the same turn, and repairs the state of a filter where they contradict.

    Parameters
    ----------
    config : FusionConfig
        Of all models.
    """

    def __init__(self, config: FusionConfig) -> None:
        self._config = config

    def take_turn(self, state: FilterState, increment: YawIncrement, slot: int | None, until: Exposure) -> int | None:
        """Compare an increment `until` an image with what the others say of that turn; returns as `compare`."""
        ekf = state.ekf
        clone = state.clones[slot] if slot is not None else None
        since = clone.exposure if clone else until
        timing = ekf.jitter * float(ekf.x[State.RATE]) ** 2
        timing += float(ekf.P[State.CAMERA_DELAY, State.CAMERA_DELAY]) * (until.rate - since.rate) ** 2
        # what it saw between the stamps, as the others did
        lag = until.turn - since.turn - since.rate * (until.delay - since.delay)
        witness = replace(increment, yaw=increment.yaw + lag, variance=increment.variance + timing)
        state.turns = state.turns.with_increment(witness)
        return self.compare(state, witness) if state.turns.ends_at_image() else None

    def compare(self, state: FilterState, increment: YawIncrement | None) -> int | None:
        """End a window: judge what the sensors say of it, and do what follows.

        Returns since when the yaws before were wrong, ns, where the yaw was moved; else None.
        """
        ekf, turns, t_ns, wrong_ns = state.ekf, state.turns, state.t_ns or 0, None
        start_ns = turns.start_ns if turns.start_ns is not None else t_ns
        joined = increment is None or (turns.compass is not None and turns.compass.start_ns == start_ns)
        if joined and 0 < t_ns - start_ns <= LONGEST_WINDOW_NS:
            window, bias = self._window(state, start_ns, increment), turns.start.bias
            self._note_source(state)
            if state.isolation.contradicting.isdisjoint((Sensor.GYRO, Sensor.COMPASS)) and not contradict(
                window.gyro, window.compass, window.seconds
            ):
                state.bias_walk = state.bias_walk.after(window, turns.start)
            before, believed = state.isolation, state.believes(Sensor.GYRO)
            state.isolation, remedy = judge(before, window, bias)
            if believed and state.isolation.excludes(Sensor.GYRO):
                _doubt_of_before(state, before)
            alternative = state.isolation.alternative(Sensor.COMPASS)
            if state.refusal and alternative and not before.alternative(Sensor.COMPASS):
                # images from references of before claim all that was refused, not what this window adds to it
                claimed = max(alternative.offset, state.refusal.last - remedy.shift, key=abs)
                state.isolation = state.isolation.with_alternative(replace(alternative, offset=claimed))
            _doubt_since_rest(state, window, before.contradicting)
            if self._apply(state, remedy, window):
                wrong_ns = min(remedy.since_ns, start_ns - WINDOW_NS)
            if state.isolation.gyro_shown_right:
                state.agreed_scale = turns.start.scale, turns.start.scale_sigma
            state.unwatched, doubt = state.unwatched.judged(state.isolation, window, turns.start.yaw)
            ekf.widen(State.YAW, doubt)
            state.warnings = warnings_of(state.isolation)
            if state.isolation.excludes(Sensor.GYRO):
                state.trail = GyroTrail()
            if state.isolation.excludes(Sensor.COMPASS):
                state.refusal = None
                if not before.excludes(Sensor.COMPASS):  # it was learnt from images that may have erred for long
                    ekf.renew(State.GYRO_SCALE, state.gyro_scale_sigma**2)
        state.turns = state.turns.anew(t_ns, _start(state), increment)
        return wrong_ns

    def _note_source(self, state: FilterState) -> None:
        """Leave out an odometry that turns by the gyro, as long as that speaks, and what was learnt as they agreed."""
        gyro, one_source = state.turns.gyro, state.common_source.one
        if gyro is None or (state.t_ns or 0) - gyro.t_ns > RATE_SILENT_NS:
            one_source = False
        if one_source is state.isolation.one_source:
            return
        state.isolation = state.isolation.with_one_source(one_source)
        if one_source:
            state.agreement = None
            if not state.hears(Sensor.COMPASS):
                sigma = self._config.initial_bias_sigma
                state.ekf.renew(State.BIAS, max(sigma**2, float(state.P[State.BIAS, State.BIAS])))
                state.ekf.widen(State.YAW, (sigma * state.common_source.seconds) ** 2)

    def _apply(self, state: FilterState, remedy: Remedy, window: Window) -> bool:
        """Do what has to be done after a window; whether the yaw was moved."""
        ekf, config = state.ekf, self._config
        late, variance = _lateness(state, remedy, window)
        if remedy.bias is not None:
            ekf.renew(State.BIAS, min(remedy.bias_sigma, JUMPED_BIAS) ** 2, remedy.bias)
            if math.isfinite(remedy.bias_sigma):  # else it may as well be the scale that is another
                ekf.renew(State.GYRO_SCALE, state.gyro_scale_sigma**2)  # it was learnt with that bias
            state.agreement = None
        if remedy.rate is not None:
            ekf.renew(State.RATE, config.initial_rate_sigma**2, remedy.rate)
            ekf.renew(State.ACCELERATION, config.rate_walk**2 / (2.0 * config.rate_ramp))
        elif remedy.shift:
            ekf.place_yaw()
        if remedy.fold > 0.0:
            ekf.widen_frame(remedy.fold)
        if remedy.shift == remedy.delay == 0.0:
            return False
        x = ekf.x.copy()
        x[State.YAW] += remedy.shift
        x[State.CAMERA_DELAY] += remedy.delay
        ekf.x = x
        ekf.widen(State.CAMERA_DELAY, remedy.delay**2)
        known = state.turns.earlier
        ekf.x[State.YAW] -= late
        ekf.widen(State.YAW, remedy.shift_variance + variance)
        if remedy.shift:  # what was learnt meanwhile of the others was learnt from what is taken back
            agreed = state.unconfirmed.since if state.unconfirmed else None
            scale = agreed if agreed and agreed.t_ns < remedy.since_ns else known
            ekf.renew(State.SCALE, scale.scale_sigma**2, scale.scale)
            ekf.renew(State.CAMERA_DELAY, known.delay_sigma**2, known.delay)
            if remedy.bias is None:
                ekf.renew(State.BIAS, known.bias_sigma**2, known.bias)
            state.tracks = None  # nor do the tracks count from a yaw of that time
        # nor is the yaw to be held at what it seemed to be meanwhile
        state.stillness = replace(state.stillness, reference_ns=None)
        state.refusal = None
        return True

    def _window(self, state: FilterState, start_ns: int, increment: YawIncrement | None) -> Window:
        """What each sensor says of the window that ends now, calibrated as known at its beginning."""
        x, turns, t_ns = state.ekf.x, state.turns, state.t_ns or 0
        compass = turns.compass
        seen = None
        if compass and compass.t_ns == t_ns:
            seen = Claim(compass.turn, math.sqrt(compass.turn_variance), begin=compass.first, end=compass.last)
        gyro = gyro_claim(turns, start_ns, t_ns, self._config, state.gyro_noise.factor.variance)
        repeats = turns.gyro is not None and turns.gyro.repeats >= max(turns.gyro.count, SAME_NUMBER)
        return Window(
            start_ns,
            t_ns,
            gyro,
            self._tracks_claim(state, start_ns, beside_two=seen is not None and gyro is not None),
            seen,
            float(x[State.YAW]) - turns.start.yaw,
            repeats,
            state.odometry_fields.pose or state.odometry_fields.twist,
            float(x[State.RATE]) - turns.start.rate,
            turns.gyro is not None and BEYOND * turns.gyro.beyond >= max(turns.gyro.count, BEYOND),
            turns.corrected,
            turns.start.bias_sigma,
            turns.start.standing and state.stillness.standing,
            increment is not None and increment.factor_sigma > 0.0,
            gyro_hangs=repeats and state.gyro_noise.stuck,
            earlier_corrected=turns.earlier_corrected,
        )

    def note_refusal(
        self, state: FilterState, increment: YawIncrement, measurement: Measurement, verdict: Verdict
    ) -> None:
        """Remember what the gate refuses, until an increment over the same time says that it was wrong."""
        refusal = state.refusal
        if verdict is Verdict.REJECTED:
            state.refusal = Refusal.of(increment, measurement.innovation, refusal)
            return
        slipped = state.isolation.alternative(Sensor.TRACKS)
        if slipped is not None and increment.t_ref_ns <= slipped.since_ns and state.hears(Sensor.GYRO):
            state.isolation = state.isolation.without_alternative(
                Sensor.TRACKS
            )  # gyro and compass saw the same all the while
        if refusal is not None:
            if increment.t_ref_ns > refusal.t_ref_ns and not self._tracks_refute(state, refusal.last):
                state.ekf.widen_frame(refusal.variance)
            state.refusal = None

    def recover(self, state: FilterState, measurement: Measurement, since: int, until: int, *, witnessed: bool) -> None:
        """Let increments in again that were refused; `witnessed`: a gyro measured all of the turn.

        A contradiction that grew is one of rates: the increments are followed, and the gyro's claim is the alternative.
        One that came at once is a wrong match: the yaw stays, and may be wrong by it. Where no gyro saw the turn, only
        tracks contradict, and those slip and get lifted: a match that repeats is followed.
        """
        ekf, refusal, off = state.ekf, state.refusal, measurement.innovation
        state.refusal = None
        if not witnessed or (refusal is not None and refusal.grew(off)):
            x = ekf.x.copy()
            x[State.YAW] += off
            x[until] += off
            ekf.x = x
            measurement = replace(measurement, innovation=0.0)
            slipped = state.isolation.alternative(Sensor.TRACKS)
            if witnessed and refusal is not None:
                self._add_gyro_alternative(state, refusal.t_ref_ns, -off)
            elif slipped is not None:  # they contradict in rates, too: all of it is what they claim
                state.isolation = state.isolation.with_alternative(slipped.apart(-off))
            else:
                ekf.widen_frame(FOUND_AGAIN_PROBABILITY * off**2)
        elif not self._tracks_refute(state, off):
            ekf.widen_frame(ALTERNATIVE_PROBABILITY[Sensor.COMPASS] * off**2)
        ekf.anchor(since, measurement)
        ekf.widen(State.BIAS, JUMPED_BIAS**2)
        state.agreement = None

    def _tracks_refute(self, state: FilterState, off: float) -> bool:
        """Whether tracks show that images erred by `off`, rad, and not the gyro, which is followed."""
        known = state.unconfirmed
        independent = state.common_source.one is False
        if known is None or not (independent and state.believes(Sensor.GYRO) and state.believes(Sensor.TRACKS)):
            return False
        start_ns = state.turns.start_ns
        claim = self._tracks_claim(state, start_ns) if start_ns is not None else None
        return known.refutes(off, claim.noise**2 if claim else 0.0, state.belief)

    def _tracks_claim(self, state: FilterState, start_ns: int, *, beside_two: bool = False) -> Claim | None:
        """What the tracks say of the window that began then.

        Their scale factor is learnt of whoever is believed. `beside_two` they are asked who of gyro and images errs:
        then only that counts which was learnt as these agreed.
        """
        slip, turns = (state.slip_turn.variance, state.slip_speed.variance), state.turns
        if beside_two:
            scale, sigma = state.agreed_scale or (self._config.initial_scale, self._config.initial_scale_sigma)
            sigma = max(sigma, turns.start.scale_sigma)
            turns = replace(turns, start=replace(turns.start, scale=scale, scale_sigma=sigma))
        return tracks_claim(turns, start_ns, state.t_ns or 0, self._config, *slip)

    def _add_gyro_alternative(self, state: FilterState, since_ns: int, offset: float) -> None:
        """Keep the alternative that the gyro's bias is as before."""
        alternative = state.isolation.alternative(Sensor.GYRO)
        if alternative is None:
            alternative = Alternative(Sensor.GYRO, since_ns, 0.0, bias=float(state.ekf.x[State.BIAS]))
        state.isolation = state.isolation.with_alternative(alternative.apart(offset))


def _lateness(state: FilterState, remedy: Remedy, window: Window) -> tuple[float, float]:
    """What a gyro that was wrong has made of the turn from the last image's exposure to its stamp, rad, and rad^2.

    The compass is followed instead, with a claim that holds this turn, less that of the image at the beginning, as the
    gyro told them, and with a delay that was learnt from it.
    """
    turns, compass, turned = state.turns, window.compass, state.isolation.turned
    known = turns.start if remedy.since_ns == window.start_ns else turns.earlier
    if compass is None or Sensor.GYRO not in state.isolation.contradicting:
        off = 0.0 if remedy.bias is None else remedy.bias - turns.start.bias
        return 0.0, ((abs(known.delay) + known.delay_sigma) * off) ** 2
    told, rate = exposure_of(state), compass.turn / window.seconds
    before = turned[-2].rate_of(Sensor.COMPASS) if len(turned) > 1 else None
    change = rate if before is None else rate - before
    gained = rate - known.lag_rate
    late = told.turn - known.lag - known.lag_rate * (told.delay - known.delay) - gained * known.delay
    return late, (known.delay_sigma * gained) ** 2 + (known.delay * change) ** 2


def _doubt_since_rest(state: FilterState, window: Window, known: frozenset[Sensor]) -> None:
    """A gyro that turns while tracks rest may have had another bias at any time since the robot last stood."""
    gyro, tracks, rested_ns = window.gyro, window.tracks, state.rested_ns
    if window.compass or not (gyro and tracks and tracks.rests) or rested_ns is None:
        return
    if state.isolation.contradicting - known:
        off, seconds = (gyro.turn - tracks.turn) / window.seconds, max(window.start_ns - rested_ns, 0) * 1e-9
        state.ekf.widen(State.YAW, (off * seconds) ** 2 / 3.0)


def _doubt_of_before(state: FilterState, before: Isolation) -> None:
    """Keep what the yaw owes to a gyro that is found to err, but for what is taken back of it.

    Taken back are two windows, or the first alone, or all that an excluded compass claimed.
    """
    known, turns, last = state.unconfirmed, state.turns, before.last
    back_ns, doubt = turns.start_ns or 0, turns.start.doubt
    if last is not None and last.t_ns == turns.start_ns:
        back_ns, doubt = last.start_ns, turns.earlier.doubt
    claimed = before.alternative(Sensor.COMPASS)
    if claimed is not None and state.isolation.alternative(Sensor.COMPASS) is None:
        back_ns, doubt = min(claimed.since_ns, back_ns), state.unconfirmed_variance()
    if known is not None:  # an increment from a view of before may know better
        state.ekf.widen(State.YAW, doubt if known.since.t_ns < back_ns else known.left)
        state.unconfirmed = replace(known, left=0.0)


def _start(state: FilterState) -> Start:
    """What is believed now, as a window begins."""
    ekf = state.ekf
    known: list[float] = []
    for one in (State.BIAS, State.GYRO_SCALE, State.SCALE, State.CAMERA_DELAY):
        known += float(ekf.x[one]), math.sqrt(float(ekf.P[one, one]))
    image = exposure_of(state)
    return Start(
        float(ekf.x[State.YAW]),
        float(ekf.x[State.RATE]),
        *known,
        lag=image.turn,
        lag_rate=image.rate,
        doubt=state.unconfirmed_variance(),
        standing=state.stillness.standing,
    )
