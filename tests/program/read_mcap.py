"""Reads the flight logs of a run with the packages `mcap` and `mcap-protobuf-support`: checks every checksum, decodes every message of
every topic, and prints the channels and attachments of the last one. All files have the same schemas. Where Rerun is installed, it
converts the last one, and shows the tip as a transform and the journal as text."""
import json
import os
import subprocess
import sys
import tempfile

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory


def check(path, schemas):
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        counts = summary.statistics.channel_message_counts
        lines = []
        for channel in summary.channels.values():
            schema = summary.schemas[channel.schema_id]
            known = schemas.setdefault(channel.topic, (schema.name, schema.encoding, schema.data))
            assert known == (schema.name, schema.encoding, schema.data), f"{path}: {channel.topic} has another schema"
            assert schema.encoding == channel.message_encoding == "protobuf", channel.topic
            assert schema.data not in (b"", b"{}"), channel.topic
            lines.append(f"{channel.topic} {schema.name} {schema.encoding} {counts.get(channel.id, 0)}")
        messages = 0
        last = 0
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            messages += 1
            assert message.log_time >= last, "the messages are not in the order of their times"
            last = message.log_time
        assert messages == summary.statistics.message_count
        decoded = {}
        for schema, channel, message, value in reader.iter_decoded_messages():
            assert value.DESCRIPTOR.full_name == schema.name, channel.topic
            decoded[channel.topic] = decoded.get(channel.topic, 0) + 1
            if channel.topic == "/events":
                assert list(json.loads(value.json)) == [value.kind]
            elif channel.topic == "/imu":
                assert len(value.gyr_rad_s) == len(value.acc_m_s2) == 3 and len(value.mag_ut) in (0, 3)
            elif channel.topic == "/tf":
                assert value.timestamp.ToNanoseconds() == message.log_time
                q = value.rotation
                assert abs(q.x**2 + q.y**2 + q.z**2 + q.w**2 - 1) < 1e-3
            elif channel.topic == "/scene":
                assert all(len(line.points) == 9 for entity in value.entities for line in entity.lines)
        for channel in summary.channels.values():
            assert decoded.get(channel.topic, 0) == counts.get(channel.id, 0), channel.topic
        lines += [f"{attachment.name} {len(attachment.data)}" for attachment in reader.iter_attachments()]
        lines += [f"{metadata.name} {metadata.metadata}" for metadata in reader.iter_metadata()]
        return lines, decoded


def convert(path, topics):
    rerun = os.path.join(os.path.dirname(sys.executable), "rerun")
    if not os.path.exists(rerun):
        print("skipped: Rerun (PyPI rerun-sdk) is not installed", file=sys.stderr)
        return
    with tempfile.TemporaryDirectory() as folder:
        out = os.path.join(folder, "flight.rrd")
        run = {"check": True, "capture_output": True, "text": True, "env": {**os.environ, "HOME": folder}}
        subprocess.run([rerun, "mcap", "convert", path, "-o", out], **run)
        shown = subprocess.run([rerun, "rrd", "print", out], **run).stdout
    for topic in topics:
        assert f" {topic} " in shown, f"Rerun does not show {topic}"
    for topic, component in [("/tf", "Transform3D:quaternion"), ("/log", "TextLog:text")]:
        assert any(f" {topic} " in line and component in line for line in shown.splitlines()), f"Rerun: {topic} is no {component}"


schemas = {}
for path in sys.argv[1:]:
    lines, decoded = check(path, schemas)
convert(sys.argv[-1], decoded)
print("\n".join(lines))
