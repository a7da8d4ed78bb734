"""Stamps of images that lie before the newest: single ones are wrong, a row of rising ones is the true time."""

from __future__ import annotations

BELIEVED_BACKWARD = 10  # images in a row whose stamps rise, but lie before a wrong one: by chance 1 in 2^9


class StampOrder:
    """Watches the stamps of images in the order of arrival."""

    def __init__(self) -> None:
        self._earlier_ns: list[int] = []  # stamps before the newest, in a rising row

    def is_backward(self, t_ns: int, newest_ns: int | None) -> bool:
        """Whether an image is to be ignored; `newest_ns` is the stamp of the newest image before, ns."""
        if newest_ns is None or t_ns > newest_ns:
            self._earlier_ns.clear()
            return False
        if self._earlier_ns and t_ns <= self._earlier_ns[-1]:
            self._earlier_ns.clear()
        self._earlier_ns.append(t_ns)
        return not self.went_back

    @property
    def went_back(self) -> bool:
        """Whether the row is long enough: the later stamp was the wrong one."""
        return len(self._earlier_ns) >= BELIEVED_BACKWARD

    def waited_ns(self) -> int:
        """How long images with earlier stamps came before they were believed, ns; begins the next row."""
        waited_ns = self._earlier_ns[-1] - self._earlier_ns[0] if self._earlier_ns else 0
        self._earlier_ns.clear()
        return waited_ns
