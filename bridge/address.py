"""MAVLink URLs and addresses, and which of them may be used without a signing key."""

from __future__ import annotations

import re
import socket
from ipaddress import IPv4Address

from bridge.peers import Peer

_URL = re.compile(r"^(udpin|udpout):(?://)?([^:/\s]+):(\d{1,5})$")
_URL_HELP = (
    "allowed is 'udpin:HOST:PORT' (listen; port 0 takes any free one) or 'udpout:HOST:PORT' (send there "
    "first), HOST an IPv4 address or a name, PORT up to 65535, for example udpin:127.0.0.1:14540"
)
_PEER = re.compile(r"^([^:/\s]+):(\d{1,5})$")
_PEER_HELP = "allowed is HOST:PORT, PORT 1 to 65535, for example 127.0.0.1:14550"


def parse_url(url: str) -> tuple[str, str, int]:
    """Split an endpoint URL into kind ("udpin" or "udpout"), host and port.

    Raises:
        ValueError: the URL is none of the allowed forms.
    """
    match = _URL.match(url)
    if match is None:
        raise ValueError(f"MAVLink URL {url!r} is not understood: {_URL_HELP}")
    kind, host, port = match.group(1), match.group(2), int(match.group(3))
    if port > 65535 or (port == 0 and kind == "udpout"):
        raise ValueError(f"MAVLink URL {url!r} has port {port}: {_URL_HELP}")
    return kind, host, port


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
        address: where it listens, or whom it calls; a caller hears nobody else.
        always: peers that get telemetry unasked.
        signed: there is a signing key.
        allow_unsigned: a person has said that none is wanted.

    Returns:
        A warning, or None.

    Raises:
        ValueError: what is wrong, and what to do.
    """
    listens = parse_url(url)[0] == "udpin"
    if signed and allow_unsigned:
        raise ValueError("a signing key and --allow-unsigned exclude each other: give one of them")
    if always and not listens:
        raise ValueError(f"MAVLink URL {url!r} calls one address and speaks to no other peer: use udpin")
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
