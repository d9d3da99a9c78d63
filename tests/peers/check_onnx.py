"""Holds a gripcast model and gripcast's whole prediction path against onnx and onnxruntime.

    python3 -m venv venv && venv/bin/pip install onnx onnxruntime numpy
    venv/bin/python tests/peers/check_onnx.py MODEL.onnx [--gripcast target/release/gripcast] [--n 64]

Checks that onnx.checker accepts the file in full, that onnxruntime sees the contract, and that
`gripcast predict images` on random images answers what onnxruntime answers on tensors that are
computed here from the contract's formulas, with the grasp head of the metadata computed here where
there is one, and that a file with an open batch answers the same for all of them at once. Prints one
JSON object; ends with 1 above the tolerance.
"""

import argparse
import json
import pathlib
import struct
import subprocess
import sys
import tempfile
import zlib

import numpy as np
import onnx
import onnxruntime as ort

TOLERANCE = 1e-5
# Relative difference of readings that onnxruntime and gripcast round differently.
ROUNDING = 1e-5
HEIGHT, WIDTH = 240, 320


def write_png(path, image):
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    bits, colour = (16, 0) if image.ndim == 2 else (8, 2)
    rows = b"".join(b"\0" + row.astype(">u2" if bits == 16 else "u1").tobytes() for row in image)
    header = struct.pack(">IIBBBBB", WIDTH, HEIGHT, bits, colour, 0, 0, 0)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(rows, 1))
        + chunk(b"IEND", b"")
    )


def gel(random):
    """An image before and after a contact of random place, size and strength, with noise."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    cx, cy, size = random.uniform(60, 260), random.uniform(50, 190), random.uniform(8, 60)
    bump = np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / size**2)
    strength = random.uniform(-1, 1, 3) * random.choice([0, 8, 25, 120])
    base = random.uniform(60, 180, 3) + 30 * np.sin(x / 90)[..., None]
    noisy = lambda image: np.clip(image + random.normal(0, 2, image.shape), 0, 255)
    return [noisy(p).astype(np.uint8) for p in (base, base + bump[..., None] * strength)]


def depth(random):
    """A depth image in mm: a box on a tilted ground, with holes."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    image = random.uniform(300, 500) - random.uniform(0, 0.5) * y
    (x0, x1), (y0, y1) = np.sort(random.integers(20, 300, 2)), np.sort(random.integers(20, 220, 2))
    image[y0:y1, x0:x1] = random.uniform(120, 250)
    image[random.random(image.shape) < 0.1] = 0
    return image.astype(np.uint16)


def points(image):
    """Points of an aligned depth image: the nominal mount and lens of the wrist camera."""
    pitch, ty, focal = np.deg2rad(-22), -0.078, 925 / 3
    u = (np.arange(WIDTH) - (WIDTH - 1) / 2)[None] / focal
    v = (np.arange(HEIGHT) - (HEIGHT - 1) / 2)[:, None] / focal
    z = image * 1e-3
    known = z > 0
    x = z * u
    y = ty + z * (np.cos(pitch) * v - np.sin(pitch))
    inverse = 0.2 / np.where(known, z, 1)
    planes = [np.clip(x / 0.1, -2, 2), np.clip(y / 0.1, -2, 2), inverse]
    return np.stack([np.where(known, plane, 0) for plane in planes])[None].astype(np.float32)


def tensor(pixels):
    return np.ascontiguousarray(pixels.transpose(2, 0, 1)[None], dtype=np.float32)


def gel_features(contact):
    """Features of a contact map: planes of 8 rows and 10 columns."""
    depth, *others = contact.reshape(5, 8, 10)
    pressed = np.maximum(depth, 0)
    total = pressed.sum() + np.float32(1e-3)
    y, x = np.mgrid[0:8, 0:10].astype(np.float32) - np.float32([3.5, 4.5])[:, None, None]
    centre = [(pressed * at).sum() / total for at in (x, y)]
    extent = [(pressed * at**2).sum() / total - c**2 for at, c in zip((x, y), centre)]
    cells = (depth > np.float32(0.2) * depth.max()).sum()
    features = [pressed.sum(), depth.max(), cells, depth.std(), centre[0], abs(centre[1]), *extent]
    for channel, plane in enumerate(others, 1):
        mean = abs(plane.mean()) if channel in (2, 4) else plane.mean()
        features += [mean, abs(plane).mean(), (plane**2).mean()]
    return np.array(features, dtype=np.float64)


