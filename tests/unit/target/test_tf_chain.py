"""Chains of transforms against homogeneous matrices, and what is not followed."""

import math

import numpy as np
import pytest

from bridge.frames import quaternion_from_yaw
from bridge.ros2.cdr import Pose, Transform
from bridge.target.tf_chain import DEPTH_MAX, EDGE_AGE_MAX_S, FRAMES_MAX, TransformChain

ONE = (1.0, 0.0, 0.0, 0.0)
SECOND = 10**9


def edge(stamp_ns, parent, child, position=(0.0, 0.0, 0.0), q=ONE):
    return Transform(child, Pose(stamp_ns, parent, position, q))


def matrix(position, q):
    w, x, y, z = q
    out = np.eye(4)
    out[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    out[:3, 3] = position
    return out


def placed(chance, count):
    """Places and unit quaternions by chance."""
    turns = chance.normal(size=(count, 4))
    turns /= np.linalg.norm(turns, axis=1)[:, None]
    return [
        (tuple(place), tuple(q))
        for place, q in zip(chance.normal(size=(count, 3)).tolist(), turns.tolist(), strict=True)
    ]


def test_a_chain_of_random_turns_is_the_product_of_matrices():
    chance = np.random.default_rng(3)
    for _ in range(50):
        poses = placed(chance, 3)
        chain = TransformChain("map", "base")
        frames = ["map", "odom", "foot", "base"]
        [found] = chain.take(edge(5, frames[i], frames[i + 1], *poses[i]) for i in range(3))
        wanted = matrix(*poses[0]) @ matrix(*poses[1]) @ matrix(*poses[2])
        assert (found.stamp_ns, found.frame_id, chain.problem) == (5, "map", "")
        assert matrix(found.position_m, found.orientation_wxyz) == pytest.approx(wanted, abs=1e-12)


def test_a_direct_transform_and_one_with_a_slash_of_ros_1():
    chain = TransformChain("map", "base")
    assert chain.take([edge(5, "/map", "/base", (1.0, 2.0, 3.0))])[0].position_m == (1.0, 2.0, 3.0)


def test_edges_come_in_messages_of_their_own_and_the_tracked_one_sets_the_time():
    chain = TransformChain("map", "foot")
    assert chain.take([edge(9, "odom", "foot", (1.0, 0.0, 0.0))]) == []
    assert "nothing says where that is in 'map'" in chain.problem
    assert chain.take([edge(10, "map", "odom", (0.0, 0.0, 0.0), quaternion_from_yaw(math.pi / 2))]) == []
    [found] = chain.take([edge(11, "odom", "foot", (2.0, 0.0, 0.0))])
    assert (found.stamp_ns, found.position_m) == (11, pytest.approx((0.0, 2.0, 0.0)))


def test_an_edge_that_died_is_not_followed():
    chain = TransformChain("map", "foot")
    chain.take([edge(0, "map", "odom")])
    late_ns = round(EDGE_AGE_MAX_S * SECOND)
    assert len(chain.take([edge(late_ns, "odom", "foot")])) == 1
    assert chain.take([edge(late_ns + SECOND // 10, "odom", "foot")]) == []
    assert "1.1 s older" in chain.problem
    assert len(chain.take([edge(late_ns + 2, "map", "odom"), edge(late_ns + 3, "odom", "foot")])) == 1


def test_localisation_may_date_its_edge_ahead():  # as AMCL does, by its transform_tolerance
    chain = TransformChain("map", "foot")
    assert len(chain.take([edge(3 * SECOND, "map", "odom"), edge(2 * SECOND, "odom", "foot")])) == 1


def test_circles_and_long_chains_end():
    chain = TransformChain("map", "foot")
    assert chain.take([edge(0, "b", "a"), edge(0, "a", "b"), edge(0, "a", "foot")]) == []
    assert "circle" in chain.problem
    chain = TransformChain("map", "foot")
    long = [edge(0, f"f{i + 1}", f"f{i}") for i in range(DEPTH_MAX)]
    assert chain.take([*long, edge(0, "f0", "foot")]) == []
    assert "circle" in chain.problem


def test_other_robots_do_not_fill_the_memory():
    chain = TransformChain("map", "foot")
    for i in range(3 * FRAMES_MAX):
        chain.take([edge(0, "map", f"f{i}")])
    assert len(chain._edges) == FRAMES_MAX
    assert len(chain.take([edge(1, "f0", "foot")])) == 1


def test_a_frame_fixed_to_one_that_moves_goes_with_it_and_has_its_time():
    chance = np.random.default_rng(4)
    for _ in range(50):
        poses = placed(chance, 5)
        frames = [
            "map",
            "room",
            "foot",
            "base",
            "mast",
            "pad",
        ]  # the room is fixed in the map, the robot moves
        edges = [edge(7, frames[i], frames[i + 1], *poses[i]) for i in range(5)]
        chain = TransformChain("map", "pad")
        assert chain.take([edges[1]]) == []
        assert "no transform of 'pad' yet" in chain.problem
        chain.take_fixed([edges[4], edges[0]])
        chain.take_fixed([edges[2]._replace(child_frame_id="/base"), edges[3]])
        late = 100 * SECOND  # what is fixed has no age
        [found] = chain.take([edge(late, "room", "foot", *poses[1])])
        wanted = np.linalg.multi_dot([matrix(*one) for one in poses])
        assert (found.stamp_ns, found.frame_id, chain.problem) == (late, "map", "")
        assert matrix(found.position_m, found.orientation_wxyz) == pytest.approx(wanted, abs=1e-12)


def test_what_is_fixed_everywhere_is_not_known_to_be_there():
    chain = TransformChain("map", "pad")
    chain.take_fixed([edge(0, "map", "robot"), edge(0, "robot", "pad")])
    assert chain.take([edge(0, "map", "another")]) == []
    assert chain.problem == "no transform of 'map' yet, to which 'pad' is fixed"


def test_a_frame_that_moves_is_not_held_by_what_was_said_of_it_before():
    chain = TransformChain("map", "foot")
    chain.take_fixed([edge(0, "map", "foot", (9.0, 9.0, 9.0)), edge(0, "map", "odom", (9.0, 9.0, 9.0))])
    [found] = chain.take([edge(3, "odom", "foot", (1.0, 0.0, 0.0)), edge(3, "map", "odom", (0.0, 2.0, 0.0))])
    assert found.position_m == (1.0, 2.0, 0.0)


def test_fixed_circles_end():
    chain = TransformChain("map", "foot")
    chain.take_fixed([edge(0, "b", "foot"), edge(0, "foot", "b")])
    assert chain.take([edge(1, "map", "other")]) == []
    assert "no transform of" in chain.problem
    chain.take_fixed([edge(0, "map", f"f{i}") for i in range(3 * FRAMES_MAX)])
    assert len(chain._fixed) == FRAMES_MAX
