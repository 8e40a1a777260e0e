"""Tests how a signing key is set and removed, with a vehicle that behaves like PX4 1.18."""

import socket
import threading

import pytest
from click.testing import CliRunner
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.preflight.examine import provision
from bridge.mavlink.signing import load_key, make_key
from flightstack.cli.real import preflight


class Vehicle:
    """A vehicle that sends heartbeats, signed if it has a key; only the first key may arrive unsigned."""

    def __init__(self, key=None, *, armed=False, obeys=True):
        self.keys = [key]
        self._armed, self._obeys = armed, obeys
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.02)
        self.url = f"udpout:127.0.0.1:{self._socket.getsockname()[1]}"
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._over.set()
        self._thread.join(10.0)
        self._socket.close()

    def _codec(self, key):
        codec = mav.MAVLink(None, srcSystem=1, srcComponent=1)
        codec.robust_parsing = True
        if key is not None:
            codec.signing.secret_key, codec.signing.sign_outgoing = key, True
            codec.signing.timestamp = 10**13
        return codec

    def _run(self):
        codec, peer = self._codec(self.keys[-1]), None
        while not self._over.is_set():
            if peer is not None:
                beat = mav.MAVLink_heartbeat_message(2, 12, 129 if self._armed else 1, 0, 3, 3)
                self._socket.sendto(beat.pack(codec), peer)
            try:
                data, peer = self._socket.recvfrom(65536)
            except TimeoutError:
                continue
            for message in codec.parse_buffer(data) or []:
                if message.get_type() == "SETUP_SIGNING" and self._obeys and not self._armed:
                    secret = bytes(message.secret_key)
                    self.keys.append(secret if any(secret) else None)
                    codec = self._codec(self.keys[-1])


@pytest.fixture
def key(tmp_path):
    make_key(tmp_path / "key")
    return load_key(tmp_path / "key")


def test_a_key_is_given_and_taken_away(key):
    with Vehicle() as vehicle:
        assert provision(vehicle.url, 1, key, remove=False, wait_s=10.0) is None
        assert vehicle.keys == [None, key.secret]
        again = provision(vehicle.url, 1, key, remove=False, wait_s=10.0)
        assert "signs already" in again
        assert provision(vehicle.url, 1, key, remove=True, wait_s=10.0) is None
        assert vehicle.keys[-1] is None
        assert "does not sign: there is no key" in provision(vehicle.url, 1, key, remove=True, wait_s=10.0)


def test_an_armed_vehicle_keeps_its_key(key):
    with Vehicle(armed=True) as vehicle:
        assert "armed" in provision(vehicle.url, 1, key, remove=False, wait_s=10.0)
        assert vehicle.keys == [None]


def test_a_vehicle_that_does_not_obey_is_told(key, monkeypatch):
    monkeypatch.setattr("bridge.mavlink.preflight.examine._KEY_TRIES", 2)
    with Vehicle(obeys=False) as vehicle:
        assert "does not sign after 2 tries" in provision(vehicle.url, 1, key, remove=False, wait_s=10.0)
    assert "no heartbeat of system 1" in provision(vehicle.url, 1, key, remove=False, wait_s=0.2)


def test_a_key_is_not_sent_over_a_network(key):
    for url in ("udpout:192.0.2.1:14550", "tcp:192.0.2.1:5760", "udpin:0.0.0.0:14550"):
        with pytest.raises(ValueError, match="over a network"):
            provision(url, 1, key, remove=False, wait_s=0.1)


def test_preflight_gives_it_where_asked_and_only_with_a_key(key, monkeypatch):
    monkeypatch.setattr("bridge.mavlink.preflight.examine._READ_MAX_S", 0.1)  # the fake has no parameters
    for words in (
        ["--provision-signing"],
        ["--provision-signing", "--remove-signing", "--signing-key", str(key.path)],
    ):
        done = CliRunner().invoke(preflight, ["--vehicle", "udpout:127.0.0.1:9", *words])
        assert done.exit_code == 2
        assert "needs --signing-key" in done.output
    with Vehicle() as vehicle:
        words = ["--vehicle", vehicle.url, "--signing-key", str(key.path), "--wait", "10"]
        assert CliRunner().invoke(preflight, [*words, "--remove-signing"]).exit_code == 1
        CliRunner().invoke(preflight, [*words, "--provision-signing"])
        assert vehicle.keys == [None, key.secret]