def leaves(tree, features, node=0):
    """Values of the leaves that a sample may fall into: where a feature is as near to a limit as
    rounding, both branches count.

    A node is a leaf's value or [feature, limit, below, above].
    """
    if not isinstance(tree[node], list):
        return [tree[node]]
    feature, limit, below, above = tree[node]
    value, limit = features[feature], float(np.float32(limit))
    # Counts are exact.
    is_near = abs(value - limit) < ROUNDING * (1 + abs(limit)) and not value.is_integer()
    branches = [below, above] if is_near else [below if value < limit else above]
    return [leaf for branch in branches for leaf in leaves(tree, features, branch)]


def prediction(metadata, outputs):
    """Smallest and largest probability from all inputs: that of the network, or of the grasp head on
    what it reads."""
    p_stable = outputs["p_stable"]
    heads = json.loads(metadata.get("gripcast.grasp", "[]"))
    for head in heads:
        if head["variant"] != metadata["gripcast.variant"]:
            continue
        sides = [gel_features(outputs[f"contact_tactile_{side}"]) for side in ("left", "right")]
        gels = np.stack([np.minimum(*sides), np.maximum(*sides)], axis=1).ravel()
        cameras = json.loads(metadata.get("gripcast.geometry", "[]"))
        features = np.concatenate([gels, *(outputs[f"geometry_{name}"] for name in cameras)])
        with np.errstate(divide="ignore"):
            network = np.clip(np.log(p_stable[0] / (1 - p_stable[0])), -12, 12)
        found = [leaves(tree, features) for tree in head["trees"]["trees"]]
        scores = [head["trees"]["bias"] + sum(map(of, found)) for of in (min, max)]
        logits = head["trees_weight"] * np.array(scores)
        logits += head["network_weight"] * network + head["offset"]
        return 1 / (1 + np.exp(-logits))
    return [float(p_stable[0])] * 2


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("model")
    parser.add_argument("--gripcast", default="target/release/gripcast")
    parser.add_argument("--n", type=int, default=64)
    args = parser.parse_args()

    onnx.checker.check_model(onnx.load(args.model), full_check=True)
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    session = ort.InferenceSession(args.model, options, providers=["CPUExecutionProvider"])
    metadata = session.get_modelmeta().custom_metadata_map
    inputs = json.loads(metadata["gripcast.inputs"])
    assert sorted(i["name"] for i in inputs) == sorted(i.name for i in session.get_inputs())

    random = np.random.default_rng(1)
    names = [output.name for output in session.get_outputs()]
    answers, networks, feeds, worst, widest = [], [], [], 0.0, 0.0
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        for _ in range(args.n):
            feed, flags = {}, []
            for spec in inputs:
                before, after = gel(random)
                if spec["name"] == "rgb":
                    mean, std = np.float32(spec["mean"]), np.float32(spec["std"])
                    feed["rgb"] = tensor((after / np.float32(255) - mean) / std)
                    files = {"--rgb": after}
                elif spec["name"] == "depth":
                    image = depth(random)
                    feed["depth"] = points(image)
                    files = {"--depth": image}
                else:
                    side = spec["name"].removeprefix("tactile_")
                    difference = (after.astype(np.float32) - before) / np.float32(255)
                    feed[spec["name"]] = tensor(difference)
                    files = {f"--initial-{side}": before, f"--grasp-{side}": after}
                for flag, image in files.items():
                    path = folder / f"{flag.lstrip('-')}.png"
                    write_png(path, image)
                    flags += [flag, str(path)]
            command = [args.gripcast, "--quiet", "predict", "images", "--json", "--already-cropped"]
            ours = subprocess.run(
                [*command, "--model", args.model, *flags], check=True, capture_output=True
            )
            ours = json.loads(ours.stdout)["p_stable"]
            outputs = dict(zip(names, (value.ravel() for value in session.run(None, feed))))
            low, high = prediction(metadata, outputs)
            answers.append(float(low))
            widest = max(widest, float(high - low))
            networks.append(outputs["p_stable"][0])
            feeds.append(feed)
            worst = max(worst, float(low) - ours, ours - float(high))

    is_open = all(isinstance(i.shape[0], str) for i in session.get_inputs())
    batch_worst = None
    if is_open:
        batch = {name: np.concatenate([feed[name] for feed in feeds]) for name in feeds[0]}
        together = session.run(["p_stable"], batch)[0].ravel()
        batch_worst = float(np.abs(together - np.array(networks)).max())
        worst = max(worst, batch_worst)

    report = {
        "batch_difference": batch_worst,
        "checker": "ok",
        "largest_difference": worst,
        "n": args.n,
        "onnx": onnx.__version__,
        "onnxruntime": ort.__version__,
        "p_stable_max": max(answers),
        "p_stable_min": min(answers),
        "tolerance": TOLERANCE,
        "widest_range_by_rounding": widest,
    }
    json.dump(report, sys.stdout, indent=2, sort_keys=True)
    print()
    sys.exit(0 if worst <= TOLERANCE else 1)


if __name__ == "__main__":
    main()
