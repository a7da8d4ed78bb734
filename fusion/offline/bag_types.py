"""The types of a bag's messages: the standard ones, and others as the bag itself defines them."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
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
        self._ros = ros
        self._connections = list(connections)
        self.standard: Any = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_JAZZY)
        for msgtype, fields in VIDEOS.items():
            self.standard.register(get_types_from_msg(fields, msgtype))

    def check(self, connection: Connection) -> None:
        """Refuse a topic whose own definition of a standard type is another one: its fields would mean something else.

        Raises
        ------
        ValueError
            It is. Of a text that cannot be read the library raises exceptions of every kind.
        """
        msgtype, ours = connection.msgtype, self.standard
        own = _defined(connection) if msgtype in ours.fielddefs else None
        if own and own.generate_msgdef(msgtype, ros_version=self._ros) != ours.generate_msgdef(
            msgtype, ros_version=self._ros
        ):
            raise ValueError(f"its definition of {msgtype.replace('/msg/', '/')} is not the standard one")

    def has_header(self, msgtype: str) -> bool:
        """Whether messages of this type begin with a ``std_msgs/Header``, or a stamp alone, and so have one."""
        fields = (self.standard if msgtype in self.standard.fielddefs else self.all).fielddefs.get(msgtype, ((), ()))[1]
        return bool(fields) and (fields[0][0] == "header" or msgtype in VIDEOS)

    @cached_property
    def all(self) -> Any:
        """The standard types, and those of the bag as far as its definitions can be read."""
        types = get_typestore(Stores.EMPTY)
        types.register(self.standard.fielddefs)
        for connection in self._connections:
            try:
                own = _defined(connection)
            except Exception:  # the library's parser meets odd texts with exceptions of every kind
                continue
            if own:
                types.register({name: fields for name, fields in own.fielddefs.items() if name not in types.fielddefs})
        return types


def _defined(connection: Connection) -> Any:
    """Types as the bag defines them, that of a topic and those that it is made of; None where it does not say."""
    msgtype, definition = connection.msgtype, connection.msgdef
    text = definition.data.replace("\r\n", "\n")
    types = get_typestore(Stores.EMPTY)
    if text.strip() and definition.format == MessageDefinitionFormat.MSG:
        types.register(get_types_from_msg(text, msgtype))
    elif text.strip() and definition.format == MessageDefinitionFormat.IDL:
        for part in text.split(_SEPARATOR):
            idl = part.split("\n", 1)[1] if part.startswith("IDL: ") else part
            types.register(get_types_from_idl(idl) if idl.strip() else {})
    return types if msgtype in types.fielddefs else None
