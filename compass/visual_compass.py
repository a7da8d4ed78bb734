"""The visual compass: panoramas in, yaw increments out."""

from __future__ import annotations

import logging
import math
from collections import Counter

import numpy as np

from compass.config import CompassConfig
from compass.image import Image
from compass.increment import CompassStatus, YawIncrement
from compass.match import Match, Method, Search
from compass.rows import match_rows
from compass.sectors import match_sectors
from compass.strip import Strip, prepare_strip

METHODS: dict[str, Method] = {"rows": match_rows, "sectors": match_sectors}

MIN_CONTRAST = 2.0  # grey values of 255; camera noise alone leaves less in the strip
FROZEN_NS = 500_000_000  # a camera never gives the very same image for so long

log = logging.getLogger(__name__)


class VisualCompass:
    """Yaw of a 360-degree camera from the circular shift of its panoramas.

    Parameters
    ----------
    config : CompassConfig
        Defaults when not given.

    Attributes
    ----------
    status : CompassStatus
        Outcome of the last `update`.
    counts : Counter of CompassStatus
        Outcomes of all updates.
    yaw : float
        Accumulated (unwrapped) yaw since the first image, rad, positive to the left.
    yaw_variance : float
        Its variance, rad^2; it grows whenever the reference moves.

    Examples
    --------
    >>> compass = VisualCompass()
    >>> for t_ns, image in frames:
    ...     increment = compass.update(t_ns, image)
    """

    def __init__(self, config: CompassConfig | None = None) -> None:
        self.config = config or CompassConfig()
        self.counts: Counter[CompassStatus] = Counter()
        self.reset()

    def reset(self) -> None:
        """Forget all images and start again at yaw 0."""
        self.status = CompassStatus.NOT_STARTED
        self._reference: Strip | None = None
        self._last: Strip | None = None
        self._still_since_ns = 0
        self._reference_yaw = 0.0
        self._reference_variance = 0.0
        self.yaw = 0.0
        self.yaw_variance = 0.0
        self._turn = 0.0  # from reference to the last good image, unwrapped, rad

    def update(self, t_ns: int, image: Image, encoding: str = "") -> YawIncrement | None:
        """Take in one panorama.

        Parameters
        ----------
        t_ns : int
            Capture time, ns, greater than that of the image before.
        image : (H, W), (H, W, 3) or (H, W, 4) array of uint8 or uint16
            The full circle across its width; BGR unless `encoding` says ``rgb8`` or ``rgba8``.
        encoding : str
            Name of the pixel layout as in `sensor_msgs`.

        Returns
        -------
        YawIncrement or None
            None where the image gives no answer; `status` says why.

        Raises
        ------
        ImageError
            `image` is no image at all (shape or type).
        """
        increment = self._update(int(t_ns), image, encoding)
        self.counts[self.status] += 1
        return increment

    def _update(self, t_ns: int, image: Image, encoding: str) -> YawIncrement | None:
        if self._last is not None and t_ns <= self._last.t_ns:
            self.status = CompassStatus.BACKWARD_STAMP
            return None
        strip = prepare_strip(t_ns, image, self.config, encoding)
        reference = self._reference
        self.status = self._judge(strip)
        if self.status is not CompassStatus.OK or reference is None:
            return None
        match = METHODS[self.config.method](reference, strip, self._search(reference, strip))
        self.status = self._judge_match(match)
        if self.status is not CompassStatus.OK:
            return None
        return self._accept(reference, strip, match)

    def _judge(self, strip: Strip) -> CompassStatus:
        """Whether the strip can be compared at all; a first one becomes the reference."""
        last, self._last = self._last, strip
        if last is None or strip.image_shape[:2] != last.image_shape[:2]:
            self._reference, self._turn = strip, 0.0
            self._reference_yaw, self._reference_variance = self.yaw, self.yaw_variance
            self._still_since_ns = strip.t_ns
            return CompassStatus.FIRST_FRAME if last is None else CompassStatus.SIZE_CHANGED
        if strip.contrast < MIN_CONTRAST:
            return CompassStatus.NO_TEXTURE
        if strip.contrast != last.contrast or not np.array_equal(strip.pixels, last.pixels):
            self._still_since_ns = strip.t_ns
        elif strip.t_ns - self._still_since_ns > FROZEN_NS:
            return CompassStatus.FROZEN
        return CompassStatus.OK

    def _search(self, reference: Strip, strip: Strip) -> Search:
        columns = reference.columns
        per_rad = columns / math.tau
        reach = self.config.max_yaw_rate * (strip.t_ns - reference.t_ns) * 1e-9 * per_rad
        return Search(0.0, reach, self.config.forward_column * columns)

    def _judge_match(self, match: Match) -> CompassStatus:
        if match.status is not CompassStatus.OK:
            return match.status
        if not match.confidence >= self.config.min_confidence or not math.isfinite(match.variance_px2):
            return CompassStatus.LOW_CONFIDENCE
        return CompassStatus.OK

    def _accept(self, reference: Strip, strip: Strip, match: Match) -> YawIncrement:
        per_px = math.tau / reference.columns
        turn = match.shift_px * per_px
        variance = match.variance_px2 * per_px**2
        self.yaw = self._reference_yaw + turn
        self.yaw_variance = self._reference_variance + variance
        self._reference, self._reference_yaw, self._reference_variance = strip, self.yaw, self.yaw_variance
        return YawIncrement(reference.t_ns, strip.t_ns, turn, variance, min(max(match.confidence, 0.0), 1.0))
