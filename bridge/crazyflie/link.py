"""Radio link through cflib: its callbacks fill bounded queues; one worker thread calls cflib.

cflib may block for 2 s in a send (radiodriver.py), and without limit while it connects; so the MAVLink loop
never calls cflib. The loop takes events with ``poll`` and queues packets with ``send``; neither blocks. The
outbox sends urgent packets first and drops old velocities.
"""

from __future__ import annotations

import logging
import math
import os
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import cflib.crtp
from cflib.crazyflie import Crazyflie
from cflib.crazyflie.log import LogConfig
from cflib.crtp.crtpstack import CRTPPort

from bridge.crazyflie.condition import too_old, with_remedy
from bridge.crazyflie.packets import (
    BLOCKS,
    FETCHED_AS,
    ArmReply,
    Block,
    Connected,
    Event,
    LogPacket,
    Lost,
    Order,
    Outbox,
    Packet,
    ParamValue,
    SetParam,
    Velocity,
)
from bridge.crazyflie.rules import DRAG
from bridge.ros2.cdr import Pose

PARAMS = (  # firmware parameters that are read for the checks before arming
    "stabilizer.estimator", "stabilizer.controller", "deck.bcFlow2", "deck.bcLighthouse4", "deck.bcLoco",
    *DRAG,
)  # fmt: skip
EVENTS_MAX = 512  # maximum number of queued events: four seconds of log packets
BLOCK_SILENT_S = 1.0  # time without a packet after which a log block is requested again, s
ANSWER_MAX_S = 2.0  # time without any answer after which an attempt to connect is given up, s
UNANSWERED_S = 0.5  # time-out of the first answer in a blind landing, s: cflib sends the first request once
CONNECT_MAX_S = 120.0  # time-out of an attempt to connect, s; 1,235 requests, a fifth of them lost, take 40 s
RESEND_S = 0.05  # time-out before cflib repeats a request over UDP, s; cflib's default of 0.2 s suits a radio
RETRY_S = 0.5  # time between two attempts to connect, s
REOPEN_S = 0.1  # time between two attempts in a blind landing, s; without set-points motors stop after 2 s
FLOWN_S = 0.5  # time after the last set-point until the vehicle no longer counts as flying, s
_ANSWERS = (CRTPPort.PARAM, CRTPPort.MEM, CRTPPort.LOGGING, CRTPPort.PLATFORM, CRTPPort.LINKCTRL)
_LOG_DATA = (CRTPPort.LOGGING, 2)  # port and channel of log packets
LOGS_MAX_S = 10.0  # time-out of the first packet of each log block, s
_ARM_REPLY = 0x81  # answer to command 1 on channel 1 of the supervisor's port (cflib supervisor.py)


class LogBlocks:
    """Requests each log block until packets of it arrive: call ``step`` often. No block delays another.

    The firmware deletes its log blocks when it has received nothing for a second (crtp.c, log.c); cflib does
    not check that blocks arrive. cflib requests a long block in two packets and does not check that the
    second packet arrived; a block without the second packet is too short and is never decoded.
    """

    def __init__(self, crazyflie: Any, put: Callable[[Event], None]) -> None:
        """``put``: function that receives the events, called in cflib's thread."""
        self._crazyflie, self._put = crazyflie, put
        known = crazyflie.log.toc.get_element_by_complete_name
        for name in (name for block in BLOCKS for name in block.variables):
            if known(name) is None:
                raise ValueError(f"the firmware has no log variable {name}: update it")
        self._heard_s = dict.fromkeys((block.name for block in BLOCKS), -math.inf)
        self._asked_s = dict(self._heard_s)
        self._configs: dict[str, Any] = {}

    def step(self) -> None:
        """Request each block that has sent no packet for a second."""
        since_s = time.monotonic() - BLOCK_SILENT_S
        for block in BLOCKS:
            if max(self._heard_s[block.name], self._asked_s[block.name]) <= since_s:
                self._ask(block)

    def _ask(self, block: Block) -> None:
        """Request a block under a new number; packets with the old number are no longer decoded."""
        if block.name in self._configs:
            old = self._configs.pop(block.name)
            old.delete()
            self._crazyflie.log.log_blocks.remove(old)
        self._asked_s[block.name] = time.monotonic()
        config = self._configs[block.name] = LogConfig(block.name, block.period_ms)
        for variable in block.variables:
            config.add_variable(variable, FETCHED_AS.get(variable))
        self._crazyflie.log.add_config(config)
        config.data_received_cb.add_callback(self._take)
        config.start()

    def _take(self, time_ms: int, values: dict[str, Any], config: Any) -> None:
        self._heard_s[config.name] = time.monotonic()
        self._put(LogPacket(config.name, time_ms, values))

    @property
    def waits_for(self) -> str | None:
        """Return the name of a block that has not arrived yet; None: all have arrived."""
        return next((name for name, heard_s in self._heard_s.items() if heard_s == -math.inf), None)


class _LostError(Exception):
    """The connection has ended; the text is the reason."""


