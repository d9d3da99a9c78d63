"""Opens exports of a gripcast dataset with the libraries they are for, and holds them against it.

    python -m venv venv
    venv/bin/pip install datasets pandas pillow numpy webdataset zarr polars duckdb lerobot
    gripcast dataset export DATASET --to parquet --out P        # and so on, any of them
    venv/bin/python tests/peers/load_exports.py DATASET [--parquet P] [--webdataset W]
        [--lerobot L] [--zarr Z] [--training T]

DATASET must be without splits and faults. Z is a folder or a .zip. Compared are ids, outcomes,
predictions, poses, field arrays, lift frames, and all images: equal pixels where bytes are kept, sizes and near colours in
Zarr, whose images are resized. Without the package `lerobot` its files are read as its
documentation describes them, and a line says so. Exits 1 when something differs.
"""

import argparse
import io
import os
import json
import math
import pathlib
import sys
import tempfile

import numpy
from PIL import Image

from comparison import expect, faults

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("dataset", type=pathlib.Path)
for name in ("parquet", "webdataset", "lerobot", "zarr", "training"):
    parser.add_argument(f"--{name}", type=pathlib.Path)
args = parser.parse_args()


def load_records():
    """By id; only what has a name that a grasp can have."""
    paths = sorted(args.dataset.glob("grasps/2*/grasp.json"))
    return {path.parent.name: json.loads(path.read_text()) for path in paths}


records = load_records()
assert records, "the dataset has no grasps"


def stored(record, stage, role):
    """The image in the dataset, or None."""
    camera = record[stage]["cameras"].get(role)
    if camera is None:
        return None
    return Image.open(args.dataset / "grasps" / record["id"] / camera["file"])


def same_pixels(image, record, stage, role, where, mode=None):
    original = stored(record, stage, role)
    if original is None or image is None:
        expect(original is None and image is None, f"{where}: {image}, stored {original}")
        return
    if mode:
        original, image = original.convert(mode), image.convert(mode)
    expect(image.mode == original.mode, f"{where}: mode {image.mode}, stored {original.mode}")
    a, b = numpy.asarray(image), numpy.asarray(original)
    expect(a.shape == b.shape and (a == b).all(), f"{where}: pixels differ")


def kinds():
    """Stage and role of every kind of image that any grasp has."""
    return sorted(
        {
            (stage, role)
            for record in records.values()
            for stage in ("initial", "grasp")
            for role in record[stage]["cameras"]
        }
    )


def fields(record):
    """Stage, role, name and array of the field arrays, read by NumPy."""
    found = []
    for stage in ("initial", "grasp"):
        for role, of_role in record[stage].get("fields", {}).items():
            for name, field in of_role.items():
                path = args.dataset / "grasps" / record["id"] / field["file"]
                array = numpy.load(path, allow_pickle=False)
                expect(list(array.shape) == field["shape"], f"{path}: shape {array.shape}")
                expect(array.dtype.str == field["dtype"], f"{path}: type {array.dtype}")
                expect(len(field["columns"]) == array.shape[-1], f"{path}: columns")
                found.append((stage, role, name, array))
    return found


def field_kinds():
    """Stage, role, name and shape of every field that any grasp has."""
    kinds = {}
    for record in records.values():
        for stage, role, name, array in fields(record):
            kinds[stage, role, name] = array.shape
    return kinds


def same_array(found, record, stage, role, name, where):
    """`found` is an array, NaN where the grasp has none."""
    found = numpy.asarray(found, "f4")
    there = {tuple(key): array for *key, array in fields(record)}
    expected = there.get((stage, role, name))
    if expected is None:
        expect(numpy.isnan(found).all(), f"{where}: {role} {name} is not NaN")
    else:
        same = found.shape == expected.shape and numpy.array_equal(found, expected, equal_nan=True)
        expect(same, f"{where}: {role} {name} differs")


