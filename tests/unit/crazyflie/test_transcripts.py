"""Tests the flights of a Crazyflie with the bridge in ``transcripts.txt``, on a simulated clock."""

import ast
import math
import random
import re
import struct
from itertools import pairwise
from operator import attrgetter
from pathlib import Path

import pytest

from bridge.crazyflie.packets import Order, SetParam
from bridge.crazyflie.pilot import UNPLACED_M_S
from bridge.mavlink.server.profile import FlightMode
from bridge.mocap.checks import Passed
from bridge.ros2.cdr import Pose
from tests.crazyflie_firmware.bench import CLIENT, GROUND, OTHER, Bench
from tests.crazyflie_firmware.firmware import Firmware
from tests.crazyflie_firmware.plant import Point
from tests.crazyflie_firmware.supervisor import State

pytestmark = pytest.mark.slow

COMMANDS = {
    "arm": "400 1", "disarm": "400 0", "kill": "400 0 21196", "take-off": "22", "land": "21",
    "terminate": "185 1", "offboard": "176 1 6", "hold": "176 1 4 3",
}  # fmt: skip
FIRMWARE = ("auto_arm", "needs_poses", "clock_rate")  # options of the firmware model
SENDERS = {"": CLIENT, "ground": GROUND, "other": OTHER}
FACTS = {
    "armed": lambda b: b.vehicle.armed,
    "motors": lambda b: b.firmware.plant.motors,
    "locked": lambda b: State.LOCKED in [state for _, state in b.firmware.supervisor.history],
    "standing": lambda b: b.vehicle.standing,
    "busy": lambda b: b.vehicle.busy,
    "alive": lambda b: b.vehicle.alive(b.now_s),
    "surface": lambda b: b.firmware.plant.on_surface,
    "down": lambda b: b.firmware.plant.on_surface and not any(map(b.fact, ("armed", "motors", "locked"))),
    **{mode.name: lambda b, mode=mode: b.vehicle.mode is mode for mode in FlightMode},
}


