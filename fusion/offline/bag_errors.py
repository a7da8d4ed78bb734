"""What an exception of the bag library means to the user."""

from __future__ import annotations

import errno
from collections.abc import Mapping
from pathlib import Path

from fusion.offline.storage import MCAP, ROS1, kind_of

_CUT = ("truncated", "end magic", "endoffile", "index", "could not read", "expected", "malformed", "footer", "seek")
_LONGEST = 120  # characters of what the library says
OURS = "only those of ROS are read: cdr by ros2msg or ros2idl, and ros1 by ros1msg"


def explain(error: Exception, path: Path, names: Mapping[str, str]) -> str:
    """Whether the file ends too early, or is of another system, and what helps.

    Parameters
    ----------
    error : Exception
        Of the bag library, whose parsers meet hostile bytes with exceptions of every kind.
    path : Path
        The bag.
    names : mapping of str to str
        How the files that are read are called by the user.
    """
    detail = " ".join(str(error).split()).rstrip(".") or type(error).__name__
    for readable, name in names.items():
        detail = detail.replace(readable, name)
    if len(detail) > _LONGEST:  # some quote all definitions of a bag
        detail = f"{detail[: _LONGEST - 4]} ..."
    if isinstance(error, OSError) and error.strerror and error.errno != errno.EINVAL:  # a place beyond all files
        return f"cannot be read: {error.strerror}"
    if "missing tables" in detail:
        return "an SQLite database, but no bag: it has no tables 'messages' and 'topics'"
    if path.name.endswith(".active"):
        return f"the recorder did not finish it ({detail}); {remedy(path)}"
    cut = any(word in detail.lower() for word in _CUT)
    return f"bag is {'truncated or ' if cut else ''}damaged ({detail}); {remedy(path)}"


def remedy(path: Path) -> str:
    """The tool that saves what can be saved of a bag."""
    kind = "" if path.is_dir() else kind_of(path)
    if kind == ROS1:
        return f"'rosbag reindex {path.name}' may save it"
    if kind == MCAP:
        return f"'mcap recover {path.name} -o saved.mcap' may save it"
    return f"'ros2 bag reindex {path.name}' may save it"
