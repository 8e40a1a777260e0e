"""Tests the topics for viewers that are derived from controller steps and MAVLink frames."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.common.strict_toml import dumps, from_table
from flightstack.core.parameters.fleet import Fleet
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.safety.barrier import Barrier
from logs.recorder.derive import Deriver, Derivers
from logs.recorder.markers import PATH_POINTS, surface
from logs.schema import schemas
from logs.schema.mavlink import pack_mavlink
from logs.schema.schemas import codec
from tests.step_rows import step_row

STORE = schemas.typestore()
EPOCH_NS = 1_577_836_800_000_000_000
CONFIG = from_table(FlightConfig, {"barrier": {"alpha_1_m": 1.0, "beta_m": 1.5}})


def step(t_ns=0, own=(1.0, 2.0, 3.0), velocity=(0.3, 0.0, -0.1), yaw=0.0, **changes):
    given = {
        "stamp_ns": EPOCH_NS + t_ns, "tick": t_ns // 10_000_000, "phase": 3, "setpoint_sent": True,
        "own_valid": True, "target_valid": True, "h_m": 0.4,
        "own_position_enu_m": own, "own_velocity_enu_m_s": velocity, "own_yaw_rad": yaw,
        "target_position_enu_m": (0.5, -0.5, 0.2), "target_velocity_enu_m_s": (0.1, 0.0, 0.0),
        "target_yaw_rad": math.pi / 2, "nominal_enu_m_s": (0.2, 0.0, -0.2),
        "filtered_enu_m_s": (0.1, 0.0, -0.1), "wanted_enu_m_s": (math.nan,) * 3, "command_yaw_rad": math.nan,
    }  # fmt: skip
    return step_row(**(given | changes))


def derive(row, deriver=None):
    deriver = deriver or Deriver("cf1")
    made = deriver.step(row.stamp_ns, row)
    return {topic: STORE.deserialize_cdr(data, schema) for topic, schema, data in made}


def test_every_message_is_what_the_generic_codec_writes():
    deriver = Deriver("cf1")
    deriver.configure({"seed": "1"}, CONFIG)
    topics = set()
    for t_ns in range(0, 2_000_000_000, 10_000_000):
        row = step(t_ns, own=(t_ns * 1e-9, 0.0, 1.0), own_valid=t_ns % 70_000_000 != 0)
        for topic, schema, data in deriver.step(row.stamp_ns, row):
            assert bytes(STORE.serialize_cdr(STORE.deserialize_cdr(data, schema), schema)) == data
            pack, unpack = codec(schema, frame_id=None)
            assert pack(unpack(data)) == data
            topics.add(topic)
    assert topics == {
        "/tf", "/tf_static", "/cf1/pose", "/cf1/odom", "/cf1/target/pose", "/cf1/cbf/markers",
        "/cf1/cmd/velocity_nominal", "/cf1/cmd/velocity_filtered", "/cf1/cmd/velocity", "/cf1/run",
    }  # fmt: skip


def test_frames_and_poses():
    shown = derive(step(yaw=math.pi / 2))
    own, target, pad = shown["/tf"].transforms
    assert [t.header.frame_id for t in (own, target, pad)] == ["map"] * 3
    assert [t.child_frame_id for t in (own, target, pad)] == ["cf1/base_link", "cf1/target", "cf1/target_pad"]
    assert (own.transform.translation.x, own.transform.translation.z) == (1.0, 3.0)
    assert own.transform.rotation.z == pytest.approx(math.sqrt(0.5))
    assert target.transform.translation.z == 0.2
    assert target.transform.rotation.w == pytest.approx(math.sqrt(0.5))
    assert (pad.transform.translation.y, pad.transform.rotation.w) == (-0.5, 1.0)
    pose = shown["/cf1/pose"]
    assert (pose.header.stamp.sec, pose.header.frame_id) == (EPOCH_NS // 10**9, "map")
    assert pose.pose.position.y == 2.0
    assert shown["/cf1/target/pose"].pose.position.x == 0.5
    assert shown["/cf1/cmd/velocity_nominal"].twist.linear.x == 0.2
    assert shown["/cf1/cmd/velocity_filtered"].twist.linear.z == -0.1


def test_odometry_gives_the_velocity_in_the_childs_frame():
    odometry = derive(step(velocity=(0.3, 0.1, -0.1), yaw=math.pi / 2))["/cf1/odom"]
    linear = odometry.twist.twist.linear  # the nose points north: x is north, y is west
    assert (linear.x, linear.y, linear.z) == pytest.approx((0.1, -0.3, -0.1))
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("map", "cf1/base_link")


def test_ned_axes_in_the_static_transform():
    (ned,) = derive(step())["/tf_static"].transforms
    assert (ned.header.frame_id, ned.child_frame_id) == ("map", "map_ned")
    q = ned.transform.rotation
    x, y, z, w = q.x, q.y, q.z, q.w
    north_in_enu = (1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w))
    down_in_enu = (2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y))
    assert north_in_enu == pytest.approx((0.0, 1.0, 0.0))
    assert down_in_enu == pytest.approx((0.0, 0.0, -1.0))


def test_what_is_not_valid_is_not_shown():
    blind = derive(step(own_valid=False))
    assert [t.child_frame_id for t in blind["/tf"].transforms] == ["cf1/target", "cf1/target_pad"]
    assert not {"/cf1/pose", "/cf1/odom"} & blind.keys()
    lost = derive(step(target_valid=False))
    assert [t.child_frame_id for t in lost["/tf"].transforms] == ["cf1/base_link"]
    assert "/cf1/target/pose" not in lost
    assert {m.ns for m in lost["/cf1/cbf/markers"].markers} == {"velocity", "vehicle"}
    assert "/tf" not in derive(step(own_valid=False, target_valid=False))


def test_rates_follow_the_log_time_only():
    counts: dict[str, int] = {}
    deriver = Deriver("cf1")
    for t_ns in range(0, 10_000_000_000, 2_000_000):  # steps at 500 Hz for ten seconds
        for topic in derive(step(t_ns), deriver):
            counts[topic] = counts.get(topic, 0) + 1
    assert counts["/tf"] == counts["/cf1/pose"] == 500
    assert counts["/cf1/cbf/markers"] == 50
    assert counts["/tf_static"] == 2  # the transform is repeated for viewers that jump in time


def markers_of(deriver, row):
    return {(m.ns, m.id): m for m in derive(row, deriver)["/cf1/cbf/markers"].markers}


def test_markers():
    deriver = Deriver("cf1")
    deriver.configure({"seed": "1"}, CONFIG)
    for t_ns in range(0, 1_000_000_000, 20_000_000):
        derive(step(t_ns, own=(t_ns * 1e-9, 0.0, 1.0)), deriver)
    shown = markers_of(deriver, step(1_000_000_000))
    numbers = {"barrier": 1, "pad": 1, "path": 2, "vehicle": 1, "velocity": 3}
    assert shown.keys() == {(name, n) for name, count in numbers.items() for n in range(count)}
    barrier, pad, path, arrow = (shown[k] for k in (("barrier", 0), ("pad", 0), ("path", 0), ("velocity", 0)))
    assert (barrier.type, barrier.header.frame_id) == (barrier.TRIANGLE_LIST, "cf1/target_pad")
    assert barrier.frame_locked
    assert (pad.type, pad.header.frame_id, pad.scale.x) == (pad.CYLINDER, "cf1/target", 0.2)
    assert (path.type, path.header.frame_id) == (path.LINE_STRIP, "map")
    assert [round(p.x, 6) for p in path.points] == [*(round(0.1 * i, 6) for i in range(10)), 1.0]
    assert arrow.type == arrow.ARROW
    tail, head = arrow.points
    assert (head.x - tail.x, head.z - tail.z) == pytest.approx((0.2, -0.2))
    body = shown["vehicle", 0]
    assert (body.type, body.header.frame_id) == (body.CUBE, "cf1/base_link")
    assert (body.scale.x, body.scale.z) == (0.092, 0.029)
    for marker in shown.values():
        assert marker.action == marker.ADD
        assert marker.color.a > 0
        assert marker.lifetime.sec + marker.lifetime.nanosec * 1e-9 == 0.5


def test_no_arrow_for_a_velocity_that_is_no_number():
    shown = derive(step(nominal_enu_m_s=(math.nan, 0.0, 0.0)))
    numbers = [m.id for m in shown["/cf1/cbf/markers"].markers if m.ns == "velocity"]
    assert numbers == [1, 2]
    silent = derive(step(setpoint_sent=False))
    assert [m.id for m in silent["/cf1/cbf/markers"].markers if m.ns == "velocity"] == [0, 1]
    assert "/cf1/cmd/velocity" not in silent


@given(st.floats(0.2, 5.0), st.floats(0.1, 5.0))
def test_surface_lies_on_the_boundary(alpha, beta):
    barrier = Barrier(alpha, beta)
    points = np.frombuffer(surface(barrier)).reshape(-1, 3)
    assert len(points) % 3 == 0
    d = np.hypot(points[:, 0], points[:, 1])
    height = np.array([barrier.height(x) for x in d])
    assert np.abs(points[:, 2] - height).max() < 2e-3 * max(1.0, barrier.slope_max)  # rounded to 1/1024 m
    assert d.max() == pytest.approx(2.5 / alpha, rel=1e-2)
    assert points[:, 2].max() > 0.9 * barrier.peak_height_m - 2e-3


def frame(sequence, system=1):
    return pack_mavlink(1, bytes([0xFD, 1, 0, 0, sequence, system, 1, 0, 0, 0, 7, 1, 2]), "p00")


def test_members_of_a_fleet_keep_their_frames_their_pads_and_their_scenes_apart():
    derivers, radii_m = Derivers(), {"cf1": 0.1, "cf2": 0.3}
    for n, (name, radius_m) in enumerate(radii_m.items(), 1):
        fleet = Fleet(id=n, members=(1, 2), radius_xy_m=0.25, radius_z_m=0.75)
        derivers.metadata(f"{name}/run", {"pad_radius_m": str(radius_m), "seed": str(n)})
        derivers.attachment(f"{name}/onboard.toml", dumps(replace(CONFIG, fleet=fleet)).encode())
        derivers.metadata(f"{name}/onboard", {"namespace": name, "system_id": str(n)})
    for n, (name, radius_m) in enumerate(radii_m.items(), 1):
        made = derivers.declare(f"/{name}/controller/step", schemas.CONTROLLER_STEP)(EPOCH_NS, step(0).pack())
        by_topic = {}
        for topic, schema, data in made:
            by_topic.setdefault(topic, []).append(STORE.deserialize_cdr(data, schema))
        frames = {each.child_frame_id for tf in by_topic["/tf"] for each in tf.transforms}
        assert frames == {f"{name}/base_link", f"{name}/target", f"{name}/target_pad"}
        (scene,) = by_topic[f"/{name}/cbf/markers"]
        shown = {(marker.ns, marker.id): marker for marker in scene.markers}
        assert len(shown) == len(scene.markers)
        assert {ns: marker.header.frame_id for (ns, _), marker in shown.items()} == {
            "vehicle": f"{name}/base_link", "ellipsoid": f"{name}/base_link", "velocity": "map",
            "pad": f"{name}/target", "barrier": f"{name}/target_pad",
        }  # fmt: skip
        pad, ellipsoid = shown["pad", 0], shown["ellipsoid", 0]
        assert pad.scale.x == 2.0 * radius_m
        # the diameters are half as large as those of the pair's ellipsoid
        assert (ellipsoid.type, ellipsoid.scale.x, ellipsoid.scale.z) == (ellipsoid.SPHERE, 0.25, 0.75)
        assert f"seed = {n}" in by_topic[f"/{name}/run"][0].data
        decode = derivers.declare(f"/uas{n}/mavlink_source", schemas.MAVLINK)
        ((topic, _, _),) = decode(EPOCH_NS, frame(0, system=n))
        assert topic.startswith(f"/{name}/mavlink/sys{n}/")


def test_no_surface_without_a_barrier_in_the_run():
    assert ("barrier", 0) not in markers_of(Deriver("cf1"), step())


def test_paths_stay_bounded_and_keep_the_start():
    deriver = Deriver("cf1")
    longest = 0
    for t_ns in range(0, 300_000_000_000, 100_000_000):
        shown = derive(step(t_ns, own=(t_ns * 1e-9, 0.0, 1.0)), deriver)
        if "/cf1/cbf/markers" in shown and t_ns:
            markers = {(m.ns, m.id): m for m in shown["/cf1/cbf/markers"].markers}
            points = markers["path", 0].points if ("path", 0) in markers else []
            longest = max(longest, len(points))
            if points:
                assert points[0].x == 0.0
                assert t_ns * 1e-9 - points[-1].x <= 300 / PATH_POINTS * 2 + 0.1
    assert PATH_POINTS * 0.9 < longest <= PATH_POINTS
