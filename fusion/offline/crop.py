"""Part of a recording: its samples within a window of time."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TypeVar

import numpy as np

from fusion.offline.bag import BagError
from fusion.offline.open_recording import FileRecording
from fusion.offline.stamp_check import Span
from fusion.offline.streams import GyroTrack, OdometryTrack, TruthTrack
from fusion.settings import OfflineSettings

Track = TypeVar("Track", GyroTrack, OdometryTrack, TruthTrack)


def cropped(recording: FileRecording, offline: OfflineSettings) -> FileRecording:
    """The recording from `offline.start` to `offline.end`, s from its first sample; itself where neither is set.

    The vertical is known from what came before, too: a levelled sample stays as it is.

    Raises
    ------
    BagError
        Nothing of it lies within.
    """
    if offline.start == 0.0 and offline.end == 0.0:
        return recording
    first, last = _ends(recording)
    begin = first + _ns(offline.start, last - first)
    end = first + _ns(offline.end, last - first) if offline.end > 0.0 else last
    if begin >= last:
        lasts = f"lasts {(last - first) * 1e-9:.1f} s"
        raise BagError(f"{recording.path}: {lasts}, nothing comes {offline.start:g} s after its start")
    truth = recording.truth and _part(recording.truth, begin, end)
    return replace(
        recording,
        gyro=_part(recording.gyro, begin, end),
        odometry=_part(recording.odometry, begin, end),
        truth=truth if truth and truth.t_ns.size else None,
        window=Span(begin, end),
    )


def _part(track: Track, begin: int, end: int) -> Track:
    """The samples of a track from `begin` to `end`, ns, both included."""
    inside = slice(int(np.searchsorted(track.t_ns, begin)), int(np.searchsorted(track.t_ns, end, side="right")))
    return replace(track, **{column.name: getattr(track, column.name)[inside] for column in fields(track)})


def _ends(recording: FileRecording) -> tuple[int, int]:
    """First and last stamp that is used, ns; of the images the last is where the recording ends."""
    firsts = [int(track.t_ns[0]) for track in (recording.gyro, recording.odometry) if track.t_ns.size]
    lasts = [int(track.t_ns[-1]) for track in (recording.gyro, recording.odometry) if track.t_ns.size]
    images = recording.image_span
    if images is not None:
        firsts.append(images.first_ns)
        lasts.append(images.last_ns)
    if not firsts:
        raise BagError(f"{recording.path}: no sample is usable, there is nothing to take a part of")
    return min(firsts), max(lasts)


def _ns(seconds: float, most: int) -> int:
    """Seconds as ns; beyond all that is recorded it does not matter how far."""
    return round(min(seconds * 1e9, most + 1.0))
