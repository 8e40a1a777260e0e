"""Definitions of all message types in the flight log: texts, hashes, and a generic codec.

This stack's types and MAVROS' raw frame are the ``.msg`` files in ``msg/``, which are written by hand.
Standard types come from ``bridge/ros2/standard.msg``; types that this file lacks come from the ROS 2 Jazzy
store of ``rosbags``. Decoded MAVLink messages are made from the dialect when first needed. Writer, reader
and comparison share one store.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from bridge.ros2.codec import MAP, SEPARATOR, Field, Pack, Unpack, fields_of_text, split, standard
from bridge.ros2.codec import codec as cdr_codec

if TYPE_CHECKING:  # the import takes 25 ms, and packing rows does not need it
    from rosbags.typesys.store import Typestore

CONTROLLER_STEP = "flightstack_msgs/msg/ControllerStep"
CONTROLLER_INPUT = "flightstack_msgs/msg/ControllerInput"
CONTROLLER_STATE = "flightstack_msgs/msg/ControllerState"
CONTROLLER_POWER = "flightstack_msgs/msg/ControllerPower"
CONTROLLER_NEIGHBOURS = "flightstack_msgs/msg/ControllerNeighbours"
RECEIVED_STATUS = "flightstack_msgs/msg/ReceivedStatus"
MEMBER_STATUS = "flightstack_msgs/msg/MemberStatus"
FLEET_ECHO = "flightstack_msgs/msg/FleetEcho"
FLEET_PAIR = "flightstack_msgs/msg/FleetPair"
TARGET_SAMPLE = "flightstack_msgs/msg/TargetSample"
LOOP_TIMING = "flightstack_msgs/msg/LoopTiming"
TRUE_STATE = "flightstack_msgs/msg/TrueState"
HEALTH = "flightstack_msgs/msg/Health"
MAVLINK = "mavros_msgs/msg/Mavlink"
LOG = "rcl_interfaces/msg/Log"
ODOMETRY = "nav_msgs/msg/Odometry"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
TWIST_STAMPED = "geometry_msgs/msg/TwistStamped"
TF_MESSAGE = "tf2_msgs/msg/TFMessage"
MARKER_ARRAY = "visualization_msgs/msg/MarkerArray"
STRING = "std_msgs/msg/String"

ROWS = (  # types with a row class in ``rows.py``
    CONTROLLER_STEP, CONTROLLER_INPUT, CONTROLLER_POWER, CONTROLLER_STATE,
    CONTROLLER_NEIGHBOURS, MEMBER_STATUS, FLEET_PAIR, LOOP_TIMING, TRUE_STATE, HEALTH, LOG,
)  # fmt: skip
COLUMNS = (CONTROLLER_STEP, LOOP_TIMING, TRUE_STATE)
_OURS = (TARGET_SAMPLE, RECEIVED_STATUS, FLEET_ECHO, MAVLINK, *(name for name in ROWS if name != LOG))
# decoded MAVLink messages: LOCAL_POSITION_NED is mavlink_msgs/msg/LocalPositionNed
_MAVLINK_MSGS = "mavlink_msgs/msg/"


@cache
def typestore() -> Typestore:
    """Return the store of all types; :func:`store_for` adds decoded MAVLink types when they are needed."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    for name in _OURS:
        store.register(get_types_from_msg(_own_text(name), name))
    return store


@cache
def fields_of(name: str) -> tuple[Field, ...]:
    """Return the fields of a message type, in order."""
    if name in _OURS or name.startswith(_MAVLINK_MSGS):
        return fields_of_text(_own_text(name))
    known = standard(name)
    if known is not None:
        return known
    return fields_of_text(store_for(name).generate_msgdef(name, ros_version=2)[0].split(SEPARATOR)[0])


def same_fields(name: str, text: str) -> bool:
    """Whether a log's definition of a type, and of all types in it, has the fields of this software."""
    texts = {name: text.partition(SEPARATOR)[0], **split(text)}
    return all(fields_of_text(body) == fields_of(kind) for kind, body in texts.items() if kind in _OURS)


