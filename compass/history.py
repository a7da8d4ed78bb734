"""What became of the images so far: enough to say what is wrong with camera and stamps."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from compass.increment import CompassStatus

RECENT = 30  # images: of so many a share of a half is known to a tenth, 0.5 / sqrt(30)
SECOND_NS = 1_000_000_000


@dataclass(slots=True)
class ImageHistory:
    """Counts of stamps and of the last images' outcomes.

    Attributes
    ----------
    images : int
        All so far.
    first_ns : int
        Stamp of the first, ns.
    recent : deque of (int, CompassStatus)
        Stamps (ns) and outcomes of the last `RECENT` images.
    intervals_ns : deque of int
        Between the last `RECENT` images with texture that are no copies, ns.
    repeated, backward : int
        Images whose stamp was that of the image before, or earlier.
    furthest_back_ns : int
        By how much at most, ns.
    first_refused_ns : int or None
        Stamp of the first of those.
    whole_seconds : int
        Images whose stamp has no part of a second.
    frozen : (int, int) or None
        Stamps of the image that the camera repeats, of the first time and the last, ns; None while it does not, or not
        for long.
    empty_since_ns : int or None
        Stamp of the first image without texture with less than `RECENT` others since the one before.
    """

    images: int = 0
    first_ns: int = 0
    recent: deque[tuple[int, CompassStatus]] = field(default_factory=lambda: deque(maxlen=RECENT))
    intervals_ns: deque[int] = field(default_factory=lambda: deque(maxlen=RECENT))
    repeated: int = 0
    backward: int = 0
    furthest_back_ns: int = 0
    first_refused_ns: int | None = None
    whole_seconds: int = 0
    frozen: tuple[int, int] | None = None
    empty_since_ns: int | None = None

    def stamped(self, t_ns: int, newest_ns: int | None) -> None:
        """Take note of a stamp, whatever becomes of the image; `newest_ns` is that of the newest image before."""
        if not self.images:
            self.first_ns = t_ns
        self.images += 1
        self.whole_seconds += t_ns % SECOND_NS == 0
        if newest_ns is None or t_ns > newest_ns:
            return
        self.repeated += t_ns == newest_ns
        self.backward += t_ns < newest_ns
        self.furthest_back_ns = max(self.furthest_back_ns, newest_ns - t_ns)
        if self.first_refused_ns is None:
            self.first_refused_ns = t_ns

    def came_out(self, t_ns: int, status: CompassStatus, same_since_ns: int) -> None:
        """Take note of an image's outcome; `same_since_ns` is when it was first taken, if the camera repeats it."""
        self.recent.append((t_ns, status))
        if status is CompassStatus.FROZEN:
            self.frozen = same_since_ns, t_ns
        elif status is not CompassStatus.BACKWARD_STAMP:
            self.frozen = None
        if not self.share(CompassStatus.NO_TEXTURE):
            self.empty_since_ns = None
        elif self.empty_since_ns is None:
            self.empty_since_ns = t_ns

    def share(self, status: CompassStatus) -> float:
        """Of the recent images, 0..1."""
        return sum(one is status for _, one in self.recent) / max(len(self.recent), 1)

    def misses_images(self, gap_ns: int) -> bool:
        """Whether images are missing in so long a time, ns: what the camera turned meanwhile is not known.

        A slow camera leaves as long between all of its images, and has nothing better to compare them with.
        """
        usual_ns = sorted(self.intervals_ns)[(len(self.intervals_ns) - 1) // 2]
        return round(gap_ns / max(usual_ns, 1)) > 1
