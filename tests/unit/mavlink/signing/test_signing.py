"""Tests the rules of message signing against pymavlink and with attacks, and the key files."""

import stat

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.framing import split_frames
from bridge.mavlink.signing import (
    AHEAD_TICKS,
    STALE_TICKS,
    Refusal,
    load_key,
    load_state,
    make_key,
)
from tests.unit.mavlink.signing.signing_helpers import (
    COMPANION,
    SECRET,
    Clock,
    S,
    forged,
    heartbeat,
    signed,
    theirs,
)


@pytest.fixture
def clock():
    return Clock()


# --- rules for accepting a frame


def test_accepts_what_pymavlink_signs_and_signs_what_pymavlink_accepts(clock):
    signer = clock.signer()
    peer = theirs(stamp=clock.ticks)
    mav = dialect.MAVLink(None, 1, 1)
    for _ in range(20):
        assert signer.refusal(heartbeat().pack(peer)) is None
        frame = signer.sign(heartbeat().pack(mav))
        assert split_frames(frame) == [frame]
        message = peer.decode(bytearray(frame))
        assert message.get_signed()
        assert message.get_type() == "HEARTBEAT"


def test_timestamps_follow_the_clock_and_are_never_equal(clock):
    signer, frame = clock.signer(), heartbeat().pack(dialect.MAVLink(None, 1, 1))

    def stamp():
        return int.from_bytes(signer.sign(frame)[-12:-6], "little")

    assert [stamp() - clock.ticks for _ in range(4)] == [0, 1, 2, 3]
    clock.advance(1.0)
    assert stamp() == clock.ticks
    clock.unix_ns -= 10**15  # the system clock is set back by eleven days
    before = stamp()
    clock.monotonic_ns += 10**9
    assert stamp() == before - 1 + S


def test_one_forged_frame_locks_nobody_out_before_or_after_the_peer_has_appeared(clock):
    signer, peer = clock.signer(), theirs(stamp=clock.ticks)
    for _ in range(2):
        assert signer.refusal(forged()) is Refusal.BAD_SIGNATURE
        assert signer.refusal(heartbeat().pack(peer)) is None
    # With the check of pymavlink, the same forged frame makes the victim reject all later frames of the peer.
    victim = theirs((1, 1), stamp=clock.ticks)
    with pytest.raises(dialect.MAVError):
        victim.decode(bytearray(forged()))
    with pytest.raises(dialect.MAVError):
        victim.decode(bytearray(heartbeat().pack(peer)))