def codec(
    schema: str, frame_id: str | None = MAP, make: Callable[[tuple[Any, ...]], Any] = tuple
) -> tuple[Pack, Unpack]:
    """Return packer and unpacker of any type in the log; arguments as in ``bridge.ros2.codec.codec``."""
    return cdr_codec(schema, frame_id, make, fields_of)


@cache
def packer(schema: str, frame_id: str | None = MAP) -> Pack:
    return codec(schema, frame_id)[0]


def store_for(name: str) -> Typestore:
    """Return a store that has the type; a decoded MAVLink type is added. Raises ValueError: unknown type."""
    store = typestore()
    if name not in store.fielddefs and name.startswith(_MAVLINK_MSGS):
        from rosbags.typesys import get_types_from_msg

        with suppress(KeyError):  # not in the dialect
            store.register(get_types_from_msg(_own_text(name), name))
    if name not in store.fielddefs:
        raise ValueError(
            f"unknown message type {name!r}; allowed are ROS 2 Jazzy standard types, {_MAVLINK_MSGS}* of the "
            f"dialect and {', '.join(_OURS)}"
        )
    return store


@cache
def schema_text(name: str) -> str:
    """Return the full ros2msg definition of a type: its text, then every type it uses.

    This stack's types keep their comments, since viewers show them.
    """
    generated: str = store_for(name).generate_msgdef(name, ros_version=2)[0]
    if name not in _OURS and not name.startswith(_MAVLINK_MSGS):
        return generated
    _, separator, used = generated.partition(SEPARATOR)
    return _own_text(name).rstrip("\n") + "\n" + separator + used


@cache
def type_hash(name: str) -> str:
    """Return the ROS 2 type hash (``RIHS01_...``) of a type."""
    return str(store_for(name).hash_rihs01(name))


def _own_text(name: str) -> str:
    if name.startswith(_MAVLINK_MSGS):
        return _mavlink_text(name)
    file = files("logs.schema") / "msg" / f"{name.rpartition('/')[2]}.msg"
    text: str = file.read_text(encoding="ascii")
    return text


def mavlink_class(message_id: int) -> tuple[str, Any] | None:
    """Return ROS 2 type and pymavlink class of a MAVLink message; None: not in the dialect."""
    return _mavlink_classes().get(message_id)


@cache
def _mavlink_classes() -> dict[int, tuple[str, Any]]:
    from bridge.mavlink.codec.messages import MESSAGES  # imported on first use, because the import is slow

    def schema(message: str) -> str:
        return _MAVLINK_MSGS + "".join(word.capitalize() for word in message.split("_"))

    return {message_id: (schema(cls.msgname), cls) for message_id, cls in MESSAGES.items()}


def _mavlink_text(name: str) -> str:
    """Return the definition of a decoded MAVLink message: its fields in wire order, with MAVLink's units.

    Names become lower case, as ROS requires; text of fixed length becomes a string.
    """
    cls = dict(_mavlink_classes().values())[name]
    kinds = dict(zip(cls.fieldnames, cls.fieldtypes, strict=True))
    lines = [
        f"# MAVLink {cls.msgname}, fields in the order of the wire.",
        "",
        "std_msgs/Header header  # stamp = of the raw frame, frame_id = name of its peer",
    ]
    for field, length in zip(cls.ordered_fieldnames, cls.array_lengths, strict=True):
        kind = _ROS_KINDS.get(kinds[field], kinds[field].removesuffix("_t"))
        if length:
            kind = "string" if kinds[field] == "char" else f"{kind}[{length}]"
        comment = cls.fieldunits_by_name.get(field) or cls.fieldenums_by_name.get(field) or ""
        comment = comment.encode("ascii", "replace").decode()
        lines.append(f"{kind} {field.lower()}" + (f"  # {comment}" if comment else ""))
    return "\n".join(lines) + "\n"


_ROS_KINDS = {"char": "uint8", "float": "float32", "double": "float64"}
