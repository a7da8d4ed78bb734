"""Names of image topics, as image_transport gives them: the raw one plain, the compressed one with a suffix."""

from __future__ import annotations

_SUFFIX = "/compressed"


def raw_topic(name: str) -> str:
    """The raw topic of a camera, given either of its topics."""
    return name.removesuffix(_SUFFIX)


def compressed_topic(name: str) -> str:
    """The compressed topic of a camera, given either of its topics."""
    return raw_topic(name) + _SUFFIX
