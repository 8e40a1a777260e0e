"""Tests consecutive flights that the flight stack commands: heights, modes, and ends of the flights."""

import math
from dataclasses import replace

import pytest

from bridge.crazyflie.packets import Order
from bridge.crazyflie.pilot import CARRIED_MAX_M_S, CLEAR_M, GAIN_1_S, Pilot
from bridge.mavlink.client.companion import CommandSequencer
from bridge.mavlink.client.vehicle_state import VehicleState
from bridge.mavlink.profiles import CRAZYFLIE
from bridge.mavlink.server.profile import FlightMode
from flightstack.core.types import Landed, Mode, Request
from tests.crazyflie_firmware.bench import CLIENT, GROUND, NAN, Bench
from tests.crazyflie_firmware.firmware import Firmware
from tests.crazyflie_firmware.plant import Point

HEIGHT_M = 0.5
KILL = (400, 0.0, 21196.0)


class Stack:
    """Sends the commands of the flight stack to a simulated Crazyflie above a movable floor."""

    def __init__(self, floor_m: float = 0.0) -> None:
        self.floor_m = floor_m
        self.bench = Bench(Firmware(Point(0.5, -0.2, lambda x, y: self.floor_m)))
        self._seen = 0

    def flight(self) -> tuple[CommandSequencer, VehicleState]:
        return CommandSequencer(CRAZYFLIE, (1, 1), HEIGHT_M), VehicleState(CRAZYFLIE)

    def run(self, flight, request: Request, done, limit_s: float = 20.0) -> None:
        sequencer, state = flight
        end_s = self.bench.now_s + limit_s
        while not done(state.status):
            assert self.bench.now_s < end_s, (request, sequencer.failed, self.bench.texts[-5:])
            self.bench.step()
            out, self._seen = self.bench.out[self._seen :], len(self.bench.out)
            for at_s, message in out:
                state.update(message, at_s)
            sequencer.home_amsl_m = state.home_amsl_m
            if self.bench.stream is not None:
                sequencer.note_setpoint(self.bench.now_s)
            for command in sequencer.step(request, state.status, self.bench.now_s):
                for ack in self.bench.node.handle(command, CLIENT, self.bench.now_s):
                    sequencer.note_ack(ack.command, ack.result)
                self.bench._send()

    def climb(self, flight) -> None:
        """Wait for HOLD and disarmed motors, take off, and enter OFFBOARD."""
        self.bench.stream = None
        self.run(flight, Request.NONE, lambda s: s is not None and s.mode is Mode.HOLD and not s.armed)
        plant = self.bench.firmware.plant
        self.run(flight, Request.TAKEOFF, lambda s: s.mode is Mode.HOLD and s.landed is Landed.IN_AIR)
        assert plant.position[2] - plant.surface_m(0, 0) == pytest.approx(HEIGHT_M, abs=0.06)
        self.bench.stream = (0.0, 0.0, 0.0)
        self.run(flight, Request.EXTERNAL, lambda s: s.mode is Mode.EXTERNAL)


@pytest.mark.parametrize("floor_m", [0.0, 0.5, 1.4, -0.3])
def test_it_climbs_by_its_height_from_a_table_of_any_height_and_then_from_another(floor_m):
    stack = Stack(floor_m)
    for _ in range(2):
        flight = stack.flight()
        stack.climb(flight)
        stack.run(flight, Request.LAND, lambda s: not s.armed)
        stack.floor_m += 0.7
        stack.bench.firmware.plant.position[2] = stack.floor_m
        stack.bench.run(0.1)


@pytest.mark.parametrize("drift_m_s", [0.2, -0.2])
@pytest.mark.parametrize("ordered", [Order.ARM, "take-off first"])
def test_a_height_that_drifts_before_the_arming_does_not_change_the_climb(drift_m_s, ordered):
    stack = Stack(0.4)
    bench, plant = stack.bench, stack.bench.firmware.plant
    step = bench.step

    def drifting():
        if not bench.vehicle.armed:
            stack.floor_m += 0.01 * drift_m_s
            plant.position[2] = stack.floor_m
        step()

    bench.step = drifting
    bench.run(3.3)  # longer than the period of HOME_POSITION
    if ordered is Order.ARM:
        stack.climb(stack.flight())
        return
    assert bench.command(22, NAN, NAN, NAN, NAN, NAN, NAN, stack.floor_m + HEIGHT_M)[0].result == 0
    bench.run(1.0).armed().until(lambda: bench.vehicle.mode is FlightMode.HOLD)
    assert plant.position[2] - stack.floor_m == pytest.approx(HEIGHT_M, abs=0.06)


