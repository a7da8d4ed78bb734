"""Many recordings from few words: files, folders to search, patterns and URLs; and a folder for the results of each."""

from __future__ import annotations

import glob
import hashlib
import logging
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from urllib.parse import urlsplit

from compass.files import is_folder, real
from fusion.offline.earlier_results import SUMMARY, EarlierResult, earlier_result
from fusion.offline.folder import ImageFolder, refuse_pictures
from fusion.offline.remote import find_urls, is_url
from fusion.offline.source import source_of
from fusion.offline.storage import WANTED, BagError, find_files

log = logging.getLogger(__name__)

METADATA = "metadata.yaml"  # of a rosbag2 folder
SUFFIXES = (".bag", ".mcap", ".db3")  # by which bags are found in a folder that is searched
PACKED = (".zstd", ".zst")  # may follow these
_PATTERN = "*?["


def find_bags(words: Sequence[str], leave_out: Path | None = None) -> list[str]:
    """Absolute paths and URLs of the recordings that `words` name, each once, in this order.

    Parameters
    ----------
    words : sequence of str
        Bags, folders with bags anywhere below them, patterns such as ``'2024-*/*.mcap'`` (``**`` for any depth), URLs.
    leave_out : Path, optional
        A folder that is not searched: that of the results.

    Raises
    ------
    BagError
        A word names nothing.
    """
    found: list[str] = []
    for word in words:
        if not word.strip():
            raise BagError(f"{word!r} names nothing, as a shell's variable that is not set; {WANTED}")
        if is_url(word):
            found += [word] if named_like_a_bag(word) and "*" not in word else find_urls(word, named_like_a_bag)
        elif any(sign in word for sign in _PATTERN) and not os.path.lexists(word):
            paths = sorted(glob.glob(word, recursive=True))
            if not paths:
                raise BagError(f"{word}: no file of that pattern; {WANTED}")
            found += [absolute(Path(path)) for path in paths if not _is_result(Path(path))]
        else:
            found += [absolute(path) for path in bags_below(Path(word), leave_out)]
    if not found:
        raise BagError(f"{' '.join(words)}: nothing but results of earlier runs; {WANTED}")
    return list(dict.fromkeys(found))


def absolute(path: Path) -> str:
    """An absolute path without ``..`` and ``.``, so that one bag named twice is one; links keep their names."""
    plain = os.path.abspath(path)
    return plain if real(Path(plain)) == real(path) else str(path.absolute())


def bags_below(path: Path, leave_out: Path | None = None) -> list[Path]:
    """The recordings in a folder and below it; `path` itself if it is one, or nothing to search.

    Raises
    ------
    BagError
        It is a folder without any.
    """
    if not is_folder(path) or (path / METADATA).exists() or ImageFolder.is_one(path):
        return [path]
    found = _search(path, real(leave_out) if leave_out else None)
    if len(found) == 1 and found[0].parent == path:
        return [path]  # the folder of a recording whose metadata is missing
    if not found:
        refuse_pictures(path)
        raise BagError(f"{path}: no bag in it or below it; {WANTED}")
    return found


def _search(folder: Path, leave_out: Path | None, *, inner: bool = False) -> list[Path]:
    """By name, in the order of names; nothing hidden, no results of ours, no links to folders.

    An `inner` folder that cannot be read is passed over.
    """
    try:
        entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
    except OSError as error:
        if not inner:
            raise BagError(f"{folder}: cannot be read: {error.strerror}") from None
        log.warning("%s: passed over: %s", folder, error.strerror)  # such as lost+found
        return []
    if any(entry.name == METADATA for entry in entries):
        return [folder]
    if any(entry.name == SUMMARY for entry in entries) and _is_result(folder):
        return []
    files = [folder / entry.name for entry in entries if named_like_a_bag(entry.name) and os.path.isfile(entry)]
    files = [folder] if len(files) > 1 and _is_one_recording(folder) else files
    below = [
        bag
        for entry in entries
        if entry.is_dir(follow_symlinks=False)
        and not entry.name.startswith(".")
        and real(folder / entry.name) != leave_out
        for bag in _search(folder / entry.name, leave_out, inner=True)
    ]
    return files + below


