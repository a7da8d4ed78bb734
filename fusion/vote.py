"""Two sensors outvote a third that is broken.

Sample by sample the gyro is by far the most precise, so the filter would believe it against all others; and a compass
that is steadily misled would in time be believed against a sound gyro. Over windows of half a second the three are
compared as turns: where gyro and compass contradict each other grossly, the tracks decide, and the loser is not
listened to until the two agree again. A gyro that repeats one and the same number loses to the compass alone.
"""

from __future__ import annotations

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
    """Turn (rad) by a rate integrated from the window's start; whether all its samples were the same number."""

    t_ns: int
    rate: float
    turn: float = 0.0
    repeats: int = 0
    frozen: bool = True

    def add(self, t_ns: int, rate: float) -> Integral:
        """With one more sample."""
        turn = self.turn + 0.5 * (self.rate + rate) * (t_ns - self.t_ns) * 1e-9
        return Integral(t_ns, rate, turn, self.repeats + 1, self.frozen and rate == self.rate)

    def turn_until(self, t_ns: int) -> float:
        """Turn up to a time after its last sample, whose rate is held."""
        return self.turn + self.rate * (t_ns - self.t_ns) * 1e-9

    def anew(self, t_ns: int) -> Integral:
        """From `t_ns` on."""
        return Integral(t_ns, self.rate)


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
    """

    gyro: Integral | None = None
    tracks: Integral | None = None
    compass: CompassTurn | None = None
    distrusted: Sensor | None = None
    contradiction: float = 0.0
    windows: int = 0
    agreed: int = 0
    strikes: int = 0

    def with_gyro(self, sample: GyroSample) -> Vote:
        """After a gyro sample."""
        t_ns, rate = sample.t_ns, sample.yaw_rate
        return replace(self, gyro=self.gyro.add(t_ns, rate) if self.gyro else Integral(t_ns, rate))

    def with_tracks(self, sample: OdometrySample) -> Vote:
        """After an odometry sample."""
        t_ns, rate = sample.t_ns, sample.yaw_rate
        return replace(self, tracks=self.tracks.add(t_ns, rate) if self.tracks else Integral(t_ns, rate))

    def with_increment(self, increment: YawIncrement, bias: float, scale: float) -> Vote:
        """After a yaw increment; at the end of a window judge, gyro bias (rad/s) and track scale as known."""
        compass = self.compass.add(increment) if self.compass else CompassTurn.begin(increment)
        length_ns = compass.t_ns - compass.start_ns
        if length_ns < WINDOW_NS:
            return replace(self, compass=compass)
        vote = self._judge(compass, bias, scale) if length_ns <= LONGEST_WINDOW_NS else self
        gyro, tracks = (integral.anew(compass.t_ns) if integral else None for integral in (self.gyro, self.tracks))
        return replace(vote, gyro=gyro, tracks=tracks, compass=CompassTurn.begin(increment))

    def _judge(self, compass: CompassTurn, bias: float, scale: float) -> Vote:
        length_ns = compass.t_ns - compass.start_ns
        seconds = length_ns * 1e-9
        if self.gyro is None or compass.t_ns - self.gyro.t_ns > 0.2 * length_ns:
            return replace(self, distrusted=None, contradiction=0.0, windows=self.windows + 1)
        seen, felt = compass.turn / seconds, self.gyro.turn_until(compass.t_ns) / seconds - bias
        off = felt - seen
        vote = replace(self, contradiction=off, windows=self.windows + 1)
        if abs(off) <= max(GROSS, CLEAR * compass.resolution):
            agreed = self.agreed + 1
            return replace(vote, agreed=agreed, distrusted=self.distrusted if agreed < 2**self.strikes else None)
        loser = self.distrusted
        if self.gyro.frozen and self.gyro.repeats > 10:
            loser = Sensor.GYRO
        elif self.tracks is not None and compass.t_ns - self.tracks.t_ns <= 0.2 * length_ns:
            claimed = self.tracks.turn_until(compass.t_ns) / seconds / scale
            if abs(claimed - seen) < AGREEING * abs(off):
                loser = Sensor.GYRO
            elif abs(claimed - felt) < AGREEING * abs(off):
                loser = Sensor.COMPASS
        lost = loser is not None and self.distrusted is None
        return replace(vote, agreed=0, distrusted=loser, strikes=min(self.strikes + lost, MOST_STRIKES))
