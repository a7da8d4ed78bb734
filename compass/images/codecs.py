"""Pictures and videos by how they begin and by name: what drivers and encoders call a codec, and how FFmpeg does."""

from __future__ import annotations

from enum import Enum


class Begins(bytes, Enum):
    """First bytes of a picture's file."""

    JPEG = b"\xff\xd8"
    PNG = b"\x89PNG\r\n\x1a\n"


def codec_of(name: str, data: bytes) -> str:
    """FFmpeg's name of the codec that a message names, or of the units that `data` begins with; "" for no video."""
    codecs = {"264": "h264", "avc": "h264", "265": "hevc", "hevc": "hevc"}
    codecs |= {codec: codec for codec in ("av1", "vp9", "vp8", "mpeg4")}
    named = next((codec for part, codec in codecs.items() if part in name.lower().replace(".", "")), "")
    # Annex B of H.264 and H.265: every unit begins with 00 00 01, before which there may be one zero more
    if data.startswith((b"\0\0\1", b"\0\0\0\1")):
        first = data[data.index(1) + 1 : data.index(1) + 2]
        return named or ("hevc" if first in (b"\x40", b"\x42", b"\x44", b"\x46") else "h264")
    return "" if data.startswith(tuple(Begins)) else named
