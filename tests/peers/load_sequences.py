"""Reads a LeRobot export of sequences and holds it against the black box and the dataset.

    python -m venv venv
    venv/bin/pip install -r python/lerobot_camera_gripcast/tests/requirements.txt
    gripcast dataset export DATASET --to lerobot --sequences --out L
    venv/bin/python tests/peers/load_sequences.py DATASET L [--lift SECONDS] [--left-out ID …]

The frames that belong to each moment are worked out again from the MCAP files, read by the package
`mcap`, and compared with what LeRobot's own `LeRobotDataset` loads: times, phases, labels, pixels of
all cameras, gel markers, openings. Without the package `lerobot` the files are read by `datasets`, and
a line says so. Exits 1 when something differs.
"""

import argparse
import bisect
import datetime
import io
import json
import math
import os
import pathlib
import sys

import numpy
from mcap.reader import NonSeekingReader
from mcap_protobuf.decoder import DecoderFactory
from PIL import Image

from comparison import expect, faults

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("dataset", type=pathlib.Path)
parser.add_argument("export", type=pathlib.Path)
parser.add_argument("--lift", type=float, default=3.0, help="as of the export, s")
parser.add_argument("--left-out", nargs="*", default=[], help="grasps that the export left out")
args = parser.parse_args()


def read_log():
    """Frames by role and driver time, shear by role and driver time, and the clock's offset."""
    frames, shear, offset = {}, {}, None
    for path in sorted((args.dataset / "blackbox").glob("*.mcap")):
        with path.open("rb") as stream:
            reader = NonSeekingReader(stream, decoder_factories=[DecoderFactory()])
            for record in reader.iter_metadata():
                if record.name == "gripcast.black_box":
                    offset = int(record.metadata["wall_minus_monotonic_ns"])
        with path.open("rb") as stream:
            reader = NonSeekingReader(stream, decoder_factories=[DecoderFactory()])
            for schema, channel, message in reader.iter_messages(log_time_order=False):
                if channel.topic == "/shear":
                    found = json.loads(message.data)
                    shear[found["role"], found["frame_time_ns"]] = found
                elif channel.topic.startswith("/camera/"):
                    role = channel.topic.removeprefix("/camera/")
                    decode = DecoderFactory().decoder_for(channel.message_encoding, schema)
                    frames.setdefault(role, {})[message.publish_time - offset] = decode(message.data)
    assert offset is not None, "the black box has no metadata"
    return frames, shear, offset


def pixels(image):
    """RGB or counts of a logged frame, and by how much ours may differ."""
    if hasattr(image, "format"):
        return numpy.asarray(Image.open(io.BytesIO(image.data)).convert("RGB")), 0
    raw = numpy.frombuffer(image.data, "u1").reshape(image.height, -1)
    if image.encoding == "16UC1":
        return raw.view("<u2").astype("f4"), 0
    if image.encoding == "rgb8":
        return raw.reshape(image.height, image.width, 3), 0
    if image.encoding == "mono8":
        return numpy.repeat(raw[:, :, None], 3, axis=2), 0
    assert image.encoding == "yuyv", image.encoding
    pairs = raw.reshape(image.height, -1, 4).astype(float)
    y = pairs[:, :, [0, 2]].reshape(image.height, -1) - 16
    u, v = (numpy.repeat(pairs[:, :, i], 2, axis=1) - 128 for i in (1, 3))
    # ITU-R BT.601, limited range.
    red, blue = 1.1644 * y + 1.596 * v, 1.1644 * y + 2.0172 * u
    rgb = numpy.stack([red, 1.1644 * y - 0.3918 * u - 0.813 * v, blue], axis=2)
    return numpy.clip(numpy.rint(rgb), 0, 255), 2


def load():
    try:
        import lerobot
        from lerobot.datasets.lerobot_dataset import LeRobotDataset
    except ImportError as error:
        print(f"SKIPPED: the package lerobot ({error}); its files are read by datasets alone")
        import datasets

        datasets.disable_progress_bars()

        def read(folder):
            files = [str(path) for path in sorted((args.export / folder).glob("*/*.parquet"))]
            return datasets.Dataset.from_parquet(files, cache_dir=os.environ.get("HF_HOME"))

        return read("data"), read("meta/episodes")
    print(f"lerobot {lerobot.__version__}")
    frames = LeRobotDataset("gripcast/sequences", root=args.export)
    check_history(LeRobotDataset, frames)
    return frames, frames.meta.episodes


def check_history(dataset, frames):
    """Policies load several frames at once, by their time stamps."""
    name = next(name for name in info["features"] if name.startswith("observation.images."))
    deltas = {name: [-1 / info["fps"], 0.0]}
    history = dataset("gripcast/sequences", root=args.export, delta_timestamps=deltas)[1][name]
    for at in (0, 1):
        expect((history[at] == frames[at][name]).all(), f"{name}: history of frame 1 at {at}")


def array(found, is_depth):
    """An image as LeRobot or `datasets` gives it."""
    if isinstance(found, Image.Image):
        return numpy.asarray(found if is_depth else found.convert("RGB"))
    found = found.numpy()
    if not is_depth:
        found = numpy.rint(found * 255)
    return found.transpose(1, 2, 0).squeeze()


