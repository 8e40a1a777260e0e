"""Tests a session with a PX4 that violates the protocol, and the parameters that the process of PX4 gets."""

import itertools
import socket
import threading
import time

import pytest
from pymavlink.dialects.v20 import common as mav

from flightstack.common.hangup import Stop
from sim.clock import NoAnswerError
from sim.px4 import session as px4_session
from sim.px4.link import LinkClosedError, Px4Link
from sim.px4.plant import Px4Plant, Px4Sensors
from sim.px4.program import Px4Model, Px4Program
from sim.px4.session import STEP_S, Px4Session
from sim.scenarios.tables import Start
from tests.processes.bounded import AT_ONCE_S
from tests.unit.px4.px4_fakes import FakePx4
from tests.unit.vehicle.vehicle_sim_helpers import scenario

SHORT_S = 0.3


@pytest.fixture
def server():
    with socket.create_server(("127.0.0.1", 0)) as listening:
        yield listening


@pytest.fixture
def short(monkeypatch):
    """Shorten the time-outs of a session."""
    monkeypatch.setattr(px4_session, "HELLO_MAX_S", SHORT_S)
    monkeypatch.setattr(px4_session, "BOOT_MAX_S", SHORT_S)
    monkeypatch.setattr(px4_session, "NUDGE_S", 0.1)


def steps(session, count):
    for _ in range(count):
        session.step()


class Pair:
    """A session and the PX4 at its other end, stepped in turn in one thread."""

    def __init__(self, server, **options):
        self.fake = FakePx4(server.getsockname()[1], **options)
        self.link = Px4Link(server.accept()[0])
        self.events = []
        self.stop = Stop()
        plant = Px4Plant(scenario(Start()), 1)
        self.session = Px4Session(
            self.link, plant, Px4Sensors(plant.params, plant.body(), 1), self.stop, speed=0.0,
            silent_max_s=SHORT_S, tell=self.events.append,
        )  # fmt: skip

    def begin(self):
        self.fake.hello()
        self.session.greet()
        self.session._start_s += 10.0  # on a busy machine, the first answer may be late
        self.answering([(0.0,) * 4])

    def answering(self, outputs, **options):
        """Run one step for each of these motor outputs, which PX4 sends as answers."""

        def px4():
            for controls in outputs:
                self.fake.answer(self.fake.sensor().time_usec, controls, **options)

        thread = threading.Thread(target=px4)
        thread.start()
        for _ in outputs:
            self.session.step()
        thread.join(10.0)


@pytest.fixture
def pair(server):
    made = Pair(server)
    yield made
    made.fake.close()
    made.link.close()


def test_steps_with_each_answer_and_tells_what_happens(pair):
    pair.begin()
    pair.answering([(0.7,) * 4] * 50)
    assert pair.session.steps == 51
    assert pair.session.plant.truth().stamp_ns == 204_000_000
    assert min(pair.session.plant.truth().rotor_rpm) > 5000.0
    pair.answering([(0.7,) * 4] * 200, armed=False)  # outputs of a disarmed PX4 have no effect
    assert max(pair.session.plant.truth().rotor_rpm) < 1.0
    assert pair.events == ["connected", "lockstep", "armed", "disarmed"]
    assert pair.session.nudges == 0


def test_a_pause_of_the_machine_is_not_caught_up(pair):
    pair.begin()
    session = pair.session
    session._speed, session._start_s = 1.0, time.monotonic() - session.steps * STEP_S - 100.0
    pair.answering([(0.7,) * 4])
    assert time.monotonic() - session._start_s - session.steps * STEP_S < 50.0


def test_sensors_come_every_4_ms_of_px4_s_clock(pair):
    pair.begin()
    times = []
    for _ in range(50):
        pair.answering([(0.0,) * 4])
        times.append(pair.session.time_us)
    assert {b - a for a, b in itertools.pairwise(times)} == {4000}
    assert pair.fake.counts["HIL_SENSOR"] == 51
    assert pair.fake.counts["HIL_GPS"] == 2


def test_a_silent_px4_is_called_dead_with_the_time_and_hardly_anything_moves_meanwhile(pair, short):
    pair.begin()
    with pytest.raises(NoAnswerError, match=r"silent.*time_usec \d+ or \d+") as error:
        steps(pair.session, 100)
    assert "0.0" in str(error.value)
    assert pair.session.steps == 1 + pair.session.nudges
    assert 1 <= pair.session.nudges <= 5


