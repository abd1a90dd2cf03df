"""Reads a flight log with the official package `mcap`, checks every checksum, and prints its channels and attachments."""
import json
import sys

from mcap.reader import make_reader

with open(sys.argv[1], "rb") as file:
    reader = make_reader(file, validate_crcs=True)
    summary = reader.get_summary()
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        count = summary.statistics.channel_message_counts[channel.id]
        print(channel.topic, channel.message_encoding, schema.name, schema.encoding, count)
        if schema.encoding == "jsonschema":
            assert json.loads(schema.data)["type"] == "object", channel.topic
    messages = 0
    last = 0
    for schema, channel, message in reader.iter_messages(log_time_order=False):
        messages += 1
        assert message.log_time >= last, "the messages are not in the order of their times"
        last = message.log_time
        if channel.message_encoding == "json":
            value = json.loads(message.data)
            assert set(value) <= set(json.loads(schema.data)["properties"]), channel.topic
    assert messages == summary.statistics.message_count
    for attachment in reader.iter_attachments():
        print(attachment.name, len(attachment.data))
    for metadata in reader.iter_metadata():
        print(metadata.name, metadata.metadata)