def named_like_a_bag(name: str) -> bool:
    """Whether a file has the name of a bag, compressed or not."""
    plain = name.lower()
    for end in PACKED:
        plain = plain.removesuffix(end)
    return not plain.startswith(".") and plain.endswith(SUFFIXES)


def _is_one_recording(folder: Path) -> bool:
    """Whether the files of a folder are the parts of one recording, numbered."""
    try:
        return len(find_files(folder)[0]) > 1
    except BagError:
        return False


def _is_result(path: Path) -> bool:
    """Whether a folder holds results of ours, or a file is one of them."""
    folder = path if is_folder(path) else path.parent
    return (folder / SUMMARY).exists() and earlier_result(folder) is not None


# ---------------------------------------------------------------- folders for the results


def name_folders(bags: Sequence[str], there: Mapping[str, EarlierResult | None]) -> dict[str, str]:
    """A folder's name for each bag, no two alike: ``drive_yaw``, with its parents in front where it must be.

    Parameters
    ----------
    bags : sequence of str
        Absolute paths and URLs.
    there : mapping of str to EarlierResult or None
        What is in the folder of the results by now, by name; None for what is no result. A bag keeps the name that it
        got in an earlier run, also after it has moved.
    """
    wanted = set(bags)
    named = {
        one.source.path: name
        for name, one in there.items()
        if one and one.source.path in wanted and name in _names(one.source.path)  # else somebody made it on purpose
    }
    taken = {name.casefold() for name in named.values()}
    others = {name.casefold(): one for name, one in there.items() if name.casefold() not in taken}
    waiting, level = [bag for bag in bags if bag not in named], 0
    while waiting:
        often = Counter(_name(bag, level).casefold() for bag in bags)
        for bag in waiting:
            name = _name(bag, level)
            key = name.casefold()
            if often[key] == 1 and key not in taken and (key not in others or _is_of(others[key], bag)):
                named[bag] = name
                taken.add(key)
        waiting, level = [bag for bag in waiting if bag not in named], level + 1
    return {bag: named[bag] for bag in bags}


def _parts(bag: str) -> list[str]:
    return [part for part in (urlsplit(bag).path if is_url(bag) else bag).split("/") if part] or ["bag"]


def _names(bag: str) -> list[str]:
    """All that a bag's folder may be called, but for further hashes."""
    return [_name(bag, level) for level in range(2 * len(_parts(bag)) + 1)]


def _name(bag: str, level: int) -> str:
    """Names that tell ever more: stem, file name; each with one parent more; and at last a hash."""
    parts = _parts(bag)
    parents, whole = divmod(level, 2)
    if parents >= len(parts):
        return f"{stem(parts[-1])}_{hashlib.sha256(os.fsencode(f'{level} {bag}')).hexdigest()[:8]}_yaw"
    last = parts[-1] if whole else stem(parts[-1])
    return "_".join([*parts[len(parts) - 1 - parents : -1], last, "yaw"])


def stem(name: str) -> str:
    """A bag's name without what says how it is stored."""
    for end in PACKED:
        name = name.removesuffix(end)
    return Path(name).stem


def _is_of(result: EarlierResult | None, bag: str) -> bool:
    """Whether a result is that of a bag which lay elsewhere then."""
    if result is None or is_url(bag):
        return False
    try:
        return result.source.same_as(source_of(Path(bag)))
    except BagError:
        return False


def results_in(folder: Path) -> dict[str, EarlierResult | None]:
    """All that is in a folder, by name: results, without their summaries, and None for the rest."""
    found: dict[str, EarlierResult | None] = {}
    for name in names_in(folder):
        one = earlier_result(folder / name)
        found[name] = one and replace(one, summary={})
    return found


def names_in(folder: Path) -> list[str]:
    """The names in a folder, in order, but for what is hidden; none where there is no folder.

    Raises
    ------
    BagError
        It cannot be read.
    """
    try:
        return sorted(entry.name for entry in os.scandir(folder) if not entry.name.startswith("."))
    except FileNotFoundError:
        return []
    except OSError as error:
        raise BagError(f"{folder}: cannot be read: {error.strerror}; give another --out") from None