def lift(record, role):
    """The images of the lift of a gel, cut out of its file by the sizes in the record."""
    camera = record.get("lift", {}).get("cameras", {}).get(role)
    if camera is None:
        return None
    rest = (args.dataset / "grasps" / record["id"] / camera["file"]).read_bytes()
    images = []
    for frame in camera["frames"]:
        image, rest = rest[: frame["bytes"]], rest[frame["bytes"] :]
        images.append(Image.open(io.BytesIO(image)))
    expect(not rest, f"{record['id']}: bytes after the lift of {role}")
    return images


def lift_roles():
    return sorted({role for r in records.values() for role in r.get("lift", {}).get("cameras", {})})


def number(value):
    return math.nan if value is None else value


def same_number(a, b, where, tolerance=0.0):
    a, b = float(number(a)), float(number(b))
    expect((math.isnan(a) and math.isnan(b)) or abs(a - b) <= tolerance, f"{where}: {a}, {b}")


def p_stable(record):
    return record["prediction"] and record["prediction"]["p_stable"]


def pose(record):
    found = record["pose"]
    return [math.nan] * 7 if found is None else found["t_m"] + found["q_wxyz"]


def check_parquet(root):
    import datasets
    import pandas

    print(f"datasets {datasets.__version__}, pandas {pandas.__version__}")
    datasets.disable_progress_bars()
    with tempfile.TemporaryDirectory() as cache:
        loaded = datasets.load_dataset(str(root), cache_dir=cache)["train"]
        expect(loaded["id"][:] == sorted(records), f"parquet: ids {loaded['id'][:]}")
        for row in loaded:
            record, where = records[row["id"]], f"parquet {row['id']}"
            for column in ("object", "scene", "operator", "outcome", "labelled_at", "rig", "note"):
                expect(row[column] == record[column], f"{where}: {column} {row[column]}")
            label = {"slip": 0, "stable": 1}.get(record["outcome"])
            expect(row["label"] == label, f"{where}: label {row['label']}")
            same_number(row["predicted_p_stable"], p_stable(record), where)
            found = row["pose_t_m"] and row["pose_t_m"] + row["pose_q_wxyz"]
            expect(found == (record["pose"] and pose(record)), f"{where}: pose {found}")
            expect(json.loads(row["record"]) == record, f"{where}: record")
            for stage, role in kinds():
                column = f"{stage}_{role}"
                same_pixels(row[column], record, stage, role, f"{where} {column}")
            for stage, role, name in field_kinds():
                found = row[f"{stage}_{role}_{name}"]
                found = numpy.full(1, numpy.nan) if found is None else found
                same_array(found, record, stage, role, name, where)
            for role in lift_roles():
                same_lift(row[f"lift_{role}"], lift(record, role), f"{where} lift_{role}")
    files = [str(path) for path in sorted(root.glob("data/*.parquet"))]
    table = pandas.concat([pandas.read_parquet(path) for path in files])
    check_columns("pandas", lambda name: table[name].tolist())
    for cell in table["grasp_left"].dropna():
        expect(Image.open(io.BytesIO(cell["bytes"])).size[0] > 0, "parquet: grasp_left by pandas")
    import duckdb
    import polars

    print(f"polars {polars.__version__}, duckdb {duckdb.__version__}")
    frame = polars.concat([polars.read_parquet(path, glob=False) for path in files])
    check_columns("polars", lambda name: frame[name].to_list())
    query = duckdb.sql("SELECT id, object, outcome FROM read_parquet(?)", params=[files])
    rows = query.order("id").fetchall()
    check_columns("duckdb", lambda name: [row[query.columns.index(name)] for row in rows])


def same_lift(found, expected, where):
    found, expected = found or [], expected or []
    expect(len(found) == len(expected), f"{where}: {len(found)} frames of {len(expected)}")
    for a, b in zip(found, expected):
        expect((numpy.asarray(a) == numpy.asarray(b)).all(), f"{where}: pixels differ")


def check_columns(library, column):
    """Text stays text: object 001 does not become 1."""
    ids = sorted(records)
    expect(column("id") == ids, f"parquet: ids by {library}")
    for name in ("object", "outcome"):
        expect(column(name) == [records[id][name] for id in ids], f"parquet: {name} by {library}")


