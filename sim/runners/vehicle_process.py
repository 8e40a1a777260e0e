"""The simulated vehicle as a process: MAVLink on one side, the robot's true pose on the other."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import MappingProxyType

from bridge.mavlink.endpoint import Endpoint, parse_peer
from bridge.mavlink.signing.key import load_key
from bridge.mavlink.transport.address import parse_udp_url
from bridge.zenoh import zenoh_link
from flightstack.common.pacing import EPOCH_NS, quiet_garbage_collector
from logs.recorder.feed import Feed, FeedError
from sim.autopilot.autopilot import COMPONENT_ID, SYSTEM_ID, Autopilot
from sim.autopilot.profiles import PROFILES, PX4
from sim.clock import NoAnswerError, StopSignal, TickGrid
from sim.runners.deck import LockstepDeck, RealTimeDeck
from sim.runners.lockstep import LockstepLoop
from sim.runners.realtime import RealTimeLoop
from sim.runners.vehicle_log import VehicleLog
from sim.runners.vehicle_runner import VehicleNode
from sim.scenarios.scenario import Scenario
from sim.vehicle.vehicle import VehicleSim, warm_up


def vehicle_main(
    scenario: Scenario,
    seed: int,
    url: str,
    *,
    lockstep: bool,
    rate_hz: int,
    feed_socket: str | None = None,
    zenoh_connect: Sequence[str] = (),
    zenoh_listen: Sequence[str] = (),
    namespace: str = "cf1",
    duration_s: float | None = None,
    ready_line: bool = True,
    signing_key: Path | None = None,
    peers: Sequence[str] = (),
    allow_unsigned: bool = False,
    zenoh_config: Path | None = None,
    personality: str = PX4.name,
    parameters: Mapping[str, float] = MappingProxyType({}),
) -> int:
    """Run the vehicle until SIGTERM, SIGINT or ``duration_s``; prints ``ready URL`` when it can be reached.

    Prints ``armed`` and ``disarmed``, too, whenever that changes.

    Without any Zenoh endpoint there is no link to the robot, and the deck stands where the scenario puts it.

    Args:
        scenario: vehicle, start, wind.
        seed: chance.
        url: MAVLink endpoint, ``udpin:HOST:PORT`` (port 0: a free one, printed) or ``udpout:HOST:PORT``.
        lockstep: simulated time goes on with the companion's answers, instead of real time.
        rate_hz: ticks per second; in lockstep that of the onboard process.
        feed_socket: flight recorder, if there is one.
        zenoh_connect: Zenoh endpoints to connect to.
        zenoh_listen: Zenoh endpoints to listen on.
        namespace: first part of all Zenoh keys.
        duration_s: how long, simulated or real; None: no end.
        ready_line: print the line.
        signing_key: file of the key that every MAVLink frame must be signed with.
        peers: ``HOST:PORT`` of those who get telemetry before they speak; real time only.
        allow_unsigned: listen to a network without a key.
        zenoh_config: Zenoh configuration to begin with.
        personality: which autopilot it plays, a name of ``PROFILES``.
        parameters: of that autopilot, set before it starts.

    Returns:
        Exit status: 0 in order, 1 when something it needs did not come, 2 for wrong input.
    """
    stop = StopSignal().install()
    try:
        with ExitStack() as stack:
            kind, host, port = parse_udp_url(url, "the simulated vehicle")
            if lockstep and peers:
                raise ValueError("--peer is for real time: in lockstep the companion calls first")
            endpoint = Endpoint(
                url,
                SYSTEM_ID,
                COMPONENT_ID,
                signing_key=load_key(signing_key) if signing_key else None,
                always=[parse_peer(peer) for peer in peers],
                allow_unsigned=allow_unsigned,
            )
            stack.callback(_close, endpoint)
            for warning in endpoint.warnings:
                print(f"vehicle: WARNING: {warning}", file=sys.stderr)
            session = None
            if zenoh_connect or zenoh_listen or zenoh_config is not None:
                session = zenoh_link.open_session(zenoh_listen, zenoh_connect, config_file=zenoh_config)
            if session is not None:
                stack.callback(session.close)
            warm_up(scenario)
            vehicle = VehicleSim(scenario, seed)
            epoch_ns = EPOCH_NS if lockstep else time.time_ns()
            feed = Feed.connect(feed_socket, "vehicle", lossless=lockstep)
            stack.callback(feed.close)
            autopilot = Autopilot(
                vehicle,
                rate_hz,
                epoch_ns=epoch_ns,
                trim_enu_m_s=vehicle.trim_velocity_enu_m_s,
                profile=PROFILES[personality],
            )
            for name, value in parameters.items():
                autopilot.parameters.preset(name, value)
            node = VehicleNode(vehicle, autopilot, endpoint, VehicleLog(feed, epoch_ns, namespace), _tell)
            grid = TickGrid(rate_hz)
            loop: LockstepLoop | RealTimeLoop
            if lockstep:
                deck = LockstepDeck(session, namespace) if session is not None else None
                loop = LockstepLoop(node, deck, grid, stop, scenario.vehicle.setpoint_delay_s)
            else:
                follower = RealTimeDeck(session, namespace) if session is not None else None
                loop = RealTimeLoop(node, follower, grid, stop)
            if ready_line:
                bound = endpoint.local_port if kind == "udpin" else port
                print(f"ready {kind}:{host}:{bound}", flush=True)
            quiet_garbage_collector()
            loop.run(grid.count(duration_s))
    except ValueError as error:
        print(f"vehicle: {error}", file=sys.stderr)
        return 2
    except (OSError, zenoh_link.ZenohLinkError, FeedError, NoAnswerError) as error:
        print(f"vehicle: {error}", file=sys.stderr)
        return 1
    return 0


def _tell(armed: bool) -> None:
    """For whoever started us: whether it may end us."""
    print("armed" if armed else "disarmed", flush=True)


def _close(endpoint: Endpoint) -> None:
    dropped = endpoint.counters.dropped()
    if dropped:
        print(f"vehicle: MAVLink not let through: {dropped}", file=sys.stderr)
    endpoint.close()
