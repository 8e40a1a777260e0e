"""Derives the messages for viewers: standard ROS messages from controller steps and from MAVLink frames.

The messages of a :class:`Deriver` let any viewer show the flight in 3-D. They contain only data of the steps,
the configuration and the metadata of the run. The log time of the steps alone determines which messages are
derived: two runs with equal steps give equal messages. Frames: ``map`` is the ENU world, ``map_ned`` the same
origin with NED axes, ``<ns>/base_link`` the vehicle (heading only), ``<ns>/target`` the pad with its heading,
``<ns>/target_pad`` the pad without heading: the boundary h = 0 does not move in this frame.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

from bridge.ros2.cdr import NO_COVARIANCE
from flightstack.common.strict_toml import ConfigError
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.types import ZERO, Vec3
from logs.reader.flight_data import ATTACHMENT, read_config, sizes_of
from logs.recorder import markers
from logs.schema import split
from logs.schema.events import pack_string
from logs.schema.mavlink import Record, decoder, unpack_mavlink
from logs.schema.rows import ControllerStepRow
from logs.schema.schemas import (
    CONTROLLER_STEP,
    MARKER_ARRAY,
    MAVLINK,
    ODOMETRY,
    POSE_STAMPED,
    STRING,
    TF_MESSAGE,
    TWIST_STAMPED,
    packer,
)

PERIOD_NS = 20_000_000  # period of 50 Hz, the refresh rate of a screen
MARKER_PERIOD_NS = 200_000_000  # period of 5 Hz, since marker messages are large
STATIC_PERIOD_NS = 5_000_000_000  # period of static transforms; a viewer needs them after a jump in the log

TOPICS_MAX = 512  # maximum number of derived topics, since a sender can invent system ids

Derived = tuple[str, str, bytes]  # fields: topic, schema, CDR payload
Derive = Callable[[int, bytes], list[Derived]]  # arguments: log time, ns, and CDR payload
# fields: topic, schema, function that converts a frame to its CDR payload
_Decoder = tuple[str, str, Callable[[Record], bytes]]

_NO_ROTATION = (0.0, 0.0, 0.0, 1.0)
# attitude of the NED axes in ENU: a half turn about the horizontal line between east and north
_NED_IN_ENU = (math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0)


class Deriver:
    def __init__(self, member: str) -> None:
        """Derive the messages of a member under its name space, for example ``cf1``."""
        self._space = f"/{member}"
        self._base, self._target = f"{member}/base_link", f"{member}/target"
        self._run: dict[str, str] = {}
        self._config: FlightConfig | None = None
        # the packers are created before the flight, because the first packer of a type takes milliseconds
        self._pack = {kind: packer(kind) for kind in (TF_MESSAGE, ODOMETRY, POSE_STAMPED, TWIST_STAMPED)}
        self._pack_markers = packer(MARKER_ARRAY, frame_id=None)
        self._own_path, self._target_path = markers.Path(), markers.Path()
        self._slots: dict[int, int] = {}
        self.configure({})

    def configure(self, run: Mapping[str, str], config: FlightConfig | None = None) -> None:
        """Add metadata of the run, which are shown as text, and set the sizes of barrier and pad."""
        self._run.update(run)
        self._config = config or self._config
        self._shapes = markers.shapes(self._base, self._target, sizes_of(self._config, self._run))
        self._run_text = pack_string("\n".join(f"{key} = {value}" for key, value in self._run.items()))

    def step(self, log_time_ns: int, row: ControllerStepRow) -> list[Derived]:
        """Return the messages for one controller step; empty if no message is due at this time."""
        if not self._due(PERIOD_NS, log_time_ns):
            return []
        stamp_ns, space = row.stamp_ns, self._space
        made: list[Derived] = []

        def add(topic: str, schema: str, value: Sequence[object]) -> None:
            made.append((topic, schema, self._pack[schema](value)))

        if self._due(STATIC_PERIOD_NS, log_time_ns):
            add("/tf_static", TF_MESSAGE, ([(stamp_ns, "map_ned", (ZERO, _NED_IN_ENU))],))
            if self._run:
                made.append((f"{space}/run", STRING, self._run_text))
        own = row.own_position_enu_m, _heading(row.own_yaw_rad)
        target = row.target_position_enu_m, _heading(row.target_yaw_rad)
        frames = [(stamp_ns, self._base, own)] if row.own_valid else []
        if row.target_valid:
            pad = row.target_position_enu_m, _NO_ROTATION
            frames += [(stamp_ns, self._target, target), (stamp_ns, f"{self._target}_pad", pad)]
        if frames:
            add("/tf", TF_MESSAGE, (frames,))
        if row.own_valid:
            add(f"{space}/pose", POSE_STAMPED, (stamp_ns, own))
            # turn rates are zero, because a controller step does not contain them
            twist = (_body_velocity(row), ZERO)
            odometry = (stamp_ns, self._base, (own, NO_COVARIANCE), (twist, NO_COVARIANCE))
            add(f"{space}/odom", ODOMETRY, odometry)
            self._own_path.add(log_time_ns, row.own_position_enu_m)
        if row.target_valid:
            add(f"{space}/target/pose", POSE_STAMPED, (stamp_ns, target))
            self._target_path.add(log_time_ns, row.target_position_enu_m)
        sent = (("velocity", row.command_enu_m_s),) if row.setpoint_sent else ()
        for name, velocity_m_s in (
            ("velocity_nominal", row.nominal_enu_m_s), ("velocity_filtered", row.filtered_enu_m_s), *sent,
        ):  # fmt: skip
            add(f"{space}/cmd/{name}", TWIST_STAMPED, (stamp_ns, (velocity_m_s, ZERO)))
        if self._due(MARKER_PERIOD_NS, log_time_ns):
            own_path = self._own_path.marker(0, markers.OWN_COLOR)
            target_path = self._target_path.marker(1, markers.TARGET_COLOR)
            shown = [path for path in (own_path, target_path) if path is not None]
            shown += markers.scene(row, self._shapes, self._base)
            packed = self._pack_markers(([markers.values(stamp_ns, marker) for marker in shown],))
            made.append((f"{space}/cbf/markers", MARKER_ARRAY, packed))
        return made

    def _due(self, period_ns: int, log_time_ns: int) -> bool:
        slot = log_time_ns // period_ns
        if self._slots.get(period_ns) == slot:
            return False
        self._slots[period_ns] = slot
        return True


def _heading(yaw_rad: float) -> tuple[float, float, float, float]:
    return (0.0, 0.0, math.sin(0.5 * yaw_rad), math.cos(0.5 * yaw_rad))


def _body_velocity(row: ControllerStepRow) -> Vec3:
    """Rotate the world velocity into the vehicle's heading frame: a ROS twist is in the child's frame."""
    x, y, z = row.own_velocity_enu_m_s
    cos_yaw, sin_yaw = math.cos(row.own_yaw_rad), math.sin(row.own_yaw_rad)
    return (cos_yaw * x + sin_yaw * y, cos_yaw * y - sin_yaw * x, z)


def frame_decoder(topic: str, spaces: Mapping[str, str] = MappingProxyType({})) -> Derive:
    """Return the function that converts a topic's raw frames into messages with named fields.

    ``spaces``: name spaces of the vehicles by the first part of the topic.
    """
    first = topic.strip("/").partition("/")[0]
    known: dict[tuple[int, int, int], _Decoder | None] = {}  # None: the dialect lacks the message

    def derive(log_time_ns: int, payload: bytes) -> list[Derived]:
        del log_time_ns
        record = unpack_mavlink(payload)
        key = system, component, message_id = (*record.sender, record.message_id)
        if key not in known and len(known) < TOPICS_MAX:
            found = decoder(message_id)
            space = f"/{spaces.get(first, first)}/mavlink/sys{system}/comp{component}"
            known[key] = None if found is None else (f"{space}/{found[0]}", *found[1:])
        if (decodes := known.get(key)) is None:
            return []
        name, schema, decode = decodes
        return [(name, schema, decode(record))]

    return derive


class Derivers:
    """Derives messages from the records of all clients of a recorder, also after a client has reconnected."""

    def __init__(self) -> None:
        self._spaces: dict[str, str] = {}  # name spaces by the first part of the topics of frames
        self._members: dict[str, Deriver] = {}
        self._frames: dict[str, Derive] = {}

    def _member(self, name: str) -> Deriver:
        if name not in self._members:
            self._members[name] = Deriver(name)
        return self._members[name]

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Use the metadata of a run or of an onboard process; ignore other metadata."""
        member, name = split(name)
        if name == "run":
            self._member(member).configure(values)
        elif name == "onboard":  # this record is sent before the first frame
            self._spaces[f"uas{values.get('system_id', '1')}"] = values.get("namespace", member)

    def attachment(self, name: str, data: bytes) -> None:
        member, name = split(name)
        if name == ATTACHMENT:
            with contextlib.suppress(ConfigError):  # an incompatible version: no boundary is drawn
                self._member(member).configure({}, read_config(data))

    def declare(self, topic: str, schema: str) -> Derive | None:
        """Return the function that derives messages from a channel; None: no messages are derived."""
        if schema == CONTROLLER_STEP:
            step = self._member(topic.removesuffix("/controller/step").strip("/")).step
            return lambda log_time_ns, payload: step(log_time_ns, ControllerStepRow.unpack(payload))
        if schema == MAVLINK:
            return self._frames.setdefault(topic, frame_decoder(topic, self._spaces))
        return None
