"""Pictures of a compressed video from its packets, by PyAV: each with the stamp of the packet that it came in."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from compass.errors import ImageError
from compass.images.decode import Image
from compass.images.h264 import UnitReader


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
        self._reader = UnitReader(codec) if codec in ("h264", "hevc") else None
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
        if self._reader:
            self._look(data, self._reader)
        packet = self._av.Packet(data)
        packet.pts = t_ns  # the decoder hands it on to the packet's picture
        return self._decoded(packet)

    def rest(self) -> list[tuple[int, Image]]:
        """Those that the decoder still holds back at the end of the stream; it is then ready for a new one."""
        try:
            return self._decoded(None)
        except ImageError:
            return []
        finally:
            self._start_anew()

    def _look(self, data: bytes, reader: UnitReader) -> None:
        """Whether the packet can be decoded: that it follows the one before, or starts anew."""
        units = reader.read(data)
        if units.frame_num is not None:
            number = units.frame_num
            if self._last is not None and not units.key:
                last, reference = self._last
                if number not in (last, (last + reference) % reader.most):
                    self._start_anew()
            self._last = (number, units.is_reference)
        if self._waits and not (units.key or units.parameters):
            raise self._none("waits for a key frame")
        self._waits = self._waits and not units.key

    def _decoded(self, packet: Any) -> list[tuple[int, Image]]:
        try:
            frames = self._context.decode(packet)
        except self._av.error.FFmpegError as error:
            raise self._damaged(str(error).split("]")[-1].strip()) from None
        if any(frame.is_corrupt for frame in frames):
            raise self._damaged("of a picture a part is missing")
        return [(frame.pts, _grey(frame)) for frame in frames if frame.pts is not None]

    def _damaged(self, why: str) -> ImageError:
        self._start_anew()
        return self._none(f"is damaged ({why}); it waits for a key frame")

    def _none(self, reason: str) -> ImageError:
        self.skipped[reason] += 1
        return ImageError(f"video ({self.codec}) {reason}")

    def _start_anew(self) -> None:
        """Forget what was decoded, but not the parameter sets: some encoders send them once."""
        self._context.flush_buffers()
        self._waits, self._last = True, None


def _grey(frame: Any) -> Image:
    """Luma of a decoded picture."""
    name = frame.format.name
    if name.startswith(("yuv4", "yuvj4", "nv12", "nv21", "gray")) and frame.format.components[0].bits == 8:
        plane = frame.planes[0]
        rows = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)
        return np.array(rows[: frame.height, : frame.width])  # a copy: the decoder uses its memory again
    return np.asarray(frame.to_ndarray(format="gray"), np.uint8)
