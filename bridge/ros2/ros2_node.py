"""Makes this process a ROS 2 node: ``ros2 node list`` shows it, and any ROS 2 node can read its topics.

In rmw_zenoh a node and each publisher is a liveliness token; a sample is CDR with an attachment.
"""

from __future__ import annotations

from bridge.ros2.ros2_names import (
    QOS_KEEP_10,
    Node,
    check_topic,
    node_token,
    publisher_id,
    publisher_token,
    topic_key,
)
from bridge.zenoh import zenoh_link
from bridge.zenoh.zenoh_link import pack_attachment


class Ros2Node:
    """A node on a Zenoh session that ROS 2 can reach; the caller owns the session."""

    def __init__(
        self, session: zenoh_link.Session, name: str, *, domain: int = 0, namespace: str = "/"
    ) -> None:
        """Announce the node to ROS 2.

        ``domain`` is the ROS_DOMAIN_ID of the other nodes; topics have full names, whatever the namespace.

        Raises ValueError: a name or the domain is not allowed.
        """
        self._session = session
        self._node = Node(domain, str(session.zid()), name, namespace)
        self._tokens = [zenoh_link.liveliness_token(session, node_token(self._node))]
        self._publishers: list[Ros2Publisher] = []

    def publisher(self, topic: str, type_name: str, type_hash: str) -> Ros2Publisher:
        """Announce a topic and declare its publisher.

        With another type hash ROS 2 nodes receive no samples.

        Raises ValueError: a part is malformed.
        """
        number = 1 + len(self._publishers)  # the node itself has number 0
        token = publisher_token(self._node, number, check_topic(topic), type_name, type_hash, QOS_KEEP_10)
        key = topic_key(self._node.domain, topic, type_name, type_hash)
        publisher = Ros2Publisher(zenoh_link.dropping_publisher(self._session, key), publisher_id(token))
        self._tokens.append(zenoh_link.liveliness_token(self._session, token))
        self._publishers.append(publisher)
        return publisher

    def close(self) -> None:
        """Undeclare node and publishers; they disappear from the graph at once."""
        for token in reversed(self._tokens):
            token.undeclare()
        for publisher in self._publishers:
            publisher.close()


class Ros2Publisher:
    """Sends serialised messages in the form of rmw_zenoh."""

    def __init__(self, publisher: zenoh_link.Publisher, identity: bytes) -> None:
        self._publisher, self._identity = publisher, identity
        self.sequence = 0  # number of the newest message; the first has 1, as in rmw_zenoh

    @property
    def matched(self) -> bool:
        return zenoh_link.is_matched(self._publisher)

    def put(self, payload: bytes, time_ns: int) -> None:
        self.sequence += 1
        self._publisher.put(payload, attachment=pack_attachment(self.sequence, time_ns, self._identity))

    def close(self) -> None:
        self._publisher.undeclare()
