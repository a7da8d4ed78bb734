"""What the units of an H.264 or H.265 stream are: where a decoder may start, and whether a picture is missing.

ITU-T H.264 (7.3, Annex B) and H.265 (7.4.2.2). A decoder of H.265 says itself that a reference is missing; one of H.264
shows the next picture as if nothing had been lost, although its `frame_num` jumps.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Units:
    """What a packet holds.

    Attributes
    ----------
    key : bool
        A picture that needs no other.
    parameters : bool
        Parameter sets, without which nothing can be decoded.
    frame_num : int or None
        Of the first slice of H.264.
    is_reference : bool
        Whether other pictures may need it.
    """

    key: bool
    parameters: bool
    frame_num: int | None = None
    is_reference: bool = True


class UnitReader:
    """Reads packets of one stream; it remembers how long its frame numbers are."""

    def __init__(self, codec: str) -> None:
        self._hevc = codec == "hevc"
        self._bits = 0  # of frame_num; 0: not known yet
        self.most = 0  # frame numbers, after which they begin anew

    def read(self, data: bytes) -> Units:
        """What a packet holds."""
        key = parameters = False
        frame_num, reference = None, True
        for unit in _units(data):
            if self._hevc:
                kind = unit[0] >> 1 & 0x3F
                key |= 16 <= kind <= 21
                parameters |= 32 <= kind <= 34
                continue
            kind = unit[0] & 0x1F
            key |= kind == 5
            parameters |= kind in (7, 8)
            if kind == 7:
                self._bits = _frame_num_bits(unit)
                self.most = 1 << self._bits
            elif kind in (1, 5) and frame_num is None and self._bits:
                bits = _Bits(unit[1:])
                for _ in range(3):  # first_mb_in_slice, slice_type, pic_parameter_set_id
                    bits.ue()
                frame_num, reference = bits.u(self._bits), bool(unit[0] & 0x60)
        return Units(key, parameters, frame_num, reference)


def _units(data: bytes) -> Iterator[bytes]:
    """The units, without the bytes that keep start codes from occurring in them."""
    for unit in data.split(b"\0\0\1")[1:]:
        if unit:
            yield unit[:1] + unit[1:].replace(b"\0\0\3", b"\0\0")


def _frame_num_bits(unit: bytes) -> int:
    """Length of `frame_num`, from a sequence parameter set."""
    bits = _Bits(unit[4:])
    bits.ue()  # seq_parameter_set_id
    if unit[1] in (100, 110, 122, 244, 44, 83, 86, 118, 128):  # profiles that tell more: H.264, 7.3.2.1.1
        chroma = bits.ue()
        if chroma == 3:
            bits.u(1)
        bits.ue(), bits.ue(), bits.u(1)  # bit depths, transform bypass
        if bits.u(1):  # scaling matrices
            for index in range(12 if chroma == 3 else 8):
                if bits.u(1):
                    _skip_scaling_list(bits, 16 if index < 6 else 64)
    return min(bits.ue() + 4, 16)


def _skip_scaling_list(bits: _Bits, size: int) -> None:
    last = scale = 8
    for _ in range(size):
        if scale:
            scale = (last + bits.se()) % 256
        last = scale or last


class _Bits:
    """Bits of a unit, most significant first; zeros after its end."""

    def __init__(self, data: bytes) -> None:
        self._value, self._left = int.from_bytes(data, "big"), 8 * len(data)

    def u(self, count: int) -> int:
        """An unsigned number of so many bits."""
        self._left -= count
        shifted = self._value >> self._left if self._left >= 0 else self._value << -self._left
        return shifted & ((1 << count) - 1)

    def ue(self) -> int:
        """An unsigned Exp-Golomb number."""
        zeros = 0
        while zeros < 32 and self._left > 0 and not self.u(1):
            zeros += 1
        return (1 << zeros) - 1 + self.u(zeros)

    def se(self) -> int:
        """A signed one."""
        code = self.ue()
        return (code + 1) // 2 if code % 2 else -(code // 2)
