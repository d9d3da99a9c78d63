"""Holds gripcast's marker dictionaries and detection against OpenCV.

    tests/peers/markers.py GRIPCAST [--images DIR] [--scenes N] [--sizes PX,PX]

1. Every marker of every dictionary, drawn by OpenCV, must be read with its id.
2. Scenes with markers of 12 to 48 px, in perspective, blurred and noisy: a table of what both find by
   size. gripcast must find 95 % of what OpenCV finds at 20 px and more, and no wrong id.
3. With --images, the images of a folder, such as those of OpenCV's tutorials: gripcast must find 95 %
   of the markers that OpenCV finds in the dictionary in which it finds most.
"""

import argparse
import json
import pathlib
import subprocess
import sys
import tempfile

import cv2
import numpy

ARUCO = cv2.aruco
LARGEST = ["DICT_4X4_1000", "DICT_5X5_1000", "DICT_6X6_1000", "DICT_7X7_1000", "DICT_ARUCO_ORIGINAL", "DICT_ARUCO_MIP_36h12",
           "DICT_APRILTAG_16h5", "DICT_APRILTAG_25h9", "DICT_APRILTAG_36h10", "DICT_APRILTAG_36h11"]
SIZES = [12, 14, 16, 18, 20, 22, 24, 28, 32, 40, 48]
WIDTH, HEIGHT, SUPERSAMPLED = 1280, 720, 4
faults = []


def dictionary(name):
    return ARUCO.getPredefinedDictionary(getattr(ARUCO, name))


def detect(paths, *flags):
    """Markers of each image: lists of (dictionary, id, corners)."""
    done = subprocess.run([gripcast, "board", "detect", *map(str, paths), *flags, "--json"], capture_output=True, text=True)
    if not done.stdout:
        sys.exit(done.stderr)
    return [[(m["dictionary"], m["id"], numpy.array(m["corners_px"])) for m in image["markers"]] for image in json.loads(done.stdout)["images"]]


def opencv(image, name):
    corners, ids, _ = ARUCO.ArucoDetector(dictionary(name), ARUCO.DetectorParameters()).detectMarkers(image)
    return [] if ids is None else [(int(i), c[0]) for i, c in zip(ids.ravel(), corners)]


