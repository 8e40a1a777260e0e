"""Tests a fleet in Rerun: each member has its own entities at its own position."""

import numpy as np
import pytest

pytestmark = [pytest.mark.xdist_group("fleet_log"), pytest.mark.slow]
MEMBERS = ("cf1", "cf2", "cf3")


@pytest.fixture(scope="module")
def save(fleet, tmp_path_factory):
    """Return a function that writes the recording of the fleet, or of a member, and returns its path."""
    pytest.importorskip("rerun", reason="needs the extra [view]")  # loading takes a second
    from logs.view.view import Recording

    def recorded(*member):
        out = tmp_path_factory.mktemp("view") / "fleet.rrd"
        Recording(fleet.log, *member).save(out)
        return out

    return recorded


def chunks(rrd):
    from rerun.chunk import RrdReader

    return RrdReader(rrd).store().stream().to_chunks()


def curve(rrd, entity):
    return values(rrd, entity, "Scalars:scalars")


def values(rrd, entity, column):
    """Return the values of one column of a Rerun entity, in the order of time."""
    found = [
        value
        for chunk in chunks(rrd)
        if chunk.entity_path == entity and not chunk.is_static
        for value in chunk.to_record_batch().column(column).to_pylist()
    ]
    return [each[0] if each else None for each in found]


def test_each_member_is_in_the_scene_at_its_place(fleet, save):
    saved = save()
    entities = {chunk.entity_path for chunk in chunks(saved)}
    read_log = fleet.read
    for member in MEMBERS:
        for what in (
            "vehicle/body", "vehicle/ellipsoid", "target/pad", "target_spot/barrier", "vehicle_path",
            "target_path", "true_vehicle/body", "velocity/command",
        ):  # fmt: skip
            assert f"/world/{member}/{what}" in entities
        truth = read_log.flights[member].truth
        shown = values(saved, f"/world/{member}/true_vehicle", "Transform3D:translation")
        nearest = [np.abs(truth.position_enu_m - place).sum(1).min() for place in shown[::50]]
        assert max(nearest) < 1e-5
        steps = read_log.flights[member].steps
        assert curve(saved, f"/{member}/safety/h/controller") == pytest.approx(
            steps.h_m.tolist(), nan_ok=True
        )
    assert not {e for e in entities if e.startswith(("/world/vehicle", "/world/target", "/safety", "/phase"))}


def test_a_member_alone_is_as_a_single_flight(save):
    entities = {chunk.entity_path for chunk in chunks(save("cf2"))}
    assert {"/world/vehicle/body", "/safety/h/controller", "/phase", "/events", "/run"} <= entities
    assert not {e for e in entities if "cf" in e}
