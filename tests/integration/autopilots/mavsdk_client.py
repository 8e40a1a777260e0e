"""Flights with MAVSDK's own Python package, as a program of its own: ``python FILE CONNECTION_URL STORY``.

Apart from the tests' process, since the C library below it has threads. It prints a line per step, and ends
with a traceback and status 1 when something is not as it should be.
"""

from __future__ import annotations

import asyncio
import math
import sys
import time
from collections.abc import AsyncGenerator, Awaitable, Callable
from typing import Any

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.info import InfoAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.action import ActionError, ActionResult
from mavsdk.plugins.offboard import OffboardError, OffboardResult, VelocityNedYaw
from mavsdk.plugins.param import ParamError, ParamResult
from mavsdk.plugins.telemetry import FlightMode, LandedState

DISCOVERY_MAX_S = 30.0
STEP_MAX_S = 60.0  # a busy machine slows the simulated flight down
SILENCE_S = 2.0  # COM_OF_LOSS_T: a busy machine may not run a client for some tenths of a second
HEIGHT_M = 0.5  # MIS_TAKEOFF_ALT
SPEED_M_S = 0.3
LEG_M = 0.5
_START_S = time.monotonic()


def step(name: str) -> None:
    """Tell the test how far it got."""
    print(f"[{time.monotonic() - _START_S:6.2f} s] step {name}", flush=True)


async def first(stream: AsyncGenerator, wanted: Callable[[Any], object], what: str) -> Any:
    """First update of a stream that is wanted."""

    async def search() -> Any:
        async for update in stream:
            if wanted(update):
                return update
        raise AssertionError(f"{what}: the stream has ended")

    try:
        return await asyncio.wait_for(search(), STEP_MAX_S)
    except TimeoutError:
        raise AssertionError(f"{what}: not within {STEP_MAX_S:g} s") from None
    finally:
        await stream.aclose()


async def refused(answer: Awaitable, error: type[Exception], result: object) -> None:
    """Check that a request fails with this result."""
    found: object = None
    try:
        await answer
    except error as caught:
        found = caught.result  # type: ignore[attr-defined]
    assert found == result, f"answered {found!r}, expected {result!r}"


class Vehicle:
    """MAVSDK's plug-ins for one vehicle, and what it said."""

    def __init__(self, system: Any) -> None:
        self.action, self.telemetry = ActionAsync(system), TelemetryAsync(system)
        self.param, self.info = ParamAsync(system), InfoAsync(system)
        self.offboard = OffboardAsync(system)
        self.system = system
        self.texts: list[str] = []
        self._news = asyncio.Condition()
        self._listening = asyncio.create_task(self._listen())

    async def close(self) -> None:
        """Stop listening."""
        self._listening.cancel()
        await asyncio.gather(self._listening, return_exceptions=True)

    async def _listen(self) -> None:
        async for text in self.telemetry.subscribe_status_text():
            async with self._news:
                self.texts.append(text.text)
                self._news.notify_all()

    async def said(self, part: str) -> None:
        """Wait until it has said this."""
        async with self._news:
            heard = self._news.wait_for(lambda: any(part in text for text in self.texts))
            try:
                await asyncio.wait_for(heard, STEP_MAX_S)
            except TimeoutError:
                raise AssertionError(f"{part!r} was not said, but {self.texts}") from None

    async def motion(self, wanted: Callable[[Any, Any], object], what: str) -> Any:
        """Wait until position and velocity are so; returns them."""
        stream = self.telemetry.subscribe_position_velocity_ned()
        return await first(stream, lambda m: wanted(m.position, m.velocity), what)

    async def here(self) -> Any:
        """Present position."""
        return (await self.motion(lambda p, v: True, "a position")).position

    async def ready(self) -> None:
        """Wait until MAVSDK calls it healthy and armable."""
        await first(self.telemetry.subscribe_health_all_ok(), bool, "health_all_ok")
        await first(self.telemetry.subscribe_health(), lambda h: h.is_armable, "is_armable")
        step("healthy")

    async def take_off(self) -> None:
        """Arm and climb to the default altitude."""
        await self.param.set_param_float("COM_OF_LOSS_T", SILENCE_S)
        await self.action.arm()
        await first(self.telemetry.subscribe_armed(), bool, "armed")
        step("armed")
        await self.action.takeoff()
        await first(self.telemetry.subscribe_in_air(), bool, "in the air")
        await first(self.telemetry.subscribe_flight_mode(), lambda m: m == FlightMode.HOLD, "holding")
        await self.motion(lambda p, v: abs(-p.down_m - HEIGHT_M) < 0.08 and abs(v.down_m_s) < 0.1, "height")
        step("up")

    async def start_offboard(self, velocity: VelocityNedYaw) -> None:
        """Hand over to set-points."""
        await self.offboard.set_velocity_ned(velocity)
        await self.offboard.start()
        await first(self.telemetry.subscribe_flight_mode(), lambda m: m == FlightMode.OFFBOARD, "OFFBOARD")
        assert await self.offboard.is_active()
        step("offboard")

    async def land(self) -> None:
        """Land; it disarms by itself."""
        await self.action.land()
        landed = self.telemetry.subscribe_landed_state()
        await first(landed, lambda s: s == LandedState.ON_GROUND, "on the ground")
        await first(self.telemetry.subscribe_armed(), lambda armed: not armed, "disarmed")
        await first(self.telemetry.subscribe_in_air(), lambda in_air: not in_air, "not in the air")
        step("down")


