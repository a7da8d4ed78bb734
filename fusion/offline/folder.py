"""A folder of images with a ``times.csv`` that says when each was taken."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from compass.errors import ConfigError, ImageError
from compass.files import is_folder, read_bounded
from compass.images.decode import image_from_compressed
from fusion.offline.decode import decode_ahead
from fusion.offline.image_files import ImageFileError
from fusion.offline.reasons import count_reason
from fusion.offline.sensor_csv import TIME_COLUMNS, check_length, csv_rows, nanoseconds
from fusion.offline.stamp_check import Span
from fusion.offline.streams import Floats, Frame, Times

TIMES = "times.csv"
WANTED = "wanted file (its name), and t (s) or t_ns"
PICTURES = (".jpg", ".jpeg", ".png")
LARGEST_IMAGE = 200_000_000  # bytes; PNG of the largest panorama that is decoded, in grey, uncompressed, and more


class ImageFolder:
    """Images of a folder by the times of its ``times.csv``; see `fusion.offline.image_files.Images`.

    Raises
    ------
    ImageFileError
        There is no ``times.csv``, or no row of it can be used.
    """

    kind = "folder"

    def __init__(self, path: Path) -> None:
        self.path, self.faults = path, list[str]()
        self._dropped: Counter[str] = Counter()
        self._files = sorted(self._listed(path / TIMES))
        if not self._files:
            why = ", ".join(self._dropped) or "has no rows"
            raise ImageFileError(f"{path / TIMES}: no row can be used: {why}; {WANTED}")

    @staticmethod
    def is_one(path: Path) -> bool:
        """Whether a path is such a folder."""
        return is_folder(path) and (path / TIMES).is_file()

    def _listed(self, times: Path) -> Iterator[tuple[int, str]]:
        """Time, ns, and name of each image."""
        rows = csv_rows(times)
        header = next(rows, [])
        clock = next((name for name in TIME_COLUMNS if name in header), None)
        if clock is None or "file" not in header:
            raise ImageFileError(f"{times}: its columns are {', '.join(header[:20]) or 'none'}; {WANTED}")
        for row in rows:
            try:
                check_length(row, header)
                yield nanoseconds(row[header.index(clock)], clock), row[header.index("file")].strip()
            except (ValueError, IndexError) as error:
                fault = str(error) if isinstance(error, ValueError) else "row too short"
                count_reason(self._dropped, f"{TIMES}: {fault}")

    @property
    def count(self) -> int:
        """How many images are listed."""
        return len(self._files)

    def span(self) -> Span:
        """From when to when."""
        return Span(self._files[0][0], self._files[-1][0])

    def frames(self, columns: int, dropped: Counter[str]) -> Iterator[Frame]:
        """Each by its time; what cannot be used is counted in `dropped`."""
        dropped.update(self._dropped)

        def decode(item: tuple[int, str]) -> tuple[Frame | None, str]:
            try:
                data = read_bounded(self.path / item[1], LARGEST_IMAGE, "give a JPEG or PNG")
                return Frame(item[0], image_from_compressed(data, columns)), ""
            except ConfigError:
                return None, "no such file, or none that can be read"
            except ImageError as error:
                return None, str(error)

        for frame, fault in decode_ahead(self._files, decode):
            if frame is None:
                count_reason(dropped, f"image: {fault}")
            else:
                yield frame

    def gyro_readings(self) -> tuple[Times, Floats]:
        """No gyro is inside a folder."""
        raise ImageFileError(f"{self.path}: a folder of images has no gyro inside; give --gyro a CSV file")


def refuse_pictures(path: Path) -> None:
    """Refuse a folder of pictures without times in words that help; they would be looked for a bag in vain."""
    if is_folder(path) and not (path / "metadata.yaml").exists():
        pictures = sum(file.suffix.lower() in PICTURES for file in path.iterdir())
        if pictures > 1:  # a single one is a plot, or a preview
            raise ImageFileError(f"{path}: {pictures} pictures but no {TIMES} to say when they were taken; {WANTED}")
