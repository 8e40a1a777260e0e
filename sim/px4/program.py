"""Runs PX4's software in the loop as a child process; every wait has a time-out."""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import signal
import subprocess
import time
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import NamedTuple

from flightstack.common.processes import END_TIME_MAX_S, Child, LaunchError
from sim.autopilot.telemetry import ORIGIN_LATITUDE_DEG, ORIGIN_LONGITUDE_DEG

INSTANCES = range(10)  # instance numbers; above 9, PX4 sends all MAVLink to one port (px4-rc.mavlink)
BOOT_MAX_S = 90.0  # default time-out of ``boot``, s of wall time
CONSOLE_MAX_S = 10.0  # time-out of one command at PX4's console, s
# latitude and longitude, degrees, altitude, m: the floor of px4-sim, origin of HIL_GPS and barometer
ROOM_WGS84 = (ORIGIN_LATITUDE_DEG, ORIGIN_LONGITUDE_DEG, 0.0)
_BOOTED = "Startup script returned successfully"
_POSITIONED = "Ready for takeoff!"  # PX4 prints this when all its estimators have a position in the room
_CHECKED = "Preflight check: OK"
_LOOK_S = 0.05  # time between two reads of the output, s
_ASK_S = 0.2  # time between two repeated console commands, s
_SAME_PLACE_DEG = 1e-5  # tolerance of the origin, about 1 m; PX4 prints its reference with six decimals
_REFERENCE = re.compile(r"^\s*(ref_lat|ref_lon): (\S+)", re.MULTILINE)
_ALIAS = re.compile(r"^alias \w+='(px4-\w+) ", re.MULTILINE)
# rcS multiplies these time-outs by the speed, for clients in real time; our clients run at the simulation's
# speed. PX4 1.18 has a fixed value of 5 s instead of COM_OBC_LOSS_T.
_SCALED_WITH_SPEED = ("COM_DL_LOSS_T", "COM_RC_LOSS_T", "COM_OF_LOSS_T", "COM_OBC_LOSS_T")
# Shell script that waits for PX4, whose output goes to standard error. When this process is killed, the shell
# receives SIGHUP and immediately kills the whole group: during its start script PX4 ignores SIGTERM, and the
# script's commands would wait for a killed PX4 without end.
_END_TOGETHER = """
trap 'kill -KILL 0' HUP
trap : TERM INT
"$@" >&2 &
while wait $!; status=$?; kill -0 $! 2>/dev/null; do :; done
exit $status
"""


class Px4Model(Enum):
    """Source of the physics; the value is PX4_SIM_MODEL."""

    NONE_IRIS = "none_iris"  # an external simulator that PX4 connects to: flightstack px4-sim
    SIHSIM_QUADX = "sihsim_quadx"  # PX4's own simulator-in-hardware, 1 kg


_AUTOSTART = {Px4Model.NONE_IRIS: "10016", Px4Model.SIHSIM_QUADX: "10040"}


class Px4Error(LaunchError):
    """PX4 did not start, ended, or rejected a command; the message contains its last lines."""


class Px4Files(NamedTuple):
    """Required files of a PX4 build."""

    binary: Path
    etc: Path  # folder with PX4's start-up scripts
    alias: Path  # px4-alias.sh, which defines the names of PX4's modules


def find_px4(place: Path) -> Px4Files:
    """Find a PX4 SITL build; ``place``: the program ``px4``, its folder or a built source tree."""
    place = place.expanduser().absolute()
    tried = [place]
    if place.is_dir():
        tried = [place / name for name in ("px4", "bin/px4", "build/px4_sitl_default/bin/px4")]
    binary = next((file for file in tried if file.is_file() and os.access(file, os.X_OK)), None)
    if binary is None:
        raise FileNotFoundError(
            f"no PX4 program found at {place}: give the file px4 of a SITL build, for example "
            "PX4-Autopilot/build/px4_sitl_default/bin/px4"
        )
    etc = next((p for p in (binary.parent / "etc", binary.parent.parent / "etc") if p.is_dir()), None)
    alias = binary.parent / "px4-alias.sh"
    if etc is None or not alias.is_file():
        missing = "its folder etc" if etc is None else "px4-alias.sh"
        raise FileNotFoundError(f"{binary}: {missing} is not beside it, as it is in a PX4 SITL build")
    return Px4Files(binary, etc, alias)


