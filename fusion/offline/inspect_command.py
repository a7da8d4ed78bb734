"""From the arguments of ``visual-compass inspect`` to its text: of a bag, a video or a folder of images."""

from __future__ import annotations

from pathlib import Path

from fusion.offline.folder import refuse_pictures
from fusion.offline.image_files import ImageFileError
from fusion.offline.inspect import inspect_bag
from fusion.offline.inspect_images import inspect_images
from fusion.offline.open_recording import images_of
from fusion.offline.topics import TopicRequest
from fusion.settings import Settings


def inspected(path: Path, settings: Settings, request: TopicRequest, roi_preview: Path | None) -> str:
    """What is in a recording, and what is wrong with it.

    Raises
    ------
    VisualCompassError
        It cannot be read, or was given what does not fit it.
    """
    images = images_of(path)
    if images is None:
        refuse_pictures(path)
        return inspect_bag(path, settings, request, roi_preview)
    if request != TopicRequest():
        raise ImageFileError(f"{path}: no bag and so without topics; leave --image-topic out")
    return inspect_images(images, settings, roi_preview)
