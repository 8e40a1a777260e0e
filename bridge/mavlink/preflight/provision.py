"""Sets or removes the MAVLink signing key of a vehicle on the ground by SETUP_SIGNING. Bounded in time.

PX4 from 1.18 on accepts a first key unsigned on any link; a key of zeros, signed with the current key, ends
signing. ArduPilot accepts a key, too, but never signs on its first USB link. Both reject a key if armed.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.client.companion import companion_heartbeat
from bridge.mavlink.endpoint import Endpoint
from bridge.mavlink.signing import EPOCH_NS, KEY_BYTES, TICK_NS, SigningKey
from bridge.mavlink.transport.address import Peer, is_local, parse_url, resolve

_COMPONENT_ID = 191  # component id MAV_COMP_ID_ONBOARD_COMPUTER
_PERIOD_S = 0.5  # time between two tries, s
_TRIES = 12
_SLICE_S = 0.02  # time between two polls, s


def provision(url: str, system_id: int, key: SigningKey, *, remove: bool, wait_s: float) -> str | None:
    """Set or remove a key; it is sent unencrypted, so only a cable or loopback is allowed.

    ``key``: the new key, or the current key with ``remove``; ``wait_s``: time-out of the first heartbeat.
    Returns the reason of a failure; None: the vehicle has shown the change.
    Raises ValueError: the URL is bad or leads over a network; OSError: the address cannot be opened.
    """
    kind, host, port = parse_url(url)
    if kind != "serial" and not is_local(resolve(f"MAVLink URL {url!r}", host, port)):
        raise ValueError(
            f"{url!r} leads over a network, where the key could be read: set or remove it over a "
            "cable (serial:DEVICE) or loopback"
        )
    endpoint = Endpoint(url, system_id, _COMPONENT_ID, signing_key=key if remove else None)
    try:
        return _Provision(endpoint, system_id, remove=remove).run(key, wait_s)
    finally:
        endpoint.close()


class _Provision:
    def __init__(self, endpoint: Endpoint, system_id: int, *, remove: bool) -> None:
        self._endpoint, self._target, self._remove = endpoint, (system_id, 1), remove
        self._heartbeat: tuple[Peer, bool] | None = None  # sender; whether the vehicle is armed
        self._said_s = -math.inf

    def run(self, key: SigningKey, wait_s: float) -> str | None:
        changed = self._changed
        if (
            not self._until(lambda: self._heartbeat is not None or changed() > 0, wait_s)
            or not self._heartbeat
        ):
            if changed():
                return "the vehicle does not sign: there is no key to remove"
            return f"no heartbeat of system {self._target[0]} within {wait_s:g} s"
        peer, armed = self._heartbeat
        if armed:
            return "the vehicle is armed: its key can be changed on the ground only"
        if changed():
            return "the vehicle signs already: remove its key first, with that key (--remove-signing)"
        secret = bytes(KEY_BYTES) if self._remove else key.secret
        stamp = 0 if self._remove else (time.time_ns() - EPOCH_NS) // TICK_NS
        message = dialect.MAVLink_setup_signing_message(*self._target, list(secret), stamp)
        for _ in range(_TRIES):
            self._endpoint.send([message], peer)
            if self._until(lambda: changed() > 0, _PERIOD_S):
                return None
        what = "still signs" if self._remove else "does not sign"
        return (
            f"the vehicle {what} after {_TRIES} tries in {_TRIES * _PERIOD_S:g} s: PX4 accepts keys "
            "from 1.18 on, with an SD card; ArduPilot does not sign on USB"
        )

    def _changed(self) -> int:
        """Return the number of frames that show the change: signed ones, or unsigned ones after a removal."""
        counters = self._endpoint.counters
        return counters.unsigned if self._remove else counters.unchecked

    def _until(self, done: Callable[[], bool], within_s: float) -> bool:
        until_s = time.monotonic() + within_s
        while not done():
            now_s = time.monotonic()
            if now_s >= until_s:
                return False
            if now_s - self._said_s >= _PERIOD_S:
                self._said_s = now_s
                self._endpoint.send([companion_heartbeat()])
            self._endpoint.wait(_SLICE_S)
            for received in self._endpoint.receive():
                message = received.message
                beats = message.get_msgId() == dialect.MAVLINK_MSG_ID_HEARTBEAT
                if beats and received.sender == self._target:
                    armed = bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)
                    self._heartbeat = (received.peer, armed)
        return True
