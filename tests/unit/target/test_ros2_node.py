"""Our side as ROS 2 sees it: tokens in the graph, samples on the key, decoded by another library."""

import struct

import pytest
import zenoh
from zenoh.ext import declare_advanced_subscriber

from bridge.ros2.cdr import encode_odometry
from bridge.ros2.ros2_names import Ros2Network, parse_topic_key, publisher_id
from bridge.ros2.ros2_node import Ros2Node
from bridge.target.ros2_target import ROS_TYPES, TargetType
from bridge.zenoh import zenoh_link
from tests.unit.target import ros2_helpers as ros
from tests.unit.target.ros2_helpers import until

ODOMETRY = ROS_TYPES[TargetType.ODOMETRY]


def graph(session, domain=0):
    """What ``ros2 node list`` and ``ros2 topic list`` are made of."""
    return sorted(
        str(reply.ok.key_expr) for reply in session.liveliness().get(f"@ros2_lv/{domain}/**", timeout=1.0)
    )


def test_a_node_its_topic_and_its_samples():
    with ros.network() as (_, ours, theirs):
        node = Ros2Node(ours, "talker", domain=3, namespace="/cf1")
        publisher = node.publisher("/cf1/target/odom", *ODOMETRY)
        until(lambda: len(graph(theirs, 3)) == 2, "both tokens")
        node_token, publisher_token = graph(theirs, 3)
        zid = str(ours.zid())
        assert node_token == f"@ros2_lv/3/{zid}/0/0/NN/%/%cf1/talker"
        assert publisher_token.startswith(
            f"@ros2_lv/3/{zid}/0/1/MP/%/%cf1/talker/%cf1%target%odom/nav_msgs::"
        )
        assert graph(theirs, 0) == []

        wanted = f"3/cf1/target/odom/nav_msgs::msg::dds_::Odometry_/{ODOMETRY.type_hash}"
        heard = declare_advanced_subscriber(theirs, wanted, zenoh.handlers.RingChannel(10))
        until(lambda: publisher.matched, "the subscription")
        payload = encode_odometry(1_500_000_000, "map", "target", (1.0, 2.0, 0.2), (1.0, 0.0, 0.0, 0.0))
        for i in range(3):
            publisher.put(payload, 1_700_000_000_000_000_000 + i)
        samples = []
        until(lambda: samples.extend(zenoh_link.drain(heard)) or len(samples) == 3, "the samples")
        for i, sample in enumerate(samples):
            key = parse_topic_key(str(sample.key_expr))
            assert (key.domain, key.topic, key.type_name, key.type_hash) == (3, "/cf1/target/odom", *ODOMETRY)
            sequence, time_ns, length = struct.unpack("<qqB", sample.attachment.to_bytes()[:17])
            assert (sequence, time_ns, length) == (i + 1, 1_700_000_000_000_000_000 + i, 16)
            assert sample.attachment.to_bytes()[17:] == publisher_id(publisher_token)
            message = ros.decode("nav_msgs/msg/Odometry", sample.payload.to_bytes())
            assert (message.header.frame_id, message.pose.pose.position.z) == ("map", 0.2)

        node.close()
        until(lambda: graph(theirs, 3) == [], "the end of the tokens")


def test_who_joins_late_finds_the_topic():
    with ros.network(0) as (endpoint, ours):
        node = Ros2Node(ours, "talker")
        node.publisher("/odom", *ODOMETRY)
        late = ros.rmw_session(endpoint)
        try:
            until(lambda: len(graph(late)) == 2, "both tokens")
        finally:
            late.close()
        node.close()


def test_numbers_and_ids_of_two_publishers_differ():
    session = zenoh_link.open_session()
    try:
        node = Ros2Node(session, "talker")
        one, two = (node.publisher(topic, *ODOMETRY) for topic in ("/a", "/b"))
        assert one._identity != two._identity
        assert len(graph(session)) == 3
        node.close()
    finally:
        session.close()


@pytest.mark.parametrize(
    ("topic", "name", "words"),
    [("odom", "talker", "full name"), ("/odom", "2", "node name"), ("/2/odom", "talker", "full name")],
)
def test_names_that_ros_does_not_allow(topic, name, words):
    session = zenoh_link.open_session()
    try:
        with pytest.raises(ValueError, match=words):
            Ros2Node(session, name).publisher(topic, *ODOMETRY)
    finally:
        session.close()


def test_a_network_is_an_endpoint_or_a_file(tmp_path):
    with ros.network(0) as (endpoint, _):
        file = tmp_path / "ros.json5"
        file.write_text(f'{{connect: {{endpoints: ["{endpoint}"]}}}}')
        for where in (endpoint, str(file)):
            session = Ros2Network(where).open()
            assert zenoh_link.transports(session) == 1
            session.close()
    with pytest.raises(ValueError, match="not understood"):
        Ros2Network("localhost").open()
    with pytest.raises(ValueError, match="0 to 232"):
        Ros2Network(endpoint, 500).open()