def every_marker(folder, name):
    """Images with all markers of a dictionary, six pixels a cell."""
    words = dictionary(name)
    cells = words.markerSize + 2
    pitch = (cells + 4) * 6
    columns, rows = WIDTH // pitch, HEIGHT // pitch
    count = len(words.bytesList)
    paths = []
    for first in range(0, count, columns * rows):
        image = numpy.full((HEIGHT, WIDTH), 230, numpy.uint8)
        for k, i in enumerate(range(first, min(count, first + columns * rows))):
            y, x = (k // columns) * pitch + 12, (k % columns) * pitch + 12
            image[y:y + cells * 6, x:x + cells * 6] = ARUCO.generateImageMarker(words, i, cells * 6)
        paths.append(folder / f"{name}-{first}.png")
        cv2.imwrite(str(paths[-1]), image)
    found = [marker for image in detect(paths, "--dictionary", name) for marker in image]
    ids = sorted(i for _, i, _ in found)
    if name == "DICT_ARUCO_ORIGINAL":
        # Some of its markers equal others when rotated.
        missing, extra = sorted(set(range(count)) - set(ids)), []
        same = len(missing) < 64
    else:
        missing, extra = sorted(set(range(count)) - set(ids)), [i for i in set(ids) if ids.count(i) > 1]
        same = not missing and not extra
    print(f"{name:22} {count:5} markers, {len(missing)} missing, {len(extra)} twice")
    if not same:
        faults.append(f"{name}: missing {missing[:10]}, twice {extra[:10]}")


def scene(name, side, seed):
    """An image with markers of about `side` px and their ids and centres."""
    random = numpy.random.default_rng(seed)
    words = dictionary(name)
    size = SUPERSAMPLED
    image = numpy.full((HEIGHT * size, WIDTH * size), 95.0, numpy.float32)
    truth = []
    pitch = 2.2 * side + 8
    columns, rows = min(14, int(WIDTH / pitch)), min(8, int(HEIGHT / pitch))
    ids = random.permutation(len(words.bytesList))[:columns * rows]
    for k, i in enumerate(ids):
        centre = numpy.array([(k % columns + 0.5) * WIDTH / columns, (k // columns + 0.5) * HEIGHT / rows]) + random.uniform(-2, 2, 2)
        angle = random.uniform(0, 2 * numpy.pi)
        turn = numpy.array([[numpy.cos(angle), -numpy.sin(angle)], [numpy.sin(angle), numpy.cos(angle)]])
        outer = numpy.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * side / 2 * random.uniform(0.93, 1.07, (4, 1))
        corners = outer @ turn.T + centre
        cells = words.markerSize + 2
        texture = cv2.copyMakeBorder(ARUCO.generateImageMarker(words, int(i), cells * 16), 32, 32, 32, 32, cv2.BORDER_CONSTANT, value=255)
        texture = texture.astype(numpy.float32) / 255 * 175 + 30
        edge = 32 - 0.5
        source = numpy.float32([[edge, edge], [edge + cells * 16, edge], [edge + cells * 16, edge + cells * 16], [edge, edge + cells * 16]])
        low = numpy.floor(corners.min(0) - side / 2 - 2).astype(int)
        high = numpy.ceil(corners.max(0) + side / 2 + 2).astype(int)
        low, high = numpy.maximum(low, 0), numpy.minimum(high, [WIDTH, HEIGHT])
        part = image[low[1] * size:high[1] * size, low[0] * size:high[0] * size]
        target = ((corners - low + 0.5) * size - 0.5).astype(numpy.float32)
        h = cv2.getPerspectiveTransform(source, target)
        box = (part.shape[1], part.shape[0])
        mask = cv2.warpPerspective(numpy.ones_like(texture), h, box, flags=cv2.INTER_NEAREST)
        drawn = cv2.warpPerspective(texture, h, box, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        part[mask > 0] = drawn[mask > 0]
        truth.append((int(i), centre))
    image = cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    image = cv2.GaussianBlur(image, (0, 0), 0.6)
    light = numpy.clip(image / 255, 0, 1)
    levels = numpy.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055) * 255
    return numpy.clip(levels + random.normal(0, 1.5, levels.shape), 0, 255).round().astype(numpy.uint8), truth


def score(found, truth, side):
    """Numbers of right and wrong detections of (id, corners)."""
    right = wrong = 0
    for i, corners in found:
        near = [t for t, centre in truth if numpy.linalg.norm(corners.mean(0) - centre) < side / 2]
        if i in near:
            right += 1
        else:
            wrong += 1
    return right, wrong


def by_size(folder, scenes, sizes):
    names = ["DICT_4X4_50", "DICT_5X5_100", "DICT_6X6_250", "DICT_APRILTAG_36h11"]
    print(f"{'px':>3} {'markers':>8} {'opencv':>7} {'gripcast':>9} {'wrong: opencv':>14} {'gripcast':>9}   by dictionary")
    total = numpy.zeros(2, int)
    for side in sizes:
        sums, parts = numpy.zeros(5, int), []
        for name in names:
            part = numpy.zeros(3, int)
            for seed in range(scenes):
                image, truth = scene(name, side, seed)
                path = folder / "scene.png"
                cv2.imwrite(str(path), image)
                ours = [(i, c) for _, i, c in detect([path], "--dictionary", name)[0]]
                theirs, their_wrong = score(opencv(image, name), truth, side)
                right, wrong = score(ours, truth, side)
                sums += [len(truth), theirs, right, their_wrong, wrong]
                part += [len(truth), theirs, right]
            parts.append(f"{name[5:]} {part[1]}/{part[2]} of {part[0]}")
        print(f"{side:3} {sums[0]:8} {sums[1]:7} {sums[2]:9} {sums[3]:14} {sums[4]:9}   {', '.join(parts)}", flush=True)
        if sums[4]:
            faults.append(f"{sums[4]} wrong ids at {side} px")
        if side >= 20:
            total += sums[1:3]
    if total[1] < 0.95 * total[0]:
        faults.append(f"from 20 px on, found {total[1]}, OpenCV {total[0]}")


def images_of(folder):
    names = [f"DICT_{n}X{n}_{c}" for n in (4, 5, 6, 7) for c in (50, 250)] + LARGEST[4:]
    paths = sorted(p for p in folder.rglob("*") if p.suffix.lower() in (".png", ".jpg", ".jpeg"))
    theirs_all = ours_all = 0
    for path in paths:
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        name, theirs = max(((n, opencv(image, n)) for n in names), key=lambda pair: len(pair[1]))
        ours = detect([path], "--dictionary", name)[0]
        print(f"{path.name:32} {name:22} opencv {len(theirs):3} gripcast {len(ours):3}")
        ids = [i for _, i, _ in ours]
        theirs_all += len(theirs)
        ours_all += sum(i in ids for i, _ in theirs)
    if ours_all < 0.95 * theirs_all:
        faults.append(f"images: found {ours_all} of OpenCV's {theirs_all}")


parser = argparse.ArgumentParser()
parser.add_argument("gripcast")
parser.add_argument("--images", type=pathlib.Path)
parser.add_argument("--scenes", type=int, default=1)
parser.add_argument("--sizes", type=lambda text: [int(word) for word in text.split(",")], default=SIZES)
given = parser.parse_args()
gripcast = given.gripcast
with tempfile.TemporaryDirectory() as temporary:
    folder = pathlib.Path(temporary)
    for name in LARGEST:
        every_marker(folder, name)
    by_size(folder, given.scenes, given.sizes)
    if given.images:
        images_of(given.images)
for fault in faults:
    print(f"fault: {fault}")
sys.exit(1 if faults else 0)
