"""Reads a black box as Python users would, and holds it against the records of its dataset.

    python -m venv venv
    venv/bin/pip install mcap mcap-protobuf-support foxglove-schemas-protobuf pillow
    venv/bin/python tests/peers/read_black_box.py DATASET [--box FOLDER] [--require]

Prints what each file has. Exits 1 when a frame that the dataset saved is in the log with other
bytes, times or sequence, when the images are not what Foxglove's schemas say, or when frames are
missing and no gap is told. Files of a killed program (`.partial.mcap`) are read as far as they go.
With --require every saved frame has to be in the log.
"""

import argparse
import collections
import hashlib
import io
import json
import pathlib
import sys

from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap_protobuf.decoder import DecoderFactory
from PIL import Image

from comparison import expect, faults

KNOWN = {"foxglove.CompressedImage": CompressedImage, "foxglove.RawImage": RawImage}
ENCODINGS = {"YUYV": "yuyv", "Z16": "16UC1", "GREY": "mono8"}

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("dataset", type=pathlib.Path)
parser.add_argument("--box", type=pathlib.Path, help="where the files are [default: in the dataset]")
parser.add_argument("--require", action="store_true", help="every saved frame has to be there")
args = parser.parse_args()


def check_schema(schema):
    """The fields of the file's own description are those of Foxglove's package."""
    files = FileDescriptorSet.FromString(schema.data).file
    name = schema.name.removeprefix("foxglove.")
    ours = [m for file in files for m in file.message_type if m.name == name]
    known = {f.name: (f.number, f.type) for f in KNOWN[schema.name].DESCRIPTOR.fields}
    found = {f.name: (f.number, f.type) for m in ours for f in m.field}
    expect(found == known, f"{schema.name}: {found} is not {known}")


def whole_records(path):
    """Records up to the end, or up to where a killed program stopped writing."""
    with path.open("rb") as stream:
        records = StreamReader(stream, validate_crcs=True).records
        while True:
            try:
                yield next(records)
            except StopIteration:
                return
            except Exception as cut:
                expect(path.name.endswith(".partial.mcap"), f"{path.name}: {cut!r}")
                print(f"  cut: {type(cut).__name__}")
                return


frames = {}  # (role, sequence, driver time) -> what was logged
sequences = collections.defaultdict(list)
notes = collections.defaultdict(list)
box = args.box or args.dataset / "blackbox"
paths = sorted(box.glob("*.mcap"))
expect(paths, f"no MCAP file in {box}")
for path in paths:
    schemas, channels, offset_ns, count, decoders = {}, {}, None, 0, {}
    last_ns = 0
    for record in whole_records(path):
        if isinstance(record, Metadata) and record.name == "gripcast.black_box":
            offset_ns = int(record.metadata["wall_minus_monotonic_ns"])
        elif isinstance(record, Schema):
            schemas[record.id] = record
            if record.encoding == "protobuf":
                check_schema(record)
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Message):
            count += 1
            channel = channels[record.channel_id]
            schema = schemas[channel.schema_id]
            expect(record.log_time >= last_ns, f"{path.name}: log times go back")
            last_ns = record.log_time
            if not channel.topic.startswith("/camera/"):
                notes[channel.topic].append(json.loads(record.data))
                continue
            if channel.id not in decoders:
                decoders[channel.id] = DecoderFactory().decoder_for("protobuf", schema)
            image = decoders[channel.id](record.data)
            stamp = image.timestamp.seconds * 10**9 + image.timestamp.nanos
            expect(stamp == record.publish_time, f"{channel.topic}: timestamp is no publish time")
            role = channel.topic.removeprefix("/camera/")
            key = (role, record.sequence, record.publish_time - offset_ns)
            is_raw = schema.name == "foxglove.RawImage"
            frames[key] = {
                "sha256": hashlib.sha256(image.data).hexdigest(),
                "format": channel.metadata["format"],
                "raw": (image.encoding, image.width, image.height, image.step) if is_raw else None,
                "depth": image.data if channel.metadata["format"] == "Z16" else None,
            }
            sequences[role].append(record.sequence)
    print(f"{path.name}: {path.stat().st_size / 1e6:.1f} MB, {count} messages")
    if not path.name.endswith(".partial.mcap"):
        with path.open("rb") as stream:
            statistics = make_reader(stream).get_summary().statistics
        expect(statistics.message_count == count, f"{path.name}: index says {statistics}")
    else:
        # What a careless user does; it must give the same messages before it stops.
        with path.open("rb") as stream:
            reader, seen = NonSeekingReader(stream).iter_messages(log_time_order=False), 0
            try:
                for _ in reader:
                    seen += 1
            except Exception:
                pass
        expect(seen == count, f"{path.name}: NonSeekingReader finds {seen} of {count}")

gaps = collections.Counter()
for line in notes["/session/events"]:
    if line["event"] == "black_box_gap":
        gaps[line["what"]["role"]] += line["what"]["frames"]
for role, found in sorted(sequences.items()):
    # A camera that is opened again counts from the beginning.
    missing = sum(max(0, after - before - 1) for before, after in zip(found, found[1:]))
    print(f"{role}: {len(found)} frames, {missing} not there, {gaps[role]} told as left out")
print(", ".join(f"{topic}: {len(found)}" for topic, found in sorted(notes.items())))

saved = present = 0
for path in sorted(args.dataset.glob("grasps/2*/grasp.json")):
    record = json.loads(path.read_text())
    for stage in ("initial", "grasp"):
        for role, camera in record[stage]["cameras"].items():
            saved += 1
            where = f"{record['id']} {stage} {role}"
            found = frames.get((role, camera["sequence"], camera["driver_time_ns"]))
            if found is None:
                expect(not args.require, f"{where}: not in the log")
                continue
            present += 1
            expect(found["format"] == camera["format"], f"{where}: {found['format']}")
            if camera["format"] == "MJPG":
                digest = record["files"][camera["file"]]["sha256"]
                expect(found["sha256"] == digest, f"{where}: other bytes")
                continue
            encoding, width, height, step = found["raw"]
            pixel_bytes = 1 if camera["format"] == "GREY" else 2
            expect(encoding == ENCODINGS[camera["format"]], f"{where}: {encoding}")
            expect((width, height) == (camera["width"], camera["height"]), f"{where}: size")
            expect(step == width * pixel_bytes, f"{where}: step {step}")
            if found["depth"] is not None:
                image = Image.open(io.BytesIO((path.parent / camera["file"]).read_bytes()))
                expect(image.tobytes() == found["depth"], f"{where}: other depths")
print(f"{present} of {saved} saved frames are in the log")
for fault in faults:
    print(f"FAULT {fault}", file=sys.stderr)
sys.exit(1 if faults else 0)
