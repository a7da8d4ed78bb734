"""Samples of all sensors in, in any order of arrival; the fused yaw out."""

from __future__ import annotations

import copy
import logging
import math
from collections import Counter
from collections.abc import Mapping
from typing import Any

from compass import YawIncrement
from compass.parameters import config_of
from compass.stamps import whole_ns
from fusion.buffer.events import (
    FOREVER_NS,
    CompassEvent,
    FusionEvent,
    Sample,
    Sensor,
    event_of,
    fault_of,
    heading_of,
    needs_reference,
    reference_of,
    sensor_of,
)
from fusion.buffer.plain import plain
from fusion.buffer.replay import Arrival, Timeline
from fusion.checks.faulty import FaultWatch
from fusion.checks.gaps import GapWatch
from fusion.checks.gate import SensorReport
from fusion.checks.lead import LeadWatch
from fusion.checks.pose_and_twist import PoseAndTwist
from fusion.checks.silence import PERIODS, SilenceWatch
from fusion.checks.spikes import SpikeWatch
from fusion.checks.stamps import ABANDONED_NS, BACKLOG_NS, LONE_NS, ClockWatch, Elsewhen, StampSequence, confirmed
from fusion.checks.warnings import Warning, most_serious_first
from fusion.config import FusionConfig
from fusion.filter import YawFilter
from fusion.record import replace
from fusion.samples import OdometrySample, YawEstimate
from fusion.state.estimate import estimate_of
from fusion.state.filter_state import FilterState

log = logging.getLogger(__name__)
SHORTEST_REACH_NS = 1_000_000_000  # a stamp off by less does no harm that lasts
SHORT_LIFE = 3  # times as far away as samples that confirm each other span: what was before is taken for a wrong stamp
UNKNOWN_TURN = math.pi**2 / 3.0  # rad^2, variance of a heading of which nothing is known
_LATE, _IN_ORDER = ({sensor: f"{sensor.value}: {fared}" for sensor in Sensor} for fared in ("late", "in order"))