def check_webdataset(root):
    import webdataset

    print(f"webdataset {webdataset.__version__}")
    shards = [str(path) for path in sorted(root.glob("*.tar"))]
    seen = []
    for sample in webdataset.WebDataset(shards, shardshuffle=False):
        key = sample["__key__"]
        seen.append(key)
        record, where = records[key], f"webdataset {key}"
        facts = json.loads(sample["json"])
        check_facts(facts, record, where)
        there = {name.rsplit(".", 1)[0]: data for name, data in sample.items() if "_" in name[1:]}
        for stage, role in kinds():
            field = f"{stage}_{role}"
            image = Image.open(io.BytesIO(there[field]))
            if facts[f"has_{field}"]:
                same_pixels(image, record, stage, role, f"{where} {field}")
            else:
                expect(stored(record, stage, role) is None, f"{where}: {field} is there")
                expect(not numpy.asarray(image).any(), f"{where}: {field} is not black")
        for stage, role, name in field_kinds():
            field = f"{stage}_{role}_{name}"
            found = numpy.load(io.BytesIO(sample[f"{field}.npy"]), allow_pickle=False)
            same_array(found, record, stage, role, name, where)
            expect(facts[f"has_{field}"] == (not numpy.isnan(found).all()), f"{where}: has_{field}")
        for role in lift_roles():
            film = sample[f"lift_{role}.mjpeg"]
            expect(facts[f"has_lift_{role}"] == bool(film), f"{where}: has_lift_{role}")
            check_film(film, lift(record, role), f"{where} lift_{role}")
    expect(seen == sorted(records), f"webdataset: keys {seen}")
    # What its users do: keys and images are decoded by their endings.
    decoded = next(iter(webdataset.WebDataset(shards, shardshuffle=False).decode("pil")))
    expect(isinstance(decoded["json"], dict), "webdataset: json is not decoded")
    expect(isinstance(decoded["grasp_left.jpg"], Image.Image), "webdataset: no image")
    check_webdataset_by_datasets(root)


def check_film(film, expected, where):
    """The frames of a Motion JPEG by OpenCV, as a video program reads them. Its decoder interpolates
    colours in another way than Pillow's: each frame must be nearest to the image at its place."""
    if expected is None:
        expect(film == b"", f"{where}: a film without frames")
        return
    import cv2

    with tempfile.NamedTemporaryFile(suffix=".mjpeg") as file:
        file.write(film)
        file.flush()
        video = cv2.VideoCapture(file.name)
        images = [numpy.asarray(image.convert("RGB")).astype(float) for image in expected]
        count = 0
        while True:
            there, image = video.read()
            if not there:
                break
            if count < len(images):
                differences = [numpy.abs(image[:, :, ::-1] - other).mean() for other in images]
                nearest, least = numpy.argmin(differences), min(differences)
                expect(nearest == count and least < 16, f"{where}: frame {count}: {differences}")
            count += 1
    expect(count == len(expected), f"{where}: {count} frames of {len(expected)} by OpenCV")


def check_facts(facts, record, where):
    expect(json.loads(facts["record"]) == record, f"{where}: record")
    expect(facts["object"] == record["object"], f"{where}: object {facts['object']}")
    label = {"slip": 0, "stable": 1}.get(record["outcome"], -1)
    expect(facts["label"] == label, f"{where}: label {facts['label']}")
    expect(facts["labelled_at"] == (record["labelled_at"] or ""), f"{where}: labelled_at")
    expect(facts["has_prediction"] == (record["prediction"] is not None), f"{where}: prediction")
    expect(facts["has_pose"] == (record["pose"] is not None), f"{where}: pose")
    if facts["has_prediction"]:
        same_number(facts["predicted_p_stable"], p_stable(record), where)
    if facts["has_pose"]:
        expect(facts["pose_t_m"] + facts["pose_q_wxyz"] == pose(record), f"{where}: pose")