def moments(record, roles, fps):
    """Phase and driver time of each camera's frame of every moment, by the definition."""
    cameras = record["grasp"]["cameras"]
    grasp = {role: cameras[role]["driver_time_ns"] for role in roles}
    grasp_ns = max(grasp.values())
    end_ns = grasp_ns + round(args.lift * 1e9)
    labelled = datetime.datetime.fromisoformat(record["labelled_at"].replace("Z", "+00:00"))
    # Microseconds: `datetime` has no nanoseconds.
    labelled_ns = round(labelled.timestamp() * 1e6) * 1000 - offset
    if labelled_ns > grasp_ns:
        end_ns = min(end_ns, labelled_ns)
    before = (grasp_ns - record["initial"]["trigger_time_ns"]) * fps // 1_000_000_000
    after = (end_ns - grasp_ns) * fps // 1_000_000_000
    for step in range(-before, after + 1):
        time_ns = grasp_ns + int(math.trunc(step * 1_000_000_000 / fps))
        if step == 0:
            yield 1, grasp
            continue
        limits = {role: min(time_ns, grasp[role]) if step < 0 else time_ns for role in roles}
        yield 0 if step < 0 else 2, {
            role: times[role][bisect.bisect_right(times[role], limits[role]) - 1] for role in roles
        }


def markers(record, role, time_ns, shape):
    """The gel markers that are stored or logged for a frame."""
    for stage in ("initial", "grasp"):
        field = record[stage].get("fields", {}).get(role, {}).get("markers")
        if field and record[stage]["cameras"][role]["driver_time_ns"] == time_ns:
            return numpy.load(args.dataset / "grasps" / record["id"] / field["file"])
    found = shear.get((role, time_ns), {}).get("markers")
    if found is None or found["shape"] != shape:
        return numpy.full(shape, numpy.nan, "f4")
    values = [math.nan if value is None else value for value in found["values"]]
    return numpy.asarray(values, "f4").reshape(shape)


def opening(record):
    if record.get("truth"):
        return record["truth"]["opening_m"]
    quality = (record["pose"] or {}).get("quality") or {}
    return quality.get("opening_m")


def check_frame(frame, record, phase, chosen, is_last, where):
    expect(int(frame["phase"]) == phase, f"{where}: phase {frame['phase']}")
    succeeds = is_last and record["outcome"] == "stable"
    expect(bool(frame["next.done"]) == is_last, f"{where}: done")
    expect(bool(frame["next.success"]) == succeeds, f"{where}: success")
    expect(float(frame["next.reward"]) == float(succeeds), f"{where}: reward")
    for role, time_ns in chosen.items():
        found = int(frame[f"driver_time_ns.{role}"])
        expect(found == time_ns, f"{where}: {role} is of {found}, not {time_ns}")
        is_depth = role == "depth"
        name = "observation.depth" if is_depth else f"observation.images.{role}"
        expected, tolerance = pixels(frames[role][time_ns])
        image = array(frame[name], is_depth).astype(float)
        same = image.shape == expected.shape and numpy.abs(image - expected).max() <= tolerance
        expect(same, f"{where}: pixels of {role} differ from the black box")
        if phase == 1:
            file = args.dataset / "grasps" / record["id"] / record["grasp"]["cameras"][role]["file"]
            stored = Image.open(file)
            stored = numpy.asarray(stored if is_depth else stored.convert("RGB"))
            expect((image == stored).all(), f"{where}: pixels of {role} differ from the grasp's")
    for name, feature in info["features"].items():
        if name.startswith("observation.tactile."):
            role = name.removeprefix("observation.tactile.")
            found = numpy.asarray(frame[name], "f4")
            expected = markers(record, role, chosen[role], feature["shape"])
            expect(numpy.array_equal(found, expected, equal_nan=True), f"{where}: markers of {role}")
            counts[role] = counts.get(role, 0) + int(not numpy.isnan(found).all())
    if "action" in info["features"]:
        expected = opening(record) if phase == 1 else None
        found = float(numpy.asarray(frame["action"]).reshape(-1)[0])
        same = math.isnan(found) if expected is None else abs(found - expected) < 1e-7
        expect(same, f"{where}: action {found}, opening {expected}")


info = json.loads((args.export / "meta/info.json").read_text())
paths = sorted(args.dataset.glob("grasps/2*/grasp.json"))
records = {path.parent.name: json.loads(path.read_text()) for path in paths}
labelled = [id for id in records if records[id]["outcome"] != "unlabelled"]
frames, shear, offset = read_log()
times = {role: sorted(of_role) for role, of_role in frames.items()}
loaded, episodes = load()
roles = [name.removeprefix("driver_time_ns.") for name in info["features"] if "driver_time" in name]
expect(roles, "no camera has driver times")
exported = [episode["gripcast/id"] for episode in episodes]
expect(exported == [id for id in labelled if id not in args.left_out], f"episodes {exported}")
counts = {}
index = 0
for episode, id in zip(episodes, exported):
    record = records[id]
    expected = list(moments(record, roles, info["fps"]))
    expect(episode["length"] == len(expected), f"{id}: {episode['length']} of {len(expected)} frames")
    for at, (phase, chosen) in enumerate(expected):
        frame, where = loaded[index + at], f"{id} frame {at}"
        expect(int(frame["frame_index"]) == at, f"{where}: index {frame['frame_index']}")
        same = abs(float(frame["timestamp"]) - at / info["fps"]) < 1e-4
        expect(same, f"{where}: timestamp {frame['timestamp']}")
        check_frame(frame, record, phase, chosen, at + 1 == len(expected), where)
    index += len(expected)
expect(len(loaded) == index, f"{len(loaded)} frames, expected {index}")
for fault in faults[:50]:
    print(f"FAULT {fault}", file=sys.stderr)
measured = ", ".join(f"{n} frames with markers of {role}" for role, n in sorted(counts.items()))
print(f"{expect.compared} comparisons, {len(faults)} faults, {len(exported)} episodes of {index} frames", measured)
sys.stdout.flush()
sys.stderr.flush()
# Threads of the C++ libraries sometimes abort the interpreter while it ends.
os._exit(1 if faults else 0)
