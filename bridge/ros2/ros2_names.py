"""ROS 2 on Zenoh: sessions, the names of rmw_zenoh and the DDS bridge, and nodes of this process.

In rmw_zenoh each node and each publisher has a liveliness token; a sample is CDR with an attachment.

Layouts: rmw_zenoh docs/design.md and detail/liveliness_utils.cpp (Jazzy from 0.2.4, Kilted, Lyrical);
zenoh-plugin-ros2dds ros2_utils.rs. Name rules: rmw validate_full_topic_name.c.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import xxhash

from bridge.zenoh import zenoh_link
from bridge.zenoh.zenoh_link import pack_attachment

DOMAIN_MAX = 232  # maximum domain id, due to the DDS ports (ROS 2 documentation, "The ROS_DOMAIN_ID")
TOPIC_LENGTH_MAX = 247  # maximum length of a topic name (rmw validate_full_topic_name.h)
NO_HASH = "TypeHashNotSupported"  # placeholder of ROS 2 Humble, which has no type hashes
QOS_KEEP_10 = "::,10:,:,:,,"  # reliable, volatile, keep last 10; empty means rmw_zenoh's default (qos.cpp)
_TOPIC = re.compile(r"(?:/[A-Za-z_][A-Za-z0-9_]*)+")
_HASH = rf"RIHS01_[0-9a-f]{{64}}|{NO_HASH}"
_KEY = re.compile(
    rf"(0|[1-9][0-9]{{0,2}})({_TOPIC.pattern})/([A-Za-z]\w*)::msg::dds_::([A-Za-z]\w*)_/({_HASH})", re.ASCII
)


class TopicKey(NamedTuple):
    domain: int
    topic: str  # name of the topic with its leading slash
    type_name: str  # type in the form package/msg/Name
    type_hash: str


class Node(NamedTuple):
    """A ROS 2 node in the graph."""

    domain: int
    session: str  # id of the Zenoh session, as Zenoh prints it
    name: str
    namespace: str = "/"

    def token(self, number: int, kind: str, *tail: str) -> str:
        """Return a liveliness token, for ``ros2 node list`` and ``ros2 topic list``.

        ``number`` is unique in the session; ``kind`` is NN for the node itself, MP for a publisher.
        """
        begin = ("@ros2_lv", str(self.domain), self.session, "0", str(number), kind)
        return "/".join((*begin, "%", _mangle(self.namespace), self.name, *tail))  # "%": no enclave

    def publisher_token(
        self, number: int, topic: str, type_name: str, type_hash: str, qos: str = QOS_KEEP_10
    ) -> str:
        return self.token(number, "MP", _mangle(topic), _dds_type(type_name), type_hash, qos)


def check_topic(topic: str) -> str:
    """Return a topic name after checking it. Raises ValueError: it is not fully qualified."""
    if _TOPIC.fullmatch(topic) and len(topic) <= TOPIC_LENGTH_MAX:
        return topic
    raise ValueError(
        f"ROS 2 topic {topic!r} is not a full name: allowed are parts of letters, digits and underscores, "
        f"each begun by a slash and not by a digit, {TOPIC_LENGTH_MAX} characters at most, for example "
        "/odom or /robot1/odom"
    )


def check_domain(domain: int) -> int:
    """Return a domain id after checking its range. Raises ValueError: ROS 2 does not allow it."""
    if 0 <= domain <= DOMAIN_MAX:
        return domain
    raise ValueError(f"ROS 2 domain id {domain} is out of range: allowed are 0 to {DOMAIN_MAX}")


def topic_key(domain: int, topic: str, type_name: str, type_hash: str) -> str:
    """Return a topic's rmw_zenoh key ``DOMAIN/TOPIC/TYPE/HASH``. Raises ValueError: bad domain or topic."""
    return f"{check_domain(domain)}{check_topic(topic)}/{_dds_type(type_name)}/{type_hash}"


def any_type_key(domain: int, topic: str) -> str:
    """Return the key expression that matches a topic of any type, to detect a wrong type."""
    return f"{check_domain(domain)}{check_topic(topic)}/*/*"


def parse_topic_key(key: str) -> TopicKey | None:
    """Parse a key of rmw_zenoh; return None for any other key."""
    match = _KEY.fullmatch(key)
    if match is None:
        return None
    domain, topic, package, name, type_hash = match.groups()
    return TopicKey(int(domain), topic, f"{package}/msg/{name}", type_hash)


def publisher_id(token: str) -> bytes:
    """Return the 16-byte publisher id that each sample has: XXH3-128 of the token, lowest byte first."""
    digest: bytes = xxhash.xxh3_128_digest(token.encode())
    return digest[::-1]


def _dds_type(type_name: str) -> str:
    """Return the name of a message type in DDS, such as ``nav_msgs::msg::dds_::Odometry_``."""
    return type_name.replace("/msg/", "::msg::dds_::") + "_"


def _mangle(name: str) -> str:
    return name.replace("/", "%")


_FILES = (".json5", ".json", ".yaml", ".yml")  # suffixes of Zenoh configuration files


def open_network(where: str, domain: int) -> zenoh_link.Session:
    """Open a session as a client; ``where``: endpoint of a ROS 2 router, or Zenoh configuration file."""
    check_domain(domain)
    if where.endswith(_FILES):
        return zenoh_link.open_session(config_file=Path(where), role=zenoh_link.Role.CLIENT)
    return zenoh_link.open_session(connect=[where], role=zenoh_link.Role.CLIENT)


class Ros2Node:
    """A node on the caller's Zenoh session: ``ros2 node list`` shows it, ROS 2 nodes read its topics.

    Node and publishers exist as long as the session is open.
    """

    def __init__(
        self, session: zenoh_link.Session, name: str, *, domain: int = 0, namespace: str = "/"
    ) -> None:
        """``domain``: ROS_DOMAIN_ID of the other nodes; ``namespace`` does not change the names of topics."""
        self._session = session
        self._node = Node(check_domain(domain), str(session.zid()), name, namespace)
        self._tokens = [zenoh_link.liveliness_token(session, self._node.token(0, "NN"))]

    def publisher(self, topic: str, type_name: str, type_hash: str) -> Ros2Publisher:
        """Announce a topic and declare its publisher; with a wrong type hash ROS 2 receives no sample."""
        # token number 0 is that of the node itself
        key = topic_key(self._node.domain, topic, type_name, type_hash)
        token = self._node.publisher_token(len(self._tokens), topic, type_name, type_hash)
        self._tokens.append(zenoh_link.liveliness_token(self._session, token))
        return Ros2Publisher(zenoh_link.dropping_publisher(self._session, key), publisher_id(token), self)


class Ros2Publisher:
    """Sends serialised messages with the attachment of rmw_zenoh."""

    def __init__(
        self, publisher: zenoh_link.Publisher, identity: bytes, node: Ros2Node | None = None
    ) -> None:
        """``identity``: id of the publisher, 16 bytes; ``node``: stored, since it owns the tokens."""
        self._publisher, self._identity, self._node = publisher, identity, node
        self._sequence = 0  # sequence number of the newest message; 0 before the first

    @property
    def matched(self) -> bool:
        """Whether there is a subscriber; samples sent without a subscriber are lost."""
        return zenoh_link.is_matched(self._publisher)

    def put(self, payload: bytes, source_time_ns: int) -> None:
        """Send a message in CDR; ``source_time_ns``: Unix or simulated time of sending."""
        self._sequence += 1
        attachment = pack_attachment(self._sequence, source_time_ns, self._identity)
        self._publisher.put(payload, attachment=attachment)
