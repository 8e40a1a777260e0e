"""Clocks, signers, and frames signed by pymavlink, for the tests of message signing."""

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.signing import EPOCH_NS, TICK_NS, Signer, SigningKey

SECRET = bytes(range(32))
KEY = SigningKey(SECRET)
START_NS = EPOCH_NS + 10**18  # Unix time of a day in 2046, ns
S = 100_000  # signing ticks per second
COMPANION = (1, 191)


class Clock:
    """System and monotonic clock of a signer, set by the test."""

    def __init__(self):
        self.unix_ns = START_NS
        self.monotonic_ns = 5 * 10**9

    def advance(self, seconds):
        self.unix_ns += round(seconds * 1e9)
        self.monotonic_ns += round(seconds * 1e9)

    @property
    def ticks(self):
        return (self.unix_ns - EPOCH_NS) // TICK_NS

    def signer(self, key=KEY, ids=(1, 1)):
        clocks = {"unix_ns": lambda: self.unix_ns, "monotonic_ns": lambda: self.monotonic_ns}
        return Signer(key, *ids, **clocks)


def heartbeat():
    return dialect.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)


def theirs(ids=COMPANION, *, secret=SECRET, stamp, link_id=0):
    """Return a pymavlink codec that signs each packed frame."""
    mav = dialect.MAVLink(None, *ids)
    mav.robust_parsing = True
    mav.signing.secret_key = secret
    mav.signing.sign_outgoing = secret is not None
    mav.signing.timestamp = stamp
    mav.signing.link_id = link_id
    return mav


def signed(ids=COMPANION, **more):
    return heartbeat().pack(theirs(ids, **more))


def forged(ids=COMPANION, stamp=2**48 - 1, link_id=0):
    """Return a frame with a correct checksum and a wrong signature."""
    return signed(ids, secret=bytes(32), stamp=stamp, link_id=link_id)