class Stage(Bench):
    """Plays the steps of a transcript; ``WORDS`` has the function of each step."""

    def __init__(self, firmware, posed=False, tilt_deg=0.0, **options):
        """``posed``: whether the flight uses a motion capture; ``tilt_deg``: argument of ``tilt``."""
        self.mark_s, self.results = 0.0, []
        self.posed = self.poses = posed
        self.tilt(tilt_deg)
        super().__init__(firmware, **options)

    def step(self):
        w, x, y, z = self.quaternion
        position = self.firmware.plant.position
        if self.poses:
            self.firmware.packet(b"\x6d\x08" + struct.pack("<7f", *position, x, y, z, w), self.now_s)
            pose = Pose(0, "map", tuple(position), self.quaternion)
            self.vehicle.mocap(None, Passed(pose, self.now_s, 0))
        elif self.posed:
            self.vehicle.mocap("mocap: no pose for 0.3 s")
        super().step()

    def tilt(self, degrees):
        """Rotate the markers relative to the body, about body y."""
        half_rad = math.radians(float(degrees)) / 2.0
        self.quaternion = (math.cos(half_rad), 0.0, math.sin(half_rad), 0.0)

    def play(self, steps: str) -> None:
        for step in steps.split("; "):
            word = max((w for w in WORDS if f"{step} ".startswith(f"{w} ")), key=len)
            done = WORDS[word](self, *([step[len(word) + 1 :]] if step != word else []))
            assert done is not False, (step, self.now_s, self.texts)

    def fact(self, name):
        return FACTS[name](self)

    def command_(self, words, sender=CLIENT):
        number, *params = map(float, words.split())
        self.results += [a.result for a in self.command(int(number), *params, sender=sender)]

    def do(self, words):
        name, _, sender = words.partition(" by ")
        self.command_(COMMANDS[name], SENDERS[sender])

    def height(self, metres):
        self.armed().command(22, *[math.nan] * 6, float(metres))
        self.until(lambda: self.fact("HOLD")).run(1.0)

    def stream_(self, velocity=""):
        self.stream = tuple(map(float, velocity.split())) or None

    def set_firmware(self, words):
        path, value = words.split()
        *owner, name = path.split(".")
        setattr(
            attrgetter(owner[0])(self.firmware) if owner else self.firmware, name, ast.literal_eval(value)
        )

    def set_param(self, words):
        self.firmware.params[words.split()[0]].value = float(words.split()[1])

    def hangs(self):
        plant, advance = self.firmware.plant, self.firmware.plant.advance

        def held_up(dt_s):
            advance(dt_s)
            plant.position[2], plant.velocity[2] = 0.5, 0.0

        plant.advance = held_up

    def loses(self, seed):
        chance, deliver = random.Random(int(seed)), self.firmware.packet
        self.firmware.packet = lambda raw, now_s: [] if chance.random() < 0.2 else deliver(raw, now_s)

    def near(self, times_s, words):
        after_s, tolerance_s = map(float, words)
        return times_s[0] - self.mark_s == pytest.approx(after_s, abs=tolerance_s)

    def sent_order(self, words):
        name, *after = words.split()
        times_s = self.orders(Order[name])
        return bool(times_s) and (not after or self.near(times_s, after))

    def became(self, words):
        name, *after = words.split()
        return self.near([t for t, s in self.firmware.supervisor.history if s is State[name]][-1:], after)

    def newest_s(self, kind):
        return self.velocities()[-1][0] if kind == "velocity" else self.times(kind)[-1]

    def flew(self, words):
        count, seconds = map(float, words.split())
        before = len(self.velocities())
        self.run(seconds)
        return len(self.velocities()) - before == count

    def follows(self, gap_s):
        """Whether all gaps between positions since ``mark_s`` are below ``gap_s``, s."""
        times_s = [t for t in self.times("LOCAL_POSITION_NED") if t > self.mark_s]
        return max(b - a for a, b in pairwise(times_s)) < float(gap_s)

    def refused(self, reason):
        self.command_(COMMANDS["arm"])
        self.step()
        said = [text for text in self.texts if text.startswith("Arming refused: ")]
        ready = self.last("SYS_STATUS").onboard_control_sensors_health & 0x10000000
        right = len(said) == 1 and re.match(f"Arming refused: {reason}", said[0])
        return bool(right) and self.results == [1] and not (ready or self.fact("armed"))


def numbers(words=""):
    return list(map(float, words.split()))


