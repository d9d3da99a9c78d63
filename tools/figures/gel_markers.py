#!/usr/bin/env python3
"""Draws docs/images/gel-markers.jpg: gel markers of real sensors beside rendered ones.

    tools/figures/gel_markers.py --gripcast target/release/gripcast --shared ../shared OUT.jpg

Needs Pillow and ffmpeg. Top: real untouched gel, rendered, real cuboid of 10 mm, rendered one. Bottom:
both fingers of a real grasp of a wire, and of a simulated grasp of a rod.
"""
import argparse
import math
import pathlib
import subprocess
import tempfile

from PIL import Image

SIZE = (320, 240)
GAP = 3
SEVENTH = 1 / 7


def box(center, size):
    """Corners and faces of a box."""
    corners = [
        tuple(c + sign * s / 2 for c, s, sign in zip(center, size, (x, y, z)))
        for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)
    ]
    faces = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    return corners, faces


def rod(diameter, length, segments=24):
    """Corners and faces of a cylinder along y, across the closing direction."""
    angles = [2 * math.pi * i / segments for i in range(segments)]
    corners = [
        (diameter / 2 * math.cos(angle), y, diameter / 2 * math.sin(angle))
        for y in (length / 2, -length / 2) for angle in angles
    ]
    ring = list(range(1, segments + 1))
    faces = [tuple(reversed(ring)), tuple(i + segments for i in ring)]
    for a, b in zip(ring, ring[1:] + ring[:1]):
        faces.append((a, b, b + segments, a + segments))
    return corners, faces


def write_obj(path, *pieces):
    lines, first = [], 0
    for corners, faces in pieces:
        lines += ["v " + " ".join(f"{c:.9f}" for c in corner) for corner in corners]
        lines += ["f " + " ".join(str(i + first) for i in face) for face in faces]
        first += len(corners)
    path.write_text("\n".join(lines) + "\n")


def cropped(image):
    """Without a seventh at each side, as the real clips are cropped a second time."""
    width, height = image.size
    x, y = SEVENTH * width, SEVENTH * height
    return image.resize(SIZE, Image.Resampling.BICUBIC, box=(x, y, width - x, height - y))


def frame(clip, number, folder):
    out = folder / f"{clip.stem}.png"
    select = ["-vf", f"select=eq(n\\,{number})", "-frames:v", "1"]
    subprocess.run(["ffmpeg", "-v", "error", "-y", "-i", clip, *select, out], check=True)
    return Image.open(out).convert("RGB")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--gripcast", default="target/release/gripcast")
    parser.add_argument("--shared", type=pathlib.Path, default=pathlib.Path("../shared"))
    parser.add_argument("--clip", default="199", help="grasp of slip_gsmini")
    parser.add_argument("--frame", type=int, default=45)
    parser.add_argument("out", type=pathlib.Path)
    args = parser.parse_args()

    with tempfile.TemporaryDirectory() as temporary:
        folder = pathlib.Path(temporary)

        def gripcast(*words):
            subprocess.run([args.gripcast, *map(str, words)], check=True)

        def render(name, *words):
            out = folder / name
            profile = ["--profile", "gelsight-mini-markers", "--markers", "image"]
            gripcast("render", "tactile", *words, *profile, "--out", out)
            return out

        def opened(path):
            return Image.open(path).convert("RGB")

        # Feet hold the rod at a height that the gels reach.
        feet = [box((0, y, 0), (0.02, 0.005, 0.04)) for y in (-0.025, 0.025)]
        write_obj(folder / "rod.obj", rod(0.003, 0.05), *feet)
        write_obj(folder / "cube.obj", box((0, 0, 0), (0.01, 0.01, 0.01)))
        trace = folder / "rod.bin"
        grasp = ["--width", "0.006", "--mass-kg", "0.005", "--friction", "0.6", "--stop-force-n", "2.5"]
        gripcast("sim", "grasp", "--object", folder / "rod.obj", *grasp, "--preset", "feats",
                 "--trace", trace, "--fields", "stages")
        simulated = render("rod", "--trace", trace)
        markers = args.shared / "data/gsmini_feats_marker"
        pressed = ["--object", folder / "cube.obj", "--side", "left"]
        top = [
            opened(markers / "nocontact_train_sensor.png"),
            opened(render("initial.png", "--trace", trace, "--moment", "initial", "--side", "left")),
            opened(markers / "cuboid_10-2-284.png"),
            opened(render("cube.png", *pressed, "--press-m", "0.0003")),
        ]
        grasps = args.shared / "data/slip_gsmini/grasps" / args.clip
        bottom = [frame(grasps / f"camera_{camera}.avi", args.frame, folder) for camera in (0, 2)]
        bottom += [cropped(opened(path)) for path in sorted(simulated.glob("*.png"))]
        rows = [top, bottom]
        step = [side + GAP for side in SIZE]
        width, height = (n * s + GAP for n, s in zip((len(top), len(rows)), step))
        sheet = Image.new("RGB", (width, height), "white")
        for row, images in enumerate(rows):
            for column, image in enumerate(images):
                sheet.paste(image, (GAP + column * step[0], GAP + row * step[1]))
        sheet.save(args.out, quality=90)


if __name__ == "__main__":
    main()
