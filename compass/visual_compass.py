"""The visual compass: panoramas in, yaw increments out."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from compass.angles import wrap_angle
from compass.config import CompassConfig
from compass.errors import VisualCompassError
from compass.features.across_gap import is_confirmed
from compass.features.long_baseline import Comparison, LongBaselines, View
from compass.features.matching import match_landmarks
from compass.history import SECOND_NS, ImageHistory
from compass.images.decode import Image
from compass.images.full_circle import CircleCheck
from compass.images.mask import load_mask
from compass.images.orientation import Orientation
from compass.images.strip import MIN_TEXTURE, Strip, prepare_strip
from compass.increment import CompassStatus, YawIncrement
from compass.methods.match import Match, Search
from compass.methods.registry import find_method
from compass.mount import CameraMount
from compass.parameters import config_of
from compass.stamp_order import StampOrder
from compass.stamps import whole_ns
from compass.tilt import Tilted, Vector, beyond_error
from compass.unmeasured_turn import LostTurn, LostTurns

UpAt = Callable[[int], Vector | None]

# A camera never gives the very same image for so long; a video may, frame by frame. A view so old is sought by its
# corners, and so often: it takes as long as some forty comparisons.
FROZEN_NS = SECOND_NS // 2


class VisualCompass:
    """Yaw of a 360-degree camera from the circular shift of its panoramas.

    The idea, and that parallax spoils it: Labrosse 2006, doi:10.1002/rob.20159; the paper (`methods/row_correlation`).

    Parameters
    ----------
    config : CompassConfig
        Defaults when not given.
    up_at : callable, optional
        Knows the vertical in the robot's frame (x ahead, y left, z up; a unit vector) at a stamp, ns, or None where it
        does not. Without it the tilt is estimated from what is seen.

    Raises
    ------
    ConfigError
        The picture that `config.mask` names cannot be read.

    Attributes
    ----------
    status : CompassStatus
        Outcome of the last `update`.
    counts : Counter of CompassStatus
        Outcomes of all updates.
    yaw : float
        Accumulated (unwrapped) yaw since the first image, rad, positive to the left.
    yaw_variance : float
        Its variance, rad^2; it grows whenever the reference moves, and by what may have been turned unseen where images
        are compared with a new one (`lost_turns`).
    history : ImageHistory
        What became of the images so far.
    circle : CircleCheck
        Whether they show the full circle.
    mount : CameraMount
        How the camera is tilted on the robot, as far as its turns have shown; unknown without `up_at`.

    Examples
    --------
    >>> compass = VisualCompass()
    >>> for t_ns, image in frames:
    ...     increment = compass.update(t_ns, image)
    """

    def __init__(self, config: CompassConfig | None = None, up_at: UpAt | None = None) -> None:
        self.config = config_of(CompassConfig, config)
        self._up_at = up_at or (lambda t_ns: None)
        self._mask = load_mask(self.config)
        self.counts: Counter[CompassStatus] = Counter()
        self.reset()

    def reset(self) -> None:
        """Forget all images and start again at yaw 0."""
        self.status = CompassStatus.NOT_STARTED
        self.yaw = 0.0
        self.yaw_variance = 0.0
        self.history, self.circle = ImageHistory(), CircleCheck()
        self._factor_before = 0.0  # of images of another size, until those of this one have shown theirs
        self._lost_turns = LostTurns()
        self._keyframe: View | None = None  # what images are compared with
        self._tilt = Tilted()  # at the last good image
        self.mount = CameraMount()
        self._last: Strip | None = None  # the last image that gave an increment, or the keyframe
        self._last_variance = 0.0  # of the yaw there
        self._last_increment: YawIncrement | None = None  # to it; None for the keyframe
        self._newest: Strip | None = None  # the last image whatever came of it
        self._order = StampOrder()
        self._still_since_ns = 0  # when the last image was first taken, if the camera repeats it
        self._unmatched_since_ns: int | None = None
        self._followed_ns = 0  # of the last image whose turn is known, if only badly
        self._sought_ns = 0  # when the last view was last sought by its corners
        self._baselines = LongBaselines()
        _, entry = find_method(self.config.method)
        self._method, self._long_baseline, spread = entry.make(), entry.long_baseline, self.config.keyframe_spread
        self._keyframe_spread = spread if spread >= 0.0 else entry.keyframe_spread

    def update(self, t_ns: int, image: Image, encoding: str = "") -> YawIncrement | None:
        """Take in one panorama.

        Parameters
        ----------
        t_ns : int
            Capture time, ns, greater than that of the image before.
        image : (H, W), (H, W, 3) or (H, W, 4) array of uint8 or uint16
            The full circle across its width, or what `config.projection` says; BGR unless `encoding` says ``rgb8`` or
            ``rgba8``.
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
        ArgumentError
            `t_ns` is no whole number, as seconds are.
        ConfigError
            Images of this size show nothing of the region of interest.
        """
        t_ns = whole_ns(t_ns)
        self.history.stamped(t_ns, self._newest.t_ns if self._newest else None)
        increment = self._update(t_ns, image, encoding)
        self.counts[self.status] += 1
        self.history.came_out(t_ns, self.status, self._still_since_ns)
        return increment

    @property
    def lost_turns(self) -> list[LostTurn]:
        """When the camera may have turned without an image that shows by how much; `yaw` misses that."""
        return self._lost_turns.all

    def _update(self, t_ns: int, image: Image, encoding: str) -> YawIncrement | None:
        if self._backward(t_ns):
            self.status = CompassStatus.BACKWARD_STAMP
            return None
        if isinstance(image, np.ndarray):
            image = image.view(np.ndarray)  # a matrix has no rows of one dimension, a masked array no minimum
        strip = prepare_strip(t_ns, image, self.config, encoding, self._mask, self._up_at(t_ns))
        strip = replace(strip, mount=self.mount)
        self.status = self._judge_strip(strip)
        if strip.texture >= MIN_TEXTURE and self.config.is_full_panorama:
            self.circle.look(strip, Orientation.of(self.config).upright(image), encoding)
        if self.status is not CompassStatus.OK or self._last is None or self._keyframe is None:
            return None
        if self._still_since_ns != strip.t_ns:
            return self._repeat(self._keyframe.strip, strip)
        match = self._compare(self._keyframe, strip)
        if self._keyframe.strip is not self._last and self._lost(match):
            self._keyframe = self._last_view(self._last)
            match = self._compare(self._keyframe, strip)
        self.status = self._judge_match(match)
        gap_ns = strip.t_ns - self._followed_ns
        missed = gap_ns > FROZEN_NS and self.history.misses_images(gap_ns)
        if match.badly_known and match.confidence >= self.config.min_confidence and not missed:
            self._followed_ns = strip.t_ns
            if strip.t_ns - self._last.t_ns <= SECOND_NS:
                return None
            self.status, match = CompassStatus.OK, replace(match, spread_px=math.inf)  # or the turn is lost
        if self.status is not CompassStatus.OK or missed:
            across = self._across_gap(self._last, self._keyframe, strip, match)
            if across is None:
                self._give_up_keyframe(strip)
                return None
            match = across
        return self._accept(self._keyframe, strip, match)

    def long_baseline(self) -> YawIncrement | None:
        """Turn from a view some seconds ago to the last image, by their corners; to be asked after each `update`.

        It is right to a hundredth of a degree, however much was driven past meanwhile, and takes some ten times as long
        as an `update`. `yaw` leaves it out: that is the sum of the increments from image to image. `YawFusion` takes
        both.

        Returns
        -------
        YawIncrement or None
            None where it is not due (`long_baseline_interval`), the last image gave no increment, or too little of the
            view is left.
        """
        comparison = self.due_long_baseline()
        return comparison() if comparison else None

    def due_long_baseline(self) -> Comparison | None:
        """What `long_baseline` would do now, if it is due; it may be called in another thread while images go on."""
        good = self.status in (CompassStatus.OK, CompassStatus.FOUND_AGAIN)
        if self._last is None or not (good and self._long_baseline):
            return None
        return self._baselines.due(self._last_view(self._last), self.config)

    def _last_view(self, last: Strip) -> View:
        """The last good image, its yaw and its tilt."""
        return View(last, self.yaw, self._last_variance, self._tilt, self.mount)

    def _backward(self, t_ns: int) -> bool:
        """Whether the image is to be ignored; where time went back for good, it is the first of its time."""
        if self._order.is_backward(t_ns, self._newest.t_ns if self._newest else None):
            return True
        if self._order.went_back:
            self._newest = None
        return False

    def _judge_strip(self, strip: Strip) -> CompassStatus:
        """Whether the strip can be compared at all; the first of its size becomes the keyframe."""
        newest, self._newest = self._newest, strip
        if newest is None or strip.image_shape[:2] != newest.image_shape[:2]:
            self._still_since_ns = strip.t_ns
            self._start_from(strip)
            if newest is not None:
                self._factor_before, self.circle = self._factor_sigma, CircleCheck()
                return CompassStatus.SIZE_CHANGED
            return CompassStatus.FIRST_FRAME if self._keyframe else CompassStatus.NO_TEXTURE
        if strip.texture < MIN_TEXTURE:
            return CompassStatus.NO_TEXTURE
        if self._keyframe is None:
            self._still_since_ns = strip.t_ns
            self._start_from(strip)
            return CompassStatus.FIRST_FRAME
        if strip.contrast != newest.contrast or not np.array_equal(strip.pixels, newest.pixels):
            self.history.intervals_ns.append(strip.t_ns - self._still_since_ns)
            self._still_since_ns = strip.t_ns
        elif strip.t_ns - self._still_since_ns > FROZEN_NS:
            return CompassStatus.FROZEN
        return CompassStatus.OK

    def _start_from(self, strip: Strip) -> None:
        """Compare with this strip from now on; what turned meanwhile is not known."""
        self._last = strip if strip.texture >= MIN_TEXTURE else None
        self._last_increment = None
        if self._last is not None:
            waited_ns = self._order.waited_ns()
            self._last_variance += self._lost_turns.lose(strip.t_ns, self.config.max_yaw_rate, waited_ns)
            self.yaw_variance = self._last_variance + self._factor_variance
        self._tilt = self._tilt_of(strip) or Tilted()
        self._unmatched_since_ns, self._sought_ns = None, strip.t_ns
        self._followed_ns = strip.t_ns
        self._keyframe = self._last_view(self._last) if self._last is not None else None
        self._baselines.start_from(self._keyframe, strip.t_ns)

    def _across_gap(self, last: Strip, keyframe: View, strip: Strip, match: Match) -> Match | None:
        """The turn since the last good image where the keyframe's match alone does not tell it; sets the status.

        In a place that repeats itself another bay may match better than the one that was seen last. So a match counts
        only if the corners of the whole view say the same; where there is none, what they say is the answer. They are
        not asked at once, and not at every image.
        """
        matched = self.status is CompassStatus.OK
        if matched and not self._long_baseline:  # such a method is all there is
            return match
        if matched:
            self.status = CompassStatus.AMBIGUOUS
        early = strip.t_ns - max(last.t_ns, self._sought_ns) < FROZEN_NS
        if early or not (self.config.find_again and self._long_baseline):
            return None
        self._sought_ns, search = strip.t_ns, self._search(keyframe, strip)
        if matched:
            if not is_confirmed(match, keyframe.strip, strip, search):
                return None
            self.status = CompassStatus.OK
            return match
        found = match_landmarks(keyframe.strip, strip, search)
        if found.status is not CompassStatus.OK:
            return None
        self.status = CompassStatus.FOUND_AGAIN
        return found

    def _compare(self, keyframe: View, strip: Strip) -> Match:
        match = self._method(keyframe.strip, strip, self._search(keyframe, strip))
        if not isinstance(match, Match):
            raise VisualCompassError(f"method {self.config.method} gave {type(match).__name__}, not a compass.Match")
        return match

    def _search(self, keyframe: View, strip: Strip) -> Search:
        columns = keyframe.strip.columns
        last = self._last or keyframe.strip
        reach = self.config.max_yaw_rate * (strip.t_ns - last.t_ns) * 1e-9
        return Search(
            (self.yaw - keyframe.yaw) * columns / math.tau,
            reach * columns / math.tau,
            self.config.forward_column * columns,
        )

    def _lost(self, match: Match) -> bool:
        """Whether the keyframe is too far behind for this match to be used; the next one moves it in any case."""
        too_far = 2.0 * self._keyframe_spread
        return match.spread_px > too_far or self._judge_match(match) is not CompassStatus.OK

    def _tilt_of(self, strip: Strip) -> Tilted | None:
        """Tilt of the camera, where an IMU measures it."""
        return None if strip.up is None else Tilted.upright(beyond_error(strip.up, self.config.tilt_sigma))

    def _judge_match(self, match: Match) -> CompassStatus:
        if not match.confidence >= self.config.min_confidence or not math.isfinite(match.variance_px2):
            return CompassStatus.LOW_CONFIDENCE
        return match.status

    def _give_up_keyframe(self, strip: Strip) -> None:
        """After a while of images that match nothing the place is taken to be another one."""
        if self._unmatched_since_ns is None:
            self._unmatched_since_ns = strip.t_ns
        elif strip.t_ns - self._unmatched_since_ns > SECOND_NS:  # such a view is a new one
            self._start_from(strip)

    def _accept(self, keyframe: View, strip: Strip, match: Match) -> YawIncrement:
        """The increment of a good match; where too much has moved apart, the strip is the next keyframe."""
        reference_ns, per_px = keyframe.strip.t_ns, math.tau / keyframe.strip.columns
        turn = match.shift_px * per_px
        if keyframe.strip.up is not None and strip.up is not None and any(match.tilt):  # else it is not known
            self.mount = self.mount.after(turn, match.tilt, keyframe.strip.up, strip.up)
        turn, tilt = self.mount.on_robot(turn, match.tilt)
        now = self._tilt_of(strip)
        if now is None:
            before = keyframe.tilts
            tilted, yaw = before.after(turn, tilt)
            now = tilted.later((strip.t_ns - reference_ns) * 1e-9)
        else:
            before, yaw = now.before(turn, tilt)
        variance = match.variance_px2 * per_px**2 + before.variance(turn, self.config.tilt_sigma)
        self.yaw += wrap_angle(keyframe.yaw + yaw - self.yaw)
        self._last_variance = keyframe.variance + variance
        self.yaw_variance = self._last_variance + self._factor_variance
        self._last = strip
        self._followed_ns = strip.t_ns
        self._lost_turns.known(strip.t_ns)
        self._tilt = now
        self._unmatched_since_ns = None
        if match.spread_px > self._keyframe_spread:
            self._keyframe = self._last_view(strip)
        confidence = min(max(match.confidence, 0.0), 1.0)
        measured = reference_ns, strip.t_ns, yaw, variance, confidence, turn, tilt
        self._last_increment = YawIncrement(*measured, factor_sigma=self._factor_sigma)
        return self._last_increment

    @property
    def _factor_sigma(self) -> float:
        """By what factor all turns may be wrong alike, a standard deviation."""
        verdict = self.circle.verdict
        return verdict.turn_factor_sigma if verdict else self._factor_before

    @property
    def _factor_variance(self) -> float:
        """Of the accumulated yaw, rad^2."""
        return (self._factor_sigma * self.yaw) ** 2

    def _repeat(self, keyframe: Strip, strip: Strip) -> YawIncrement | None:
        """The increment of an exact copy of the image before: the turn until that was taken, nothing of the time since.

        A driver that sends each frame twice and a camera that hangs look alike at first. Neither measured that there
        was no turn; it lies within what `max_yaw_rate` allows, and the copy's variance says so. The image itself, at
        its own stamp, stays what later ones are compared with.
        """
        if self._last is None or self._last.t_ns != self._still_since_ns:
            self.status = CompassStatus.FROZEN  # what it repeats gave no increment
            return None
        unseen = (self.config.max_yaw_rate * (strip.t_ns - self._last.t_ns) * 1e-9) ** 2 / 3.0
        copied = self._last_increment
        if copied is None or keyframe is self._last:
            copied = YawIncrement(keyframe.t_ns, strip.t_ns, 0.0, 0.0, 1.0, 0.0, factor_sigma=self._factor_sigma)
        self.yaw_variance = self._last_variance + unseen + self._factor_variance
        return replace(copied, t_ns=strip.t_ns, variance=copied.variance + unseen)
