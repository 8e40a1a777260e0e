"""MAVLink URLs and addresses, and which of them may be used without a signing key."""

from __future__ import annotations

import re
import socket
from ipaddress import IPv4Address

from bridge.mavlink.transport.peers import Peer

DEFAULT_BAUD = 921_600  # bits/s of a serial line that names none, as PX4's TELEM2 has
_BAUDS = range(1_200, 12_000_001)  # bits/s
_URL = re.compile(r"^(udpin|udpout|tcp):(?://)?([^:/\s]+):(\d{1,5})$")
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
    """Split an endpoint URL.

    Returns:
        Kind ("udpin", "udpout", "tcp"), host and port; or "serial", device and bits a second.

    Raises:
        ValueError: the URL is none of the allowed forms.
    """
    line = _SERIAL.match(url)
    if line is not None:
        baud = int(line.group(2) or DEFAULT_BAUD)
        if baud not in _BAUDS:
            raise ValueError(
                f"MAVLink URL {url!r} has {baud} baud: allowed is {_BAUDS.start} to {_BAUDS.stop - 1}"
            )
        return "serial", line.group(1), baud
    match = _URL.match(url)
    if match is None:
        raise ValueError(f"MAVLink URL {url!r} is not understood: {_URL_HELP}")
    kind, host, port = match.group(1), match.group(2), int(match.group(3))
    if port > 65535 or (port == 0 and kind != "udpin"):
        raise ValueError(f"MAVLink URL {url!r} has port {port}: {_URL_HELP}")
    return kind, host, port


def parse_udp_url(url: str, who: str) -> tuple[str, str, int]:
    """Split the URL of a part that speaks UDP only, as ``parse_url`` does.

    Args:
        url: to be split.
        who: subject of the error's sentence, for example "the simulated vehicle".

    Raises:
        ValueError: another kind of link, or none of the allowed forms.
    """
    kind, host, port = parse_url(url)
    if kind not in ("udpin", "udpout"):
        raise ValueError(
            f"MAVLink URL {url!r}: {who} speaks UDP only; give udpin:HOST:PORT or udpout:HOST:PORT"
        )
    return kind, host, port


def baud_of(url: str) -> int | None:
    """Bits a second of a serial line; None for everything else, whose speed is not known.

    Raises:
        ValueError: the URL is none of the allowed forms.
    """
    kind, _, number = parse_url(url)
    return number if kind == "serial" else None


def parse_peer(text: str) -> Peer:
    """Address of a configured peer from ``HOST:PORT``.

    Raises:
        ValueError: another form, or the host has no IPv4 address.
    """
    match = _PEER.match(text)
    if match is None or not 1 <= int(match.group(2)) <= 65535:
        raise ValueError(f"MAVLink peer {text!r} is not understood: {_PEER_HELP}")
    return resolve(f"MAVLink peer {text!r}", match.group(1), int(match.group(2)), _PEER_HELP)


def resolve(what: str, host: str, port: int, help_text: str = _URL_HELP) -> Peer:
    """IPv4 address of a host.

    Raises:
        ValueError: it has none; ``what`` and ``help_text`` go into the message.
    """
    try:
        info = socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_DGRAM)
    except OSError as error:
        raise ValueError(f"{what}: host {host!r} has no IPv4 address ({error}); {help_text}") from error
    address, found_port = info[0][4][:2]
    return (str(address), int(found_port))


def is_local(address: Peer) -> bool:
    """Whether an address is of the loopback network 127.0.0.0/8."""
    return IPv4Address(address[0]).is_loopback


def local_host_for(address: Peer) -> str:
    """Our own address on the way to ``address``, so that the socket does not listen on other interfaces."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect(address)  # UDP: chooses a route, sends nothing
        return str(probe.getsockname()[0])


def check_policy(
    url: str, address: Peer, always: tuple[Peer, ...], *, signed: bool, allow_unsigned: bool
) -> str | None:
    """Refuse an endpoint that anybody on the network could command.

    Args:
        url: as it was given.
        address: where it listens, or whom it calls, who alone is heard then; device and baud of a cable.
        always: peers that get telemetry unasked.
        signed: there is a signing key.
        allow_unsigned: a person has said that none is wanted.

    Returns:
        A warning, or None.

    Raises:
        ValueError: what is wrong, and what to do.
    """
    kind = parse_url(url)[0]
    listens = kind == "udpin"
    if signed and allow_unsigned:
        raise ValueError("a signing key and --allow-unsigned exclude each other: give one of them")
    if always and not listens:
        raise ValueError(f"MAVLink URL {url!r} calls one address and speaks to no other peer: use udpin")
    if kind == "serial":  # a cable: who holds its other end can do more than send
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
            f"MAVLink URL {url!r} listens to the network, where anybody could fly the vehicle: give "
            "--signing-key FILE (`flightstack key FILE` makes one), or listen on 127.0.0.1; "
            "--allow-unsigned takes the risk, on a network where you trust everybody"
        )
    who = "anybody on the network" if listens else "whoever can forge its address"
    return f"MAVLink is not signed on {url!r}: {who} can command the vehicle"
