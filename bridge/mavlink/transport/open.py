"""Opens the transport that a MAVLink URL names."""

from __future__ import annotations

from bridge.mavlink.transport.address import Peer, parse_url
from bridge.mavlink.transport.byte_stream import OUTGOING_MAX, ByteStream
from bridge.mavlink.transport.datagram import DatagramTransport
from bridge.mavlink.transport.tcp_client import open_tcp
from bridge.mavlink.transport.transport import LineCounters, Transport

_QUEUE_S = 0.1  # s of a serial line that outgoing frames may wait: a set-point that is older is of no use
_FRAMES_MIN = 280  # bytes; one frame of the greatest length must fit


def open_transport(url: str, address: Peer, counters: LineCounters) -> Transport:
    """Open what a URL names.

    Args:
        url: as :func:`bridge.mavlink.transport.address.parse_url` reads it.
        address: IPv4 address and port, or device and baud.
        counters: of the endpoint.

    Raises:
        OSError: it cannot be opened; a TCP connection that is refused is tried again instead.
    """
    kind = parse_url(url)[0]
    if kind == "serial":
        from bridge.mavlink.transport.serial_line import BITS_PER_BYTE, open_serial

        device, baud = address
        stream = ByteStream(
            f"serial line {device}, {baud} baud",
            address,
            lambda: open_serial(device, baud),
            counters,
            baud=baud,
            outgoing_max=max(_FRAMES_MIN, round(baud / BITS_PER_BYTE * _QUEUE_S)),
        )
        stream.open_now()
        return stream
    if kind == "tcp":
        name = f"TCP connection to {address[0]}:{address[1]}"
        return ByteStream(name, address, lambda: open_tcp(address), counters, outgoing_max=OUTGOING_MAX)
    return DatagramTransport(url, kind == "udpin", address, counters)
