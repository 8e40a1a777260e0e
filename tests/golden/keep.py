"""Writes the part of a flight log that a replay needs, as small as it gets."""

from pathlib import Path

from mcap.writer import CompressionType, Writer

from logs.reader.reader import LogFile
from logs.replay.read import ROSOUT, SINK, SOURCE
from logs.schema.schemas import schema_text

TOPICS = ("controller/input", "controller/step", "controller/state", "target/odom")
WIRE = (SOURCE, SINK)
CHUNK_BYTES = 16 * 2**20  # one chunk: repeats are found over the whole flight
METADATA = ("onboard", "run")


def write_kept(source: Path, target: Path, *, wire: bool = True, when=None, change=None) -> Path:
    """Copy a log's topics of interest.

    Args:
        source: a whole or broken log.
        target: file to write.
        wire: keep MAVLink frames and odometry, too.
        when: keeps a message if this is true of it; None: all.
        change: makes a message's data anew; None: verbatim.
    """
    log = LogFile(source)
    space = log.metadata()["onboard"]["namespace"]
    topics = {f"/{space}/{name}" for name in TOPICS if wire or name != "target/odom"}
    topics |= {ROSOUT, *(WIRE if wire else ())}
    with target.open("wb") as stream:
        writer = Writer(stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start("ros2", "crazyflie-flightstack, kept for replay")
        for each in log.attachments():
            if each.name.endswith("onboard.toml"):
                writer.add_attachment(0, 0, each.name, each.media_type, each.data)
        for name in METADATA:
            values = dict(log.metadata().get(name, {}))
            if name == "onboard" and not wire:
                values.pop("lockstep", None)  # without frames the wire is not replayed
            writer.add_metadata(name, values)
        channels: dict[str, int] = {}
        for message in log.messages(topics):
            if when is not None and not when(message):
                continue
            if message.topic not in channels:
                schema = writer.register_schema(
                    message.schema, "ros2msg", schema_text(message.schema).encode()
                )
                channels[message.topic] = writer.register_channel(message.topic, "cdr", schema)
            data = message.data if change is None else change(message)
            writer.add_message(
                channels[message.topic], message.log_time_ns, data, message.publish_time_ns, message.sequence
            )
        writer.finish()
    return target