class CrazyflieLink:
    """Link to one Crazyflie by URI; opens the connection again after each loss until closed."""

    def __init__(self, uri: str, cache: Path | None = None) -> None:
        """Start connecting; a ``cache`` folder for tables of contents makes a second connection fast."""
        self._uri, self._cache = uri, cache
        self._temporary = tempfile.TemporaryDirectory()  # folder of the tables of contents without ``cache``
        self._events: deque[tuple[float, Event]] = deque(maxlen=EVENTS_MAX)
        self._outbox = Outbox()
        self._closing = threading.Event()
        self._read_fd, self._write_fd = os.pipe()
        os.set_blocking(self._read_fd, False)
        os.set_blocking(self._write_fd, False)
        self._heard_s = 0.0  # time of the newest answer, s
        self._broken: str | None = None  # reason why the present connection is lost, or None
        self._protocol: int | None = None  # CRTP protocol of the last connection
        self._current: Any = None  # cflib's object of the present connection
        self._flown_s = -math.inf  # time of the last set-point sent, s
        self._fully = False  # whether the start-up requests of cflib are answered
        # cflib logs a stack trace for every packet that it cannot use
        logging.getLogger("cflib").setLevel(logging.CRITICAL)
        cflib.crtp.init_drivers()
        self._thread = threading.Thread(target=self._run, name="crazyflie-link", daemon=True)
        self._thread.start()

    def fileno(self) -> int:
        """Return a descriptor for ``select`` that is readable as long as events wait."""
        return self._read_fd

    def poll(self) -> list[tuple[float, Event]]:
        """Return all events with their times on ``time.monotonic``, oldest first; never blocks."""
        with suppress(BlockingIOError):
            while os.read(self._read_fd, 4096):
                pass
        return [self._events.popleft() for _ in range(len(self._events))]

    def send(self, packet: Packet) -> None:
        """Queue a packet; never blocks. A newer velocity or pose replaces one that is not sent yet."""
        self._outbox.put(packet, time.monotonic())

    def close(self) -> None:
        """Close the link; this takes up to about 2 s, because cflib waits for its threads to end."""
        self._closing.set()
        self._outbox.wake()
        self._thread.join(6.0)
        self._temporary.cleanup()
        os.close(self._read_fd)
        os.close(self._write_fd)

    def _put(self, event: Event) -> None:
        self._events.append((time.monotonic(), event))
        with suppress(OSError):  # a full pipe is already readable; a closed pipe has no reader
            os.write(self._write_fd, b"\x00")

    def _run(self) -> None:
        while not self._closing.is_set():
            crazyflie = Crazyflie(rw_cache=str(self._cache or self._temporary.name))
            try:
                self._connection(crazyflie)
            except _LostError as error:
                reason = str(error)
            except Exception as error:  # cflib raises plain Exception
                reason = f"{type(error).__name__}: {error}"
            finally:
                self._close(crazyflie)
            if not self._closing.is_set():
                self._put(Lost(reason))
                self._closing.wait(REOPEN_S if self._flies else RETRY_S)

    def _connection(self, crazyflie: Any) -> None:
        """Open the link and pass on packets and events; raise an exception when the connection ends."""
        if not self._flies:
            self._outbox.clear()  # drop packets that are older than this connection
        begin_s = self._heard_s = time.monotonic()
        self._broken, self._fully, self._current = None, False, crazyflie

        def put(event: Event) -> None:
            if self._current is crazyflie:
                self._put(event)

        self._listen(crazyflie, put)
        crazyflie.open_link(self._uri)
        if self._flies and self._protocol is not None:  # set-points need a known packet format
            crazyflie.platform._protocolVersion = self._protocol
        while not self._fully:
            self._pass_on(crazyflie, 0.05)
            unanswered = self._flies and self._heard_s <= begin_s
            silent_max_s = UNANSWERED_S if unanswered else ANSWER_MAX_S
            if time.monotonic() > min(self._heard_s + silent_max_s, begin_s + CONNECT_MAX_S):
                raise _LostError(
                    f"no answer from {self._uri}: is it switched on, and are channel and address right?"
                )
        protocol = self._protocol = crazyflie.platform.get_protocol_version()
        try:
            logs = LogBlocks(crazyflie, put)
        except ValueError as error:
            raise _LostError(too_old(protocol) or str(error)) from error
        deadline_s = time.monotonic() + LOGS_MAX_S
        while (name := logs.waits_for) is not None:
            if time.monotonic() > deadline_s:
                raise _LostError(f"the Crazyflie sends no {name} log")
            logs.step()
            self._pass_on(crazyflie, 0.02)
        crazyflie.param.add_update_callback(cb=lambda name, value: put(ParamValue(name, str(value))))
        groups = crazyflie.param.values
        found = {name: groups.get(name.partition(".")[0], {}).get(name.partition(".")[2]) for name in PARAMS}
        self._put(Connected(protocol, {name: str(n) for name, n in found.items() if n is not None}))
        while True:
            logs.step()
            packet = self._pass_on(crazyflie, 0.1)
            if packet is Order.RECONNECT:
                raise _LostError("silent")
            find = crazyflie.param.toc.get_element_by_complete_name
            if isinstance(packet, SetParam) and find(packet.name) is None:
                put(ParamValue(packet.name, None))
            elif packet is not None:
                _transmit(crazyflie, packet)

    @property
    def _flies(self) -> bool:
        """Whether the vehicle flies, so that set-points continue while the connection is opened again."""
        return not self._closing.is_set() and time.monotonic() - self._flown_s < FLOWN_S

    def _pass_on(self, crazyflie: Any, wait_s: float) -> Packet | None:
        """Wait for a packet and send it; set-points and orders are sent as soon as the link is open.

        Set-points and orders do not wait for the set-up of the connection, so that a blind landing continues;
        without a link they are dropped. Other packets and RECONNECT are returned. Raises _LostError: the
        connection ended.
        """
        packet = self._outbox.get(wait_s, time.monotonic)
        if self._closing.is_set() or self._broken is not None:
            raise _LostError(self._broken or "closed")
        if not isinstance(packet, Velocity | Order) or packet is Order.RECONNECT:
            return packet
        if isinstance(packet, Velocity):
            self._flown_s = time.monotonic()
        elif packet is Order.STOP:
            self._flown_s = -math.inf
        # before the protocol version is known, cflib would send an outdated packet format
        if crazyflie.link is not None and crazyflie.platform.get_protocol_version() >= 0:
            _transmit(crazyflie, packet)
        return None

    def _close(self, crazyflie: Any) -> None:
        """Close the link and stop the motors, unless the vehicle flies.

        cflib would end with a set-point of zero thrust. Within two seconds after a flight the supervisor
        would treat the silence after this set-point as a lost link, and lock. So a stop set-point and its
        notice are sent instead. cflib waits up to two seconds for its threads; so a separate thread closes
        the link, and the next connection may begin.
        """
        if crazyflie.link is not None and not self._flies:
            crazyflie.commander.send_stop_setpoint()
            for _ in range(3):  # repeated because a packet may be lost
                crazyflie.commander.send_notify_setpoint_stop()
        crazyflie.commander.send_setpoint = lambda *_: None
        self._current = None  # later events of the closed link's threads are ignored
        closer = threading.Thread(
            target=_close_quietly, args=(crazyflie,), name="crazyflie-close", daemon=True
        )
        closer.start()
        if self._closing.is_set():
            closer.join()

    def _listen(self, crazyflie: Any, put: Callable[[Event], None]) -> None:
        def resend(_uri: str) -> None:
            # The UDP driver never repeats a request: one lost answer would block the connection permanently.
            if crazyflie.link is not None and crazyflie.link.get_name() == "udp":
                crazyflie.link.needs_resending = True
                crazyflie.send_packet = partial(crazyflie.send_packet, timeout=RESEND_S)

        def heard(packet: Any) -> None:
            # Log packets of an earlier connection may still arrive; they answer no request.
            answer = packet.port in _ANSWERS and (packet.port, packet.channel) != _LOG_DATA
            if answer and self._current is crazyflie:
                self._heard_s = time.monotonic()

        def fully(_uri: str) -> None:
            if self._current is crazyflie:
                self._fully = True
                self._outbox.wake()

        def broken(_uri: str, reason: str) -> None:
            if self._current is crazyflie:
                self._broken = with_remedy(reason.strip().partition("\n")[0])
                self._outbox.wake()

        def supervisor(packet: Any) -> None:
            if len(packet.data) >= 3 and packet.data[0] == _ARM_REPLY:
                put(ArmReply(bool(packet.data[1]), bool(packet.data[2])))

        crazyflie.link_established.add_callback(resend)
        crazyflie.packet_received.add_callback(heard)
        crazyflie.connection_failed.add_callback(broken)
        crazyflie.connection_lost.add_callback(broken)
        crazyflie.fully_connected.add_callback(fully)
        crazyflie.add_port_callback(CRTPPort.SUPERVISOR, supervisor)


def _close_quietly(crazyflie: Any) -> None:
    with suppress(Exception):  # closing a broken link raises its error again
        crazyflie.close_link()


def _transmit(crazyflie: Any, packet: Packet) -> None:
    commander, supervisor = crazyflie.commander, crazyflie.supervisor
    match packet:
        case Velocity(velocity_enu_m_s, yaw_rate_rad_s):  # CRTP expects degrees per second
            commander.send_velocity_world_setpoint(*velocity_enu_m_s, yaw_rate_rad_s * 57.29577951308232)
        case Pose(position_m=position_enu_m, orientation_wxyz=(w, x, y, z)):
            crazyflie.loc.send_extpose(list(position_enu_m), [x, y, z, w])
        case SetParam(name, value):
            crazyflie.param.set_value(name, value)
        case Order.STOP:
            commander.send_stop_setpoint()
        case Order.NOTIFY_STOP:
            commander.send_notify_setpoint_stop()
        case Order.ARM | Order.DISARM:
            supervisor.send_arming_request(packet is Order.ARM)
        case Order.RECOVER:
            supervisor.send_crash_recovery_request()
        case Order.EMERGENCY_STOP:
            supervisor.send_emergency_stop()
