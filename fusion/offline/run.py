"""A recording through the one pipeline, and what came of it, time by time."""

from __future__ import annotations

import heapq
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from operator import attrgetter

import numpy as np
import numpy.typing as npt

from compass import CompassStatus, YawIncrement
from compass.mount import CameraMount
from fusion.buffer.events import Sample, Sensor
from fusion.checks.gate import SensorReport
from fusion.checks.silence import SILENT_NS
from fusion.checks.warnings import Warning
from fusion.compass_rate import CompassRate
from fusion.offline.image_results import ImageResult, ImageResults
from fusion.offline.streams import GyroTrack, OdometryTrack, Progress, Recording, TruthTrack
from fusion.offline.warning_history import Warned, WarningHistory
from fusion.samples import GyroSample, OdometrySample, YawEstimate
from fusion.settings import Settings

LONGEST_SILENCE_NS = 100_000_000  # without images there is a row at least this often
LONGEST_PREDICTION_NS = 10_000_000_000  # at `initial_rate_sigma` the yaw is known to no better than 5 rad by then


@dataclass(frozen=True, slots=True)
class CompassReading:
    """The raw compass at one image.

    Attributes
    ----------
    status : CompassStatus
        Outcome of the update.
    increment : YawIncrement or None
        What it gave.
    yaw, sigma : float
        Accumulated yaw and its standard deviation, rad; NaN where no increment was given.
    rate, rate_variance : float
        Mean turn rate since the image before, rad/s, and its variance; NaN where no increment was given.
    long_baseline : YawIncrement or None
        The turn from a view some seconds ago, where it was due.
    """

    status: CompassStatus
    increment: YawIncrement | None = None
    yaw: float = math.nan
    sigma: float = math.nan
    rate: float = math.nan
    rate_variance: float = math.nan
    long_baseline: YawIncrement | None = None

    def increments(self) -> Iterator[YawIncrement]:
        """All that the filter was given."""
        return (one for one in (self.increment, self.long_baseline) if one)


@dataclass(frozen=True, slots=True)
class Row:
    """Everything known at one time.

    Attributes
    ----------
    t_ns : int
        Its time.
    compass : CompassReading or None
        None between images.
    fused : YawEstimate or None
        Predicted to that time from the newest sample. None before the first sample of the filter, more than
        `LONGEST_PREDICTION_NS` after the newest one, and for an image that is older than that.
    gates : dict of Sensor to SensorReport
        How samples fared that came since the row before.
    warnings : tuple of Warning
        What was known at that time to be wrong, most serious first.
    smoothed : YawEstimate or None
        The estimate that knows the future; None where it was not asked for or nothing was measured at that time.
    """

    t_ns: int
    compass: CompassReading | None
    fused: YawEstimate | None
    gates: dict[Sensor, SensorReport]
    warnings: tuple[Warning, ...] = ()
    smoothed: YawEstimate | None = None


@dataclass(slots=True)
class FusedRun:
    """A run, complete.

    Attributes
    ----------
    rows : list of Row
        One per image; without images one at least every 0.1 s.
    gyro, odometry, truth
        The tracks that went in.
    compass_counts : Counter of CompassStatus
        Outcomes of all images.
    mount : CameraMount
        How the camera is tilted on the robot, as learnt by the end.
    fusion_counts : Counter of str
        What became of the samples.
    gates : dict of Sensor to SensorReport
        How the samples of each sensor fared at the filter's gate, all in all.
    warnings : list of Warned
        All that was wrong, and when; most serious first.
    initial_yaw : float
        Of the filter, rad.
    """

    rows: list[Row]
    gyro: GyroTrack
    odometry: OdometryTrack
    truth: TruthTrack | None
    compass_counts: Counter[CompassStatus] = field(default_factory=Counter)
    mount: CameraMount = field(default_factory=CameraMount)
    fusion_counts: Counter[str] = field(default_factory=Counter)
    gates: dict[Sensor, SensorReport] = field(default_factory=dict)
    warnings: list[Warned] = field(default_factory=list)
    initial_yaw: float = 0.0

    @property
    def t_ns(self) -> npt.NDArray[np.int64]:
        """Times of the rows, ns."""
        return np.array([row.t_ns for row in self.rows], np.int64)


def fuse_recording(
    recording: Recording,
    settings: Settings,
    progress: Progress = lambda part: None,
    results: ImageResults | None = None,
) -> FusedRun:
    """Run a recording through compass and filter, every sample at its stamp; `results` may have begun already."""
    results = results or ImageResults(recording, settings)
    run = _Run(settings)
    run.pipeline.warning_sources.append(lambda: results.warnings)
    total = recording.gyro.t_ns.size + recording.odometry.t_ns.size + recording.frame_count
    for count, event in enumerate(_events(recording, results)):
        run.take(event)
        progress(count / total)
    warnings = run.close()
    progress(1.0)
    images = results.counts, results.mount
    gates = run.reports()
    tracks = recording.gyro, recording.odometry, recording.truth
    return FusedRun(
        run.rows, *tracks, *images, run.pipeline.fusion.counts, gates, warnings, settings.fusion.initial_yaw
    )


