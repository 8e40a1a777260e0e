"""Message definitions of everything the flight log holds: texts, hashes, and a generic codec.

Standard types come from the ROS 2 Jazzy store of ``rosbags``; ours and MAVROS' raw frame are the ``.msg``
files next to this module. One store serves writer, reader and comparison.
"""

from __future__ import annotations

from functools import cache
from importlib.resources import files

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

CONTROLLER_STEP = "flightstack_msgs/msg/ControllerStep"
LOOP_TIMING = "flightstack_msgs/msg/LoopTiming"
TRUE_STATE = "flightstack_msgs/msg/TrueState"
MAVLINK = "mavros_msgs/msg/Mavlink"
LOG = "rcl_interfaces/msg/Log"
ODOMETRY = "nav_msgs/msg/Odometry"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
TWIST_STAMPED = "geometry_msgs/msg/TwistStamped"
TF_MESSAGE = "tf2_msgs/msg/TFMessage"
MARKER_ARRAY = "visualization_msgs/msg/MarkerArray"

_OURS = {
    CONTROLLER_STEP: "ControllerStep.msg",
    LOOP_TIMING: "LoopTiming.msg",
    TRUE_STATE: "TrueState.msg",
    MAVLINK: "Mavlink.msg",
}
_SEPARATOR = "=" * 80


class UnknownSchemaError(ValueError):
    """A message type that is neither a ROS 2 standard type nor one of ours."""


@cache
def typestore() -> Typestore:
    """Return the one store that knows every type a flight log may hold."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name in _OURS:
        store.register(get_types_from_msg(_own_text(name), name))
    return store


@cache
def schema_text(name: str) -> str:
    """Return the full ros2msg definition of a type: its text, then every type it uses.

    Our own types keep their comments, since viewers show them.

    Args:
        name: Full name, for example ``nav_msgs/msg/Odometry``.

    Raises:
        UnknownSchemaError: No such type.
    """
    generated: str = _known(name).generate_msgdef(name, ros_version=2)[0]
    if name not in _OURS:
        return generated
    _, separator, used = generated.partition(_SEPARATOR)
    return _own_text(name).rstrip("\n") + "\n" + separator + used


@cache
def type_hash(name: str) -> str:
    """Return the ROS 2 type hash (``RIHS01_...``) of a type.

    Raises:
        UnknownSchemaError: No such type.
    """
    return str(_known(name).hash_rihs01(name))


def _known(name: str) -> Typestore:
    store = typestore()
    if name not in store.fielddefs:
        raise UnknownSchemaError(
            f"unknown message type {name!r}; allowed are ROS 2 Jazzy standard types and {', '.join(_OURS)}"
        )
    return store


def _own_text(name: str) -> str:
    text: str = (files("logs") / "msg" / _OURS[name]).read_text(encoding="ascii")
    return text
