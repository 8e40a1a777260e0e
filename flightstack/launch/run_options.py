"""The options of ``flightstack sitl``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path

from bridge.mavlink.profiles.autopilots import AUTO
from bridge.ros2.ros2_names import Ros2Network
from flightstack.common.strict_toml import ConfigError

DEFAULT_PROFILE = "px4"  # of the simulated vehicle
_SIMULATED, _REAL = "works with the simulated vehicle only", "works with PX4 and ArduPilot only"


class Flies(Enum):
    """The autopilot that flies; the value is the option of ``sitl`` that names its program."""

    OWN = ""  # the simulated vehicle with its own autopilot
    PX4 = "--px4"  # PX4 on the simulated vehicle
    PX4_SIH = "--px4-sih"  # PX4 with its own physics
    ARDUPILOT = "--ardupilot"  # ArduCopter with its own physics


@dataclass(frozen=True)
class RunOptions:
    """One run.

    Attributes:
        scenario: by name or file.
        seed: of all chance.
        filter: name of the safety filter; None: the configuration's.
        lockstep: simulated time instead of real time.
        duration_s: after which it ends; None: the scenario's.
        out: folder; None: a new one in ``runs``.
        live: whether the terminal shows the flight.
        signing_key: of MAVLink.
        listen: where others may watch, besides a free port of loopback.
        zenoh_config: of the onboard process.
        ros2: where target and flight are shown to ROS 2.
        view: where the scene is shown in 3-D; None: nowhere.
        profile: of the autopilot that the simulated vehicle imitates.
        autopilot: of the onboard process.
        accept_release: fly an autopilot whose release is not known.
        config: of the onboard process, by name or file; None: the vehicle's, or the scenario's.
        flies: whose autopilot and physics.
        program: of that autopilot.
        instance: number that moves its ports; None: a free one.
        mocap: motion capture instead of satellites.
        speed: of simulated time against real time.
        members: MAVLink URLs of members of a team that are not simulated, by their numbers.
    """

    scenario: str
    seed: int = 0
    filter: str | None = None
    lockstep: bool = False
    duration_s: float | None = None
    out: Path | None = None
    live: bool = True
    signing_key: Path | None = None
    listen: tuple[str, ...] = ()
    zenoh_config: Path | None = None
    ros2: Ros2Network | None = None
    view: str | None = None
    profile: str = DEFAULT_PROFILE
    autopilot: str = AUTO
    accept_release: bool = False
    config: str | Path | None = None
    flies: Flies = Flies.OWN
    program: Path | None = None
    instance: int | None = None
    mocap: bool = False
    speed: float = 1.0
    members: Mapping[int, str] = field(default_factory=dict)

    @property
    def told(self) -> dict[str, str]:
        """What the log says of the options that change bytes or timing; the report's command has them again.

        The scenario as it was flown has filter and configuration.
        """
        values = {
            "vehicle": self.flies.value.removeprefix("--"),
            "program": str(self.program or ""),
            "speed": f"{self.speed:g}" if self.speed != 1.0 else "",
            "profile": self.profile if self.profile != DEFAULT_PROFILE else "",
            "autopilot": self.autopilot if self.autopilot != AUTO else "",
            "accept_release": "true" if self.accept_release else "",
            "mocap": "true" if self.mocap else "",
            "duration_s": f"{self.duration_s:g}" if self.duration_s is not None else "",
            "signing_key": str(self.signing_key or ""),
            "config": str(self.config or ""),
        }
        return {name: value for name, value in values.items() if value}

    def check(self) -> None:
        """Refuse options that cannot be combined.

        Raises:
            ConfigError: which options, and why.
        """
        own = self.flies is Flies.OWN
        for name, given, allowed, why in (
            ("--lockstep", self.lockstep, own, f"{_SIMULATED}; use --speed to fly PX4 faster"),
            (
                "--signing-key",
                self.signing_key is not None,
                own,
                "is not given to a PX4 or ArduPilot in software",
            ),
            ("--profile", self.profile != DEFAULT_PROFILE, own, _SIMULATED),
            ("--speed", self.speed != 1.0, not own, f"{_REAL}; --lockstep is faster"),
            ("--instance", self.instance is not None, not own, _REAL),
            ("--mocap", self.mocap, self.flies is Flies.PX4, "works with --px4 only, instead of satellites"),
        ):
            if given and not allowed:
                raise ConfigError(f"{name} with {self.flies.value or 'the simulated vehicle'}: {name} {why}")
