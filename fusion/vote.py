"""Two sensors outvote a third that is broken.

Sample by sample the gyro is by far the most precise, so the filter would believe it against all others; and a compass
that is steadily misled would in time be believed against a sound gyro. Over windows of half a second the three are
compared as turns: where gyro and compass contradict each other grossly, the tracks decide, and the loser is not
listened to until the two agree again. A gyro that repeats one and the same number loses to the compass alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from compass import YawIncrement
from fusion.events import Sensor
from fusion.samples import GyroSample, OdometrySample
from fusion.standstill import CompassTurn

WINDOW_NS = 500_000_000
LONGEST_WINDOW_NS = 2_000_000_000  # a compass that was silent for longer is no witness of what happened meanwhile
GROSS = 0.02  # rad/s; smaller contradictions are for the filter to settle
CLEAR = 5.0  # standard deviations of the compass
MOST_STRIKES = 6
AGREEING = 0.4  # of the contradiction; tracks this close to one take its side


@dataclass(frozen=True, slots=True)
class Integral:
    """Turn (rad) by a rate integrated since `start_ns`; whether all its samples were the same number."""

    start_ns: int
    t_ns: int
    start_rate: float
    rate: float
    turn: float = 0.0
    repeats: int = 0
    frozen: bool = True

    def add(self, t_ns: int, rate: float) -> Integral:
        """With one more sample."""
        turn = self.turn + 0.5 * (self.rate + rate) * (t_ns - self.t_ns) * 1e-9
        frozen = self.frozen and rate == self.rate
        return Integral(self.start_ns, t_ns, self.start_rate, rate, turn, self.repeats + 1, frozen)

    def spans(self, window: CompassTurn) -> bool:
        """Whether there were samples from the beginning of a window to its end."""
        slack_ns = (window.t_ns - window.start_ns) // 5
        return self.start_ns <= window.start_ns and window.t_ns - self.t_ns <= slack_ns

    def turn_until(self, t_ns: int) -> float:
        """Turn up to a time after its last sample, whose rate is held."""
        return self.turn + self.rate * (t_ns - self.t_ns) * 1e-9

    def turn_exposed(self, t_ns: int, delay: float) -> float:
        """The same between the exposures of two images that were stamped `delay` seconds later."""
        return self.turn_until(t_ns) - delay * (self.rate - self.start_rate)

    def anew(self, t_ns: int) -> Integral:
        """From `t_ns` on."""
        return Integral(t_ns, t_ns, self.rate, self.rate)


@dataclass(frozen=True, slots=True)
class Vote:
    """What the three say of the present window, and the verdict from the last one.

    Attributes
    ----------
    gyro, tracks : Integral or None
        Claimed turns; bias and scale not taken out.
    compass : CompassTurn or None
        None before the first increment.
    distrusted : Sensor or None
        Who is outvoted.
    contradiction : float
        Mean rate by which gyro and compass differed in the last window, rad/s.
    windows : int
        How many were judged.
    agreed : int
        How many in a row up to the last were without contradiction.
    strikes : int
        How often trust was lost; it takes ``2**strikes`` agreeing windows to win it back.
    opposed : bool
        Whether tracks and gyro contradicted the compass in the last window.
    """

    gyro: Integral | None = None
    tracks: Integral | None = None
    compass: CompassTurn | None = None
    distrusted: Sensor | None = None
    contradiction: float = 0.0
    windows: int = 0
    agreed: int = 0
    strikes: int = 0
    opposed: bool = False

    def with_gyro(self, sample: GyroSample) -> Vote:
        """After a gyro sample."""
        t_ns, rate = sample.t_ns, sample.yaw_rate
        return replace(self, gyro=self.gyro.add(t_ns, rate) if self.gyro else Integral(t_ns, t_ns, rate, rate))

    def with_tracks(self, sample: OdometrySample) -> Vote:
        """After an odometry sample."""
        t_ns, rate = sample.t_ns, sample.yaw_rate
        return replace(self, tracks=self.tracks.add(t_ns, rate) if self.tracks else Integral(t_ns, t_ns, rate, rate))

    def with_increment(
        self, increment: YawIncrement, bias: float, bias_sigma: float, scale: float, delay: float
    ) -> Vote:
        """After a yaw increment; at the end of a window judge.

        Parameters
        ----------
        increment : YawIncrement
            Of the turn between the stamps, so far as the gyro is right.
        bias, bias_sigma, scale, delay : float
            Gyro bias (rad/s) and its deviation, track scale and camera delay (s) as known.
        """
        compass = self.compass.add(increment) if self.compass else CompassTurn.begin(increment)
        length_ns = compass.t_ns - compass.start_ns
        if 0 < length_ns < WINDOW_NS:
            return replace(self, compass=compass)
        judged = WINDOW_NS <= length_ns <= LONGEST_WINDOW_NS
        vote = self._judge(compass, bias, bias_sigma, scale, delay) if judged else self
        gyro, tracks = (integral.anew(compass.t_ns) if integral else None for integral in (self.gyro, self.tracks))
        return replace(vote, gyro=gyro, tracks=tracks, compass=CompassTurn.begin(increment))

    def _judge(self, compass: CompassTurn, bias: float, bias_sigma: float, scale: float, delay: float) -> Vote:
        """Compare the turns of a window that is over."""
        seconds = (compass.t_ns - compass.start_ns) * 1e-9
        if self.gyro is None or not self.gyro.spans(compass):
            return replace(self, distrusted=None, contradiction=0.0, windows=self.windows + 1)
        seen, felt = compass.turn / seconds, self.gyro.turn_until(compass.t_ns) / seconds - bias
        off = felt - seen
        vote = replace(self, contradiction=off, windows=self.windows + 1, opposed=False)
        if abs(off) <= max(GROSS, CLEAR * compass.resolution, 3.0 * bias_sigma):
            agreed = self.agreed + 1
            return replace(vote, agreed=agreed, distrusted=self.distrusted if agreed < 2**self.strikes else None)
        loser = self.distrusted
        frozen = self.gyro.frozen and self.gyro.repeats > 10
        claimed = from_compass = math.inf
        if self.tracks is not None and self.tracks.spans(compass):
            claimed = self.tracks.turn_until(compass.t_ns) / seconds / scale
            # a gyro that is wrong may have brought the compass's turn from exposures to stamps, or not
            exposed = self.tracks.turn_exposed(compass.t_ns, delay) / seconds / scale
            from_compass = min(abs(claimed - seen), abs(exposed - seen))
        if abs(claimed - felt) < AGREEING * abs(off):
            # one wrong match is for the gate; a misled compass stays wrong
            loser = Sensor.COMPASS if self.opposed else self.distrusted
            vote = replace(vote, opposed=True)
        elif from_compass < AGREEING * abs(off) or frozen:
            loser = Sensor.GYRO
        lost = loser is not None and self.distrusted is None
        return replace(vote, agreed=0, distrusted=loser, strikes=min(self.strikes + lost, MOST_STRIKES))
