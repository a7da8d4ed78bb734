"""Results of an earlier run: of which recording, by which settings, and whether others may take their place."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from compass.errors import ConfigError
from compass.files import is_folder, read_bounded, real
from compass.version import __version__
from fusion.offline.atomic_output import OutputError
from fusion.offline.source import Source
from fusion.settings import Settings

SUMMARY = "summary.json"
ALWAYS = ("yaw.csv", "result.mcap", SUMMARY, "yaw.png", "config.yaml")
# not in the results of every run
OPTIONAL = ("compass.tum", "fused.tum", "smoothed.tum", "truth.tum", "report.html", "run.rrd")
_KINDS = {"settings_hash": str, "yaw": dict, "warnings": list, "images": dict}  # what others rely on
_LARGEST = 64 << 20  # bytes of a summary; warnings make the most of it


@dataclass(frozen=True, slots=True)
class EarlierResult:
    """A folder of results: the recording they are of, the settings they were made by, and their summary."""

    source: Source
    settings_hash: str
    summary: dict[str, Any]

    def is_of(self, source: Source | None) -> bool:
        """Whether it is of this recording, as far as that is known."""
        return source is not None and self.source.same_as(source)


def earlier_result(folder: Path) -> EarlierResult | None:
    """What is in a folder of results; None where it is no such folder."""
    try:
        summary = json.loads(read_bounded(folder / SUMMARY, _LARGEST, "give a folder of results"))
        source = Source(**summary["source"])
        values = (source.path, source.size_bytes, source.content, *(summary[key] for key in _KINDS))
        if not all(map(isinstance, values, (str, int, str, *_KINDS.values()))):
            return None
        return EarlierResult(source, summary["settings_hash"], summary)
    except (ConfigError, ValueError, TypeError, LookupError, RecursionError):  # no file, no JSON, none of ours
        return None


def settings_hash(settings: Settings) -> str:
    """Of all that decides what a run makes of a recording, hexadecimal: version, settings, pixels of the mask."""
    facts: list[Any] = [__version__, settings.to_dict()]
    mask = Path(settings.compass.mask) if settings.compass.mask else None
    if mask is not None and mask.is_file():
        facts.append(hashlib.sha256(mask.read_bytes()).hexdigest())
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()


def check_place(folder: Path, source: Source, *, force: bool = False, inputs: Iterable[Path] = ()) -> None:
    """Refuse a folder in which results would take the place of anything but earlier ones of the same recording.

    Parameters
    ----------
    folder : Path
        Where the results shall go.
    source : Source
        The recording.
    force : bool
        Whether its user gave leave to write there all the same.
    inputs : iterable of Path
        What the run reads: not replaced even by `force`.

    Raises
    ------
    OutputError
        It is refused.
    """
    if not is_folder(folder):
        return  # absent; or refused for what it is where it is written
    try:
        empty = not any(folder.iterdir())
    except OSError as error:
        raise OutputError(f"{folder}: cannot be read: {error.strerror}; give another --out") from None
    earlier = earlier_result(folder)
    if empty or (earlier is not None and earlier.source.same_as(source)):
        return
    if force:
        _spare(inputs, folder)
    elif earlier is None:
        raise OutputError(f"{folder}: is not empty and no earlier result; give another --out, or --force")
    else:
        changed = " as it was before it changed" if earlier.source.path == source.path else ""
        other = f"{folder}: holds the results of {earlier.source.path}{changed}"
        raise OutputError(f"{other}; give another --out, or --force to replace them")


def _spare(inputs: Iterable[Path], folder: Path) -> None:
    """Refuse to replace what is read."""
    place = real(folder)
    for read in inputs:
        if real(read).parent == place and read.name in (*ALWAYS, *OPTIONAL):
            raise OutputError(f"{folder}: a result would take the place of {read}, which is read; give another --out")
