"""What a real camera makes of a clean image: the robot's body, blur, exposure, noise, darkness, JPEG.

These are applied anew for each seed to the cached clean frames. Those are 8 bit; their rounding (deviation 0.29) is
small beside the noise that follows it.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from scipy.special import ndtri

from fusion.simulation.body import robot_body
from fusion.simulation.robot import wander

Floats = npt.NDArray[np.float64]
Frame = npt.NDArray[np.uint8]

# Quantiles of the standard normal, of which each pixel of each frame draws one: a quarter of the time of normals.
# No two frames share noise; in a dim scene corners would follow what they share.
_LEVELS = 1 << 16
_QUANTILES = ndtri((np.arange(_LEVELS) + 0.5) / _LEVELS).astype(np.float32)


@dataclass(frozen=True, slots=True)
class Effects:
    """What happens between the scene and the message.

    Attributes
    ----------
    noise : float
        Deviation of the sensor's noise in the dark, of 255.
    shot_noise : float
        Variance of the noise per grey level.
    exposure : float
        Deviation of the slow change of brightness, relative.
    exposure_steps : float
        Sudden changes of exposure per second, each of up to 20 %.
    shutter : float
        Exposure time, s; turning blurs by ``rate * shutter``.
    vignette : float
        How much darker the picture is between the lenses, relative; fixed in the picture.
    body : str
        See `robot_body`.
    jpeg_quality : int
        Of the compressed stream.
    dark : tuple of float
        Begin and end of a time without any light, s since the start.
    """

    noise: float = 2.0
    shot_noise: float = 0.015
    exposure: float = 0.03
    exposure_steps: float = 0.05
    shutter: float = 0.006
    vignette: float = 0.015
    body: str = "deck"
    jpeg_quality: int = 90
    dark: tuple[float, float] = (0.0, 0.0)


NO_EFFECTS = Effects(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, "none", 95)


class FrameEffects:
    """The effects over one drive.

    Parameters
    ----------
    effects : Effects
        Their strengths.
    t, yaw_rate : ndarray
        Times of the frames, s, and the robot's turn rate at them, rad/s.
    seed : int
        Same seed, same bytes, in whatever order frames are asked for.
    """

    def __init__(self, effects: Effects, t: Floats, yaw_rate: Floats, seed: int) -> None:
        self._effects, self._t, self._yaw_rate, self._seed = effects, t, yaw_rate, seed
        self._gain = _gains(effects, t, np.random.default_rng([seed, 1]))
        self._fixed: tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]] | None = None

    def apply(self, index: int, clean: Frame) -> Frame:
        """What the camera gives for the frame number `index`; uint8 of `clean`'s shape."""
        effects = self._effects
        scale, body = self._fixed_pattern(clean.shape[0], clean.shape[1])
        image = self._blur(clean.astype(np.float32), self._yaw_rate[index])
        image *= scale
        image += body
        dark = effects.dark[0] <= self._t[index] < effects.dark[1]
        image *= np.float32(0.0 if dark else self._gain[index])
        if effects.noise or effects.shot_noise:
            deviation = np.sqrt(effects.noise**2 + effects.shot_noise * np.arange(256)).astype(np.float32)
            level = np.clip(image, 0, 255).astype(np.uint8)
            image += cv2.LUT(level, deviation) * self._noise(index, image.shape)
        np.rint(image, out=image)
        return np.asarray(np.clip(image, 0, 255).astype(np.uint8))

    def _noise(self, index: int, shape: tuple[int, ...]) -> npt.NDArray[np.float32]:
        """(height, width) standard normal noise of one frame."""
        rng = np.random.default_rng([self._seed, 3, index])
        return np.asarray(_QUANTILES[rng.integers(0, _LEVELS, shape, np.uint16)])

    def _blur(self, image: npt.NDArray[np.float32], rate: float) -> npt.NDArray[np.float32]:
        """Smear of the turn during the exposure: three taps of the variance of a box (exact to a shift of 2 px)."""
        smear = rate * self._effects.shutter / (2.0 * np.pi) * image.shape[1]
        side = min(smear**2 / 24.0, 0.25)
        if side < 1e-4:
            return image
        wide = cv2.copyMakeBorder(image, 0, 0, 1, 1, cv2.BORDER_WRAP)
        return np.asarray((1.0 - 2.0 * side) * image + side * (wide[:, :-2] + wide[:, 2:]), np.float32)

    def _fixed_pattern(self, height: int, width: int) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """What the scene is multiplied by, and the body that is added: both fixed in the picture."""
        if self._fixed is None:
            body, cover = robot_body(self._effects.body, width, height)
            # Five lenses side by side, as in a Ladybug: each brightest in its middle.
            lens = np.cos(5.0 * 2.0 * np.pi * (np.arange(width) + 0.5) / width)
            vignette = 1.0 - self._effects.vignette * (0.5 + 0.5 * lens)
            self._fixed = (vignette * (1.0 - cover)).astype(np.float32), body * cover
        return self._fixed


def encode_jpeg(image: Frame, quality: int) -> bytes:
    """`image` as a JPEG file."""
    return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1])


def _gains(effects: Effects, t: Floats, rng: np.random.Generator) -> Floats:
    """Brightness over time: a slow drift, and steps where the exposure control acts."""
    if t.size < 2:
        return np.ones_like(t)
    step = float(np.median(np.diff(t)))
    gain = effects.exposure * wander(rng, t.size, step, 10.0)
    for _ in range(rng.poisson(effects.exposure_steps * (t[-1] - t[0]))):
        gain = gain + np.where(t >= rng.uniform(t[0], t[-1]), rng.uniform(-0.2, 0.2), 0.0)
    return np.asarray(np.exp(gain), np.float64)
