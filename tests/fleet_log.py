"""Flies a fleet in one process and writes its log as onboard processes and simulator would write it.

``land`` flies; the logging code is that of the processes and of the recorder, including derived topics.
Only the transports are missing: MAVLink frames and the bytes of the targets' samples.
"""

from dataclasses import replace
from pathlib import Path

from flightstack.common.pacing import EPOCH_NS
from flightstack.common.strict_toml import dumps
from flightstack.onboard.log import OnboardLog
from logs.recorder.feed import Kind, Record, encode_json
from logs.recorder.recording import McapFile, Recorder
from logs.schema import Names, schemas
from logs.schema.controller_rows import status_row
from logs.schema.events import CONTROLLER, pack_log
from sim.campaign.rows import judge_landing
from sim.runners import landing as team_runner
from sim.runners.landing import Companion
from sim.runners.log import VehicleLog
from sim.runners.room import Room
from sim.scenarios.scenario import Scenario, load, text
from sim.scenarios.tables import ExchangeLink
from tests.unit.logs.replay.replay_helpers import NoSession


def near() -> Scenario:
    """Return a team of three whose pads are so close that one vehicle lands at a time; messages are lost."""
    team = load("fleet_3")
    near = {"pad_distance_m": 1.5, "wait_distance_m": 1.6}
    members = (
        replace(m, onboard=replace(m.onboard, fleet=replace(m.onboard.fleet, **near))) for m in team.members
    )
    return replace(Scenario.of(members), exchange=ExchangeLink(delay_s=0.05, loss=0.1))


class MemberFeed:
    """Connection of one member to a recorder in the same process."""

    connected = True

    def __init__(self, recorder: Recorder, number: int):
        self.recorder, self.number, self._channels = recorder, number, 0

    def _handle(self, kind, payload, channel=0, log_ns=0, publish_ns=0, sequence=0):
        record = Record(kind, channel, log_ns, publish_ns, sequence, payload)
        self.recorder.handle(self.number, record)

    def _json(self, kind, content):
        return encode_json(kind, 0, 0, content)[28:]

    def channel(self, topic, schema):
        self._channels += 1
        declared = self._json(Kind.DECLARE, {"topic": topic, "schema": schema})
        self._handle(Kind.DECLARE, declared, self._channels)
        return self._channels

    def write(self, channel, log_ns, publish_ns, sequence, payload):
        self._handle(Kind.MESSAGE, payload, channel, log_ns, publish_ns, sequence)

    def metadata(self, name, values):
        self._handle(Kind.METADATA, self._json(Kind.METADATA, {"name": name, "values": values}))

    def attachment(self, name, text):
        head = f'{{"name": "{name}", "media_type": "application/toml"}}\n'
        self._handle(Kind.ATTACHMENT, head.encode() + text.encode())

    def flush(self):
        """Do nothing: the records are already in the file."""

    def close(self):
        self._handle(Kind.GOODBYE, b"")


class RecordedCompanion(Companion):
    """Companion of a member, which writes the member's log."""

    recorder: Recorder

    def __init__(self, scenario, seed, on_step=None, system_id=1, target_seed=None, *, controller=None):
        super().__init__(scenario, seed, on_step, system_id, target_seed, controller=controller)
        self.feed = MemberFeed(self.recorder, system_id)
        config, names = scenario.onboard, Names(self.name, system_id)
        shape = config.barrier.build()
        run = {
            "scenario": scenario.name, "seed": str(seed), "filter": config.filter, "mode": "lockstep",
            "rate_hz": str(config.loop.rate_hz), "barrier_alpha_1_m": repr(shape.alpha_1_m),
            "barrier_beta_m": repr(shape.beta_m), "judge_alpha_1_m": repr(shape.alpha_1_m),
            "judge_beta_m": repr(shape.beta_m), "pad_radius_m": repr(scenario.target.pad_radius_m),
        }  # fmt: skip
        self.feed.metadata(names.record("run"), run)
        self.feed.metadata(names.record("onboard"), {"namespace": self.name, "system_id": str(system_id)})
        self.feed.attachment(names.record("onboard.toml"), dumps(config))
        self.log = OnboardLog(
            self.feed, NoSession(), names, config, lockstep=True,
        )  # fmt: skip
        vehicle = VehicleLog(self.feed, EPOCH_NS, names)
        rosout = self.feed.channel("/rosout", schemas.LOG)
        truth, event = self._notes.truth, self._notes.note

        def note_truth(tick, now_ns, state):
            truth(tick, now_ns, state)
            vehicle.truth(tick, now_ns, state)

        def note_event(t_s, level, source, text):
            event(t_s, level, source, text)
            at_ns = EPOCH_NS + round(t_s * 1e9)
            if source != CONTROLLER:  # texts of the controller are already written by the onboard process
                self.feed.write(rosout, at_ns, at_ns, 0, pack_log(at_ns, level, names.logger(source), text))

        self._notes.truth, self._notes.note = note_truth, note_event

    def write(self, tick, taken, out, exec_s):
        super().write(tick, taken, out, exec_s)
        if out.member_status is not None:
            self.log.status(tick, status_row(out.member_status, EPOCH_NS, self.feed.number).pack())
        self.log.step(tick, taken, out, self.controller)
        self.log.timing(tick, out, 0.0, 0)


class RecordedRoom(Room):
    """Simulated room, which writes the simulator's log."""

    recorder: Recorder

    def __init__(self, members, grid, feed):
        super().__init__(members, grid, MemberFeed(self.recorder, 0))


def fly_fleet(path: Path, team: Scenario, seed: int, monkeypatch):
    """Fly a team and write its log; return the verdict of the campaign on the flight."""
    recorder = Recorder(McapFile(path))
    names = [f"cf{number}" for number in range(1, len(team.members) + 1)]
    first = MemberFeed(recorder, 0)
    first.metadata(
        "fleet",
        {"members": ",".join(names), "scenario": team.name, "description": team.description,
         "seed": str(seed), "mode": "lockstep"},
    )  # fmt: skip
    first.metadata("made", {"version": "0.1.0"})
    first.attachment("scenario.toml", text(team))
    first.close()
    monkeypatch.setattr(RecordedCompanion, "recorder", recorder, raising=False)
    monkeypatch.setattr(RecordedRoom, "recorder", recorder, raising=False)
    monkeypatch.setattr(team_runner, "Companion", RecordedCompanion)
    monkeypatch.setattr(team_runner, "Room", RecordedRoom)
    flown = team_runner.land(team, seed)
    for number in range(1, len(names) + 1):
        MemberFeed(recorder, number).close()
        recorder.gone(number, 0)
    recorder.finish()
    return judge_landing(flown)
