"""Tests names and attachments of ROS 2 messages on Zenoh."""

import re
import string

import pytest
import xxhash
from hypothesis import given
from hypothesis import strategies as st
from zenoh.ext import Int64, z_serialize

from bridge.ros2.ros2_names import (
    DOMAIN_MAX,
    NO_HASH,
    TOPIC_LENGTH_MAX,
    Node,
    TopicKey,
    any_type_key,
    check_topic,
    parse_topic_key,
    publisher_id,
    topic_key,
)
from bridge.zenoh.zenoh_link import pack_attachment, parse_attachment

# rmw_zenoh docs/design.md, "Topic and Service name mapping" and "Graph Cache"
STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
CHATTER = f"0/chatter/std_msgs::msg::dds_::String_/{STRING_HASH}"
ROBOT_CHATTER = f"0/robot1/chatter/std_msgs::msg::dds_::String_/{STRING_HASH}"
LISTENER = "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener"
TALKER = (
    "@ros2_lv/2/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/%chatter/"
    f"std_msgs::msg::dds_::String_/{STRING_HASH}/::,7:,:,:,,"
)

letters = string.ascii_letters + "_"
tokens = st.builds(
    "".join, st.tuples(st.sampled_from(letters), st.text(letters + string.digits, max_size=12))
)
topics = st.lists(tokens, min_size=1, max_size=5).map(lambda parts: "/" + "/".join(parts))
words = st.builds(
    "".join, st.tuples(st.sampled_from(string.ascii_letters), st.text(letters + string.digits, max_size=12))
)
types = st.builds("{}/msg/{}".format, words, words)
hashes = st.one_of(
    st.just(NO_HASH), st.text("0123456789abcdef", min_size=64, max_size=64).map("RIHS01_".__add__)
)


def test_the_examples_of_the_design_document():
    assert topic_key(0, "/chatter", "std_msgs/msg/String", STRING_HASH) == CHATTER
    assert topic_key(0, "/robot1/chatter", "std_msgs/msg/String", STRING_HASH) == ROBOT_CHATTER
    assert parse_topic_key(ROBOT_CHATTER) == TopicKey(
        0, "/robot1/chatter", "std_msgs/msg/String", STRING_HASH
    )
    assert Node(2, "aac3178e146ba6f1fc6e6a4085e77f21", "listener").token(0, "NN") == LISTENER
    talker = Node(2, "8b20917502ee955ac4476e0266340d5c", "talker")
    made = talker.publisher_token(10, "/chatter", "std_msgs/msg/String", STRING_HASH, "::,7:,:,:,,")
    assert made == TALKER


@given(st.integers(0, DOMAIN_MAX), topics, types, hashes)
def test_what_is_built_is_parsed_and_is_one_topic(domain, topic, name, type_hash):
    key = topic_key(domain, topic, name, type_hash)
    assert parse_topic_key(key) == TopicKey(domain, topic, name, type_hash)
    pattern = any_type_key(domain, topic)
    assert re.fullmatch(re.escape(pattern).replace(r"\*", "[^/]+"), key)
    assert not re.fullmatch(
        re.escape(pattern).replace(r"\*", "[^/]+"), topic_key(domain, topic + "/a", name, type_hash)
    )


@given(st.integers(0, DOMAIN_MAX), topics, types, hashes, tokens, st.integers(0, 10**6))
def test_a_token_takes_apart_into_what_made_it(domain, topic, name, type_hash, node, number):
    token = Node(domain, "c0ffee", node).publisher_token(number, topic, name, type_hash)
    parts = token.split("/")
    assert parts[:8] == ["@ros2_lv", str(domain), "c0ffee", "0", str(number), "MP", "%", "%"]
    assert parts[8:] == [
        node,
        topic.replace("/", "%"),
        *topic_key(0, topic, name, type_hash).split("/")[-2:],
        "::,10:,:,:,,",
    ]
    low, high = publisher_id(token)[:8], publisher_id(token)[8:]
    digest = xxhash.xxh3_128_intdigest(token.encode())  # rmw_zenoh copies the low half first
    assert int.from_bytes(low, "little") == digest & (2**64 - 1)
    assert int.from_bytes(high, "little") == digest >> 64


@given(st.text(max_size=40))
def test_any_text_is_parsed_or_refused(text):
    found = parse_topic_key(text)
    if found is not None:
        assert topic_key(*found) == text


@given(
    st.integers(-(2**63), 2**63 - 1), st.integers(-(2**63), 2**63 - 1), st.binary(min_size=16, max_size=16)
)
def test_an_attachment_is_the_33_bytes_of_the_design_document(sequence, time_ns, gid):
    data = pack_attachment(sequence, time_ns, gid)
    assert len(data) == 33
    assert int.from_bytes(data[:8], "little", signed=True) == sequence
    assert int.from_bytes(data[8:16], "little", signed=True) == time_ns
    assert data[16] == 16
    assert data[17:] == gid
    assert parse_attachment(data) == (sequence, time_ns)
    # Zenoh's own serialisation, which rmw_zenoh uses: two int64 and a sequence of bytes with its length.
    assert data == bytes(z_serialize((Int64(sequence), Int64(time_ns), gid)))


@pytest.mark.parametrize(
    "topic",
    [
        "", "/", "odom", "//odom", "/odom/", "/1odom", "/robot/2", "/a b", "/a-b", "/a*", "/~a",
        "/" + "a" * TOPIC_LENGTH_MAX,
    ],
)  # fmt: skip
def test_a_topic_that_ros_does_not_allow_says_what_is(topic):
    with pytest.raises(ValueError, match="/robot1/odom"):
        check_topic(topic)
