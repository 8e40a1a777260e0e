"""The onboard process: it opens its links, checks the vehicle, and runs ticks in real time or in lockstep."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path

from bridge.mavlink.client.link import COMPONENT_ID
from bridge.mavlink.endpoint import open_endpoint
from bridge.mavlink.line_budget import plan
from bridge.mavlink.preflight.examine import Examination
from bridge.mavlink.profiles import profile
from bridge.mavlink.transport.address import is_local, parse_url, resolve
from bridge.mavlink.transport.transport import dropped
from bridge.zenoh import zenoh_link
from flightstack.common import pacing
from flightstack.common.strict_toml import ConfigError, dumps
from flightstack.compiled.core import chosen_core, compiled
from flightstack.config.options import OnboardOptions, Piloted, described
from flightstack.core.controller import ERROR, WARN, Controller, Outputs
from flightstack.core.memory import Memory
from flightstack.core.mission.phases import DISARMED, MODE_CHANGED
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.strategies.strategy import ignored
from flightstack.core.types import Operator, Phase, VehicleStatus
from flightstack.onboard import preflight
from flightstack.onboard.fleet_wire import FleetWire, LiveStatuses
from flightstack.onboard.leaving import Ended, Leaving, Signals
from flightstack.onboard.lockstep import LockstepStatuses, LockstepWires
from flightstack.onboard.log import OnboardLog
from flightstack.onboard.recording import Described, own_recorder
from flightstack.onboard.runner import LiveWires, Refusals, Runner, Taken, open_link
from flightstack.onboard.waiting import WaitReport
from flightstack.onboard.zenoh_wires import ZenohWires
from flightstack.verify.certificate import certificate_of, refuse
from logs.recorder.feed import Feed
from logs.schema import Names, member_name
from logs.schema.events import CAUSE, ONBOARD

_SEVERITY_LEVEL = {0: ERROR, 1: ERROR, 2: ERROR, 3: ERROR, 4: WARN}  # rcl_interfaces level by MAV_SEVERITY


class Onboard(Leaving):
    """Owner of the links and the controller; it logs the ticks and decides when the flight ends."""

    def __init__(
        self,
        config: FlightConfig,
        options: OnboardOptions,
        say: Callable[[str], None],
        records: ExitStack | None = None,
    ) -> None:
        """Open the links; start a recorder if the options name none, and end it with ``records``."""
        super().__init__(options.duration_s)
        self.options, self.config, self.say = options, config, say
        self.namespace = options.namespace or member_name(config.fleet.id)
        self.names = Names(self.namespace, options.system_id)
        self.core = chosen_core(options.core, config, lockstep=options.lockstep)
        self.controller = compiled(config) if self.core == "compiled" else Controller(config)
        self.wires = ZenohWires(config, options, self.namespace)
        self.fleet = _fleet(config, options, self.wires.session, self.namespace)
        age_max_s, signed = config.checks.own_age_max_s, options.signing_key is not None
        every = plan(parse_url(options.vehicle_url).baud, config.loop.rate_hz, age_max_s, signed=signed).every
        # this process has the same MAVLink system id as the vehicle
        system_id, lockstep = options.system_id, options.lockstep
        endpoint = open_endpoint("onboard", options.vehicle_url, system_id, COMPONENT_ID, options)
        autopilot = profile(options.autopilot)
        self.link = open_link(config, endpoint, system_id, autopilot, lockstep=lockstep, every=every)
        self.log_file: Path | None = None
        recorder = options.recorder
        if recorder is None and records is not None and not options.no_record:
            plugged = {"vehicle": options.vehicle_url, "target": options.target_key}
            flight = Described(config, plugged, self.names)
            recorder, self.log_file = records.enter_context(own_recorder(flight))
        socket = str(recorder) if recorder is not None else None
        self.feed = Feed.connect(socket, self.names.logger(ONBOARD), lossless=lockstep)
        self._describe()
        self.log = OnboardLog(
            self.feed, self.wires.session, self.names, config, self.fleet.topics, lockstep=lockstep
        )
        self.link.endpoint.tap = self.log.tap
        # no search for other keys in lockstep, because its texts would depend on wall time
        self.waiting = WaitReport(config, system_id, self.link, self.wires, searches=not lockstep)
        self._foreign_due, self.refusals = 1, Refusals()
        self.cause = ""  # reason why the autopilot ended the flight; it is appended to the phase's reason
        self.opened_s = time.monotonic()

    def write(self, tick: pacing.Tick, taken: Taken, out: Outputs, exec_s: float) -> None:
        """Log and publish a tick, and send the message to the fleet."""
        link, arrived = self.link, taken.arrived
        exec_s *= self.options.speed
        self.log.status(tick, self.fleet.say(out.member_status))  # other members wait for this message
        self.log.samples(arrived.messages, tick.unix_ns)
        for text in self.refusals.told(arrived.problems):
            self.log.event(tick.unix_ns, WARN, text)
        for severity, text in link.take_texts():
            self.waiting.note_text(tick.now_s, severity, text)
            self.log.event(tick.unix_ns, _SEVERITY_LEVEL.get(severity, 20), f"vehicle: {text}")
        foreign = link.foreign.total()
        if foreign >= self._foreign_due:  # the count is reported whenever it has doubled
            self.log.event(tick.unix_ns, WARN, f"frames of other systems ignored: {foreign}")
            self._foreign_due = 2 * foreign
        notices = (*link.endpoint.take_notices(), *link.senders.take_notices())
        for text in (*notices, *self.wires.texts(tick.now_s), *self.fleet.texts()):
            self.warn(text, tick.unix_ns)
        memory = self.controller.memory
        report = self.waiting.step(out, memory, len(arrived.messages), arrived.problems, tick.now_s)
        if self.options.lockstep:  # the report depends on wall time
            report = None
        if report is not None:
            self.log.event(tick.unix_ns, WARN, report)
        row = self.log.step(tick, taken, out, self.controller)
        self.log.timing(tick, out, exec_s, self.feed.dropped)
        if out.transition is not None and out.transition.reason.startswith((DISARMED, MODE_CHANGED)):
            self.cause = f"; {self.waiting.cause(tick.now_s)}"
            self.log.event(tick.unix_ns, ERROR, CAUSE + self.cause[2:])
        why = memory.reason + self.cause
        health = self.log.health(tick, out, why, link.state.battery, self.feed.dropped)
        self.wires.show(tick, out, row, health)
        if out.transition is not None and out.transition.after is not out.transition.before:
            self.say(out.transition.timed_text(tick.now_s) + self.cause)
        if report is not None:
            self.say(f"{tick.now_s:8.2f} s  {report}")

    def _describe(self) -> None:
        """Write configuration and connections to the log; a replay needs them."""
        options, spec = self.options, self.wires.target
        own_key = f"{self.namespace}/target/odom"
        text, endpoint = dumps(self.config), self.link.endpoint
        self.feed.attachment(self.names.record("onboard.toml"), "application/toml", text.encode())
        self.feed.metadata(
            self.names.record("onboard"),
            {
                "namespace": self.namespace,
                "target_key": spec.key if spec.is_direct else own_key,  # key of the recorded target
                **({} if spec.is_direct else spec.described()),
                "system_id": str(options.system_id),
                "lockstep": str(options.lockstep).lower(),
                "autopilot": options.autopilot,
                **described(options, Piloted),
                "core": self.core,
                # the message rates of a slow serial line depend on the baud rate
                **({"baud": str(endpoint.baud)} if endpoint.baud is not None else {}),
                "signed": str(endpoint.signed).lower(),
            },
        )

    def warn(self, text: str, unix_ns: int | None = None, level: int = WARN) -> None:
        """Print and log a warning."""
        print(f"onboard: WARNING: {text}", file=sys.stderr)
        self.log.event(time.time_ns() if unix_ns is None else unix_ns, level, text)

    def ended(self, out: Outputs, memory: Memory, status: VehicleStatus | None, now_s: float) -> Ended | None:
        """Return how the flight ended, or why link or fleet reject the vehicle; None: it has not ended."""
        armed = status is not None and status.armed
        doubled = self.link.senders.doubled or self.fleet.doubled
        refused = self.link.refused or (doubled if out.phase is Phase.WAIT and not armed else "")
        if refused and not out.finished:
            return Ended(out.phase, refused, 1)
        ended = super().ended(out, memory, status, now_s)
        if ended is not None and self.cause:
            return ended._replace(reason=ended.reason + self.cause)
        lacking, person = self.waiting.lacking, self.person
        if ended is None or not lacking or person.stop or person.operator is not Operator.NONE:
            return ended
        return ended._replace(reason=f"{ended.reason}: {'; '.join(lacking)}")

    def close(self) -> None:
        """Close all links; the feed then reports its end to the recorder."""
        counters, took_s = self.link.endpoint.counters, time.monotonic() - self.opened_s
        if lost := dropped(counters):
            print(f"onboard: MAVLink frames rejected: {lost}", file=sys.stderr)
        if self.link.endpoint.baud is not None:
            came, went = counters["bytes_in"] / took_s, counters["bytes_out"] / took_s
            print(
                f"onboard: serial line in {took_s:.1f} s: {came:.0f} B/s in, {went:.0f} B/s out",
                file=sys.stderr,
            )
        # the fleet is first: in lockstep other members wait for its last message
        for end in (self.fleet.close, self.log.end, self.feed.close, self.link.close, self.wires.close):
            try:
                end()
            except Exception as error:  # the other links must be closed, too
                print(f"onboard: WARNING: not closed in order: {error!r}", file=sys.stderr)


def run(config: FlightConfig, options: OnboardOptions, say: Callable[[str], None] = print) -> Ended:
    """Fly until the vehicle has landed, the flight is aborted, the operator ends it, or its time is over."""
    _check_speed(options)
    pacing.chosen_clock(options.speed, options.clock, pacing.Follower.ONBOARD, lockstep=options.lockstep)
    refuse([config])
    if not (options.unproven or options.lockstep or certificate_of(config)):
        raise ConfigError(
            f"refused before take-off: filter {config.filter} has no certificate of its own; "
            "--unproven flies it"
        )
    with ExitStack() as records:
        onboard = Onboard(config, options, say, records)  # a signal before this line cancels the flight
        records.callback(onboard.close)
        onboard.person = Signals()
        if onboard.log_file is not None:
            say(f"log {onboard.log_file}")
        say(f"core {onboard.core}")
        for text in ignored(config):
            say(text)
        say("ready")
        sys.stdout.flush()
        if not options.lockstep:  # in lockstep the vehicle is simulated, with known parameters
            ended = _preflight(onboard)
            if ended is not None:
                return ended
        pacing.quiet_garbage_collector()
        ticks = Runner(onboard.controller, _wires(onboard), onboard, onboard.write)
        return ticks.fly(partial(onboard.warn, level=ERROR))


def _check_speed(options: OnboardOptions) -> None:
    """Reject a speed other than real time unless the vehicle is a simulator."""
    if options.speed == 1.0 and options.clock is None:
        return
    kind, host, port = parse_url(options.vehicle_url)
    if kind == "serial" or not is_local(resolve(f"MAVLink URL {options.vehicle_url!r}", host, port)):
        raise ValueError(
            f"--speed or --clock is given and {options.vehicle_url!r} is not on loopback: only a simulator "
            "has a clock of its own; leave them out"
        )


def _fleet(
    config: FlightConfig, options: OnboardOptions, session: zenoh_link.Session, namespace: str
) -> FleetWire:
    """Return the connection to the other fleet members. Raises ConfigError: they cannot connect."""
    if not config.fleet.others:
        return FleetWire()
    if not (options.connect or options.listen or options.zenoh_config):
        raise ConfigError(
            "[fleet]: no other process can reach this one; --connect, --listen or --zenoh-config is needed "
            "(docs/how_it_works/fleet.md)"
        )
    if options.lockstep:
        return LockstepStatuses(session, namespace)
    return LiveStatuses(session, namespace, config.fleet)


def _preflight(onboard: Onboard) -> Ended | None:
    """Return why the flight must not start (vehicle not ready, or id used twice); None: it is permitted."""
    options, endpoint, senders = onboard.options, onboard.link.endpoint, onboard.link.senders
    wait_s = onboard.config.checks.wait_time_max_s
    if options.duration_s is not None:
        wait_s = min(wait_s, options.duration_s)
    tap, endpoint.tap = endpoint.tap, None  # the frames of the check are not logged

    def tell(text: str) -> None:
        onboard.say(f"preflight: {text}")
        onboard.log.event(time.time_ns(), WARN, f"preflight: {text}")

    vehicle = Examination(
        endpoint, options.system_id, profile(options.autopilot), senders, say=tell,
        stopped=lambda: onboard.person.stop or onboard.person.operator is not Operator.NONE,
    )  # fmt: skip
    report = preflight.check(vehicle, onboard.config, wait_s=wait_s, accept_release=options.accept_release)
    endpoint.tap = tap
    senders.begin(0.0)
    for notice in (*endpoint.take_notices(), *senders.take_notices()):
        onboard.warn(notice)
    onboard.feed.metadata(onboard.names.record("preflight"), preflight.record(report))
    if report.profile is not None and onboard.link.state.profile is None:
        onboard.link.adopt(report.profile)
    for line in preflight.lines(report):
        onboard.say(line)
    if onboard.person.operator is Operator.EMERGENCY_STOP:
        return None  # the ticks send the emergency stop without a pre-flight check
    problem = preflight.verdict(report) or onboard.fleet.namesake()
    return Ended(Phase.WAIT, problem, 1) if problem else None


def _wires(onboard: Onboard) -> LockstepWires | LiveWires:
    """Return the connections that a tick uses: clock, vehicle, target, fleet."""
    options, link, zenoh, fleet = onboard.options, onboard.link, onboard.wires, onboard.fleet
    rate_hz, person = onboard.config.loop.rate_hz, onboard.person
    if options.lockstep:
        return LockstepWires(link, rate_hz, zenoh.odometry, zenoh.session, onboard.namespace, person, fleet)
    pacing.run_promptly()
    clock = pacing.chosen_clock(options.speed, options.clock, pacing.Follower.ONBOARD, lambda: person.stop)
    pacer = pacing.RealTimePacer(rate_hz, clock)
    fleet.begin(pacer.unix_start_ns, pacer.now_s)
    return LiveWires(link, pacer, zenoh.odometry, fleet.statuses)
