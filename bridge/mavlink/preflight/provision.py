"""Sets or removes the MAVLink signing key of a vehicle on the ground by SETUP_SIGNING. Bounded in time.

PX4 1.18 and later accepts a first key unsigned on any link; a key of zeros, signed with the current key, ends
signing. ArduPilot also accepts a key but never signs on its first USB link. Both reject a key if armed.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.client.senders import Senders
from bridge.mavlink.endpoint import Endpoint
from bridge.mavlink.preflight.examine import Dialogue
from bridge.mavlink.signing import EPOCH_NS, KEY_BYTES, TICK_NS, SigningKey
from bridge.mavlink.transport.address import is_local, parse_url, resolve

_COMPONENT_ID = 191  # component id MAV_COMP_ID_ONBOARD_COMPUTER
_PERIOD_S = 0.5  # time between two tries, s
_TRIES = 12


def provision(url: str, system_id: int, key: SigningKey, *, remove: bool, wait_s: float) -> str | None:
    """Set or remove a key; it is sent unencrypted, so only a cable or loopback is allowed.

    ``key``: the new key, or the current key with ``remove``; ``wait_s``: time-out of the first heartbeat.
    Returns the reason of a failure; None: the vehicle has shown the change.
    """
    kind, host, port = parse_url(url)
    if kind != "serial" and not is_local(resolve(f"MAVLink URL {url!r}", host, port)):
        raise ValueError(
            f"{url!r} leads over a network, where the key could be read: set or remove it over a "
            "cable (serial:DEVICE) or loopback"
        )
    endpoint = Endpoint(url, system_id, _COMPONENT_ID, signing_key=key if remove else None)
    try:
        return _provision(endpoint, system_id, key, remove=remove, wait_s=wait_s)
    finally:
        endpoint.close()


def _provision(
    endpoint: Endpoint, system_id: int, key: SigningKey, *, remove: bool, wait_s: float
) -> str | None:
    link = Dialogue(endpoint, system_id, lambda _message: None, Senders())

    def changed() -> bool:
        """Whether received frames show the change: they are signed, or unsigned after a removal."""
        return bool(endpoint.counters.unsigned if remove else endpoint.counters.unchecked)

    def until(done: Callable[[], bool], within_s: float) -> bool:
        until_s = time.monotonic() + within_s
        while not done() and time.monotonic() < until_s:
            link.turn()
        return done()

    until(lambda: link.heard or changed(), wait_s)
    if not link.heard:
        if changed():
            return "the vehicle does not sign: there is no key to remove"
        return f"no heartbeat of system {system_id} within {wait_s:g} s"
    if link.armed:
        return "the vehicle is armed: its key can be changed on the ground only"
    if changed():
        return "the vehicle signs already: remove its key first, with that key (--remove-signing)"
    secret = bytes(KEY_BYTES) if remove else key.secret
    stamp = 0 if remove else (time.time_ns() - EPOCH_NS) // TICK_NS
    message = dialect.MAVLink_setup_signing_message(*link.target, list(secret), stamp)
    for _ in range(_TRIES):
        link.endpoint.send([message], link.senders.known)
        if until(changed, _PERIOD_S):
            return None
    what = "still signs" if remove else "does not sign"
    return (
        f"the vehicle {what} after {_TRIES} tries in {_TRIES * _PERIOD_S:g} s: PX4 accepts keys "
        "from 1.18 on, with an SD card; ArduPilot does not sign on USB"
    )
