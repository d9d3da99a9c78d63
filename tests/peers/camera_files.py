"""Holds gripcast's camera files against the programs whose formats they are.

    python -m venv venv && venv/bin/pip install opencv-python-headless pyyaml
    venv/bin/python tests/peers/camera_files.py target/release/gripcast

Files that gripcast writes are opened by OpenCV's FileStorage and, as ROS does, by yaml.safe_load;
files that these write are read by gripcast. Every number has to come back exactly. Exits 1 where
one does not.
"""

import json
import pathlib
import subprocess
import sys
import tempfile

import cv2
import numpy
import yaml

gripcast = sys.argv[1]
faults = []

TOML = """width = 1280
height = 720
fx = 915.1234567890123
fy = 911.0
cx = 642.8
cy = 357.4
model = "brown-conrady"
coefficients = [1e-7, -0.3333333333333333, 1.5e-17, -0.0004, 0.0025]
"""
K = numpy.array([[915.1234567890123, 0, 642.8], [0, 911.0, 357.4], [0, 0, 1]])
D = numpy.array([1e-7, -0.3333333333333333, 1.5e-17, -0.0004, 0.0025])


def run(*words):
    done = subprocess.run([gripcast, "calibrate", *map(str, words)], capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"gripcast calibrate {' '.join(map(str, words))}: {done.stderr}")
    return done.stdout


def check(what, found, expected):
    found, expected = numpy.asarray(found, float), numpy.asarray(expected, float)
    if found.shape != expected.shape or not (found == expected).all():
        faults.append(f"{what}: {found.tolist()}, expected {expected.tolist()}")


def check_shown(what, path, k, d):
    shown = json.loads(run("show", path, "--json"))
    check(f"{what} size", [shown["width"], shown["height"]], [1280, 720])
    check(f"{what} K", [shown[n] for n in ("fx", "fy", "cx", "cy")], [k[0, 0], k[1, 1], k[0, 2], k[1, 2]])
    check(f"{what} D", shown["coefficients"], d)


with tempfile.TemporaryDirectory() as folder:
    folder = pathlib.Path(folder)
    source = folder / "camera.toml"
    source.write_text(TOML)

    ours = folder / "ours.yml"
    run("convert", source, "--to", "opencv", "--out", ours)
    storage = cv2.FileStorage(str(ours), cv2.FILE_STORAGE_READ)
    check("OpenCV K", storage.getNode("camera_matrix").mat(), K)
    check("OpenCV D", storage.getNode("distortion_coefficients").mat(), D.reshape(5, 1))
    check("OpenCV size", [storage.getNode(f"image_{n}").real() for n in ("width", "height")], [1280, 720])

    ours = folder / "ours.yaml"
    run("convert", source, "--to", "ros", "--camera-name", "external", "--out", ours)
    info = yaml.safe_load(ours.read_text())
    matrix = lambda name: numpy.reshape(info[name]["data"], (info[name]["rows"], info[name]["cols"]))
    check("ROS K", matrix("camera_matrix"), K)
    check("ROS D", matrix("distortion_coefficients"), D.reshape(1, 5))
    check("ROS R", matrix("rectification_matrix"), numpy.eye(3))
    check("ROS P", matrix("projection_matrix"), numpy.hstack([K, numpy.zeros((3, 1))]))
    check("ROS size", [info["image_width"], info["image_height"]], [1280, 720])
    if (info["camera_name"], info["distortion_model"]) != ("external", "plumb_bob"):
        faults.append(f"ROS names: {info['camera_name']}, {info['distortion_model']}")

    for shape in ((1, 5), (5, 1)):
        theirs = folder / f"theirs{shape[0]}.yml"
        storage = cv2.FileStorage(str(theirs), cv2.FILE_STORAGE_WRITE)
        storage.write("calibration_time", "Mon 03 Aug 2026 10:00:00")
        storage.write("image_width", 1280)
        storage.write("image_height", 720)
        storage.write("camera_matrix", K)
        storage.write("distortion_coefficients", D.reshape(shape))
        storage.write("avg_reprojection_error", 0.1875)
        storage.release()
        check_shown(f"from OpenCV {shape}", theirs, K, D)

    theirs = folder / "theirs.yaml"
    block = lambda m: {"rows": m.shape[0], "cols": m.shape[1], "data": m.flatten().tolist()}
    theirs.write_text(yaml.dump({
        "image_width": 1280, "image_height": 720, "camera_name": "external",
        "camera_matrix": block(K), "distortion_model": "plumb_bob",
        "distortion_coefficients": block(D.reshape(1, 5)),
        "rectification_matrix": block(numpy.eye(3)),
        "projection_matrix": block(numpy.hstack([K, numpy.zeros((3, 1))])),
    }))
    check_shown("from PyYAML", theirs, K, D)

for fault in faults:
    print(f"FAULT {fault}", file=sys.stderr)
print(f"OpenCV {cv2.__version__}, PyYAML {yaml.__version__}: {len(faults)} faults")
sys.exit(1 if faults else 0)
