"""What a JPEG says of itself before it is decoded, and a JPEG of its upper rows alone (ITU-T T.81)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt

Bytes = npt.NDArray[np.uint8]


class Marker(IntEnum):
    """Of T.81, table B.1, what follows 0xff; and of Exif, CIPA DC-008."""

    BASELINE = 0xC0
    EXTENDED_SEQUENTIAL = 0xC1
    END = 0xD9
    SCAN = 0xDA
    RESTART_INTERVAL = 0xDD
    EXIF = 0xE1


@dataclass(frozen=True, slots=True)
class JpegHeader:
    """Of a JPEG file.

    Attributes
    ----------
    width, height : int
        Pixels; 0 where the file does not say.
    height_at : int
        Which byte of the file says the height first.
    is_plain : bool
        Whether rows follow each other once, from top to bottom, without restart markers and Exif data: what is cut
        off below changes nothing above.
    """

    width: int = 0
    height: int = 0
    height_at: int = 0
    is_plain: bool = False

    @staticmethod
    def of(data: Bytes) -> JpegHeader:
        """Of a file's bytes, found as libjpeg finds it; zeros where there is none."""
        return _read(data.tobytes())


def _read(data: bytes) -> JpegHeader:
    at, frame, components, is_plain = 2, JpegHeader(), 0, True
    while (at := data.find(b"\xff", at)) >= 0:
        while data[at : at + 1] == b"\xff":  # any number of them may fill the space before a marker
            at += 1
        marker = data[at] if at < len(data) else Marker.SCAN
        if marker == Marker.SCAN:  # pixels begin; of all components, or there are more scans to come
            is_plain = is_plain and data[at + 3 : at + 4] == bytes([components])
            break
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = (int.from_bytes(data[at + i : at + i + 2], "big") for i in (4, 6))
            frame, components = JpegHeader(width, height, at + 4), int.from_bytes(data[at + 8 : at + 9], "big")
            is_plain = is_plain and marker in (Marker.BASELINE, Marker.EXTENDED_SEQUENTIAL)
        is_plain = is_plain and marker not in (Marker.RESTART_INTERVAL, Marker.EXIF)
        alone = marker in (0x00, 0x01) or 0xD0 <= marker <= 0xD8  # these have no length
        at += 1 if alone else 1 + max(int.from_bytes(data[at + 1 : at + 3], "big"), 2)
    return JpegHeader(frame.width, frame.height, frame.height_at, is_plain and at >= 0)


def upper_rows(data: Bytes, header: JpegHeader, rows: int) -> Bytes | None:
    """The file of so many upper rows, whose pixels are the same; None where that can't be had so.

    It says that it is so high, and libjpeg decodes no further. Without the end marker it does not look for what is
    missing either.
    """
    if not (header.is_plain and 0 < rows < header.height and data[-2:].tobytes() == bytes((0xFF, Marker.END))):
        return None
    cut = data[:-2].copy()
    cut[header.height_at : header.height_at + 2] = rows >> 8, rows & 0xFF
    return cut
