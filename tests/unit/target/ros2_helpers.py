"""Makes ROS 2 messages with mcap-ros2-support, an independent CDR codec, and Zenoh sessions."""

import re
from contextlib import contextmanager
from functools import cache
from types import SimpleNamespace

import zenoh
from mcap_ros2._dynamic import generate_dynamic, serialize_dynamic

from bridge.zenoh import zenoh_link
from logs.schema.schemas import schema_text
from tests.processes.ports import free_endpoint, free_port

ODOMETRY = "nav_msgs/msg/Odometry"
POSE = "geometry_msgs/msg/PoseStamped"
POSE_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
GID = bytes(range(16))


def space(**fields):
    return SimpleNamespace(**fields)


@cache
def encoder(name):
    return serialize_dynamic(name, schema_text(name))[name]


@cache
def decoder(name):
    return generate_dynamic(name, schema_text(name))[name]


def encode(name, message):
    return encoder(name)(message)


def decode(name, payload):
    return decoder(name)(payload)


def header(stamp_ns, frame_id):
    sec, nanosec = divmod(stamp_ns, 10**9)
    return space(stamp=space(sec=sec, nanosec=nanosec), frame_id=frame_id)


def quaternion(q):
    return space(w=q[0], x=q[1], y=q[2], z=q[3])


def vector(v):
    return space(x=v[0], y=v[1], z=v[2])


def pose(position, q=(1.0, 0.0, 0.0, 0.0)):
    return space(position=vector(position), orientation=quaternion(q))


def pose_stamped(stamp_ns, frame_id, position, q=(1.0, 0.0, 0.0, 0.0)):
    return encode(POSE, space(header=header(stamp_ns, frame_id), pose=pose(position, q)))


def pose_covariance(stamp_ns, frame_id, position, covariance, q=(1.0, 0.0, 0.0, 0.0)):
    body = space(pose=pose(position, q), covariance=list(covariance))
    return encode(POSE_COVARIANCE, space(header=header(stamp_ns, frame_id), pose=body))


def odometry(
    stamp_ns, frame_id="odom", child="base_footprint", position=(0.0, 0.0, 0.0), q=(1.0, 0.0, 0.0, 0.0),
    linear=(0.0, 0.0, 0.0), angular=(0.0, 0.0, 0.0), pose_cov=(0.0,) * 36, twist_cov=(0.0,) * 36,
):  # fmt: skip
    twist = space(linear=vector(linear), angular=vector(angular))
    message = space(
        header=header(stamp_ns, frame_id),
        child_frame_id=child,
        pose=space(pose=pose(position, q), covariance=list(pose_cov)),
        twist=space(twist=twist, covariance=list(twist_cov)),
    )
    return encode(ODOMETRY, message)


def on_free_ports(text):
    """Return the commands with each port 74xx and 14xxx replaced by a free port."""
    found = set(re.findall(r":(74\d\d|14\d\d\d)\b", text))
    free = {port: free_port(udp=port.startswith("14")) for port in found}  # ports 74xx use TCP
    return re.sub(r":(74\d\d|14\d\d\d)\b", lambda match: f":{free[match[1]]}", text)


def rmw_session(endpoint):
    """Open a Zenoh session as rmw_zenoh does (DEFAULT_RMW_ZENOH_SESSION_CONFIG.json5)."""
    config = zenoh.Config.from_json5(f'''{{
        mode: "peer",
        connect: {{ endpoints: ["{endpoint}"] }},
        listen: {{ endpoints: ["tcp/localhost:0"] }},
        scouting: {{
            multicast: {{ enabled: false }},
            gossip: {{ enabled: true, target: {{ router: ["router", "peer"], peer: ["router"] }} }},
        }},
        timestamping: {{ enabled: {{ router: true, peer: true, client: true }} }},
    }}''')
    return zenoh.open(config)


@contextmanager
def network(nodes=1):
    """Yield the endpoint of a Zenoh router, this project's client session, and sessions of ROS 2 nodes."""
    endpoint = free_endpoint()
    sessions = [zenoh_link.open_session([endpoint], role=zenoh_link.Role.ROUTER)]
    try:
        sessions.append(zenoh_link.open_session(connect=[endpoint], role=zenoh_link.Role.CLIENT))
        sessions += [rmw_session(endpoint) for _ in range(nodes)]
        yield (endpoint, *sessions[1:])
    finally:
        for session in reversed(sessions):
            session.close()
