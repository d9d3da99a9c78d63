#!/usr/bin/env python3
"""Runs `gripcast sim mesh` on public meshes and compares their masses with manifold3d.

    tests/peers/public_meshes.py --gripcast target/release/gripcast [--urdfs 200] [--seed 1] [FOLDER …]

Installs the sets that PyPI has (pybullet with pybullet_data, robosuite) and manifold3d and trimesh
into a virtual environment below ${GRIPCAST_CACHE:-~/.cache/gripcast}. Further folders with meshes are
given by path. Meshes of fewer than 60 faces are left out; those larger than 250 mm or smaller than
15 mm are scaled to 80 mm.

Prints a table by set and a table by cause, and each mesh whose volume or centre of mass is more than
2 % (of the size) away from the union that manifold3d computes from its closed pieces. Exit code 1 if
fewer than 95 % run or a mass disagrees.
"""
import argparse
import collections
import concurrent.futures
import json
import os
import pathlib
import random
import re
import subprocess
import sys

PACKAGES = ["numpy==2.4.6", "trimesh==5.2.0", "manifold3d==3.5.4", "networkx==3.6.1", "scipy==1.17.1", "pillow==12.3.0"]
# Their meshes are used, not their code.
SETS = ["pybullet==3.2.7", "robosuite==1.5.2"]
SUFFIXES = {".obj", ".stl", ".ply", ".glb", ".gltf"}
MIN_FACES = 60
SCALED_M = 0.08
LIMITS_M = (0.015, 0.25)
WALL_MM = 2.0
TOLERANCE = 0.02


def environment():
    """Python of the virtual environment."""
    cache = pathlib.Path(os.environ.get("GRIPCAST_CACHE", pathlib.Path.home() / ".cache/gripcast"))
    home = cache / "public-meshes"
    python = home / "bin/python"
    if not (home / "complete").exists():
        print(f"installing the sets into {home}", file=sys.stderr)
        subprocess.run([sys.executable, "-m", "venv", "--clear", home], check=True)
        pip = [python, "-m", "pip", "install", "--quiet", "--only-binary", ":all:"]
        subprocess.run([*pip, *PACKAGES], check=True)
        subprocess.run([*pip, "--no-deps", *SETS], check=True)
        (home / "complete").touch()
    return python


def files(folder):
    return sorted(p for p in folder.rglob("*") if p.suffix.lower() in SUFFIXES and p.is_file())


def sets(folders, urdfs, seed):
    """Files by name of the set."""
    import sysconfig

    site = pathlib.Path(sysconfig.get_paths()["purelib"])
    data = site / "pybullet_data"
    drawn = files(data / "random_urdfs")
    drawn = sorted(random.Random(seed).sample(drawn, min(urdfs, len(drawn))))
    found = {
        "random_urdfs": drawn,
        "pybullet_data": [p for p in files(data) if "random_urdfs" not in p.parts],
        "robosuite": files(site / "robosuite/models/assets/objects"),
    }
    found.update({str(folder): files(folder) for folder in folders})
    return found


def pieces(path):
    """The mesh, welded by position."""
    import trimesh

    mesh = trimesh.load(path, force="mesh", process=False, skip_materials=True)
    mesh = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    return mesh


def union(mesh, scale):
    """Volume (m³) and centre of mass (m) of the union of the closed pieces; None if it has others."""
    import manifold3d
    import numpy
    import trimesh

    bodies = []
    for part in mesh.split(only_watertight=False):
        if not part.is_watertight or not part.is_winding_consistent:
            return None
        if part.volume < 0:
            return None
        raw = manifold3d.Mesh(part.vertices.astype(numpy.float32), part.faces.astype(numpy.uint32))
        body = manifold3d.Manifold(raw)
        if body.status() != manifold3d.Error.NoError:
            return None
        bodies.append(body)
    if not bodies:
        return None
    # A union with itself also resolves the crossings of one piece.
    whole = manifold3d.Manifold.batch_boolean(bodies + bodies[:1], manifold3d.OpType.Add)
    raw = whole.to_mesh()
    result = trimesh.Trimesh(raw.vert_properties[:, :3], raw.tri_verts, process=False)
    if result.volume <= 0:
        return None
    return result.volume * scale**3, (result.center_mass * scale).tolist()


def gripcast(binary, path, scale, *flags):
    command = [binary, "sim", "mesh", "--object", str(path), "--scale", repr(scale), "--json", *flags]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def cause(text):
    """The refusal without its numbers and names."""
    line = text.strip().splitlines()[0] if text.strip() else "no message"
    line = re.sub(r"\([^)]*\)|\"[^\"]*\"|[-+]?\d[\d.e+-]*", "#", line.split(": ")[-1])
    return line[:90]


