"""Messages of a ROS 1 bag as ROS 2 has them."""

from __future__ import annotations

from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore


class Ros2Converter:
    """Turns serialised ROS 1 messages into CDR.

    Parameters
    ----------
    bag_types : Typestore
        The types as the bag defines them.
    """

    def __init__(self, bag_types: Any) -> None:
        self._bag_types = bag_types
        self._types: Any = get_typestore(Stores.ROS2_JAZZY)
        own = {name: fields for name, fields in bag_types.fielddefs.items() if name not in self._types.fielddefs}
        self._types.register(own)

    def convertible(self, msgtype: str) -> bool:
        """Whether the type has the same fields in ROS 2 as in the bag."""
        if msgtype == "std_msgs/msg/Header":
            return True  # ROS 1 has a seq more, which the conversion knows
        theirs, ours = (types.fielddefs.get(msgtype, ((), ()))[1] for types in (self._bag_types, self._types))
        if [kind for _, kind in theirs] != [kind for _, kind in ours]:
            return False
        return all(self.convertible(name) for name in {_name(kind) for _, kind in theirs} - {""})

    def cdr(self, raw: bytes, msgtype: str) -> bytes:
        """A serialised ROS 1 message as CDR."""
        return bytes(self._types.ros1_to_cdr(raw, msgtype))


def _name(kind: Any) -> str:
    """Name of the message type of a field, or of the elements of an array; empty for plain numbers and text."""
    node, detail = kind
    if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        return _name(detail[0])
    return str(detail) if node == Nodetype.NAME else ""
