"""Finds Zenoh keys that may be a target's, to name them when the configured target sends nothing."""

from __future__ import annotations

from bridge.ros2.ros2_names import parse_topic_key
from bridge.zenoh import zenoh_link

KEYS_MAX = 8  # keys that are remembered
_CAPACITY = 64  # samples kept between two looks
# A chunk of the key holds the word: robot1/odom, 0/odom/nav_msgs::msg::dds_::Odometry_/RIHS01_...
_LIKELY = (
    "**/$*odom$*/**", "**/$*Odometry$*/**", "**/$*pose$*/**", "**/$*Pose$*/**", "**/tf/**",
)  # fmt: skip


class KeySearch:
    """Subscribes to keys with names of odometry, a pose or tf, from the first ``keys`` until ``stop``.

    While it does, all samples of such keys travel to this process: use it only where nothing flies.
    What the session publishes itself is not found.
    """

    def __init__(self, session: zenoh_link.Session) -> None:
        self._session = session
        self._subscribers: list[zenoh_link.Subscriber] = []
        self._found: dict[str, None] = {}

    def keys(self) -> tuple[str, ...]:
        """Names found so far, in order; those of rmw_zenoh as ``ros2:/TOPIC``. None in the first call."""
        if not self._subscribers:
            self._subscribers = [
                zenoh_link.remote_subscriber(self._session, key, _CAPACITY) for key in _LIKELY
            ]
        for subscriber in self._subscribers:
            for sample in zenoh_link.drain(subscriber):
                name = _shown(str(sample.key_expr))
                if len(self._found) < KEYS_MAX:
                    self._found[name] = None
        return tuple(sorted(self._found))

    def stop(self) -> None:
        """End the search and forget its results; may be called at any time."""
        for subscriber in self._subscribers:
            subscriber.undeclare()
        self._subscribers, self._found = [], {}


def _shown(key: str) -> str:
    topic = parse_topic_key(key)
    return key if topic is None else f"ros2:{topic.topic} ({topic.type_name}, domain {topic.domain})"