def check(binary, name, path):
    """Row of one mesh; None if it has too few faces."""
    row = {"set": name, "path": str(path)}
    try:
        mesh = pieces(path)
        size, faces = float(mesh.extents.max()), len(mesh.faces)
        # Where a dimension is zero, there is no mesh.
    except Exception as error:  # any error of a reader that is not ours
        return {**row, "result": "not read by trimesh", "detail": str(error)[:100]}
    if faces < MIN_FACES:
        return None
    scale = 1.0 if LIMITS_M[0] <= size <= LIMITS_M[1] else SCALED_M / size
    try:
        done = gripcast(binary, path, scale)
        if done.returncode and "--wall-thickness-mm" in done.stderr:
            row["without_wall"] = cause(done.stderr)
            done = gripcast(binary, path, scale, "--wall-thickness-mm", str(WALL_MM))
    except subprocess.TimeoutExpired:
        return {**row, "result": "too slow", "detail": f"{faces} faces"}
    if done.returncode:
        return {**row, "result": "refused", "detail": cause(done.stderr)}
    report = json.loads(done.stdout)
    row.update(
        result="runs with a wall" if "without_wall" in row else "runs",
        uncertainty=report["volume_uncertainty"],
        warnings=report["warnings"],
    )
    try:
        expected = union(mesh, scale) if "without_wall" not in row else None
    except Exception as error:
        row["union"] = str(error)[:100]
        expected = None
    if expected:
        volume, center = expected
        row["volume_error"] = report["volume_m3"] / volume - 1
        distance = sum((a - b) ** 2 for a, b in zip(report["center_of_mass_m"], center)) ** 0.5
        row["center_error"] = distance / max(report["size_m"])
    return row


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folders", nargs="*", type=pathlib.Path)
    parser.add_argument("--gripcast", required=True)
    parser.add_argument("--urdfs", type=int, default=200, help="meshes of pybullet's random_urdfs")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--rows", type=pathlib.Path, help="write a JSON line for each mesh")
    args = parser.parse_args()
    python = environment()
    if pathlib.Path(sys.prefix) != python.parent.parent:
        os.execv(python, [python, *sys.argv])
    binary = str(pathlib.Path(args.gripcast).resolve())
    work = [(name, path) for name, found in sets(args.folders, args.urdfs, args.seed).items() for path in found]
    with concurrent.futures.ProcessPoolExecutor(args.jobs) as pool:
        futures = [pool.submit(check, binary, *item) for item in work]
        rows = [row for row in (future.result() for future in futures) if row]
    if args.rows:
        args.rows.write_text("".join(json.dumps(row) + "\n" for row in rows))
    sys.exit(report_on(rows))


def report_on(rows):
    """Prints the tables; the exit code."""
    usable = [row for row in rows if row["result"] != "not read by trimesh"]
    print(f"{'set':40} meshes   run  with wall  refused")
    for name in dict.fromkeys(row["set"] for row in usable):
        results = collections.Counter(row["result"] for row in usable if row["set"] == name)
        runs, wall, total = results["runs"], results["runs with a wall"], results.total()
        print(f"{name[-40:]:40} {total:6} {runs:5} {wall:10} {total - runs - wall:8}")
    for title, key in (("refused", "detail"), ("open, given a wall", "without_wall")):
        causes = collections.Counter(
            row[key] for row in usable if key in row and row["result"] != "runs"
        )
        print(f"\n{title}:")
        for text, count in causes.most_common():
            print(f"{count:5}  {text}")
    repairs = collections.Counter(
        re.sub(r"[-+]?\d[\d.e+-]*", "#", text) for row in usable for text in row.get("warnings", [])
    )
    print("\nwarnings:")
    for text, count in repairs.most_common():
        print(f"{count:5}  {text[:110]}")
    compared = [row for row in usable if "volume_error" in row]
    wrong = [
        row for row in compared if max(abs(row["volume_error"]), row["center_error"]) > TOLERANCE
    ]
    print(f"\ncompared with manifold3d: {len(compared)}, beyond {TOLERANCE:.0%}: {len(wrong)}")
    for row in wrong:
        print(f"  volume {row['volume_error']:+.2%}, centre {row['center_error']:.2%}  {row['path']}")
    share = sum(row["result"].startswith("runs") for row in usable) / max(len(usable), 1)
    plain = sum(row["result"] == "runs" for row in usable) / max(len(usable), 1)
    print(f"run: {share:.1%} of {len(usable)}; {plain:.1%} without a wall")
    return 0 if share >= 0.95 and not wrong else 1


if __name__ == "__main__":
    main()
