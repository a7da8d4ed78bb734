"""Why messages, images and rows could not be used, counted by reason."""

from __future__ import annotations

import re
from collections import Counter

_NUMBER = re.compile(r"\d+")


def count_reason(counted: Counter[str], reason: str) -> None:
    """Count one more; reasons that differ by their numbers alone are one, in the words of the first.

    ``compressed image of 4711 bytes is corrupt`` is another one for each image else, and a summary of as many lines.
    """
    if reason not in counted:
        form = _NUMBER.sub("#", reason)
        reason = next((known for known in counted if _NUMBER.sub("#", known) == form), reason)
    counted[reason] += 1
