"""Packing of a message, microseconds: made from the definition, by hand, and by rosbags' generic codec."""

import time

from pymavlink.dialects.v20 import ardupilotmega as dialect

from logs.schema import schemas
from logs.schema.cdr import codec
from logs.schema.codec_mavlink import pack_mavlink
from logs.schema.controller_rows import TickInputs, pack_controller_input
from logs.schema.rows import ControllerStepRow
from tests.benchmarks.control_step import inputs
from tests.synthetic_flight import landing

ROUNDS, CALLS = 100, 200
STAMP_NS = 1_577_836_800_000_000_000


def best_us(calls) -> dict[str, float]:
    """Least microseconds a call of each function, the rounds of all taking turns."""
    best = dict.fromkeys(calls, float("inf"))
    for _ in range(ROUNDS):
        for name, call in calls.items():
            started = time.perf_counter()
            for _ in range(CALLS):
                call()
            best[name] = min(best[name], (time.perf_counter() - started) / CALLS * 1e6)
    return best


def main() -> None:
    """Run and print."""
    store = schemas.typestore()
    row, given = landing().steps[500], TickInputs(STAMP_NS, 1, 0.01, inputs(1), False)
    step, taken = row.pack(), pack_controller_input(given)
    frame = dialect.MAVLink_local_position_ned_message(5, *[1.0] * 6).pack(dialect.MAVLink(None, 1, 1))
    record = pack_mavlink(STAMP_NS, frame, b"p00")
    pack_record, unpack_record = codec(schemas.MAVLINK, frame_id=None)
    values = unpack_record(record)
    generic = {
        name: store.deserialize_cdr(data, name)
        for name, data in (
            (schemas.CONTROLLER_STEP, step),
            (schemas.CONTROLLER_INPUT, taken),
            (schemas.MAVLINK, record),
        )
    }
    calls = {
        "step, made": row.pack,
        "step, unpacked": lambda: ControllerStepRow.unpack(step),
        "inputs with a target sample, made": lambda: pack_controller_input(given),
        "MAVLink frame, by hand": lambda: pack_mavlink(STAMP_NS, frame, b"p00"),
        "MAVLink frame, made, fields known": lambda: pack_record(values),
        **{f"{name}, rosbags": lambda m=m, n=name: store.serialize_cdr(m, n) for name, m in generic.items()},
    }
    for name, took_us in best_us(calls).items():
        print(f"{name:42} {took_us:6.2f} us")


if __name__ == "__main__":
    main()