def test_one_lost_answer_does_not_end_the_flight(pair, short):
    pair.begin()
    pair.session._silent_max_s = 5.0
    pair.session.step()  # the session repeats the sensor message, for which PX4 may wait
    assert pair.session.nudges == 1
    pair.fake.sensor()
    pair.answering([(0.7,) * 4] * 10)
    assert pair.session.nudges == 1


def test_an_old_answer_and_one_said_twice_let_nothing_go_on(pair):
    pair.begin()
    first = pair.fake.first_us

    def px4():
        sensor = pair.fake.sensor()
        pair.fake.answer(first, (0.9,) * 4)  # a second answer to the first sensor message
        pair.fake.answer(sensor.time_usec, (0.5,) * 4)
        pair.fake.answer(sensor.time_usec, (0.9,) * 4)
        pair.fake.answer(pair.fake.sensor().time_usec, (0.4,) * 4)

    thread = threading.Thread(target=px4)
    thread.start()
    pair.session.step()
    wanted = pair.session.plant.wanted[0]
    pair.session.step()
    thread.join(10.0)
    rotor = pair.session.plant.params.rotor
    assert rotor.thrust_n(wanted) == pytest.approx(0.5 * 0.12)
    assert rotor.thrust_n(pair.session.plant.wanted[0]) == pytest.approx(0.4 * 0.12)
    assert pair.session.lockstep.old == 2
    assert pair.session.steps == 3


def test_a_client_that_says_nothing_or_garbage_is_dropped_with_a_reason(pair, short):
    pair.fake.raw(b"GET / HTTP/1.1\r\n\r\n")
    with pytest.raises(LinkClosedError, match="18 other bytes"):
        pair.session.greet()


def test_another_autopilot_is_refused_by_number(pair):
    pair.fake.hello(autopilot=mav.MAV_AUTOPILOT_ARDUPILOTMEGA)
    with pytest.raises(LinkClosedError, match="autopilot 3"):
        pair.session.greet()


def test_px4_without_lockstep_is_refused(pair):
    pair.begin()
    with pytest.raises(NoAnswerError, match="without lockstep"):
        pair.answering([(0.0,) * 4], flags=0)


def test_px4_that_goes_is_noticed_at_once(pair):
    pair.begin()
    pair.fake.close()
    with pytest.raises(LinkClosedError):
        steps(pair.session, 3)


def test_a_stop_signal_ends_the_wait(pair):
    pair.begin()
    pair.stop.ask()
    began_s = time.monotonic()
    pair.session.step()
    assert time.monotonic() - began_s < AT_ONCE_S


# Each parameter of the script is a file; a command with an unknown parameter fails.
STAND_IN = """#!/bin/sh
cd "$(dirname "$0")/.."
case "$(basename "$0") $1" in
  "px4 "*) echo 'Startup script returned successfully'; echo 'Ready for takeoff!'; exec sleep 60;;
esac
shift 2; verb=$1; name=$2; value=$3
[ -e "values/$name" ] || exit 1
case $verb in
  compare) [ "$(cat "values/$name")" = "$value" ];;
  set) echo "$value" > "values/$name";;
  reset) echo reset > "values/$name";;
esac
"""


@pytest.fixture
def build(tmp_path):
    """Return the folder of a fake build of PX4 that knows three parameters."""
    (tmp_path / "etc").mkdir()
    (tmp_path / "px4-alias.sh").write_text("alias param='px4-param --instance 0'\n")
    (tmp_path / "px4").write_text(STAND_IN)
    (tmp_path / "px4").chmod(0o755)
    values = tmp_path / "run" / "values"
    values.mkdir(parents=True)
    for name in ("COM_OBL_RC_ACT", "COM_OF_LOSS_T", "COM_RC_IN_MODE"):
        (values / name).write_text("0\n")
    return tmp_path


@pytest.mark.parametrize("speed", [1.0, 5.0])
def test_what_the_release_has_is_set_and_what_it_has_not_is_named(build, speed):
    """Parameters that the build has are set; a missing parameter is named and does not prevent the start."""
    wanted = {"COM_OBL_RC_ACT": 4, "COM_RC_IN_MODE": 0, "SYS_HAS_GPS": 0}
    px4 = Px4Program(
        build, build / "run", Px4Model.SIHSIM_QUADX, parameters=wanted, speed=speed, origin_wgs84=None
    )
    try:
        px4.boot(20.0)
        found = {file.name: file.read_text().strip() for file in (build / "run" / "values").iterdir()}
    finally:
        px4.end()
    assert px4.absent == ["SYS_HAS_GPS"]
    scaled = "reset" if speed != 1.0 else "0"
    assert found == {"COM_OBL_RC_ACT": "4", "COM_RC_IN_MODE": "0", "COM_OF_LOSS_T": scaled}
