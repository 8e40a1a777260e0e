"""Keys that a target might be under are found over a real session, and only while they are looked for."""

import time

import pytest

from bridge.target.target_keys import KEYS_MAX, KeySearch
from bridge.zenoh import zenoh_link

LIKELY = {
    "robot1/odom": "robot1/odom",
    "robot/odometry/filtered": "robot/odometry/filtered",
    "arena/pose": "arena/pose",
    "3/odom/nav_msgs::msg::dds_::Odometry_/TypeHashNotSupported": (
        "ros2:/odom (nav_msgs/msg/Odometry, domain 3)"
    ),
}
OTHERS = ("cf1/controller/step", "camera/image")


@pytest.fixture
def pair():
    """Two sessions of which the second dials the first, at a port that was free a moment ago."""
    from tests.unit.target import ros2_helpers as ros

    endpoint = ros.free_endpoint()
    there = zenoh_link.open_session(listen=[endpoint])
    here = zenoh_link.open_session(connect=[endpoint])
    yield there, here
    here.close()
    there.close()


def until_found(search, publishers, count):
    deadline_s = time.monotonic() + 10.0
    while len(search.keys()) < count:
        assert time.monotonic() < deadline_s, search.keys()
        for publisher in publishers:
            publisher.put(b"x")
        time.sleep(0.01)
    return search.keys()


def test_likely_keys_are_found_and_others_are_not(pair):
    there, here = pair
    search = KeySearch(here)
    assert search.keys() == ()
    publishers = [zenoh_link.dropping_publisher(there, key) for key in (*OTHERS, *LIKELY)]
    own = zenoh_link.dropping_publisher(here, "cf1/own/odom")
    assert set(until_found(search, [*publishers, own], len(LIKELY))) == set(LIKELY.values())
    search.stop()
    assert not any(zenoh_link.is_matched(one) for one in publishers[: len(OTHERS)])
    assert search.keys() == ()  # begun anew


def test_no_more_keys_are_kept_than_a_person_reads(pair):
    there, here = pair
    search = KeySearch(here)
    publishers = [zenoh_link.dropping_publisher(there, f"r{n}/odom") for n in range(3 * KEYS_MAX)]
    assert len(until_found(search, publishers, KEYS_MAX)) == KEYS_MAX
    search.stop()