WORDS = {
    **{word: lambda b, word=word: getattr(Bench, word)(b) and None for word in
       ("ready", "armed", "hover", "offboard", "connect", "lose")},
    "run": lambda b, seconds: b.run(float(seconds)) and None,
    "until": lambda b, fact: b.until(lambda: b.fact(fact)) and None,
    "until-not": lambda b, fact: b.until(lambda: not b.fact(fact)) and None,
    "until-sent": lambda b, order: b.until(lambda: b.orders(Order[order]), 4.0) and None,
    "mark": lambda b: setattr(b, "mark_s", b.now_s),
    "set": lambda b, words: setattr(b, words.split()[0], words.endswith("True")),
    "end": lambda b: b.vehicle.end(b.now_s),
    "answers nothing": lambda b: setattr(b.firmware, "packet", lambda raw, now_s: []),
    "held": lambda b: setattr(b.firmware.plant, "advance", lambda dt_s: None),
    "forgets log blocks": lambda b: b.firmware._blocks.clear(),
    "stalls": lambda b, seconds: b.firmware.stall(float(seconds)),
    "restarts": lambda b: b.firmware.restart(),
    "restarts at once": lambda b: b.firmware._start(),
    "command": Stage.command_, "do": Stage.do, "height": Stage.height, "stream": Stage.stream_,
    "firmware": Stage.set_firmware, "param": Stage.set_param, "hangs": Stage.hangs, "loses": Stage.loses,
    # checks
    "is": lambda b, facts: all(map(b.fact, facts.split())),
    "not": lambda b, facts: not any(map(b.fact, facts.split())),
    "says": lambda b, text: any(re.search(text, said) for said in b.texts),
    "silent": lambda b, text: text not in b.texts,
    "counts": lambda b, words: sum(words[2:] in said for said in b.texts) == int(words[0]),
    "problem": lambda b, text: bool(re.match(text, b.vehicle.problems(b.now_s)[0])),
    "results": lambda b, words="": b.results == numbers(words),
    "replies": lambda b, words="": [r.result for r in b.replies] == numbers(words),
    "unsent": lambda b, order: not b.orders(Order[order]),
    "times": lambda b, words: len(b.orders(Order[words.split()[0]])) >= int(words.split()[1]),
    "no-later": lambda b, words: b.newest_s(words.split()[0]) - b.mark_s <= float(words.split()[1]),
    "younger": lambda b, words: b.now_s - b.newest_s(words.split()[0]) < float(words.split()[1]),
    "older": lambda b, words: b.now_s - b.newest_s(words.split()[0]) > float(words.split()[1]),
    "blind": lambda b, height_m: b.now_s - b.mark_s < 2.2 + 1.2 * float(height_m) / 0.25,
    "velocity": lambda b, words: numbers(words) == pytest.approx(list(b.velocities()[-1][1][0])),
    "fresh": lambda b, seconds: b.now_s - b.vehicle.state.at_s < float(seconds),
    "follows": Stage.follows, "tilt": Stage.tilt,
    "lost": lambda b, words: b.near([b.newest_s(words.split()[0])], words.split()[1:]),
    "fit": lambda b: not b.vehicle.problems(b.now_s),
    "steady": lambda b: max(b.vehicle.health.variance_m2) < 0.01,
    "unplaced": lambda b: not b.vehicle.sensors_healthy(b.now_s),
    "sinks": lambda b: {(0.0, 0.0, -UNPLACED_M_S)}
    == {v.velocity_enu_m_s for t, v in b.velocities() if t > b.mark_s + 1.6},
    "holds": lambda b, words: b.firmware.params[words.split()[0]].value == float(words.split()[1]),
    "writes": lambda b, words: [packet.name for _, packet in b.sent if isinstance(packet, SetParam)].count(
        words.split()[0]) == int(words.split()[1]),
    "place": lambda b, words: b.firmware.plant.position == pytest.approx(numbers(words), abs=0.05),
    "sent": Stage.sent_order, "became": Stage.became, "velocities": Stage.flew, "refused": Stage.refused,
}  # fmt: skip


def flights():
    """Yield name, options and steps of each flight in ``transcripts.txt``."""
    for paragraph in (Path(__file__).parent / "transcripts.txt").read_text().split("\n\n")[1:]:
        head, *lines = paragraph.strip().splitlines()
        head, _, variants = head.partition(" : ")
        name, _, options = head.partition(" | ")
        for word in variants.split() or [""]:
            title = name.replace("{}", word) + (f" ({word})" if word and "{}" not in name else "")
            yield title, options.replace("{}", word), "; ".join(lines).replace("{}", word)


def begin(place=(0.0, 0.0), uptime_s=0.0, posed=False, tilt_deg=0.0, **options):
    model = {name: options.pop(name) for name in FIRMWARE if name in options}
    if posed:
        model["needs_poses"], options["mocap_key"] = True, "lab/pose"
    firmware = Firmware(Point(*place), **model)
    firmware._boot_s = -uptime_s
    return Stage(firmware, posed=posed, tilt_deg=tilt_deg, **options)


@pytest.mark.parametrize(("options", "steps"), [pytest.param(*rest, id=name) for name, *rest in flights()])
def test_each_flight_goes_as_its_transcript(options, steps):
    begin(**eval(f"dict({options})")).play(steps)