def check_webdataset_by_datasets(root):
    """Hugging Face infers the types from the first five samples of the first shard."""
    import datasets

    datasets.disable_progress_bars()
    with tempfile.TemporaryDirectory() as cache:
        loaded = datasets.load_dataset(str(root), cache_dir=cache)["train"]
        expect(loaded["__key__"][:] == sorted(records), "webdataset: keys by datasets")
        for row in loaded:
            where = f"webdataset by datasets {row['__key__']}"
            check_facts(row["json"], records[row["__key__"]], where)
            images = [name for name in row if name.endswith((".jpg", ".png"))]
            expect(len(images) == len(kinds()), f"{where}: images {images}")
            for name in images:
                expect(isinstance(row[name], Image.Image), f"{where}: {name} is no image")
            for stage, role, name in field_kinds():
                found = row[f"{stage}_{role}_{name}.npy"]
                same_array(found, records[row["__key__"]], stage, role, name, where)


def check_lerobot(root):
    labelled = [id for id in sorted(records) if records[id]["outcome"] != "unlabelled"]
    info = json.loads((root / "meta/info.json").read_text())
    expect(info["codebase_version"] == "v3.0", f"lerobot: {info['codebase_version']}")
    expect(info["total_episodes"] == len(labelled), f"lerobot: {info['total_episodes']} episodes")
    try:
        import lerobot
        from lerobot.datasets.lerobot_dataset import LeRobotDataset
    except ImportError as error:
        print(f"SKIPPED: the package lerobot ({error}); its files are read by datasets alone")
        frames, episodes = read_lerobot_files(root)
    else:
        print(f"lerobot {lerobot.__version__}")
        frames = LeRobotDataset("gripcast/export", root=root)
        episodes = frames.meta.episodes
        check_lerobot_statistics(frames)
    check_lerobot_depth(root)
    expect(len(frames) == 2 * len(labelled), f"lerobot: {len(frames)} frames")
    for index, id in enumerate(labelled):
        record, episode = records[id], episodes[index]
        expect(episode["gripcast/id"] == id, f"lerobot {id}: {episode['gripcast/id']}")
        for at, stage in enumerate(("initial", "grasp")):
            check_frame(frames[2 * index + at], record, stage, info, f"lerobot {id} {stage}")


def check_frame(frame, record, stage, info, where):
    is_last = stage == "grasp"
    succeeds = is_last and record["outcome"] == "stable"
    expect(bool(frame["next.done"]) == is_last, f"{where}: done")
    expect(bool(frame["next.success"]) == succeeds, f"{where}: success")
    same_number(frame["next.reward"], float(succeeds), f"{where}: reward")
    expect(frame["task"] == f"grasp the {record['object']}", f"{where}: {frame['task']}")
    if "prediction.p_stable" in info["features"]:
        same_number(frame["prediction.p_stable"], p_stable(record), f"{where}: p", 1e-7)
    if "observation.pose" in info["features"]:
        for a, b in zip(frame["observation.pose"], pose(record)):
            same_number(a, b, f"{where}: pose", 1e-6)
    for name, feature in info["features"].items():
        if name.startswith("observation.tactile."):
            role, _, field = name.removeprefix("observation.tactile.").partition(".")
            expect(len(feature["names"]["components"]) == feature["shape"][-1], f"{where}: names")
            found = numpy.asarray(frame[name], "f4")
            expect(list(found.shape) == feature["shape"], f"{where} {name}: {found.shape}")
            same_array(found, record, stage, role, field or "markers", where)
        if feature["dtype"] != "image":
            continue
        role = name.split(".")[-1]
        found = frame[name]
        if not isinstance(found, Image.Image):
            array = found.numpy()
            if role != "depth":
                array = numpy.rint(array * 255).astype(numpy.uint8)
            found = array.transpose(1, 2, 0).squeeze()
        found = numpy.asarray(found)
        shape = [n for n in feature["shape"] if n != 1]
        expect(list(found.shape) == shape, f"{where} {name}: {found.shape}")
        original = stored(record, stage, role)
        if role == "depth":
            expected = numpy.zeros(shape) if original is None else numpy.asarray(original)
        else:
            expected = numpy.asarray(original.convert("RGB"))
        expect((found == expected).all(), f"{where} {name}: pixels differ")


