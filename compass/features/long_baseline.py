"""Long baselines: the turn since a view some seconds ago, by the corners that both show."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from compass.agreement import DISAGREE
from compass.angles import wrap_angle
from compass.config import CompassConfig
from compass.features.matching import follow_landmarks
from compass.flow.correlation import FLOOR_PX
from compass.images.strip import Strip
from compass.increment import CompassStatus, YawIncrement
from compass.methods.match import Search
from compass.mount import CameraMount
from compass.tilt import GOOD_FOR_S, Tilted

Comparison = Callable[[], YawIncrement | None]


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A view that a later one may be compared with.

    Attributes
    ----------
    strip : Strip
        What it shows.
    yaw, variance : float
        Sum of the increments until then, rad, and its variance, rad^2.
    tilts : Tilted
        Tilt of the robot.
    mount : CameraMount
        And of the camera on it, as known then.
    """

    strip: Strip
    yaw: float
    variance: float
    tilts: Tilted
    mount: CameraMount


class LongBaselines:
    """Remembers a view, and compares it from time to time with the present one."""

    def __init__(self) -> None:
        self._view: View | None = None
        self._last_ns = 0
        self._moving = threading.Lock()  # a comparison may end in another thread

    def start_from(self, view: View | None, t_ns: int) -> None:
        """Make this view the other end of the baselines from now on; where there is none, the next one."""
        with self._moving:
            self._view, self._last_ns = view, t_ns

    def due(self, now: View, config: CompassConfig) -> Comparison | None:
        """The comparison with the present view, if it is time for one: in whatever thread, before the next is due."""
        t_ns, interval_ns = now.strip.t_ns, config.long_baseline_interval * 1e9
        if not interval_ns or t_ns - self._last_ns < interval_ns:
            return None
        view, self._last_ns = self._view, t_ns
        if view is None:
            self.start_from(now, t_ns)
            return None
        return partial(self._compare, view, now, config)

    def _compare(self, view: View, now: View, config: CompassConfig) -> YawIncrement | None:
        """Turn from one view to the other, if the latter still shows enough of the former."""
        per_px, forward_px = math.tau / now.strip.columns, config.forward_column * now.strip.columns
        expected = now.yaw - view.yaw
        # either view errs by itself, too, where both were compared with one keyframe
        between = abs(now.variance - view.variance) + 2.0 * (FLOOR_PX * per_px) ** 2
        reach = DISAGREE * math.sqrt(between)
        search = Search(now.mount.on_camera(expected) / per_px, reach / per_px, forward_px)
        match = follow_landmarks(view.strip, now.strip, search)
        (turn, tilt), variance = now.mount.on_robot(match.shift_px * per_px, match.tilt), match.variance_px2 * per_px**2
        tilts, yaw = view.tilts, view.tilts.after(turn, tilt)[1]
        if now.strip.up is not None:
            tilts, yaw = now.tilts.before(turn, tilt)
        apart = wrap_angle(yaw - expected) ** 2
        refused = match.status is not CompassStatus.OK or apart > DISAGREE**2 * (between + variance)
        old = now.strip.t_ns - view.strip.t_ns > (GOOD_FOR_S - config.long_baseline_interval) * 1e9
        with self._moving:
            if self._view is view and (refused or old or variance > between):  # the increments are as good
                self._view = now
        if refused:
            return None
        found = yaw, float(variance + tilts.variance(turn, config.tilt_sigma)), match.confidence, turn, tilt
        return YawIncrement(view.strip.t_ns, now.strip.t_ns, *found, long_baseline=True)
