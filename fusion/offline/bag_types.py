"""The types of a bag's messages: the standard ones, and others as the bag itself defines them."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from functools import cache, cached_property
from typing import Any, Literal

from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from fusion.offline.bag_messages import VIDEOS

_SEPARATOR = "=" * 80 + "\n"


class BagTypes:
    """Types by name; what a bag says of types that nobody asks for is not even read.

    Parameters
    ----------
    connections : iterable of Connection
        Of the bag.
    ros : 1 or 2
        Whose messages they are.
    """

    def __init__(self, connections: Iterable[Connection], ros: Literal[1, 2]) -> None:
        self._connections = list(connections)
        self.standard = _standard(ros)

    def check(self, connection: Connection) -> None:
        """Refuse a topic whose own definition of a standard type is another one: its fields would mean something else.

        Raises
        ------
        ValueError
            It is. Of a text that cannot be read the library raises exceptions of every kind.
        """
        ours, own = self.standard.fielddefs, _defined(connection)
        # constants, the first of the two, are none of a message's bytes
        if any(fields[1] != ours[name][1] for name, fields in own.items() if name in ours):
            raise ValueError(f"its definition of {connection.msgtype.replace('/msg/', '/')} is not the standard one")

    def has_header(self, msgtype: str) -> bool:
        """Whether messages of this type begin with a ``std_msgs/Header``, or a stamp alone, and so have one."""
        fields = (self.standard if msgtype in self.standard.fielddefs else self.all).fielddefs.get(msgtype, ((), ()))[1]
        return bool(fields) and (fields[0][0] == "header" or msgtype in VIDEOS)

    @cached_property
    def all(self) -> Any:
        """The types as the bag defines them as far as that can be read, else the standard ones."""
        fields = dict(self.standard.fielddefs)
        for connection in self._connections:
            with suppress(Exception):  # the library's parser meets odd texts with exceptions of every kind
                fields |= _defined(connection)
        types = get_typestore(Stores.EMPTY)
        types.register(fields)
        return types


@cache
def _standard(ros: Literal[1, 2]) -> Any:
    """The types that come with ROS, and packets of videos."""
    types = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_JAZZY)
    for msgtype, fields in VIDEOS.items():
        types.register(get_types_from_msg(fields, msgtype))
    return types


def _defined(connection: Connection) -> dict[str, Any]:
    """Types as the bag defines them, that of a topic and those that it is made of."""
    definition, types = connection.msgdef, {}
    text = definition.data.replace("\r\n", "\n")
    if text.strip() and definition.format == MessageDefinitionFormat.MSG:
        types = get_types_from_msg(text, connection.msgtype)
    elif text.strip() and definition.format == MessageDefinitionFormat.IDL:
        for part in text.split(_SEPARATOR):
            idl = part.split("\n", 1)[1] if part.startswith("IDL: ") else part
            types |= get_types_from_idl(idl) if idl.strip() else {}
    return types
