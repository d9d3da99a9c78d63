"""Renders a scene that `examples/visual_reference.rs --export` wrote with PyPI's mitsuba, and compares.

    python3 tests/peers/mitsuba_scene.py DIR [--samples 4,16,64] [--reference 4096] [--ours]

Prints one JSON object: for each number of samples the process' CPU time, RMSE to Mitsuba's own
reference and mean. With `--ours`, the gripcast images DIR/reference.pfm and DIR/samplesN.pfm are
held against Mitsuba's reference, too. DIR/mitsuba_reference.npy is kept and used again.
Ends with code 3 when mitsuba or numpy is absent.

The variant is llvm_ad_rgb where DRJIT_LIBLLVM_PATH names an LLVM that works with it (Debian:
package libllvm19, libLLVM.so.19.1), otherwise scalar_rgb.
"""

import argparse
import json
import math
import os
import pathlib
import sys
import time

try:
    import mitsuba as mi
    import numpy as np
except ImportError:
    sys.exit(3)


def colour(folder, value):
    if isinstance(value, str):
        return {"type": "bitmap", "filename": str(folder / value)}
    return {"type": "rgb", "value": value}


def bsdf(folder, material):
    """The material as Mitsuba's nearest: the same model but for `principled`."""
    kind = material["kind"]
    if kind == "diffuse":
        found = {"type": "diffuse", "reflectance": colour(folder, material["colour"])}
    elif kind == "principled":
        found = {
            "type": "principled",
            "base_color": colour(folder, material["colour"]),
            "roughness": material["roughness"],
            "metallic": material["metallic"],
            "eta": material["ior"],
        }
    elif kind == "conductor":
        found = {
            "type": "roughconductor",
            "distribution": "ggx",
            "alpha": material["roughness"] ** 2,
            "eta": {"type": "rgb", "value": material["eta"]},
            "k": {"type": "rgb", "value": material["k"]},
        }
    elif kind == "dielectric":
        rough = material["roughness"] > 0.0
        found = {"type": "roughdielectric" if rough else "dielectric", "int_ior": material["ior"], "ext_ior": 1.0}
        if rough:
            found["distribution"] = "ggx"
            found["alpha"] = material["roughness"] ** 2
        return found
    return {"type": "twosided", "bsdf": found}


def column(axis):
    return [float(v) for v in axis]


def load(folder):
    scene = json.loads((folder / "scene.json").read_text())
    camera = scene["camera"]
    right, down, forward = (np.array(camera[k]) for k in ("right", "down", "forward"))
    # Mitsuba's camera: x to the left, y up, z forward.
    to_world = np.eye(4)
    to_world[:3, 0], to_world[:3, 1], to_world[:3, 2] = -right, -down, forward
    to_world[:3, 3] = camera["eye_m"]
    width, height = camera["width"], camera["height"]
    centre = camera["principal_px"]
    # Its dome: y up, the middle column along +z. Ours: z up, the middle column along +x.
    dome = np.array([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]], dtype=float)
    turn = scene["environment"]["rotation_rad"]
    turned = np.eye(4)
    turned[:2, :2] = [[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]]
    description = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": scene["max_bounces"] + 1},
        "sensor": {
            "type": "perspective",
            "fov_axis": "x",
            "fov": math.degrees(2 * math.atan(0.5 * width / camera["focal_px"][0])),
            "principal_point_offset_x": (centre[0] + 0.5) / width - 0.5,
            "principal_point_offset_y": (centre[1] + 0.5) / height - 0.5,
            "near_clip": 1e-3,
            "far_clip": 1e3,
            "to_world": mi.ScalarTransform4f(to_world),
            "film": {
                "type": "hdrfilm",
                "width": width,
                "height": height,
                "rfilter": {"type": "box"},
                "pixel_format": "rgb",
                "component_format": "float32",
            },
            "sampler": {"type": "independent"},
        },
        "dome": {
            "type": "envmap",
            "filename": str(folder / scene["environment"]["file"]),
            "scale": scene["environment"]["intensity"],
            "to_world": mi.ScalarTransform4f(turned @ dome),
        },
    }
    for m, mesh in enumerate(scene["meshes"]):
        description[f"mesh{m}"] = {
            "type": "ply",
            "filename": str(folder / mesh["file"]),
            "bsdf": bsdf(folder, scene["materials"][mesh["material"]]),
        }
    return mi.load_dict(description)


def render(scene, samples, seed):
    """Image and CPU seconds; large numbers of samples in parts, for the memory."""
    total, done, took = None, 0, 0.0
    while done < samples:
        part = min(64, samples - done)
        started = time.process_time()
        image = np.array(mi.render(scene, spp=part, seed=seed * 100_003 + done), dtype=np.float64)
        took += time.process_time() - started
        total = image * part if total is None else total + image * part
        done += part
    return total / samples, took


def read_pfm(path):
    with open(path, "rb") as file:
        file.readline()
        width, height = map(int, file.readline().split())
        file.readline()
        values = np.frombuffer(file.read(), dtype="<f4")
    return values.reshape(height, width, 3)[::-1].astype(np.float64)


def rmse(a, b):
    return float(np.sqrt(np.mean((a - b) ** 2)))


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--samples", default="4,16,64")
    parser.add_argument("--reference", type=int, default=4096)
    parser.add_argument("--ours", action="store_true")
    options = parser.parse_args()
    variant = "llvm_ad_rgb" if os.environ.get("DRJIT_LIBLLVM_PATH") else "scalar_rgb"
    mi.set_variant(variant)
    scene = load(options.folder)
    # The first image pays for compiling the kernels.
    render(scene, 1, 999)
    kept = options.folder / "mitsuba_reference.npy"
    report = {"peer": "mitsuba", "version": mi.__version__, "variant": variant, "figures": []}
    if kept.exists():
        reference = np.load(kept)
    else:
        reference, took = render(scene, options.reference, 1)
        np.save(kept, reference)
        report["reference_cpu_s"] = took
    report["reference_mean"] = reference.mean(axis=(0, 1)).tolist()
    for samples in map(int, options.samples.split(",")):
        render(scene, samples, 3)
        image, took = render(scene, samples, 2)
        report["figures"].append(
            {
                "samples": samples,
                "cpu_s": took,
                "rmse": rmse(image, reference),
                "mean": image.mean(axis=(0, 1)).tolist(),
            }
        )
    if options.ours:
        report["ours"] = []
        for path in sorted(options.folder.glob("*.pfm")):
            if path.stem == "environment":
                continue
            image = read_pfm(path)
            relative = image.mean(axis=(0, 1)) / reference.mean(axis=(0, 1)) - 1
            report["ours"].append(
                {"file": path.name, "rmse": rmse(image, reference), "mean_relative_difference": relative.tolist()}
            )
    print(json.dumps(report, indent=2))


main()
