"""The connection to ROS 2 nodes: a Zenoh router or a Zenoh configuration, and the nodes' domain."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from bridge.ros2.ros2_names import check_domain
from bridge.zenoh import zenoh_link

_FILES = (".json5", ".json", ".yaml", ".yml")  # what Zenoh reads


@dataclass(frozen=True, slots=True)
class Ros2Network:
    """Address and domain of the ROS 2 nodes.

    Attributes:
        where: endpoint of their router (``rmw_zenohd``, zenoh-bridge-ros2dds), or a Zenoh configuration file.
        domain: their ROS_DOMAIN_ID.
    """

    where: str
    domain: int = 0

    def open(self) -> zenoh_link.Session:
        """Open a session there; close it when done.

        Raises:
            ValueError: neither an endpoint nor a configuration, or the domain is out of range.
            ZenohLinkError: nobody answers.
        """
        check_domain(self.domain)
        if self.where.endswith(_FILES):
            return zenoh_link.open_session(config_file=Path(self.where), role=zenoh_link.Role.CLIENT)
        return zenoh_link.open_session(connect=[self.where], role=zenoh_link.Role.CLIENT)
