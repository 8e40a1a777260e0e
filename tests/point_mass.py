"""Connects the controller to a point-mass vehicle and a robot on a circle, for tests of its decisions."""

import math
from dataclasses import dataclass, field

from flightstack.core.controller import Controller, Outputs
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.types import (
    Inputs,
    Landed,
    Mode,
    Operator,
    OwnState,
    Phase,
    Request,
    TargetSample,
    VehicleStatus,
)

DT_S = 0.01
VELOCITY_RATE_1_S = 8.0
STREAM_LOSS_S = 0.5  # time without set-points after which the vehicle lands by itself, s


@dataclass
class World:
    """Simulated world. ``fault``: function ``(world, inputs) -> inputs``; it is applied if
    ``fault_from_s <= t < fault_to_s``."""

    config: FlightConfig
    fault: object = None
    fault_from_s: float = math.inf
    fault_to_s: float = math.inf
    t_s: float = 0.0
    position: tuple = (-0.8, 0.3, 1.1)
    velocity: tuple = (0.0, 0.0, 0.0)
    armed: bool = True
    mode: Mode = Mode.HOLD
    landed: Landed = Landed.IN_AIR
    pad: tuple = (0.0, 0.0, 0.2)
    heading: float = 0.0
    solid_pad: bool = False
    says_standing: bool = True
    touched_s: float = math.inf
    stream_s: float = -math.inf
    sent: list = field(default_factory=list)
    texts: list = field(default_factory=list)
    outputs: list[Outputs] = field(default_factory=list)

    def __post_init__(self):
        self.controller = Controller(self.config)

    @property
    def phase(self):
        return self.controller.memory.phase

    def relative(self):
        return tuple(p - q for p, q in zip(self.position, self.pad, strict=True))

    def inputs(self) -> Inputs:
        own = OwnState(self.t_s, self.t_s, self.position, self.velocity, 0.0)
        status = VehicleStatus(self.t_s, self.armed, self.mode, self.landed, True)
        speed = (0.1 * math.cos(self.heading), 0.1 * math.sin(self.heading), 0.0)
        sample = TargetSample(self.t_s, self.t_s + 7.0, "map", "target", self.pad, speed, self.heading, 0.1)
        inputs = Inputs(own, status, (sample,), Operator.NONE)
        if self.fault is not None and self.fault_from_s <= self.t_s < self.fault_to_s:
            inputs = self.fault(self, inputs)
        return inputs

    def step(self) -> Outputs:
        inputs = self.inputs()
        out = self.controller.step(inputs, self.t_s)
        self.outputs.append(out)
        self.texts += [e.text for e in out.events]
        if out.setpoint is not None:
            self.sent.append((self.t_s, out.setpoint.velocity_enu_m_s))
            self.stream_s = self.t_s
        self._vehicle(out)
        self.heading += 0.1 * DT_S
        self.pad = (
            self.pad[0] + 0.1 * math.cos(self.heading) * DT_S,
            self.pad[1] + 0.1 * math.sin(self.heading) * DT_S,
            self.pad[2],
        )
        self.t_s = round(self.t_s + DT_S, 6)
        return out

    def _vehicle(self, out):
        if out.request is Request.MOTORS_OFF:
            self.armed = False
        elif out.request is Request.LAND:
            self.mode = Mode.LAND
        elif out.request is Request.EXTERNAL and out.setpoint is not None and self.mode is Mode.HOLD:
            self.mode = Mode.EXTERNAL
        if self.mode is Mode.EXTERNAL and self.t_s - self.stream_s > STREAM_LOSS_S:
            self.mode = Mode.LAND
        wanted = (0.0, 0.0, 0.0)
        if self.mode is Mode.EXTERNAL and out.setpoint is not None:
            wanted = out.setpoint.velocity_enu_m_s
        elif self.mode is Mode.LAND:
            wanted = (0.0, 0.0, -0.3)
        gain = VELOCITY_RATE_1_S * DT_S
        self.velocity = tuple(v + gain * (w - v) for v, w in zip(self.velocity, wanted, strict=True))
        if not self.armed:
            self.velocity = (0.0, 0.0, 0.0)
        self.position = tuple(p + v * DT_S for p, v in zip(self.position, self.velocity, strict=True))
        top = self.pad[2] + 0.0144
        if self.solid_pad and math.dist(self.position[:2], self.pad[:2]) < 0.1 and self.position[2] <= top:
            self.position, self.velocity = (*self.position[:2], top), (*self.velocity[:2], 0.0)
            self.touched_s = min(self.touched_s, self.t_s)
            if self.says_standing and self.t_s - self.touched_s > 0.3:
                self.landed = Landed.ON_GROUND
        if self.position[2] <= 0.015:
            self.position, self.landed = (*self.position[:2], 0.015), Landed.ON_GROUND
            if self.mode is Mode.LAND:
                self.armed = False

    def run(self, seconds: float, until=None):
        """Simulate until the time is over, the controller has finished, or ``until(self)`` is true."""
        end = self.t_s + seconds
        while self.t_s < end:
            out = self.step()
            if out.finished or (until is not None and until(self)):
                break
        return self

    def fault_in(self, phase: Phase, fault, seconds: float = math.inf):
        """Run until the start of the phase, then apply the fault."""
        self.run(60.0, until=lambda w: w.phase is phase)
        assert self.phase is phase
        self.fault, self.fault_from_s, self.fault_to_s = fault, self.t_s, self.t_s + seconds
        return self


def each_sample(**changes):
    """Return a fault that changes each target sample."""
    return lambda _, inputs: inputs._replace(
        target_samples=tuple(s._replace(**changes) for s in inputs.target_samples)
    )