async def flight(vehicle: Vehicle) -> None:
    """The whole of it, with what is refused on the way."""
    version = await vehicle.info.get_version()
    assert (version.flight_sw_major, version.flight_sw_minor) == (1, 18), version
    await vehicle.ready()
    await parameters(vehicle)
    await refused(vehicle.offboard.start(), OffboardError, OffboardResult.NO_SETPOINT_SET)
    await vehicle.take_off()
    await refused(vehicle.action.disarm(), ActionError, ActionResult.COMMAND_DENIED)
    await vehicle.said("Disarming refused: not landed")
    await telemetry_fits(vehicle)
    await square(vehicle)
    await vehicle.offboard.stop()
    await first(vehicle.telemetry.subscribe_flight_mode(), lambda m: m == FlightMode.HOLD, "HOLD")
    await vehicle.motion(lambda p, v: _speed(v) < 0.1, "standing in the air")
    step("hold")
    await vehicle.land()


async def parameters(vehicle: Vehicle) -> None:
    """Read, write, read back, be refused."""
    param = vehicle.param
    assert await param.get_param_float("MPC_XY_P") == 1.0
    await param.set_param_float("MPC_XY_P", 1.25)
    assert await param.get_param_float("MPC_XY_P") == 1.25
    await param.set_param_float("MPC_XY_P", 1.0)
    assert await param.get_param_int("COM_DL_LOSS_T") == 10
    await param.set_param_int("COM_DL_LOSS_T", 12)
    assert await param.get_param_int("COM_DL_LOSS_T") == 12
    assert await vehicle.action.get_takeoff_altitude() == HEIGHT_M
    await refused(param.set_param_float("MPC_XY_P", 55.0), ParamError, ParamResult.VALUE_OUT_OF_RANGE)
    await vehicle.said("MPC_XY_P: 55, allowed 0.1 to 2")
    await refused(param.set_param_int("MAV_TYPE", 3), ParamError, ParamResult.READ_ONLY)
    await refused(param.get_param_int("NO_SUCH"), ParamError, ParamResult.DOES_NOT_EXIST)
    every = await param.get_all_params()
    floats = {p.name: p.value for p in every.float_params}
    integers = {p.name: p.value for p in every.int_params}
    assert floats["MPC_XY_P"] == 1.0
    assert integers["COM_DL_LOSS_T"] == 12
    step(f"parameters {len(floats) + len(integers)}")


async def telemetry_fits(vehicle: Vehicle) -> None:
    """The same height and place by every message that has them."""
    telemetry = vehicle.telemetry
    above = await first(telemetry.subscribe_position(), lambda p: True, "global position")
    assert abs(above.relative_altitude_m - HEIGHT_M) < 0.1, above
    home = await first(telemetry.subscribe_home(), lambda h: True, "home")
    assert abs(above.latitude_deg - home.latitude_deg) < 3e-6, (above, home)  # 0.3 m
    battery = await first(telemetry.subscribe_battery(), lambda b: True, "battery")
    assert 3.0 < battery.voltage_v < 4.3, battery
    attitude = await first(telemetry.subscribe_attitude_euler(), lambda a: True, "attitude")
    assert abs(attitude.roll_deg) < 10.0, attitude
    assert abs(attitude.pitch_deg) < 10.0, attitude
    step("telemetry")


async def square(vehicle: Vehicle) -> None:
    """North, west, south, east, away from the deck and back; each leg by what position and velocity say."""
    attitude = await first(vehicle.telemetry.subscribe_attitude_euler(), lambda a: True, "heading")
    yaw_deg = attitude.yaw_deg
    still = VelocityNedYaw(0.0, 0.0, 0.0, yaw_deg)
    start = await vehicle.here()
    await vehicle.start_offboard(still)
    for name, north, east in (("north", 1, 0), ("west", 0, -1), ("south", -1, 0), ("east", 0, 1)):
        begin = await vehicle.here()
        velocity = VelocityNedYaw(SPEED_M_S * north, SPEED_M_S * east, 0.0, yaw_deg)
        await vehicle.offboard.set_velocity_ned(velocity)

        def along(p: Any, begin: Any = begin, north: int = north, east: int = east) -> float:
            return north * (p.north_m - begin.north_m) + east * (p.east_m - begin.east_m)

        def fast(v: Any, north: int = north, east: int = east) -> bool:
            wanted = (SPEED_M_S * north, SPEED_M_S * east)
            return math.dist((v.north_m_s, v.east_m_s), wanted) < 0.1 and abs(v.down_m_s) < 0.1

        await vehicle.motion(lambda p, v, f=fast: f(v), f"velocity {name}")
        await vehicle.motion(lambda p, v, a=along: a(p) > LEG_M, f"way {name}")
        await vehicle.offboard.set_velocity_ned(still)
        await vehicle.motion(lambda p, v: _speed(v) < 0.08, f"stop after {name}")
        step(name)
    end = await vehicle.here()
    gap_m = math.dist((start.north_m, start.east_m), (end.north_m, end.east_m))
    assert gap_m < 0.25, f"the square is open by {gap_m:.2f} m"
    assert abs(-end.down_m - HEIGHT_M) < 0.2, end


def _speed(velocity: Any) -> float:
    return math.hypot(velocity.north_m_s, velocity.east_m_s, velocity.down_m_s)


STORIES = {"flight": flight}


async def main(url: str, story: str) -> None:
    """Connect, find the autopilot, and play a story."""
    configuration = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    async with Mavsdk(configuration) as mavsdk:
        await mavsdk.add_any_connection(url)
        system = await mavsdk.first_autopilot(timeout_s=DISCOVERY_MAX_S)
        assert system is not None, f"no autopilot at {url} within {DISCOVERY_MAX_S:g} s"
        step("found")
        vehicle = Vehicle(system)
        try:
            await STORIES[story](vehicle)
        finally:
            await vehicle.close()
    step("done")


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], sys.argv[2]))
