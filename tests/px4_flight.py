"""Location of a real PX4 for the tests, and whole recorded flights with it on the plant of px4-sim."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from flightstack.common.processes import Child, Port
from sim.plant import params
from sim.px4.airframe import parameters
from sim.px4.program import InstanceClaim, Px4Model, Px4Program, find_px4
from sim.scenarios.scenario import load
from tests.processes.started import StartedChild

PX4_PLACE = "FLIGHTSTACK_PX4"  # environment variable: the program or its folder (sim.px4.program.find_px4)
ROOT = Path(__file__).parents[1]


def px4_place() -> Path | None:
    """Return program or folder; None if there is none and none is named.

    A named place without PX4 is an error where it is used; the test is not skipped.
    """
    named = os.environ.get(PX4_PLACE)
    if named:
        return Path(named)
    beside = [up / "shared" / "px4" for up in ROOT.parents]  # a worktree may be one folder deeper
    return next((place for place in beside if (place / "px4").is_file()), None)


def px4_or_skip() -> Path:
    """Return the program; skip the test if there is none."""
    place = px4_place()
    if place is None:
        pytest.skip(f"no PX4 here: {PX4_PLACE} names none, and there is no folder shared/px4 beside this one")
    return find_px4(place).binary


_LOOK_S = 0.02


class Px4Flying:
    """Processes of one flight; the onboard process starts with ``take_off``."""

    def __init__(self, px4: Px4Program, folder: Path, speed: float, words: list[str]) -> None:
        self.px4 = px4
        self._folder, self._speed, self._words = folder, speed, words
        self.onboard: Child | None = None
        self.simulator: Child
        self.target: Child
        self.recorder: Child
        self.said: list[str] = []  # output of the simulator: armed, disarmed, touched the pad ...
        self.told: list[str] = []  # output of the onboard process

    def take_off(self) -> Child:
        self.onboard = StartedChild("onboard", ["onboard", *self._words], self._folder)
        return self.onboard

    def look(self) -> None:
        self.said += self.simulator.lines(0.0)
        if self.onboard is not None:
            self.told += self.onboard.lines(0.0)

    def until(self, done: Callable[[], bool], within_s: float) -> bool:
        """Wait at most this stack time; return whether the condition became true."""
        until_s = time.monotonic() + within_s / self._speed
        while time.monotonic() < until_s:
            self.look()
            if done():
                return True
            time.sleep(_LOOK_S)
        return False

    def in_phase(self, name: str) -> bool:
        """Return whether the onboard process has reached this phase."""
        return any(f"-> {name}" in line for line in self.told)

    @property
    def armed(self) -> bool:
        return [line for line in self.said if line in ("armed", "disarmed")][-1:] == ["armed"]

    @property
    def disarmed(self) -> bool:
        """Return whether it has flown and its motors are off again."""
        changes = [line for line in self.said if line in ("armed", "disarmed")]
        return changes[-1:] == ["disarmed"]

    def ended(self) -> bool:
        """Return whether the onboard process has ended."""
        return self.onboard is not None and not self.onboard.alive()

    def interrupt(self) -> None:
        assert self.onboard is not None
        self.onboard.process.send_signal(signal.SIGINT)


@contextlib.contextmanager
def flying(
    place: Path, scenario_name: str, config: Path, folder: Path, speed: float,
    vehicle_url: Callable[[Px4Program], str],
) -> Iterator[Px4Flying]:  # fmt: skip
    """Simulator, PX4, recorder and robot, ready to fly; all are ended whatever happens.

    Raises LaunchError: a process did not start.

    Args:
        place: location of PX4, as for ``sim.px4.program.find_px4``.
        scenario_name: scenario of the flight.
        config: configuration of the onboard process.
        folder: folder of the log and the outputs.
        speed: ratio to real time.
        vehicle_url: URL of the vehicle for the onboard process.
    """
    folder.mkdir(parents=True, exist_ok=True)
    socket, paced = folder / "feed", ["--speed", f"{speed:g}"]
    common = ["--scenario", scenario_name, "--seed", "1", *paced]
    with contextlib.ExitStack() as stack:
        claim = stack.enter_context(contextlib.closing(InstanceClaim()))
        at, onboard_at = (stack.enter_context(contextlib.closing(Port())).endpoint for _ in range(2))
        px4 = Px4Program(
            place, folder / "px4", Px4Model.NONE_IRIS, instance=claim.number,
            parameters=parameters(params.load(load(scenario_name).vehicle.airframe)),
        )  # fmt: skip
        stack.callback(px4.end)

        def start(verb: str, *words: str, within_s: float | None = None) -> Child:
            child = StartedChild(verb, [verb, *words], folder)
            stack.callback(child.end, *(() if within_s is None else (within_s,)))
            child.wait_ready()
            return child

        one = Px4Flying(px4, folder, speed, [
            "--vehicle", vehicle_url(px4), "--system-id", str(claim.number + 1), "--config", str(config),
            "--connect", at, "--listen", onboard_at, "--recorder", str(socket), *paced,
        ])  # fmt: skip
        one.recorder = start(
            "record",
            "--socket",
            str(socket),
            "--out",
            str(folder / "flight.mcap"),
            "--until-clients",
            "3",
            within_s=30.0,
        )
        one.simulator = start(
            "px4-sim", *common, "--tcp", f"127.0.0.1:{px4.simulator_port}", "--connect", at, "--once",
            "--recorder", str(socket),
        )  # fmt: skip
        px4.wait_ready()
        one.target = start(
            "target", *common, "--listen", at, "--connect", onboard_at, "--recorder", str(socket)
        )
        stack.callback(lambda: one.onboard.end() if one.onboard is not None else None)
        yield one
