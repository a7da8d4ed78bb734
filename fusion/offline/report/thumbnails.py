"""Small pictures of the panoramas, taken while a recording is fused."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable, Iterator

import cv2
import numpy as np

from compass.errors import ImageError
from compass.images.decode import to_grey
from fusion.checks.warnings import Warning
from fusion.offline.streams import Frame, GyroTrack, OdometryTrack, Recording, TruthTrack

MOST = 240  # pictures of a run; one each 0.4 % of the page's width
WIDTH = 320  # px
QUALITY = 60  # of the JPEG; 2 to 8 kB each, so 2 MB for all


class Thumbnails:
    """A `Recording` that keeps a small picture of every so many-th panorama that passes.

    The number of panoramas need not be known well: whenever there are too many, every other one goes, and from then on
    only half as many are taken.

    Parameters
    ----------
    recording : Recording
        What is watched.
    bottom : float
        Share of the panoramas' height, from the top, that was decoded.

    Attributes
    ----------
    pictures : list of (int, bytes)
        Time, ns, and JPEG of each.
    """

    def __init__(self, recording: Recording, bottom: float = 1.0) -> None:
        self._recording, self._bottom = recording, bottom
        self.pictures: list[tuple[int, bytes]] = []

    @property
    def gyro(self) -> GyroTrack:
        """All gyro samples."""
        return self._recording.gyro

    @property
    def odometry(self) -> OdometryTrack:
        """All odometry samples."""
        return self._recording.odometry

    @property
    def truth(self) -> TruthTrack | None:
        """The true yaw, where it is known."""
        return self._recording.truth

    @property
    def frame_count(self) -> int:
        """How many panoramas there are."""
        return self._recording.frame_count

    @property
    def warnings(self) -> Iterable[Warning]:
        """What was found to be wrong with it."""
        return self._recording.warnings

    def frames(self) -> Iterator[Frame]:
        """The panoramas, unchanged."""
        self.pictures, every = [], -(-max(self.frame_count, 1) // MOST)
        for index, frame in enumerate(self._recording.frames()):
            if index % every == 0:
                self.pictures.append((frame.t_ns, small_jpeg(frame, self._bottom)))
                if len(self.pictures) > MOST:
                    self.pictures, every = self.pictures[::2], 2 * every
            yield frame

    def as_json(self, start_ns: int) -> str:
        """Times, s since `start_ns`, and pictures as data URIs; safe inside a script element."""
        return json.dumps(
            {
                "t": [round(1e-9 * (t_ns - start_ns), 4) for t_ns, _ in self.pictures],
                "picture": ["data:image/jpeg;base64," + base64.b64encode(jpeg).decode() for _, jpeg in self.pictures],
            }
        )


def small_jpeg(frame: Frame, bottom: float = 1.0) -> bytes:
    """The panorama in grey, at most `WIDTH` wide, down to a share of its height; nothing where it is no picture."""
    try:
        grey = to_grey(frame.image, frame.encoding)
        grey = grey[: max(round(bottom * len(grey)), 1)]
        height, width = grey.shape[:2]
        if width > WIDTH:
            grey = cv2.resize(grey, (WIDTH, max(1, height * WIDTH // width)), interpolation=cv2.INTER_AREA)
        if grey.dtype != np.uint8:
            grey = (grey // 256).astype(np.uint8)
        return bytes(cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1])
    except (cv2.error, ImageError):
        return b""  # what the compass says of it is in its status
