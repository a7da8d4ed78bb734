"""Videos by name: what drivers and encoders call a codec, and how FFmpeg does."""

from __future__ import annotations

# the first whose part is in the name
CODECS = {
    "264": "h264",
    "avc": "h264",
    "265": "hevc",
    "hevc": "hevc",
    "av1": "av1",
    "vp9": "vp9",
    "vp8": "vp8",
    "mpeg4": "mpeg4",
}


def codec_of(name: str, data: bytes) -> str:
    """FFmpeg's name of the codec that a message names, or of the units that `data` begins with; "" for no video."""
    named = next((codec for part, codec in CODECS.items() if part in name.lower().replace(".", "")), "")
    # Annex B of H.264 and H.265: every unit begins with 00 00 01, before which there may be one zero more
    if data.startswith((b"\0\0\1", b"\0\0\0\1")):
        first = data[data.index(1) + 1 : data.index(1) + 2]
        return named or ("hevc" if first in (b"\x40", b"\x42", b"\x44", b"\x46") else "h264")
    return "" if data.startswith((b"\xff\xd8", b"\x89PNG")) else named
