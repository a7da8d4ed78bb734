"""What the compass knows to be wrong with camera, images and stamps, in words."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from compass.history import ImageHistory
from compass.increment import CompassStatus
from fusion.checks.faulty import is_frequent
from fusion.checks.warnings import Warning

if TYPE_CHECKING:
    from compass import VisualCompass

# Not derived: `EMPTY_SHARE`, `FEWEST_IMAGES`, `CUT_SHARE`.
EMPTY_SHARE = 0.5  # of the last images; a single dark one is no fault
FEWEST_IMAGES = 10  # images before a share of them says anything

CUT_SHARE = 0.1  # of stamps that repeat, where all are whole seconds: a camera of 1 Hz may have whole seconds rightly
CLOCK_NS = 1_000_000_000  # a stamp further back comes from another clock, not from images in disorder


def image_warnings(compass: VisualCompass) -> list[Warning]:
    """What is wrong at present with the images that a compass was given; cheap enough to be asked after each."""
    history = compass.history
    found = (_circle(compass), _turn_lost(compass), _stamps(history), _frozen(history), _empty(history))
    return [warning for warning in found if warning is not None]


def _circle(compass: VisualCompass) -> Warning | None:
    verdict = compass.circle.verdict
    if verdict is None or not verdict.fault:
        return None
    text = (
        f"the images do not show the full circle once: {verdict.fault}, in {verdict.views} views; every turn is then "
        "wrong by a factor: give equirectangular panoramas of 360 deg across the image width, or say what the camera "
        "shows (compass.projection and field_of_view_deg, docs/cameras.md)"
    )
    return Warning("not_full_circle", "compass", verdict.since_ns, text)


def _turn_lost(compass: VisualCompass) -> Warning | None:
    """The raw compass misses what it did not see for good; the fused yaw does not, where a gyro measured it."""
    lost = compass.lost_turns
    if not lost:
        return None
    last = lost[-1]
    bound = "any turn" if last.bound >= math.pi and last.t_to_ns < last.t_from_ns else _up_to(last.bound)
    seconds = (last.t_to_ns - last.t_from_ns) * 1e-9
    if seconds < 0.0:
        what = f"the images' stamps went back by {-seconds:.3g} s {_when(compass.history, last.t_from_ns)}"
    else:
        what = f"{seconds:.2g} s without a usable image {_when(compass.history, last.t_from_ns)}"
    more = f"; {len(lost)} such gaps so far" if len(lost) > 1 else ""
    sigma = math.degrees(math.sqrt(compass.yaw_variance))
    text = (
        f"{what}: {bound} unknown{more}; the raw compass yaw is uncertain by {sigma:.3g} deg since (1 sigma), "
        "the fused yaw only where no gyro or odometry measured the turn: see to the camera's light, lens and clock"
    )
    return Warning("turn_lost", "compass", min(lost[0].t_from_ns, lost[0].t_to_ns), text)


def _when(history: ImageHistory, t_ns: int) -> str:
    return f"from t={(t_ns - history.first_ns) * 1e-9:.1f} s on (0: first image)"


def _up_to(bound: float) -> str:
    return f"up to {math.degrees(bound):.0f} deg of turning"


def _stamps(history: ImageHistory) -> Warning | None:
    """Stamps that are not the moments of capture."""
    refused = history.repeated + history.backward
    since_ns = history.first_refused_ns
    if since_ns is None or not is_frequent(refused, history.images):
        return None
    remedy = "stamp each image with the time of its capture (header.stamp)"
    share = f"{refused} of {history.images} images ({100.0 * refused / history.images:.0f} %)"
    if history.repeated == history.images - 1 and history.images >= FEWEST_IMAGES:
        text = f"all {history.images} images carry the stamp {since_ns * 1e-9:.3f} s; only the first was used: {remedy}"
    elif history.whole_seconds == history.images and history.repeated > CUT_SHARE * history.images:
        text = (
            f"the images' stamps are cut to whole seconds; {share} repeat one and were left out, the rest may be "
            f"late by up to 1 s: {remedy}, with its nanoseconds"
        )
    else:
        back = ""
        if history.backward:
            back = f", {history.backward} go back, by up to {history.furthest_back_ns * 1e-9:.3g} s"
        if history.furthest_back_ns > CLOCK_NS:
            remedy = "let one clock stamp them, and play no recording over another"
        text = f"stamps of {share} do not increase: {history.repeated} repeat{back}; such images are left out: {remedy}"
    return Warning("stamps_not_increasing", "compass", since_ns, text)


def _frozen(history: ImageHistory) -> Warning | None:
    if history.frozen is None:
        return None
    since_ns, t_ns = history.frozen
    text = (
        f"the camera has repeated one image for {(t_ns - since_ns) * 1e-9:.1f} s, {_when(history, since_ns)}; that "
        "measures nothing: restart the camera or its driver"
    )
    return Warning("images_frozen", "compass", since_ns, text)


def _empty(history: ImageHistory) -> Warning | None:
    share, since_ns = history.share(CompassStatus.NO_TEXTURE), history.empty_since_ns
    if since_ns is None or len(history.recent) < FEWEST_IMAGES or share < EMPTY_SHARE:
        return None
    text = (
        f"{100.0 * share:.0f} % of the last {len(history.recent)} images are black, covered or overexposed; no yaw "
        "comes of them: see to lens cap, exposure and light, and to roi_top and roi_bottom"
    )
    return Warning("images_empty", "compass", since_ns, text)