def _landing_by_set_points(stack, flight):
    stack.bench.stream = (0.0, 0.0, 0.25)
    stack.bench.until(lambda: stack.bench.vehicle.standing)
    stack.run(flight, Request.MOTORS_OFF, lambda s: not s.armed)


def _abort(stack, flight):
    stack.run(flight, Request.LAND, lambda s: not s.armed)


def _kill(stack, flight):
    stack.bench.command(*KILL)


def _take_over(stack, flight):
    stack.bench.stream = None
    stack.bench.run(1.2)
    assert stack.bench.result(176, 1.0, 4.0, 3.0, sender=GROUND) == 0
    stack.bench.run(1.0)
    assert stack.bench.result(21, sender=GROUND) == 0


def _killed_after_a_landing_by_its_own_client(stack, flight):
    stack.bench.stream = (0.0, 0.0, 0.25)
    stack.bench.until(lambda: stack.bench.vehicle.standing)
    stack.bench.command(400, 0.0)


ENDS = (_landing_by_set_points, _abort, _kill, _take_over, _killed_after_a_landing_by_its_own_client)


def test_after_any_end_the_next_flight_begins_as_the_first():
    stack = Stack(0.2)
    for end in (*ENDS, ENDS[0]):
        flight = stack.flight()
        stack.climb(flight)
        end(stack, flight)
        stack.bench.until(lambda: not stack.bench.vehicle.armed)
        stack.bench.stream = None
        stack.bench.until(lambda: stack.bench.firmware.plant.on_surface).run(0.1)
        assert stack.bench.vehicle.mode is FlightMode.HOLD
        assert stack.bench.times("HEARTBEAT")[-1] > stack.bench.now_s - 1.1


@pytest.mark.parametrize("deck_m_s", [(0.0, 0.0), (0.3, 0.0), (-0.2, 0.25), (0.0, -1.0), (3.0, 0.0)])
def test_a_take_off_from_a_deck_that_drives_rises_above_its_place_on_the_deck_then_stops(deck_m_s):
    state = Bench().ready().vehicle.state
    assert state is not None
    speed_m_s, period_s = math.hypot(*deck_m_s), 0.02
    kept = min(1.0, CARRIED_MAX_M_S / speed_m_s) if speed_m_s else 0.0
    (x, y, floor_m), (vx, vy), rise_m = state.position_enu_m, deck_m_s, 0.0
    pilot, left = Pilot(), (x, y)
    pilot.begin(0.0)
    for n in range(500):
        seen = replace(state, position_enu_m=(x, y, floor_m + rise_m), velocity_enu_m_s=(vx, vy, 0.0))
        velocity = pilot.velocity(seen, floor_m + 0.5)
        if pilot.arrived(seen, floor_m + 0.5):
            break
        vx, vy, vz = velocity.velocity_enu_m_s
        if rise_m < CLEAR_M:  # the feet may touch the deck
            assert (vx, vy) == pytest.approx((kept * deck_m_s[0], kept * deck_m_s[1]))
            vx, vy = deck_m_s if n * period_s < 0.5 else (vx, vy)  # the vehicle is on the deck until 0.5 s
            left = (x, y)
        x, y = x + period_s * vx, y + period_s * vy
        rise_m += period_s * vz if n * period_s >= 0.5 else 0.0
    assert rise_m == pytest.approx(0.5, abs=0.06)
    beyond_m = math.hypot(x - left[0], y - left[1])  # the vehicle stops and does not fly back
    assert beyond_m == pytest.approx(min(speed_m_s, CARRIED_MAX_M_S) / GAIN_1_S, rel=0.3, abs=0.01)