def free_instance() -> int:
    """Return the lowest instance number with which no PX4 runs; PX4's system id is this number + 1 (rcS)."""
    for number in INSTANCES:
        if not _instance_runs(number):
            return number
    raise Px4Error(f"all PX4 instances, 0 to {INSTANCES.stop - 1}, are in use here; end one")


def _instance_runs(number: int) -> bool:
    """Whether a PX4 with this instance number runs and holds its lock file."""
    lock = Path(f"/tmp/px4_lock-{number}")  # path as in PX4 platforms/posix/src/px4/common/main.cpp
    if not lock.exists():
        return False
    with contextlib.suppress(OSError), lock.open("r+") as file:
        fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return False
    return True


class Px4Program(Child):
    """One PX4 SITL process.

    ``parameters``: PX4's parameters by name, with integers for PX4's integers; ``speed``: ratio of simulated
    to real time for ``SIHSIM_QUADX`` (with ``NONE_IRIS`` the simulator sets it); ``origin_wgs84``: origin of
    the room (latitude, longitude, degrees; altitude, m); None keeps PX4's origin.
    """

    end_signal, lines_max = signal.SIGHUP, 12

    def __init__(
        self, binary: Path, folder: Path, model: Px4Model, *, instance: int = 0,
        parameters: Mapping[str, float] | None = None, speed: float = 1.0,
        origin_wgs84: tuple[float, float, float] | None = ROOM_WGS84,
    ) -> None:  # fmt: skip
        if instance not in INSTANCES:
            raise ValueError(f"PX4 instance {instance}: allowed are 0 to {INSTANCES.stop - 1}")
        files = find_px4(binary)
        self.folder = folder.absolute()  # working folder: parameters, PX4's log (log/), output (px4.txt)
        self.instance = instance  # instance number, which PX4 adds to all port numbers
        # UDP port to which PX4 sends the MAVLink messages for a companion
        self.onboard_port = 14540 + instance
        self._parameters = dict(parameters or {})
        self._speed, self._model, self._origin = speed, model, origin_wgs84
        self.absent: list[str] = []  # requested parameters that this release lacks; set by ``boot``
        self._bin = self.folder / "bin"
        self._lay_out(files)
        super().__init__(
            "px4", ["-d", "-w", str(self.folder), str(files.etc), "-i", str(instance)], self.folder,
            program=["sh", "-c", _END_TOGETHER, "sh", self._bin / "px4"], works_in=self.folder,
            environment=self._environment(),
        )  # fmt: skip

    def _lay_out(self, files: Px4Files) -> None:
        """Link the program under the names of its modules, and delete the parameters of an earlier run."""
        self._bin.mkdir(parents=True, exist_ok=True)
        for name in ("parameters.bson", "parameters_backup.bson"):
            (self.folder / name).unlink(missing_ok=True)
        links = {"px4": files.binary, "px4-alias.sh": files.alias}
        links |= {name: Path("px4") for name in _ALIAS.findall(files.alias.read_text())}
        for name, aim in links.items():
            link = self._bin / name
            link.unlink(missing_ok=True)
            link.symlink_to(aim)

    def _environment(self) -> dict[str, str]:
        ours = {name: text for name, text in os.environ.items() if not name.startswith("PX4_")}
        ours |= {f"PX4_PARAM_{name}": str(value) for name, value in self._parameters.items()}
        ours |= {"PX4_SIM_MODEL": self._model.value, "PX4_SYS_AUTOSTART": _AUTOSTART[self._model]}
        if self._model is Px4Model.SIHSIM_QUADX:
            places = ("LAT", "LON", "ALT")
            ours |= {f"PX4_HOME_{p}": str(v) for p, v in zip(places, self._origin or (), strict=False)}
            if self._speed != 1.0:
                ours["PX4_SIM_SPEED_FACTOR"] = f"{self._speed:g}"
        return ours

    def boot(self, timeout_s: float = BOOT_MAX_S) -> None:
        """Wait until PX4 can arm, with the requested parameters and the room's origin.

        The simulator must run, because PX4 waits for it. The origin is set after PX4 has a position, because
        the first satellite fix sets an origin, too. In HOLD PX4 arms only with an origin; with motion capture
        PX4's checks fail for some seconds after the origin is set.
        """
        until_s = time.monotonic() + timeout_s
        self._wait_for(_BOOTED, until_s)
        self._settle_parameters()
        self._wait_for(_POSITIONED, until_s)
        if self._origin is None:
            return
        self.console("commander", "set_ekf_origin", *(f"{value:.9g}" for value in self._origin))
        while not self._at_origin():
            self._keep_waiting(until_s, "the origin of the room")
            time.sleep(_ASK_S)
        while _CHECKED not in self._client("commander", "check").stdout:
            self._keep_waiting(until_s, repr(_CHECKED))
            time.sleep(_ASK_S)

    def _wait_for(self, text: str, until_s: float) -> None:
        while text not in self.output.read_text(errors="replace"):
            self._keep_waiting(until_s, repr(text))
            time.sleep(_LOOK_S)

    def _settle_parameters(self) -> None:
        """Set each parameter that the environment did not set, if this release has it.

        PX4 does not store a value that equals its own default. The start script's default for simulations
        then applies instead (SYS_FAILURE_EN of v1.16).
        """
        if self._model is Px4Model.SIHSIM_QUADX and self._speed != 1.0:
            for name in _SCALED_WITH_SPEED:
                if name not in self._parameters and self._has(name):
                    self.console("param", "reset", name)
        for name, value in self._parameters.items():
            if self._client("param", "compare", name, str(value)).returncode == 0:
                continue
            if not self._has(name):
                self.absent.append(name)
                continue
            self.console("param", "set", name, str(value))
            self.console("param", "compare", name, str(value))

    def _has(self, name: str) -> bool:
        return self._client("param", "find", name).returncode == 0

    def _at_origin(self) -> bool:
        assert self._origin is not None
        said = self._client("listener", "vehicle_local_position", "-n", "1").stdout
        found, place = dict(_REFERENCE.findall(said)), zip(("ref_lat", "ref_lon"), self._origin, strict=False)
        return all(abs(float(found.get(key, "nan")) - degrees) < _SAME_PLACE_DEG for key, degrees in place)

    def console(self, module: str, *words: str) -> str:
        """Return the reply of a module at PX4's console, e.g. ``console("param", "show", "MAV_SYS_ID")``."""
        done = self._client(module, *words)
        if done.returncode != 0:
            command = " ".join((module, *words))
            raise Px4Error(f"PX4: {command!r} failed with status {done.returncode}: {done.stdout.strip()}")
        return done.stdout

    def _client(self, module: str, *words: str) -> subprocess.CompletedProcess[str]:
        self._check_alive()
        try:
            return subprocess.run(
                [self._bin / f"px4-{module}", "--instance", str(self.instance), *words],
                stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                text=True, errors="replace", timeout=CONSOLE_MAX_S, check=False,
            )  # fmt: skip
        except FileNotFoundError as error:
            raise Px4Error(f"this PX4 has no module {module!r}") from error
        except subprocess.TimeoutExpired as error:
            text = f"PX4 did not answer {' '.join((module, *words))!r} in {CONSOLE_MAX_S:g} s"
            raise Px4Error(f"{text}:\n{self.errors()}") from error

    def _check_alive(self) -> None:
        if not self.alive():
            raise Px4Error(f"PX4 has ended with status {self.process.returncode}:\n{self.errors()}")

    def _keep_waiting(self, until_s: float, what: str) -> None:
        self._check_alive()
        if time.monotonic() > until_s:
            raise Px4Error(f"PX4 did not come to {what} in time; its last lines:\n{self.errors()}")

    def end(self, within_s: float = END_TIME_MAX_S) -> int:
        """Terminate PX4; after ``within_s`` kill it and its children. Return the exit status."""
        if self.alive():
            self._signal(signal.SIGCONT)  # a stopped process does not receive SIGTERM
            self._signal(signal.SIGTERM)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(within_s)
        self._signal(signal.SIGKILL)
        return super().end(within_s)

    def _signal(self, number: signal.Signals) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, number)