def check_lerobot_statistics(frames):
    """Against sums over the frames as LeRobot loads them."""
    for name in [key for key in frames.meta.stats if key.startswith("observation.images.")]:
        images = numpy.stack([frames[i][name].numpy() for i in range(len(frames))])
        found = frames.meta.stats[name]
        for figure, expected in (
            ("mean", images.mean((0, 2, 3))),
            ("std", images.std((0, 2, 3))),
            ("min", images.min((0, 2, 3))),
            ("max", images.max((0, 2, 3))),
        ):
            near = numpy.allclose(found[figure].reshape(-1), expected, atol=1e-4)
            expect(near, f"lerobot: {name} {figure} {found[figure].reshape(-1)}, {expected}")


def read_lerobot_files(root):
    import datasets
    import pandas

    datasets.disable_progress_bars()
    cache = tempfile.mkdtemp()

    def read(folder, features=None):
        files = [str(path) for path in sorted((root / folder).glob("*/*.parquet"))]
        return datasets.Dataset.from_parquet(files, features=features, cache_dir=cache)

    tasks = pandas.read_parquet(root / "meta/tasks.parquet")
    data = read("data", lerobot_features(root))
    frames = [{**row, "task": tasks.iloc[row["task_index"]].name} for row in data]
    return frames, read("meta/episodes")


def lerobot_features(root):
    """The types that LeRobot gives to `datasets`: those of info.json."""
    import datasets

    array = {2: datasets.Array2D, 3: datasets.Array3D, 4: datasets.Array4D}
    features = {}
    for name, feature in json.loads((root / "meta/info.json").read_text())["features"].items():
        dtype, shape = feature["dtype"], feature["shape"]
        if dtype == "image":
            features[name] = datasets.Image()
        elif shape == [1]:
            features[name] = datasets.Value(dtype)
        elif len(shape) == 1:
            features[name] = datasets.List(datasets.Value(dtype), length=shape[0])
        else:
            features[name] = array[len(shape)](shape=tuple(shape), dtype=dtype)
    return datasets.Features(features)


def check_lerobot_depth(root):
    """The stored TIFF: read by Pillow, and by OpenCV's libtiff, against the metres of the dataset."""
    import cv2
    import pandas

    files = sorted((root / "data").glob("*/*.parquet"))
    table = pandas.concat([pandas.read_parquet(path) for path in files])
    if "observation.depth" not in table:
        return
    labelled = [id for id in sorted(records) if records[id]["outcome"] != "unlabelled"]
    for row in table.to_dict("records"):
        record = records[labelled[row["episode_index"]]]
        where = f"lerobot {record['id']} depth of frame {row['frame_index']}"
        file = row["observation.depth"]["bytes"]
        image = Image.open(io.BytesIO(file))
        expect(image.format == "TIFF" and image.mode == "F", f"{where}: {image.format} {image.mode}")
        counts = numpy.asarray(image)
        by_opencv = cv2.imdecode(numpy.frombuffer(file, "u1"), cv2.IMREAD_UNCHANGED)
        expect(by_opencv.dtype == numpy.float32, f"{where}: {by_opencv.dtype} by OpenCV")
        expect((by_opencv == counts).all(), f"{where}: Pillow and OpenCV differ")
        original = stored(record, "grasp", "depth") if row["frame_index"] == 1 else None
        if original is None:
            expect(not counts.any(), f"{where}: not 0")
            continue
        unit_m = record["grasp"]["cameras"]["depth"]["depth_unit_m"]
        metres = counts.astype(float) * unit_m
        expected = numpy.asarray(original).astype(float) * unit_m
        expect(expected.max() > 0, f"{where}: the dataset has no depth")
        expect(numpy.array_equal(metres, expected), f"{where}: metres differ")