def test_each_changed_bit_is_noticed(clock):
    signer, frame = clock.signer(), signed(stamp=clock.ticks)
    for bit in range(8 * 10, 8 * len(frame)):  # all bytes after the header
        changed = bytearray(frame)
        changed[bit // 8] ^= 1 << bit % 8
        assert signer.refusal(bytes(changed)) is Refusal.BAD_SIGNATURE
    assert signer.refusal(frame) is None


@pytest.mark.parametrize(
    ("offset", "refusal"),
    [
        (-STALE_TICKS, None),
        (-STALE_TICKS - 1, Refusal.STALE),
        (-(10**12), Refusal.STALE),
        (AHEAD_TICKS, None),
        (AHEAD_TICKS + 1, Refusal.AHEAD),
    ],
)
def test_new_stream_must_be_near_our_clock(clock, offset, refusal):
    assert clock.signer().refusal(signed(stamp=clock.ticks + offset)) is refusal


# --- time stamps after a restart


@pytest.fixture
def key(tmp_path):
    make_key(tmp_path / "fleet.key")
    return load_key(tmp_path / "fleet.key")


def test_replay_after_a_restart_is_refused_although_it_is_less_than_a_minute_old(clock, key):
    first, peer = clock.signer(key), theirs(secret=key.secret, stamp=clock.ticks)
    frames = [heartbeat().pack(peer) for _ in range(3)]
    assert [first.refusal(f) for f in frames] == [None] * 3
    first.save()
    clock.advance(5.0)
    second = clock.signer(key)
    assert {second.refusal(f) for f in frames} == {Refusal.REPLAYED}
    assert second.refusal(heartbeat().pack(peer)) is None


def test_clock_that_went_back_over_a_restart_opens_nothing(clock, key):
    old = signed(COMPANION, secret=key.secret, stamp=clock.ticks)
    clock.advance(100.0)
    first = clock.signer(key)
    first.sign(heartbeat().pack(dialect.MAVLink(None, 1, 1)))
    sent = load_state_of(key).sent
    first.save()
    assert load_state_of(key).sent > sent
    before = first.now()
    clock.unix_ns -= 100 * 10**9  # the clock is set back to the time of the old frame
    second = clock.signer(key)
    assert second.now() == before + STALE_TICKS
    assert "clock is 100 s behind" in second.warning
    assert second.refusal(old) is Refusal.STALE
    frame = second.sign(heartbeat().pack(dialect.MAVLink(None, 1, 1)))
    assert int.from_bytes(frame[-12:-6], "little") > before


def test_state_is_written_every_ten_seconds_and_at_the_end(clock, key):
    signer = clock.signer(key)
    clock.advance(9.9)
    assert signer.refusal(signed(secret=key.secret, stamp=clock.ticks)) is None
    signer.save_if_due()
    assert load_state_of(key).streams == []
    clock.advance(0.2)
    signer.save_if_due()
    assert load_state_of(key).streams == [(0, 1, 191, clock.ticks - round(0.2 * S))]
    path = state_of(key)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert [p.name for p in path.parent.iterdir() if p.name != "fleet.key"] == [path.name]


def test_state_that_cannot_be_written_is_an_error_at_the_start_only(clock, key, monkeypatch):
    signer = clock.signer(key)

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("bridge.mavlink.signing.save_state", full)
    clock.advance(11.0)
    signer.save_if_due()
    with pytest.raises(OSError, match="No space"):
        clock.signer(key)


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"clock": -1, "sent": 0, "streams": []}', "\x00" * 50,
                                  '{"clock": 1, "sent": 0, "streams": [[0, 1, 256, 3]]}'])  # fmt: skip
def test_damaged_state_is_refused_with_what_to_do(clock, key, text):
    state_of(key).write_text(text)
    with pytest.raises(ValueError, match="delete it"):
        clock.signer(key)


def state_of(key):
    return key.path.with_name("fleet.key.1-1-0.state")


def load_state_of(key):
    return load_state(state_of(key))


def test_made_key_is_private_random_and_never_written_over(tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    make_key(one)
    make_key(two)
    assert stat.S_IMODE(one.stat().st_mode) == 0o600
    assert load_key(one).secret != load_key(two).secret
    assert load_key(one).secret.hex() not in repr(load_key(one))
    with pytest.raises(FileExistsError, match="not overwritten"):
        make_key(one)


@pytest.mark.parametrize("content", [SECRET, SECRET.hex().encode(), SECRET.hex().upper().encode() + b"\n"])
def test_key_file_holds_32_bytes_or_64_hexadecimal_characters(tmp_path, content):
    path = tmp_path / "key"
    path.touch(0o600)
    path.write_bytes(content)
    assert load_key(path).secret == SECRET


@pytest.mark.parametrize(
    "content", [b"", b"secret", SECRET[:-1], SECRET + b"\n", b"0" * 64, b"g" * 64, bytes(32)]
)
def test_other_content_is_no_key(tmp_path, content):
    path = tmp_path / "key"
    path.touch(0o600)
    path.write_bytes(content)
    with pytest.raises(ValueError, match="flightstack key FILE"):
        load_key(path)


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o644, 0o620])
def test_key_that_others_can_get_at_is_refused(tmp_path, mode):
    make_key(tmp_path / "key")
    (tmp_path / "key").chmod(mode)
    with pytest.raises(ValueError, match="chmod 600"):
        load_key(tmp_path / "key")
