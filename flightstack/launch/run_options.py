"""Options of ``flightstack sitl`` and ``flightstack fly``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Annotated

from flightstack.common.options import BadOptionError, Option
from flightstack.common.strict_toml import ConfigError
from flightstack.config import options as shared
from flightstack.config.options import FlightOptions, described

_SIMULATED, _REAL = "works with the simulated vehicle only", "works with PX4 and ArduPilot only"


class Flies(Enum):
    """Autopilot that flies; the value is the option of ``sitl`` for the autopilot's program.

    The field of the option in ``RunOptions`` has the name of the member in lower case.
    """

    OWN = ""  # simulated vehicle with the simulator's autopilot
    PX4 = "--px4"  # PX4 on the simulated vehicle
    PX4_SIH = "--px4-sih"  # PX4 with its built-in simulation of the physics
    ARDUPILOT = "--ardupilot"  # ArduCopter with its built-in simulation of the physics


def _members(given: tuple[str, ...]) -> Mapping[int, str]:
    """Return a table of vehicle numbers and URLs from texts N=URL."""
    found = {}
    for text in given:
        number, equals, url = text.partition("=")
        if not (number.isdecimal() and equals and url):
            raise BadOptionError(f"found {text!r}; N=URL is needed, for example 2=udpin:127.0.0.1:14541")
        found[int(number)] = url
    return found


def _program(flies: Flies, help: str) -> Option:
    return Option(flies.value, help, exists=True)


@dataclass(frozen=True, kw_only=True)
class RunOptions(shared.Ros2, shared.Result, shared.Repeated, shared.Simulated):
    filter: Annotated[str | None, shared.safety_filter("Safety filter; default: the configuration's")] = None
    config_file: Annotated[Path | None, shared.config(
        "Configuration instead of the scenario's, or of the one for an autopilot"
    )] = None  # fmt: skip
    lockstep: shared.Lockstep = False
    view: shared.View = None
    px4: Annotated[Path | None, _program(
        Flies.PX4, "Fly this PX4 (SITL program or build folder) on the simulated vehicle."
    )] = None  # fmt: skip
    px4_sih: Annotated[
        Path | None, _program(Flies.PX4_SIH, "Fly this PX4 with its own physics of a 1 kg quadrotor.")
    ] = None
    ardupilot: Annotated[Path | None, _program(
        Flies.ARDUPILOT, "Fly this ArduCopter (SITL program) with its own physics."
    )] = None  # fmt: skip
    instance: Annotated[int | None, Option(
        "--instance",
        "Number that selects the ports of PX4 or ArduPilot; default: a free one, ArduPilot 0.", "N",
        span=(0, 9)
    )] = None  # fmt: skip
    members: Annotated[Mapping[int, str], Option(
        "--member", "MAVLink URL of an external vehicle that flies as member N of a team; repeatable "
        "(docs/how_it_works/fleet.md).", "N=URL", read=_members
    )] = field(default_factory=dict)  # fmt: skip
    listen: Annotated[tuple[str, ...], Option(
        "--listen",
        "Additional Zenoh endpoint for watchers, beside the printed one on loopback; repeatable; a second "
        "vehicle has the next port, and so on.",
        "ENDPOINT"
    )] = ()  # fmt: skip
    zenoh_config: shared.ZenohConfig = None

    @property
    def _given(self) -> list[Flies]:
        return [each for each in Flies if each.value and getattr(self, each.name.lower()) is not None]

    @property
    def flies(self) -> Flies:
        """Autopilot of the run, which for some values also simulates the physics."""
        return next(iter(self._given), Flies.OWN)

    @property
    def program(self) -> Path | None:
        """Path of the autopilot's program; None if the run starts no such program."""
        return getattr(self, self.flies.name.lower(), None)

    def described(self) -> dict[str, str]:
        """Return the options for the log; the filter is left out, because the logged scenario names it."""
        vehicle = self.flies.value.removeprefix("--")
        own = {"vehicle": vehicle, "program": self.program, "config": self.config_file}
        return {
            **{name: str(value) for name, value in own.items() if value},
            **described(self, shared.Repeated),
        }

    def check(self) -> None:
        """Raise ConfigError if options cannot be combined with each other."""
        if len(self._given) > 1:
            raise ConfigError(
                f"only one of {', '.join(flies.value for flies in Flies if flies.value)} can be flown"
            )
        flies = self.flies
        own, flown = flies is Flies.OWN, flies.value or "the simulated vehicle"
        for name, given, allowed, other, why in (
            ("--lockstep", self.lockstep, own, flown, f"{_SIMULATED}; --speed flies PX4 faster"),
            ("--signing-key", self.signing_key, own, flown, "is not given to a PX4 or ArduPilot in software"),
            ("--speed", self.speed != 1.0, not own, flown, f"{_REAL}; --lockstep is faster"),
            ("--instance", self.instance is not None, not own, flown, _REAL),
            ("--mocap", self.mocap, flies is Flies.PX4, flown, "works with --px4 only, not with satellites"),
            ("--member", self.members, not self.lockstep, "--lockstep", "it cannot run in lockstep"),
        ):  # fmt: skip
            if given and not allowed:
                raise ConfigError(f"{name} with {other}: {why}; leave it out")


@dataclass(frozen=True, kw_only=True)
class FlyOptions(shared.Result, FlightOptions):
    view: shared.View = None