def check_zarr(path):
    import zarr

    print(f"zarr {zarr.__version__}")
    is_zip = path.suffix == ".zip"
    group = zarr.open_group(zarr.storage.ZipStore(path, mode="r") if is_zip else str(path), mode="r")
    ends = group["meta/episode_ends"][:]
    ids = [str(id) for id in group["meta/id"][:]]
    expect(ids == sorted(records), f"zarr: ids {ids}")
    expect(list(ends) == [2 * (i + 1) for i in range(len(ids))], f"zarr: ends {ends}")
    for name in group["data"].array_keys():
        expect(group["data"][name].shape[0] == ends[-1], f"zarr: {name} has another length")
    codes = {"unlabelled": -1, "slip": 0, "stable": 1}
    for index, id in enumerate(ids):
        record, where = records[id], f"zarr {id}"
        expect(group["meta/object"][index] == record["object"], f"{where}: object")
        expect(group["meta/outcome"][index] == codes[record["outcome"]], f"{where}: outcome")
        same_number(group["meta/p_stable"][index], p_stable(record), where)
        found = [*group["meta/pose_t_m"][index], *group["meta/pose_q_wxyz"][index]]
        for a, b in zip(found, pose(record)):
            same_number(a, b, f"{where}: pose")
        for at, stage in enumerate(("initial", "grasp")):
            expect(group["data/stage"][2 * index + at] == at, f"{where}: stage")
            for role, name in {(role, name) for _, role, name in field_kinds()}:
                found = group[f"data/{role}_{name}"][2 * index + at]
                same_array(found, record, stage, role, name, where)
            for role in ("left", "right", "rgb"):
                check_zarr_image(group, 2 * index + at, record, stage, role, where)


def check_zarr_image(group, row, record, stage, role, where):
    if role not in group["data"]:
        return
    found = group[f"data/{role}"][row]
    original = stored(record, stage, role)
    expect(group[f"data/{role}_is_there"][row] == (original is not None), f"{where}: {role}")
    if original is None:
        expect(not found.any(), f"{where}: {role} is not black")
        return
    height, width, _ = found.shape
    box = crop(original.size, record[stage]["cameras"][role]["crop_profile"])
    resized = original.convert("RGB").resize((width, height), Image.Resampling.BILINEAR, box=box)
    difference = numpy.abs(found.astype(float) - numpy.asarray(resized)).mean()
    expect(difference < 1.0, f"{where}: {stage} {role} differs by {difference:.2f} grey levels")


def crop(size, profile):
    """Left, top, right, bottom of the crop profiles that rigs use."""
    width, height = size
    if profile == "gsmini-seventh-v1":
        return (width // 7, height // 7 + 2, width - width // 7, height - height // 7)
    assert profile in (None, "full-v1"), f"this script does not know the crop {profile}"
    return (0, 0, width, height)


def check_training(root):
    import pandas

    tables = [pandas.read_parquet(path) for path in sorted(root.glob("data/*.parquet"))]
    table = pandas.concat(tables)
    labelled = [id for id in sorted(records) if records[id]["outcome"] != "unlabelled"]
    expect(sorted(table["id"]) == labelled, f"training: ids {list(table['id'])}")
    for row in table.to_dict("records"):
        record, where = records[row["id"]], f"training {row['id']}"
        expect(row["object"] == record["object"], f"{where}: object {row['object']}")
        expect(row["label"] == (record["outcome"] == "stable"), f"{where}: label {row['label']}")
        for column in ("initial_left", "initial_right", "grasp_left", "grasp_right", "grasp_rgb"):
            image = Image.open(io.BytesIO(row[column]["bytes"]))
            expect(image.size == (320, 240), f"{where}: {column} {image.size}")


asked = 0
for name, check in (
    ("parquet", check_parquet),
    ("webdataset", check_webdataset),
    ("lerobot", check_lerobot),
    ("zarr", check_zarr),
    ("training", check_training),
):
    place = getattr(args, name)
    if place is None:
        continue
    asked += 1
    before = len(faults)
    check(place)
    print(f"{name}: {'as the dataset' if len(faults) == before else 'FAULTS'}")
if asked == 0:
    sys.exit("name an export, as --parquet P")
for fault in faults:
    print(f"FAULT {fault}", file=sys.stderr)
print(f"{expect.compared} comparisons, {len(faults)} faults, {len(records)} grasps")
sys.stdout.flush()
sys.stderr.flush()
# Threads of the C++ libraries sometimes abort the interpreter while it ends.
os._exit(1 if faults else 0)
