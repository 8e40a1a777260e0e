"""The simulated vehicles of a fleet as one process: a MAVLink endpoint each, with system ids from 1 on.

They share a process since what happens between them is physical: jets and collisions need all states at once.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack

from bridge.mavlink.transport.address import parse_udp_url
from flightstack.common.hangup import Stop
from flightstack.common.pacing import EPOCH_NS, quiet_garbage_collector
from logs.recorder.feed import Feed
from logs.schema.names import Names, member_name
from sim.clock import TickGrid
from sim.runners.deck import RealTimeDeck
from sim.runners.fleet.lockstep import FleetLockstep, LockstepMember
from sim.runners.fleet.room import Member, Room
from sim.runners.fleet.team import warm_up_room
from sim.runners.fleet.words import Words
from sim.runners.log import VehicleLog
from sim.runners.options import VehicleOptions
from sim.runners.vehicle_node import VehicleNode
from sim.runners.vehicle_process import (
    RealTimeLoop,
    RealTimeVehicle,
    autopilot_of,
    joined,
    opened,
    served,
)
from sim.scenarios.team import TeamScenario
from sim.vehicle.vehicle import VehicleSim

_PAUSE_S = 0.1  # s between two looks at the signals when all flights are over


def fleet_main(team: TeamScenario, options: VehicleOptions) -> int:
    """Run the vehicles until SIGTERM, SIGINT or ``duration_s``; prints ``ready URL URL ...``, cf1's first.

    Prints ``armed cf1`` and the like, too, whenever that changes.

    Args:
        team: everything that is not chance.
        options: as of one vehicle; a port that is not 0 is that of cf1, and the others follow. Namespaces are
            those of the members.

    Returns:
        Exit status, as of ``vehicle_main``.
    """
    return served(lambda stop, stack: _fly(team, options, stop, stack))


def _fly(team: TeamScenario, options: VehicleOptions, stop: Stop, stack: ExitStack) -> None:
    session = joined(options, stack)
    if session is None:
        raise ValueError("vehicles of a team follow robots on Zenoh; --connect, --listen or --zenoh-config")
    kind, host, port = parse_udp_url(options.url, "the simulated vehicle")
    warm_up_room(team)
    epoch_ns = EPOCH_NS if options.lockstep else time.time_ns()
    number = len(team.member) - len(options.leave_out)
    feed = Feed.connect(options.recorder, "vehicle", lossless=options.lockstep, vehicles=max(1, number))
    stack.callback(feed.close)
    members, urls = [], []
    here = [
        (number, scenario, seed)
        for number, (scenario, seed) in enumerate(team.singles(options.seed), 1)
        if number not in options.leave_out
    ]
    if not here:
        raise ValueError("--leave-out leaves no vehicle; the scenario of one of them simulates it alone")
    if options.leave_out and options.lockstep:
        raise ValueError(
            "--leave-out is for real time: a vehicle from elsewhere does not wait for the others"
        )
    for number, scenario, seed in here:
        own = f"{kind}:{host}:{port + number - 1 if port else 0}"
        endpoint, url = opened(options, own, number, stack)
        urls.append(url)
        name = member_name(number)
        vehicle = VehicleSim(scenario, seed)
        autopilot = autopilot_of(vehicle, options, number, epoch_ns)
        log = VehicleLog(feed, epoch_ns, name, Names(name, number))
        members.append(Member(number, VehicleNode(vehicle, autopilot, endpoint, log, _teller(name))))
    grid = TickGrid(options.rate_hz)
    room, ticks = Room(members, grid, feed), grid.count(options.duration_s)
    stop.install()
    print("ready", *urls, flush=True)
    quiet_garbage_collector()
    if not options.lockstep:
        vehicles = [RealTimeVehicle(each.node, RealTimeDeck(session, each.name), grid) for each in members]
        RealTimeLoop(vehicles, grid, stop, room).run(ticks)
        return
    in_step = [
        LockstepMember(member, session, grid, stop, scenario.vehicle.setpoint_delay_s)
        for member, (_, scenario, _) in zip(members, here, strict=True)
    ]
    FleetLockstep(in_step, room, Words(team, options.seed), stop, epoch_ns).run(ticks)
    feed.flush()
    while not stop.is_set:  # whoever started this process ends it
        time.sleep(_PAUSE_S)


def _teller(name: str) -> Callable[[bool], None]:
    def tell(armed: bool) -> None:
        print("armed" if armed else "disarmed", name, flush=True)

    return tell
