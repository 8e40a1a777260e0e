"""MAVLink URLs and addresses, the rules for unsigned links, and the table of peers."""

from __future__ import annotations

import re
import socket
import time
from ipaddress import IPv4Address

Peer = tuple[str, int]

DEFAULT_BAUD = 921_600  # default speed of a serial line, bit/s; equal to PX4's TELEM2
_BAUDS = range(1_200, 12_000_001)  # allowed speeds, bit/s
_URL = re.compile(r"^(udpin|udpout|tcp):(?://)?([^:/\s]+):(\d{1,5})$")
_IPV6 = re.compile(r"^\w+:(//)?(\[|[^/]*::)")
_SERIAL = re.compile(r"^serial:(?://(?=/))?(/\S+?)(?::(\d{1,8}))?$")
_URL_HELP = (
    "allowed is 'udpin:HOST:PORT' (listen; port 0 takes any free one), 'udpout:HOST:PORT' (send there "
    "first), 'tcp:HOST:PORT' (connect there), HOST an IPv4 address or a name, PORT up to 65535, or "
    f"'serial:DEVICE:BAUD' (without BAUD {DEFAULT_BAUD}), for example udpin:127.0.0.1:14540 or "
    "serial:/dev/ttyACM0:57600"
)
_PEER = re.compile(r"^([^:/\s]+):(\d{1,5})$")
_PEER_HELP = "allowed is HOST:PORT, PORT 1 to 65535, for example 127.0.0.1:14550"


def parse_url(url: str) -> tuple[str, str, int]:
    """Split an endpoint URL into kind ("udpin", "udpout", "tcp"), host, port; or "serial", device, bit/s."""
    line = _SERIAL.match(url)
    if line is not None:
        baud = int(line.group(2) or DEFAULT_BAUD)
        if baud not in _BAUDS:
            raise ValueError(
                f"MAVLink URL {url!r} has {baud} baud: allowed is {_BAUDS.start} to {_BAUDS.stop - 1}"
            )
        return "serial", line.group(1), baud
    match = _URL.match(url)
    if match is None and _IPV6.search(url):
        raise ValueError(
            f"MAVLink URL {url!r} has an IPv6 address; MAVLink links here use IPv4 alone: give 127.0.0.1 for "
            "this machine, or another address or name of IPv4"
        )
    if match is None:
        raise ValueError(f"MAVLink URL {url!r} is not understood: {_URL_HELP}")
    kind, host, port = match.group(1), match.group(2), int(match.group(3))
    if port > 65535 or (port == 0 and kind != "udpin"):
        raise ValueError(f"MAVLink URL {url!r} has port {port}: {_URL_HELP}")
    return kind, host, port


def parse_udp_url(url: str, who: str) -> tuple[str, str, int]:
    """Parse a URL of UDP as ``parse_url`` does; ``who`` is the subject of the error text."""
    kind, host, port = parse_url(url)
    if kind not in ("udpin", "udpout"):
        raise ValueError(
            f"MAVLink URL {url!r}: {who} supports UDP only; give udpin:HOST:PORT or udpout:HOST:PORT"
        )
    return kind, host, port


def baud_of(url: str) -> int | None:
    """Return the speed of a serial line, bit/s; None for other links. Raises ValueError: bad URL."""
    kind, _, number = parse_url(url)
    return number if kind == "serial" else None


def parse_peer(text: str) -> Peer:
    """Return the address of a peer ``HOST:PORT``. Raises ValueError: bad text, or no IPv4 address."""
    match = _PEER.match(text)
    if "[" in text or "::" in text:
        raise ValueError(f"MAVLink peer {text!r} has an IPv6 address; MAVLink links here use IPv4 alone")
    if match is None or not 1 <= int(match.group(2)) <= 65535:
        raise ValueError(f"MAVLink peer {text!r} is not understood: {_PEER_HELP}")
    return resolve(f"MAVLink peer {text!r}", match.group(1), int(match.group(2)), _PEER_HELP)


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


def local_host_for(address: Peer) -> str:
    """Return the local address on the route to ``address``, so that the socket uses one interface only."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect(address)  # UDP selects a route without sending
        return str(probe.getsockname()[0])


def check_policy(
    url: str, address: Peer, always: tuple[Peer, ...], *, signed: bool, allow_unsigned: bool
) -> str | None:
    """Reject an endpoint that accepts commands from any host of the network; return a warning, or None.

    ``address``: local address, or address of the only peer; for a serial line device and baud; ``always``:
    peers that receive telemetry from the start; ``signed``: there is a key; ``allow_unsigned``: the operator
    accepts the risk.
    """
    kind = parse_url(url)[0]
    listens = kind == "udpin"
    if signed and allow_unsigned:
        raise ValueError("a signing key and --allow-unsigned exclude each other: give one of them")
    if always and not listens:
        raise ValueError(f"MAVLink URL {url!r} has one address and no other peers: use udpin")
    if kind == "serial":  # the peer of a cable has physical access anyway
        return None
    if is_local(address):
        for host, port in [peer for peer in always if not is_local(peer)]:
            raise ValueError(
                f"MAVLink peer {host}:{port} is on the network and {url!r} listens on loopback only: listen "
                "on an address of the network, with --signing-key FILE"
            )
        return None
    if signed:
        return None
    if listens and not allow_unsigned:
        raise ValueError(
            f"MAVLink URL {url!r} listens to the network, where any host could control the vehicle: give "
            "--signing-key FILE (`flightstack key FILE` makes one), or listen on 127.0.0.1; "
            "--allow-unsigned accepts the risk, on a network with trusted hosts only"
        )
    who = "any host on the network" if listens else "a host that forges its address"
    return f"MAVLink is not signed on {url!r}: {who} can command the vehicle"


EXPIRY_S = 10.0  # wall time without a heartbeat (1 Hz) after which a peer expires, s


class PeerTable:
    """Receivers of telemetry: ``configured`` peers, and at most ``peers_max`` senders of heartbeats."""

    def __init__(self, configured: tuple[Peer, ...], peers_max: int) -> None:
        self._configured = configured
        self._peers_max = peers_max
        self._beating: dict[Peer, float] = {}  # time of the last frame of a peer that has sent a heartbeat

    @property
    def reached(self) -> tuple[Peer, ...]:
        """Configured peers, and peers that sent a heartbeat and then a frame in the last 10 s."""
        oldest_s = time.monotonic() - EXPIRY_S
        alive = [peer for peer, heard_s in self._beating.items() if heard_s >= oldest_s]
        return tuple(dict.fromkeys((*self._configured, *alive)))

    def heard(self, peer: Peer, *, heartbeat: bool) -> bool:
        """Record a valid frame; return False if the table has no room for the sender of a heartbeat."""
        now_s = time.monotonic()
        if peer not in self._beating:
            if not heartbeat:
                return True
            for other, heard_s in list(self._beating.items()):
                if len(self._beating) >= self._peers_max and now_s - heard_s > EXPIRY_S:
                    del self._beating[other]
            if peer not in self._configured and len(self._beating) >= self._peers_max:
                return False
        self._beating[peer] = now_s
        return True