class YawFusion:
    """Fuses yaw increments, gyro and track odometry into one yaw.

    Samples may come from any subset of the sensors, late, out of order and twice (see `FusionConfig.lag_window`).
    A sample that cannot be used is refused and counted in `counts`, never an error.

    Attributes
    ----------
    config : FusionConfig
    counts : Counter
        How many samples fared how, by text.
    refusals : dict of Sensor to str
        Why the last refused sample of each sensor was refused.
    """

    def __init__(self, config: FusionConfig | None = None) -> None:
        self.config = config_of(FusionConfig, config)
        self.counts: Counter[str] = Counter()
        self.refusals: dict[Sensor, str] = {}
        self._filter = YawFilter(self.config)
        self._before_jump: dict[str, Any] = {}  # all that was known when stamps last jumped ahead
        self.reset()

    def reset(self) -> None:
        """Forget all samples and start anew from the initial yaw; the counts stay."""
        self._restart(self._filter.start)

    def _restart(self, start: FilterState) -> None:
        """Forget all samples and start anew from a state."""
        lag_ns, reference_ns = (round(s * 1e9) for s in (self.config.lag_window, self.config.reference_window))
        self._lag_ns, self._reference_ns = lag_ns, reference_ns
        self._reach_ns = max(lag_ns, SHORTEST_REACH_NS)
        self._timeline: Timeline[FusionEvent, FilterState] = Timeline(start, self._filter.step, lag_ns + reference_ns)
        self._last_increments: dict[bool, YawIncrement] = {}  # from the keyframe, and over a long baseline
        self._ahead, self._behind = Elsewhen(True, max(lag_ns, LONE_NS)), Elsewhen(False, BACKLOG_NS)
        self._heard: dict[Sensor, int] = {}  # newest stamp of each sensor
        self._first_ns = FOREVER_NS  # of all stamps
        self._gaps: dict[Sensor, int] = {}  # between its last two
        self._sequences = {sensor: StampSequence(sensor) for sensor in (Sensor.GYRO, Sensor.TRACKS)}
        self._image_stamps = StampSequence(Sensor.COMPASS)
        self._clocks, self._silence, self._pauses = ClockWatch(), SilenceWatch(), GapWatch()
        self._faults, self._leads = FaultWatch(), LeadWatch()
        self._spikes = SpikeWatch(by_poses=self.config.odometry == "pose")
        self._fields = PoseAndTwist()
        self._beginning: list[Sample] | None = []  # until it is confirmed

    def add(self, sample: Sample) -> bool:
        """Take a sample at its own time; False if it was refused (why is in `counts`).

        One that is far ahead of all others is not believed before another confirms it; should that happen, it is taken
        in then.

        Raises
        ------
        ArgumentError
            Its stamp is no whole number, as seconds are, or another value is no number.
        """
        sensor = sensor_of(sample)
        sample = plain(sample)
        fault = fault_of(sample)
        self._faults.note(sensor, sample.t_ns, fault)
        if fault:
            return self._refuse(sample, fault)
        newest_ns = self._timeline.newest_ns
        if newest_ns is not None and sample.t_ns < newest_ns - self._lag_ns:
            return self._too_old(sample, newest_ns)
        if newest_ns is not None and self._leads.holds(sample):
            self._refuse(sample, "far ahead of all others")
            if self._leads.opposed:
                self._clocks.mismatch(sensor, sample.t_ns, newest_ns)
            return self._jump_ahead(self._leads.deserted()) and self._catch_up()
        if newest_ns is not None and sample.t_ns > newest_ns + self._reach_of(sensor):
            return self._wait(sample, newest_ns)
        for other in (self._ahead, self._behind):
            if other.since:
                other.opposed(sensor, newest_ns or 0)
        self._clocks.well(sensor)
        taken = self._take(sample)
        if self._ahead.samples:
            self._catch_up()
        return taken

    def _catch_up(self) -> bool:
        """Take samples that were ahead and are so no more; always True."""
        self._take_all(self._ahead.caught_up((self._timeline.newest_ns or 0) + self._reach_ns))
        return True

    def _jump_ahead(self, samples: list[Sample]) -> bool:
        """Take samples that are believed to say that time has jumped, if there are any."""
        if samples:
            self._before_jump = {}
            shared = self.config, self.counts, self.refusals, self._filter
            self._before_jump = copy.deepcopy(self.__dict__, {id(one): one for one in shared})
        return self._take_all(samples)

    def _as_before_jump(self, t_ns: int) -> bool:
        """Take back a jump ahead if a stamp, ns, goes on where stamps were then; whether it did."""
        before = self._before_jump
        left_ns = before["_timeline"].newest_ns if before else None
        if left_ns is None or not left_ns - self._lag_ns <= t_ns <= left_ns + self._reach_ns:
            return False
        log.warning("time is back at %d ns: what was stamped later was stamped wrongly, and is taken back", t_ns)
        self.counts["reset: back from a jump ahead"] += 1
        self.__dict__.update(before)
        return True

    def _take_all(self, samples: list[Sample]) -> bool:
        """Take samples that have waited; whether there were any."""
        for sample in samples:
            self._take(sample)
        return bool(samples)

    def _reach_of(self, sensor: Sensor) -> int:
        """How far ahead of all others a sample is believed, ns; the only sensor there is keeps to its own pace."""
        if len(self._heard) > 1 or (self._heard and sensor not in self._heard):
            return self._reach_ns
        return max(self._reach_ns, PERIODS * self._gaps.get(sensor, 0))

    def flush(self) -> None:
        """Take in what still waits to be confirmed and was never contradicted: no more samples will come."""
        self._take_all(self._leads.deserted(at_end=True))
        if self._ahead.samples and not self._ahead.against:
            self._take_all(self._ahead.leave(ABANDONED_NS))

    def _too_old(self, sample: Sample, newest_ns: int) -> bool:
        """Refuse a sample that is older than the lag window, unless time itself has jumped back."""
        sensor = sensor_of(sample)
        self._refuse(sample, "older than lag_window")
        if newest_ns - sample.t_ns <= self._reach_ns:
            return False  # over so short a way the others catch up by themselves
        self._clocks.mismatch(sensor, sample.t_ns, newest_ns)
        self._behind.add(sample, newest_ns)
        if not self._behind.believed(self._heard, newest_ns, self._reach_ns):
            return False
        group = self._behind.leave(ABANDONED_NS)
        if self._as_before_jump(group[0].t_ns):
            return self._take_all(group)
        log.warning("time jumped back to %d ns: fusion starts anew", sample.t_ns)
        self.counts["reset: time jumped back"] += 1
        wrong = self._began_elsewhen(group, newest_ns)
        self._restart(self._filter.start if wrong else self._filter.lost(self._timeline.state, UNKNOWN_TURN))
        if not wrong:
            self._pauses.jumped(newest_ns, group[0].t_ns)
        return self._take_all(group)

    def _wait(self, sample: Sample, newest_ns: int) -> bool:
        """Let a sample wait that is far ahead; False as long as no other confirms it."""
        sensor = sensor_of(sample)
        self._refuse(sample, "far ahead of all others")
        self._clocks.mismatch(sensor, sample.t_ns, newest_ns)
        self._ahead.add(sample, newest_ns)
        if not self._ahead.believed(self._heard, newest_ns, self._reach_ns):
            return False
        group = self._ahead.leave(ABANDONED_NS)
        if self._began_elsewhen(group, newest_ns):
            self.reset()
        self._clocks = ClockWatch()
        return self._jump_ahead(group)

    def _began_elsewhen(self, group: list[Sample], newest_ns: int) -> bool:
        """Whether all before these samples of another time was a wrong stamp at the very start, or a foreign clock.

        It never was confirmed; or it was one sensor's alone, for no longer than the others were at that other time.
        """
        span_ns = group[-1].t_ns - group[0].t_ns
        if self._beginning is not None and abs(group[0].t_ns - newest_ns) > SHORT_LIFE * span_ns:
            return True
        others = {sensor_of(sample) for sample in group} - self._heard.keys()
        lived_ns = newest_ns - min(self._first_ns, newest_ns)
        return len(self._heard) == 1 and bool(others) and lived_ns <= span_ns + self._reach_ns

    def _take(self, sample: Sample) -> bool:
        """Put a sample whose stamp is believed into the timeline; False if there is one at its place already."""
        sensor = sensor_of(sample)
        if self._beginning is not None:
            self._beginning.append(sample)
            self._beginning = None if confirmed(self._beginning) else self._beginning[:1]
        event = event_of(sample)
        if self._timeline.holds(event):
            return self._refuse(sample, "duplicate")
        if sensor in self._sequences and not self._sequences[sensor].fits(sample.t_ns):
            self._refuse(sample, "its stamp repeats or goes back")
            return self._clocks_set_back(sample)
        if isinstance(sample, YawIncrement) and not sample.long_baseline:
            self._image_stamps.fits(sample.t_ns)  # late ones are used; that a clock was set they show
        references = self._references_of(event.sample) if isinstance(event, CompassEvent) else ()
        arrival = self._timeline.add(event, *references)
        if sample.t_ns > self._heard.get(sensor, sample.t_ns):
            self._gaps[sensor] = sample.t_ns - self._heard[sensor]
        self._heard[sensor] = max(self._heard.get(sensor, 0), sample.t_ns)
        self._first_ns = min(self._first_ns, sample.t_ns)
        self._silence.hear(sensor, sample.t_ns)
        if not isinstance(sample, YawIncrement):
            self._spikes.hear(sensor, sample)
            if isinstance(sample, OdometrySample):
                self._fields.hear(sample)
        self._pauses.hear(sample.t_ns, sample.t_ref_ns if isinstance(sample, YawIncrement) else None)
        self.counts[_LATE[sensor] if arrival is Arrival.LATE else _IN_ORDER[sensor]] += 1
        self._take_all(self._leads.hear(sensor, sample.t_ns))
        return True

    def _clocks_set_back(self, sample: Sample) -> bool:
        """Start anew where two sensors' clocks were set back by less than `lag_window`; whether they were."""
        newest_ns = self._timeline.newest_ns or 0
        if sum(one.went_back for one in (*self._sequences.values(), self._image_stamps)) < 2:
            return False
        log.warning("all clocks were set back to %d ns: fusion starts anew", sample.t_ns)
        self.counts["reset: time jumped back"] += 1
        self._restart(self._filter.lost(self._timeline.state, UNKNOWN_TURN))
        self._pauses.jumped(newest_ns, sample.t_ns)
        return self._take(sample)

    def _references_of(self, increment: YawIncrement) -> list[FusionEvent]:
        """What gives the filter the yaw at an increment's reference, as far as it may go back for that."""
        first = self._timeline.newest_ns is None  # then there is no yaw but the initial one, which it had then
        before, after = self._last_increments.get(increment.long_baseline), None
        if before is None or increment.t_ns > before.t_ns:
            self._last_increments[increment.long_baseline] = increment
        else:  # it comes between others: the one after it counted on the one before it
            before, after = self._neighbours(increment)
        needed = [increment] if first or needs_reference(increment, before, self._reference_ns) else []
        if after is not None and needs_reference(after, increment, self._reference_ns):
            needed.append(after)
        return [reference_of(one) for one in needed]

    def _neighbours(self, increment: YawIncrement) -> tuple[YawIncrement | None, YawIncrement | None]:
        """The increments of its kind that come before and after one."""
        before = None
        for event in self._timeline.after(-1):
            if isinstance(event, CompassEvent) and event.sample.long_baseline == increment.long_baseline:
                if event.t_ns > increment.t_ns:
                    return before, event.sample
                before = event.sample
        return before, None

    def set_yaw(self, heading: float, variance: float) -> None:
        """Say what the yaw is now, modulo a turn (rad, variance rad^2): the turn count and all references stay.

        Raises
        ------
        ValueError
            `heading` or `variance` is not finite, or `variance` not positive.
        """
        if not (math.isfinite(heading) and math.isfinite(variance) and variance > 0.0):
            raise ValueError(
                f"heading {heading!r} rad, variance {variance!r} rad^2: finite and positive ones are needed"
            )
        self._timeline.add(heading_of(self._timeline.newest_ns or 0, heading, variance))

    def _refuse(self, sample: Sample, reason: str) -> bool:
        """Count and log a refused sample; always False."""
        sensor = sensor_of(sample)
        self.refusals[sensor] = reason
        reason = f"{sensor.value}: {reason}"
        self.counts[reason] += 1
        log.debug("refused %s: %r", reason, sample)
        return False

    def estimate(self, t_ns: int | None = None) -> YawEstimate | None:
        """The estimate after the newest sample, predicted to `t_ns`, ns, where that is later; None before the first."""
        state = self._timeline.state
        estimate = estimate_of(state if t_ns is None else self._filter.predicted(state, whole_ns(t_ns)))
        stamps = self.stamp_warnings()
        if estimate is None or not stamps:
            return estimate
        return replace(estimate, warnings=tuple(most_serious_first((*estimate.warnings, *stamps))))

    def warnings(self) -> list[Warning]:
        """What is wrong at present, most serious first: what `estimate` says of it, in a tenth of the time."""
        state = self._timeline.state
        return most_serious_first((*state.all_warnings, *self.stamp_warnings()))

    def stamp_warnings(self) -> list[Warning]:
        """What is wrong with clocks and stamps, and who is missing; known before there is an estimate."""
        found = self._clocks.warnings()
        found += self._silence.warnings([warning.sensor for warning in found])
        found += self._pauses.warnings() + self._faults.warnings() + self._spikes.warnings()
        found += self._fields.warnings()
        return found + [w for sequence in self._sequences.values() for w in sequence.warnings()]

    @property
    def state(self) -> FilterState:
        """All that the filter knows after the newest sample: state, covariance, gates."""
        return self._timeline.state

    def reports(self) -> Mapping[Sensor, SensorReport | None]:
        """How the last sample of each sensor fared at its gate."""
        return {sensor: gate.report for sensor, gate in self._timeline.state.gates.items()}
