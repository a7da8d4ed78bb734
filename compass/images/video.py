"""Pictures of a compressed video from its packets, by PyAV: each with the stamp of the packet that it came in."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from compass.errors import ImageError
from compass.images.decode import Image
from compass.images.h264 import UnitReader

# what drivers and encoders call a codec -> how FFmpeg does; the first whose part is in the name
_CODECS = {
    "264": "h264",
    "avc": "h264",
    "265": "hevc",
    "hevc": "hevc",
    "av1": "av1",
    "vp9": "vp9",
    "vp8": "vp8",
    "mpeg4": "mpeg4",
}
_UNITS = ("h264", "hevc")
MOST_WAITING = 64  # pictures that a decoder holds back, and their stamps
WAITS = "waits for a key frame"


def codec_of(name: str, data: bytes) -> str:
    """FFmpeg's name of the codec that a message names, or of the units that `data` begins with; "" for no video."""
    named = next((codec for part, codec in _CODECS.items() if part in name.lower().replace(".", "")), "")
    if data[:3] == b"\0\0\1" or data[:4] == b"\0\0\0\1":
        first = data[data.index(1) + 1 : data.index(1) + 2]
        return named or ("hevc" if first in (b"\x40", b"\x42", b"\x44", b"\x46") else "h264")
    return "" if data[:2] == b"\xff\xd8" or data[:4] == b"\x89PNG" else named


class VideoDecoder:
    """Decodes one stream packet by packet.

    It starts at a key frame, and waits for the next one where a packet was lost or is damaged: what is decoded in
    between would show parts of an older picture.

    Parameters
    ----------
    codec : str
        As `codec_of` gives it.

    Attributes
    ----------
    skipped : Counter of str
        Packets that gave no picture, by reason.

    Raises
    ------
    ImageError
        PyAV is not installed, or has no such decoder.
    """

    def __init__(self, codec: str) -> None:
        try:
            import av
        except ImportError:
            raise ImageError(
                f"images are pieces of a video ({codec}); to decode them install PyAV: pip install "
                "'visual-compass[video]'"
            ) from None
        self.codec = codec
        self.skipped: Counter[str] = Counter()
        self._av: Any = av
        self._stamps: dict[int, int] = {}
        self._count = 0
        self._reader = UnitReader(codec)
        self._context = self._opened()
        self._waits = True
        self._last: tuple[int, bool] | None = None  # frame_num, and whether it was a reference

    def _opened(self) -> Any:
        try:
            context: Any = self._av.CodecContext.create(self.codec, "r")
        except self._av.error.FFmpegError as error:
            raise ImageError(f"PyAV has no decoder for {self.codec}: {error}") from None
        context.thread_count = 1  # more hold pictures back
        context.flags |= self._av.codec.context.Flags.low_delay
        context.options = {"err_detect": "explode"}  # a reference that is missing is an error
        return context

    def decode(self, t_ns: int, data: bytes) -> list[tuple[int, Image]]:
        """Stamps (ns) and grey pictures that a packet completes, in the order in which they were taken.

        Parameters
        ----------
        t_ns : int
            When the packet's picture was taken.
        data : bytes
            All units of one picture.

        Raises
        ------
        ImageError
            There is no picture: the decoder waits for a key frame, or the packet is damaged.
        """
        if self.codec in _UNITS:
            self._look(data)
        packet = self._av.Packet(data)
        self._count += 1
        packet.pts = self._count
        self._stamps[self._count] = t_ns
        while len(self._stamps) > MOST_WAITING:
            del self._stamps[next(iter(self._stamps))]
        return self._decoded(packet)

    def rest(self) -> list[tuple[int, Image]]:
        """Those that the decoder still holds back at the end of the stream; it is then ready for a new one."""
        try:
            return self._decoded(None)
        except ImageError:
            return []
        finally:
            self._start_anew()

    def _look(self, data: bytes) -> None:
        """Whether the packet can be decoded: that it follows the one before, or starts anew."""
        units = self._reader.read(data)
        if units.frame_num is not None:
            number = units.frame_num
            if self._last is not None and not units.key:
                last, reference = self._last
                if number not in (last, (last + reference) % self._reader.most):
                    self._start_anew()
            self._last = (number, units.is_reference)
        if self._waits and not (units.key or units.parameters):
            raise self._none(WAITS)
        self._waits = self._waits and not units.key

    def _decoded(self, packet: Any) -> list[tuple[int, Image]]:
        try:
            frames = self._context.decode(packet)
        except self._av.error.FFmpegError as error:
            self._start_anew()
            raise self._none(f"is damaged ({str(error).split(']')[-1].strip()}); it {WAITS}") from None
        pictures = []
        for frame in frames:
            t_ns = self._stamps.pop(frame.pts, None)
            if frame.is_corrupt:
                self._start_anew()
                raise self._none(f"is damaged; it {WAITS}")
            if t_ns is not None:
                pictures.append((t_ns, _grey(frame)))
        return pictures

    def _none(self, reason: str) -> ImageError:
        self.skipped[reason] += 1
        return ImageError(f"video ({self.codec}) {reason}")

    def _start_anew(self) -> None:
        """Forget what was decoded, but not the parameter sets: some encoders send them once."""
        self._context.flush_buffers()
        self._stamps.clear()
        self._waits, self._last = True, None


def _grey(frame: Any) -> Image:
    """Luma of a decoded picture."""
    name = frame.format.name
    if name.startswith(("yuv4", "yuvj4", "nv12", "nv21", "gray")) and frame.format.components[0].bits == 8:
        plane = frame.planes[0]
        rows = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)
        return np.array(rows[: frame.height, : frame.width])  # a copy: the decoder uses its memory again
    return np.asarray(frame.to_ndarray(format="gray"), np.uint8)
