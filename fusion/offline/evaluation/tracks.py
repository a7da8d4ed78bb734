"""The yaw of every source on one recording, all compasses shown the same frames on their way to the filter."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from compass import VisualCompass, YawIncrement
from compass.config import METHODS
from compass.methods.registry import find_method, own_methods
from compass.tilt import Vector
from fusion import Warning
from fusion.offline.run import FusedRun, fuse_recording, smooth_run
from fusion.offline.scores import COMPASS, YawTrack, yaw_tracks
from fusion.offline.streams import Frame, Progress, Recording
from fusion.settings import Settings

PAPER = "rows"  # the paper's method, which has the camera alone


class _Watched:
    """A recording whose frames are shown to further compasses on their way: every method sees the same frames."""

    def __init__(self, recording: Recording, compasses: Mapping[str, VisualCompass]) -> None:
        self._recording = recording
        self._compasses = compasses
        self.gyro, self.odometry, self.truth = recording.gyro, recording.odometry, recording.truth
        self.yaws: dict[str, list[tuple[int, float]]] = {name: [] for name in compasses}
        self.increments: dict[str, list[YawIncrement]] = {name: [] for name in compasses}
        self.frame_count = recording.frame_count

    @property
    def warnings(self) -> Iterable[Warning]:
        return self._recording.warnings

    def frames(self) -> Iterator[Frame]:
        for frame in self._recording.frames():
            for name, compass in self._compasses.items():
                increment = compass.update(frame.t_ns, frame.image, frame.encoding)
                if increment is not None:
                    self.increments[name].append(increment)
                if increment is not None or not self.yaws[name]:
                    self.yaws[name].append((frame.t_ns, compass.yaw))
            yield frame


@dataclass(frozen=True, slots=True)
class Tracks:
    """The yaw of every source on one recording, the run they come from and the increments of each method."""

    run: FusedRun
    yaws: Mapping[str, YawTrack]
    increments: Mapping[str, list[YawIncrement]]


def all_tracks(
    recording: Recording,
    settings: Settings,
    progress: Progress = lambda part: None,
    *,
    smooth: bool = False,
    exposed_ns: Mapping[int, int] | None = None,
    methods: Sequence[str] = METHODS,
) -> Tracks:
    """Run `methods`, the configured and the registered ones, and the filter, each frame shown to all of them.

    Where it is known when images were exposed, by their stamps, the methods are told: nobody but them is to blame for
    their errors. The raw compass, as the configured method is published, goes by the stamps all the same, as does the
    fused yaw, which has to find out.
    """
    when = exposed_ns or {}

    def up_exposed(t_ns: int) -> Vector | None:
        return recording.gyro.up_at(when.get(t_ns, t_ns))

    names = dict.fromkeys((*(find_method(m)[0] for m in methods), settings.compass.method, *own_methods()))
    configs = {name: replace(settings.compass, method=name) for name in names}
    compasses = {name: VisualCompass(c, None if name == PAPER else up_exposed) for name, c in configs.items()}
    watched = _Watched(recording, compasses)
    run = fuse_recording(watched, settings, progress)
    if smooth:
        smooth_run(run, settings)
    yaws = dict(yaw_tracks(run))
    if exposed_ns is None:
        yaws.pop(COMPASS, None)  # the same as the configured method's
    for name, seen in watched.yaws.items():
        if len(seen) > 1:
            t_ns = np.array([when.get(t, t) for t, _ in seen], np.int64)
            yaws[name] = YawTrack(t_ns, np.array([yaw for _, yaw in seen]))
    increments = {
        name: [replace(i, t_ref_ns=when.get(i.t_ref_ns, i.t_ref_ns), t_ns=when.get(i.t_ns, i.t_ns)) for i in found]
        for name, found in watched.increments.items()
    }
    return Tracks(run, yaws, increments)