def smooth_run(run: FusedRun, settings: Settings) -> None:
    """Give the rows of a run their smoothed estimates."""
    from fusion import smooth  # type: ignore[attr-defined,unused-ignore]

    increments = (one for row in run.rows if row.compass for one in row.compass.increments())
    samples: list[Sample] = [*run.gyro.samples(), *run.odometry.samples(), *increments]
    smoothed = {estimate.t_ns: estimate for estimate in smooth(samples, settings.fusion)}
    run.rows = [replace(row, smoothed=smoothed.get(row.t_ns)) for row in run.rows]


Event = GyroSample | OdometrySample | ImageResult


def _events(recording: Recording, results: ImageResults) -> Iterator[Event]:
    """All samples by stamp; at equal stamps the image comes last and so sees all that is known of its time."""
    streams = (recording.gyro.samples(), recording.odometry.samples(), results)
    return heapq.merge(*streams, key=attrgetter("t_ns"))


class _Run:
    """The pipeline with a notebook."""

    def __init__(self, settings: Settings) -> None:
        from fusion import YawPipeline  # type: ignore[attr-defined,unused-ignore]

        self.pipeline = YawPipeline(settings.compass, settings.fusion)
        self.rows: list[Row] = []
        self.pipeline.warning_sources.append(lambda: self._image_warnings)
        self._image_warnings: tuple[Warning, ...] = ()
        self._rate = CompassRate()
        self._reported: dict[Sensor, int] = {}
        self._last_ns: int | None = None
        self._history = WarningHistory()
        self._only_image_ns: int | None = None  # of the first image, until the second

    def take(self, event: Event) -> None:
        """Feed one event and note a row where one is due."""
        if isinstance(event, ImageResult):
            first = event.status is CompassStatus.FIRST_FRAME and all(row.compass is None for row in self.rows)
            self._only_image_ns = event.t_ns if first else None
            self._note(event.t_ns, self._read(event))
        elif self.pipeline.add(event):
            self._last_ns = event.t_ns
            if not self.rows or event.t_ns - self.rows[-1].t_ns > LONGEST_SILENCE_NS:
                self._note(event.t_ns, None)

    def close(self) -> list[Warned]:
        """Note the last samples; returns all that was wrong."""
        self.pipeline.flush()
        if self._last_ns is not None and self.rows and self._last_ns > self.rows[-1].t_ns:
            self._note(self._last_ns, None)
        return self._history.finish([*self.pipeline.warnings(), *self._lone_image()])

    def _lone_image(self) -> list[Warning]:
        """What is wrong if one image has come, and none after it while the others went on."""
        if self._only_image_ns is None or self.rows[-1].t_ns - self._only_image_ns <= 2 * SILENT_NS:
            return []
        text = (
            "compass: one image, and nothing to compare it with after it; the yaw goes on without it: check the camera,"
            " its driver and its link"
        )
        return [Warning("sensor_silent", Sensor.COMPASS.value, self._only_image_ns, text)]

    def reports(self) -> dict[Sensor, SensorReport]:
        """How the samples of each sensor that has given any fared at the gate so far."""
        return {sensor: report for sensor, report in self.pipeline.fusion.reports().items() if report}

    def _read(self, result: ImageResult) -> CompassReading:
        self._image_warnings = result.warnings
        for one in result.increments():
            self.pipeline.add(one)
        if result.increment is None:
            return CompassReading(result.status)
        rate, variance = self._rate.update(result.increment)
        sigma = math.sqrt(result.yaw_variance)
        return CompassReading(result.status, result.increment, result.yaw, sigma, rate, variance, result.long_baseline)

    def _note(self, t_ns: int, reading: CompassReading | None) -> None:
        reports = self.reports()
        new = {sensor: report for sensor, report in reports.items() if self._reported.get(sensor) != report.t_ns}
        self._reported.update({sensor: report.t_ns for sensor, report in new.items()})
        if self.rows and self.rows[-1].t_ns == t_ns and self.rows[-1].compass is None:
            new = self.rows.pop().gates | new
        warnings = self._history.note(t_ns, self.pipeline.warnings())
        self.rows.append(Row(t_ns, reading, self._estimate_at(t_ns), new, warnings))

    def _estimate_at(self, t_ns: int) -> YawEstimate | None:
        """The estimate for a row's own time; None where there is none worth the name."""
        newest_ns = self.pipeline.fusion.state.t_ns
        if newest_ns is None or not 0 <= t_ns - newest_ns <= LONGEST_PREDICTION_NS:
            return None
        return self.pipeline.estimate(t_ns)
