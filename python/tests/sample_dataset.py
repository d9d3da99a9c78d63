"""Writes a small dataset: three grasps with both gels, colour, depth and the markers of the left gel."""

from __future__ import annotations

import hashlib
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

GRASPS = [
    ("20261120T101500Z-0001", "mug", "stable"),
    ("20261120T101600Z-0002", "bottle", "slip"),
    ("20261120T101700Z-0003", "mug", "unlabelled"),
]
DEPTH_UNIT_M = 0.001


def gel(number: int, salt: int) -> np.ndarray[Any, Any]:
    rows, columns, channels = np.indices((48, 64, 3))
    pattern = rows * 3 + columns * 2 + channels * 40 + 17 * number + salt
    return np.asarray(pattern % 251, dtype=np.uint8)


def depth(number: int) -> np.ndarray[Any, Any]:
    """Counts; the first one is unknown."""
    counts = (np.arange(8 * 16, dtype=np.uint16) * 7 + number).reshape(8, 16)
    counts[0, 0] = 0
    return counts


def markers(number: int) -> np.ndarray[Any, Any]:
    values = np.arange(2 * 3 * 5, dtype=np.float32).reshape(2, 3, 5) + number / 8
    values[0, 0] = np.nan
    return values


def png(image: np.ndarray[Any, Any]) -> bytes:
    out = io.BytesIO()
    Image.fromarray(image).save(out, "PNG")
    return out.getvalue()


def npy(values: np.ndarray[Any, Any]) -> bytes:
    out = io.BytesIO()
    np.save(out, values)
    return out.getvalue()


def write_dataset(folder: Path) -> None:
    (folder / "grasps").mkdir(parents=True)
    (folder / "dataset.toml").write_text(
        'schema = 2\nname = "kitchen"\nrig = "bench"\nlicence = "CC-BY-4.0"\n'
        'label_definition = "stable = still in the gripper 3 s after the lift"\nsoftware = "gripcast 0.1.0"\n'
    )
    for index, (name, obj, outcome) in enumerate(GRASPS):
        write_grasp(folder / "grasps" / name, index, obj, outcome)


def write_grasp(folder: Path, index: int, obj: str, outcome: str) -> None:
    folder.mkdir()
    files: dict[str, dict[str, Any]] = {}

    def store(name: str, data: bytes) -> str:
        (folder / name).write_bytes(data)
        files[name] = {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
        return name

    def camera(stage: str, number: int, role: str) -> dict[str, Any]:
        is_depth = role == "depth"
        salt = {"left": 0, "right": 60, "rgb": 120}.get(role, 0)
        image = depth(number) if is_depth else gel(number, salt)
        return {
            "file": store(f"{stage}.{role}.png", png(image)),
            "product": "Sample",
            "serial": f"S-{role}",
            "interface": 0,
            "port": "1-1",
            "format": "Z16" if is_depth else "YUYV",
            "width": image.shape[1],
            "height": image.shape[0],
            "driver_time_ns": 1_000_000_000 + 40_000_000 * number,
            "sequence": number,
            "age_ms": 5.5,
            "controls": {},
            "crop_profile": "gsmini-seventh-v1" if role in ("left", "right") else None,
            "depth_unit_m": DEPTH_UNIT_M if is_depth else None,
        }

    def stage(name: str, number: int, roles: list[str]) -> dict[str, Any]:
        return {
            "captured_at": f"2026-11-20T10:{15 + index}:{number % 2:02}Z",
            "trigger_time_ns": 1_010_000_000 + 40_000_000 * number,
            "trigger": "script",
            "skew_ms": 0.0,
            "cameras": {role: camera(name, number, role) for role in roles},
            "fields": {
                "left": {
                    "markers": {
                        "file": store(f"{name}.left.markers.npy", npy(markers(number))),
                        "shape": [2, 3, 5],
                        "dtype": "<f4",
                        "columns": ["rest_x_px", "rest_y_px", "dx_px", "dy_px", "confidence"],
                        "units": ["px", "px", "px", "px", "1"],
                        "frame": "sensor_image",
                        "m_per_px": 2.9e-5,
                    }
                }
            },
        }

    record = {
        "schema": 2,
        "id": folder.name,
        "object": obj,
        "scene": "table",
        "operator": "Ada",
        "rig": "bench",
        "software": "gripcast 0.1.0",
        "outcome": outcome,
        "labelled_at": None if outcome == "unlabelled" else "2026-11-20T11:00:00Z",
        "initial": stage("initial", 2 * index, ["left", "right", "rgb"]),
        "grasp": stage("grasp", 2 * index + 1, ["left", "right", "rgb", "depth"]),
        "pose": {
            "t_m": [0.01, 0.02, 0.03 * index],
            "q_wxyz": [1.0, 0.0, 0.0, 0.0],
            "frame": "t_object_gripper",
            "covariance": None,
            "reprojection_px": None,
        }
        if index
        else None,
        "prediction": {
            "p_stable": 0.75,
            "threshold": 0.5,
            "model_sha256": "0" * 64,
            "model": "baseline",
            "latency_ms": 20.5,
            "engine_ms": 3.25,
        }
        if index
        else None,
        "overridden_guards": [],
        "calibration": {},
        "files": files,
        "note": "",
    }
    (folder / "grasp.json").write_text(json.dumps(record, indent=2, sort_keys=True) + "\n")
