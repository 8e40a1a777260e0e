"""Messages and a fake autopilot for the tests of the vehicle link."""

from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.client.companion import CommandSequencer
from bridge.mavlink.client.link import COMPONENT_ID, VehicleLink
from bridge.mavlink.endpoint import Endpoint
from bridge.mavlink.profiles import PX4
from flightstack.core.types import Landed, Mode, VehicleStatus

OFFBOARD, LOITER, TAKEOFF, LAND = 6 << 16, 4 << 16 | 3 << 24, 4 << 16 | 2 << 24, 4 << 16 | 6 << 24
HEIGHT = 1.2


@dataclass(frozen=True)
class Setpoint:
    velocity_enu_m_s: tuple
    yaw_rad: float


def heartbeat(custom_mode=LOITER, *, armed=False, autopilot=12):
    return dialect.MAVLink_heartbeat_message(2, autopilot, 128 if armed else 1, custom_mode, 3, 3)


def position(time_ms=0, x=1.0, y=2.0, z=-3.0, vx=0.1, vy=0.2, vz=-0.3):
    return dialect.MAVLink_local_position_ned_message(time_ms, x, y, z, vx, vy, vz)


def attitude(time_ms=0, yaw=0.0, roll=0.0, pitch=0.0):
    return dialect.MAVLink_attitude_message(time_ms, roll, pitch, yaw, 0.0, 0.0, 0.0)


def status(arrival_s=0.0, *, armed=False, mode=Mode.HOLD, landed=Landed.ON_GROUND):
    return VehicleStatus(arrival_s, armed, mode, landed, True)


def sequencer(autopilot=PX4):
    made = CommandSequencer(autopilot, (1, 1), HEIGHT)
    made.home_amsl_m = 0.0
    return made


def home(altitude_m=0.0):
    altitude_mm = round(altitude_m * 1000)
    return dialect.MAVLink_home_position_message(0, 0, altitude_mm, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0, 0)


def commands(messages):
    return [m.command for m in messages]


def params(message):
    return [getattr(message, f"param{i}") for i in range(1, 8)]


class FakeAutopilot:
    """A UDP socket without replies of its own; a test sends messages from it and reads received messages."""

    def __init__(self, url="udpin:127.0.0.1:0"):
        self.endpoint = Endpoint(url, 1, 1)
        self.armed = False
        self.mode = LOITER

    def send(self, *messages, peer=None):
        self.endpoint.send(messages, peer)

    def beat(self):
        self.send(heartbeat(self.mode, armed=self.armed))

    def take(self, until):
        """Return all messages up to and including the first of type ``until``."""
        received = []
        while not any(m.get_type() == until for m in received):
            assert self.endpoint.wait(5.0), f"no {until} came"
            received += [r.message for r in self.endpoint.receive()]
        return received


def linked(to="udpin:127.0.0.1:0", signing_key=None, **options):
    """Return a companion's link to a URL, or to a ``FakeAutopilot``, which learns the address of the link."""
    url = to if isinstance(to, str) else f"udpout:127.0.0.1:{to.endpoint.local_port}"
    endpoint = Endpoint(url, 1, COMPONENT_ID, signing_key=signing_key)
    link = VehicleLink(endpoint, takeoff_height_m=HEIGHT, **options)
    if url is not to:
        link.poll(0.0)
        to.take("HEARTBEAT")
    return link


def poll(link, now_s):
    assert link.endpoint.wait(5.0)
    link.poll(now_s)
