"""Flies a point mass, and records the flight with the code of the onboard process and the recorder."""

from pathlib import Path

from bridge.mavlink.endpoint import Direction
from flightstack.common.pacing import EPOCH_NS, Tick
from flightstack.common.strict_toml import dumps, from_table
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.types import Phase
from flightstack.onboard.log import OnboardLog
from flightstack.onboard.runner import Taken
from logs.recorder.recording import McapFile
from logs.schema import Names
from tests.point_mass import DT_S, World

CONFIG = from_table(
    FlightConfig,
    {
        "barrier": {"alpha_1_m": 1.0, "beta_m": 1.5},
        "limits": {"velocity_max_m_s": [0.4, 0.4, 0.5]},
        "touchdown": {"rule": "paper"},
    },
)
STEP, INPUT, STATE = "/cf1/controller/step", "/cf1/controller/input", "/cf1/controller/state"


class FileFeed:
    """A feed that writes directly into a file, and flushes the file as the recorder does."""

    def __init__(self, path: Path):
        self.file = McapFile(path)

    def channel(self, topic, schema):
        return self.file.channel(topic, schema)

    def write(self, channel, log_time_ns, publish_time_ns, sequence, payload):
        self.file.write(channel, log_time_ns, publish_time_ns, sequence, payload)

    def metadata(self, name, values):
        self.file.metadata(name, values)

    def flush(self):
        self.file.flush()


class NoSession:
    def declare_publisher(self, key, **_):
        return self

    def put(self, payload):
        pass


def record(
    path: Path, world: World, seconds: float, *, until=None, config: FlightConfig = CONFIG, after=()
) -> Path:
    """Fly and record for at most ``seconds``; ``after``: frames sent after the last tick."""
    feed = FileFeed(path)
    feed.file.attachment("cf1/onboard.toml", "application/toml", 0, dumps(config).encode())
    feed.file.metadata("cf1/onboard", {"namespace": "cf1"})
    log = OnboardLog(feed, NoSession(), Names("cf1", 1), config, lockstep=True)
    for number in range(round(seconds / DT_S)):
        tick = Tick(number, world.t_s, EPOCH_NS + round(world.t_s * 1e9), 0.0, 0.0)
        given = world.inputs()
        out = world.step()
        log.step(tick, Taken(given, False), out, world.controller)
        log.timing(tick, out, 0.0, 0)
        if out.finished or (until is not None and until(world)):
            break
    for frame in after:
        log.tap(Direction.OUT, frame, ("127.0.0.1", 14550))
    log.end()
    feed.file.close()
    return path


def short_flight(path: Path, seconds: float = 3.0) -> Path:
    """Record the first seconds of a landing that starts in the air next to the pad; return the path."""
    world = World(CONFIG, position=(-0.6, 0.2, 0.95))
    record(path, world, seconds)
    assert world.phase in (Phase.APPROACH, Phase.LAND, Phase.TOUCHDOWN, Phase.LANDED)
    return path
