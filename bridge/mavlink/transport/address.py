"""MAVLink URLs and addresses, the rules for unsigned links, and the table of peers."""

from __future__ import annotations

import re
import socket
import time
from ipaddress import IPv4Address
from typing import NamedTuple

Peer = tuple[str, int]

DEFAULT_BAUD = 921_600  # default speed of a serial line, bit/s; equal to PX4's TELEM2
_BAUDS = range(1_200, 12_000_001)  # allowed speeds, bit/s
PORT_MAX = 65535
_URL = re.compile(r"^(udpin|udpout|tcp):(?://)?([^:/\s]+):(\d{1,5})$")
_SERIAL = re.compile(r"^(serial):(?://(?=/))?(/\S+?)(?::(\d{1,8}))?$")
_URL_HELP = (
    "allowed is 'udpin:HOST:PORT' (listen; port 0 takes any free one), 'udpout:HOST:PORT' (send there "
    "first), 'tcp:HOST:PORT' (connect there), HOST an IPv4 address (not IPv6) or a name, PORT up to "
    f"{PORT_MAX}, or 'serial:DEVICE:BAUD' (BAUD {_BAUDS.start} to {_BAUDS.stop - 1}, without it "
    f"{DEFAULT_BAUD}), for example udpin:127.0.0.1:14540 or serial:/dev/ttyACM0:57600"
)
_PEER = re.compile(r"^([^:/\s]+):(\d{1,5})$")


class Url(NamedTuple):
    kind: str  # "udpin", "udpout", "tcp" or "serial"
    host: str  # host, or device of a serial line
    port: int  # port, or speed of a serial line, bit/s

    @property
    def baud(self) -> int | None:
        """Speed of a serial line, bit/s; None for other links."""
        return self.port if self.kind == "serial" else None


def parse_url(url: str) -> Url:
    """Parse an endpoint URL. Raises ValueError: bad URL."""
    match = _SERIAL.match(url) or _URL.match(url)
    if match is not None:
        found = Url(match.group(1), match.group(2), int(match.group(3) or DEFAULT_BAUD))
        ports = _BAUDS if found.baud else range(0 if found.kind == "udpin" else 1, PORT_MAX + 1)
        if found.port in ports:
            return found
    raise ValueError(f"MAVLink URL {url!r} is not understood: {_URL_HELP}")


def parse_peer(text: str, what: str = "MAVLink peer", port_min: int = 1) -> Peer:
    """Return the address ``HOST:PORT``. Raises ValueError, with ``what``: bad text, or no IPv4 address."""
    match = _PEER.match(text)
    allowed = (
        f"allowed is HOST:PORT, HOST an IPv4 address (not IPv6) or a name, PORT {port_min} to {PORT_MAX}"
    )
    if match is None or not port_min <= int(match.group(2)) <= PORT_MAX:
        raise ValueError(f"{what} {text!r} is not understood: {allowed}, for example 127.0.0.1:14550")
    return resolve(f"{what} {text!r}", match.group(1), int(match.group(2)), allowed)


def resolve(what: str, host: str, port: int, help_text: str = _URL_HELP) -> Peer:
    """Return the IPv4 address of a host. Raises ValueError, with ``what`` and ``help_text``: no address."""
    try:
        info = socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_DGRAM)
    except OSError as error:
        raise ValueError(f"{what}: host {host!r} has no IPv4 address ({error}); {help_text}") from error
    address, found_port = info[0][4][:2]
    return (str(address), int(found_port))


def is_local(address: Peer) -> bool:
    return IPv4Address(address[0]).is_loopback


def check_policy(
    url: str, address: Peer, always: tuple[Peer, ...], *, signed: bool, allow_unsigned: bool
) -> str | None:
    """Reject an endpoint that accepts commands from any host of the network; return a warning, or None.

    ``address``: local address, address of the only peer, or device and baud of a serial line; ``always``:
    peers that receive telemetry from the start; ``signed``: whether there is a key; ``allow_unsigned``:
    whether the operator accepts the risk.
    """
    kind = parse_url(url)[0]
    listens = kind == "udpin"
    if signed and allow_unsigned:
        raise ValueError("a signing key and --allow-unsigned exclude each other: give one of them")
    if always and not listens:
        raise ValueError(f"MAVLink URL {url!r} has one address and no other peers: use udpin")
    local = kind == "serial" or is_local(address)  # the peer of a cable has physical access anyway
    for host, port in [peer for peer in always if local and not is_local(peer)]:
        raise ValueError(
            f"MAVLink peer {host}:{port} is on the network and {url!r} listens on loopback only: listen "
            "on an address of the network, with --signing-key FILE"
        )
    if local or signed:
        return None
    if listens and not allow_unsigned:
        raise ValueError(
            f"MAVLink URL {url!r} listens to the network, where any host could control the vehicle: give "
            "--signing-key FILE (`flightstack key FILE` makes one), or listen on 127.0.0.1; "
            "--allow-unsigned accepts the risk, on a network with trusted hosts only"
        )
    who = "any host on the network" if listens else "a host that forges its address"
    return f"MAVLink is not signed on {url!r}: {who} can command the vehicle"


PEERS_MAX = 8  # maximum number of learnt peers: senders of heartbeats
EXPIRY_S = 10.0  # wall time without a frame after which a learnt peer expires, s


class PeerTable:
    """Receivers of telemetry: ``configured`` peers, and senders of heartbeats."""

    def __init__(self, configured: tuple[Peer, ...]) -> None:
        self._configured = configured
        self._beating: dict[Peer, float] = {}  # time of the newest frame of each sender of heartbeats

    @property
    def reached(self) -> tuple[Peer, ...]:
        """Configured peers, and senders of heartbeats whose newest frame arrived in the last 10 s."""
        oldest_s = time.monotonic() - EXPIRY_S
        alive = [peer for peer, heard_s in self._beating.items() if heard_s >= oldest_s]
        return tuple(dict.fromkeys((*self._configured, *alive)))

    def heard(self, peer: Peer, *, heartbeat: bool) -> bool:
        """Record a valid frame; return False if the table has no room for the sender of a heartbeat."""
        now_s = time.monotonic()
        if peer not in self._beating:
            if not heartbeat:
                return True
            alive = {one: heard_s for one, heard_s in self._beating.items() if now_s - heard_s <= EXPIRY_S}
            if peer not in self._configured and len(alive) >= PEERS_MAX:
                return False
            self._beating = alive
        self._beating[peer] = now_s
        return True
