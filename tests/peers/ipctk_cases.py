"""Asks ipctk (the IPC Toolkit) for the numbers that tests/it/sim/ipctk.rs holds gripcast to.

    python3 -m venv venv && venv/bin/pip install ipctk==1.6.1 numpy
    venv/bin/python tests/peers/ipctk_cases.py tests/data/ipctk_cases.json

Lengths in m. Matrices are lower triangles by rows, to 13 digits; everything else is exact.
"""

import importlib.metadata
import json
import math
import sys

import ipctk
import numpy as np

SEED = 20261120
D_HAT = 5e-4
KAPPA = 3e6
MU = 0.4
EPSILON = 1e-5
SHARES = [1e-3, 1e-2, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 0.99, 0.999, 1.0, 1.5]

rng = np.random.default_rng(SEED)


def random_points():
    """Four points in a cube of 2 mm, to 0.1 um, so that the file stays short."""
    return np.round(rng.uniform(-1e-3, 1e-3, (4, 3)), 7)


def plain(value):
    """What json can write; no negative zeros."""
    if isinstance(value, np.ndarray):
        return [plain(entry) for entry in value]
    value = float(value)
    if not math.isfinite(value):
        return None
    return int(value) if value == int(value) and abs(value) < 1e15 else value


def triangle(matrix):
    """Lower triangle of a symmetric matrix."""
    matrix = np.asarray(matrix)
    scale = np.abs(matrix).max()
    assert np.abs(matrix - matrix.T).max() <= 1e-12 * scale, "not symmetric"
    rows = range(len(matrix))
    entries = [matrix[i, j] for i in rows for j in range(i + 1)]
    return [plain(float(f"{e:.12e}")) if abs(e) > 1e-16 * scale else 0 for e in entries]


def barrier():
    law = ipctk.NormalizedClampedLogBarrier()
    rows = []
    for power, name in ((2, "squared"), (1, "linear")):
        for fraction in SHARES:
            x, support = (fraction * D_HAT) ** power, D_HAT**power
            values = [
                law(x, support),
                law.first_derivative(x, support),
                law.second_derivative(x, support),
            ]
            rows.append({"form": name, "x": x, "b": [plain(v) for v in values]})
    return rows


def distance(kind, name, x):
    prefix = {"pt": "point_triangle_distance", "ee": "edge_edge_distance"}[kind]
    call = lambda suffix: getattr(ipctk, prefix + suffix)(*x)
    return {
        "name": name,
        "x": plain(x),
        "type": call("_type").name,
        "squared": plain(call("")),
        "gradient": plain(call("_gradient")),
        "hessian": triangle(call("_hessian")),
    }


def point_triangles():
    corner = np.array([[0, 0, 0], [1e-3, 0, 0], [0, 1e-3, 0]])
    named = [
        ("inside", [2e-4, 3e-4, 2e-4]),
        ("side t0 t1", [5e-4, -2e-4, 1e-4]),
        ("side t1 t2", [8e-4, 8e-4, 1e-4]),
        ("side t2 t0", [-2e-4, 5e-4, 1e-4]),
        ("corner t0", [-2e-4, -3e-4, 1e-4]),
        ("corner t1", [1.4e-3, -3e-4, 1e-4]),
        ("corner t2", [-3e-4, 1.4e-3, 1e-4]),
        ("inside, 1e-8 m above", [2e-4, 3e-4, 1e-8]),
    ]
    cases = [distance("pt", name, np.vstack([p, corner])) for name, p in named]
    thin = np.array([[3e-4, 2e-6, 1e-4], [0, 0, 0], [1e-3, 0, 0], [4e-4, 1e-5, 0]])
    cases.append(distance("pt", "thin triangle", thin))
    return cases + [distance("pt", f"random {i}", random_points()) for i in range(24)]


def edge_edges():
    a = [[-5e-4, 0, 0], [5e-4, 0, 0]]
    turned = lambda angle: [
        [1e-4 - 5e-4 * math.cos(angle), 2e-4 - 5e-4 * math.sin(angle), 2e-4],
        [1e-4 + 5e-4 * math.cos(angle), 2e-4 + 5e-4 * math.sin(angle), 2e-4],
    ]
    named = [
        ("crossed", [[0, -5e-4, 2e-4], [0, 5e-4, 2e-4]]),
        ("inside of a, end of b", [[1e-4, 2e-4, 1e-4], [2e-4, 9e-4, 3e-4]]),
        ("end of a, inside of b", [[8e-4, -5e-4, 1e-4], [9e-4, 4e-4, 2e-4]]),
        ("end, end", [[-8e-4, 3e-4, 1e-4], [-9e-4, 9e-4, 2e-4]]),
        ("parallel, overlapping", [[-4e-4, 1e-4, 0], [6e-4, 1e-4, 0]]),
        ("parallel, apart", [[8e-4, 1e-4, 0], [2e-3, 1e-4, 0]]),
        ("at 1e-3 rad", turned(1e-3)),
        ("at 0.01 rad", turned(1e-2)),
        ("at 0.1 rad", turned(0.1)),
    ]
    cases = [distance("ee", name, np.array(a + b, dtype=float)) for name, b in named]
    return cases + [distance("ee", f"random {i}", random_points()) for i in range(24)]


def mollifiers():
    rows = []
    for angle in [0, 1e-4, 1e-3, 1e-2, 2e-2, 3e-2, 3.3e-2, 0.1, 1]:
        x = np.array([[0, 0, 0], [1e-3, 0, 0], [0, 0, 1e-4], [0, 0, 1e-4]])
        x[3] += 1e-3 * np.array([math.cos(angle), math.sin(angle), 0])
        epsilon = ipctk.edge_edge_mollifier_threshold(*x)
        rows.append(
            {
                "angle": angle,
                "x": plain(x),
                "epsilon": plain(epsilon),
                "value": plain(ipctk.edge_edge_mollifier(*x, epsilon)),
                "gradient": plain(ipctk.edge_edge_mollifier_gradient(*x, epsilon)),
                "hessian": triangle(ipctk.edge_edge_mollifier_hessian(*x, epsilon)),
            }
        )
    return rows


def friction_scalars():
    rows = []
    for fraction in [0, 1e-6, 1e-3, 0.01, 0.1, 0.25, 0.5, 0.75, 0.9, 0.999, 1, 1.001, 2, 10]:
        y = fraction * EPSILON
        functions = [
            ipctk.smooth_friction_f0,
            ipctk.smooth_friction_f1,
            ipctk.smooth_friction_f1_over_x,
            ipctk.smooth_friction_f2,
        ]
        rows.append({"y": y, "f": [plain(f(y, EPSILON)) for f in functions]})
    return rows


def potential(name, kind, x, motion):
    """Barrier and friction of one stencil; `motion` is its displacement over the step."""
    if kind == "pt":
        # A far triangle carries the point, because only vertices of surfaces collide.
        vertices = np.vstack([x, x[0] + [0, 2e-4, 4e-3], x[0] + [2e-4, 0, 4e-3]])
        faces = np.array([[1, 2, 3], [0, 4, 5]])
        edges = ipctk.edges(faces)
    else:
        vertices, faces, edges = x, np.empty((0, 3), dtype=int), np.array([[0, 1], [2, 3]])
    vertices = np.asfortranarray(vertices)
    mesh = ipctk.CollisionMesh(vertices, edges, faces)
    collisions = ipctk.NormalCollisions()
    collisions.build(mesh, vertices, D_HAT)
    assert len(collisions) == 1, f"{name}: {len(collisions)} collisions"
    law = ipctk.BarrierPotential(ipctk.NormalizedClampedLogBarrier(), D_HAT, KAPPA)
    # The far vertices take no part: only the stencil's 12 coordinates are kept.
    stencil = lambda matrix: triangle(np.asarray(matrix)[:12, :12])
    result = {
        "name": name,
        "kind": kind,
        "x": plain(x),
        "energy": plain(law(collisions, mesh, vertices)),
        "gradient": plain(law.gradient(collisions, mesh, vertices)[:12]),
        "hessian": stencil(law.hessian(collisions, mesh, vertices).todense()),
    }
    tangential = ipctk.TangentialCollisions()
    tangential.build(mesh, vertices, collisions, law, MU)
    if len(tangential) == 1 and motion is not None:
        moved = np.zeros_like(vertices)
        moved[:4] = motion
        friction = ipctk.FrictionPotential(EPSILON)
        result["friction"] = {
            "motion": plain(np.asarray(motion, dtype=float)),
            "force": plain(tangential[0].normal_force_magnitude),
            "energy": plain(friction(tangential, mesh, moved)),
            "gradient": plain(friction.gradient(tangential, mesh, moved)[:12]),
            "hessian": stencil(friction.hessian(tangential, mesh, moved).todense()),
        }
    return result


def potentials():
    corner = [[0, 0, 0], [4e-3, 0, 0], [0, 4e-3, 0]]
    over = lambda height: np.array([[1e-3, 1e-3, height]] + corner)
    pushed = lambda motion: np.array([motion, [0, 0, 0], [0, 0, 0], [0, 0, 0]])
    crossed = [[-2e-3, 0, 0], [2e-3, 0, 0], [0, -2e-3, 2e-4], [0, 2e-3, 2e-4]]
    skew = [[-2e-3, 1e-4, 0], [2e-3, -3e-4, 1e-4], [5e-4, -1e-3, 3e-4], [-1e-3, 2e-3, 4e-4]]
    tilted = [[1.2e-3, 9e-4, 3e-4], [1e-4, 0, 1e-4], [4e-3, 2e-4, 0], [-3e-4, 4e-3, 3e-4]]
    slip = np.array([[3e-6, 1e-6, 0], [1e-6, -2e-6, 4e-6], [2e-6, 1e-6, 0], [0, -4e-6, 1e-6]])
    angle = 0.02
    along = [1.5e-3 * math.cos(angle), 1.5e-3 * math.sin(angle), 0]
    middle = np.array([2e-4, 1e-4, 3e-4])
    near_parallel = [[-2e-3, 0, 0], [2e-3, 0, 0], list(middle - along), list(middle + along)]
    return [
        potential("point over triangle, sticks", "pt", over(2.5e-4), pushed([3e-6, 0, 0])),
        potential("point over triangle, slips", "pt", over(2.5e-4), pushed([3e-5, 4e-5, -1e-5])),
        potential("tilted triangle", "pt", np.array(tilted), slip * 2),
        potential("crossed edges", "ee", np.array(crossed), slip),
        potential("skew edges", "ee", np.array(skew), slip * 10),
        potential("mollified edges", "ee", np.array(near_parallel), None),
    ]


def ccd(kind, x0, x1):
    name = {"pt": "point_triangle_ccd", "ee": "edge_edge_ccd"}[kind]

    def run(method):
        hit, toi = getattr(method, name)(*x0, *x1)
        return plain(toi) if hit else None

    exact = ipctk.TightInclusionCCD(tolerance=1e-9, conservative_rescaling=0.999999)
    return {
        "kind": kind,
        "x0": plain(x0),
        "x1": plain(x1),
        "tight": run(exact),
        "tight_default": run(ipctk.TightInclusionCCD()),
        "additive": run(ipctk.AdditiveCCD()),
    }


def collisions():
    over = np.array([[2e-4, 2e-4, 1e-3], [0, 0, 0], [1e-3, 0, 0], [0, 1e-3, 0]])
    cross = np.array([[-1e-3, 0, 0], [1e-3, 0, 0], [0, -1e-3, 1e-3], [0, 1e-3, 1e-3]])
    beside = over.copy()
    beside[0, :2] = 2e-3

    def shifted(x, rows, dz):
        moved = x.copy()
        moved[rows, 2] += dz
        return moved

    rows = [
        ccd("pt", over, shifted(over, [0], -2e-3)),
        ccd("pt", over, shifted(over, [0], -9e-4)),
        ccd("pt", beside, shifted(beside, [0], -2e-3)),
        ccd("ee", cross, shifted(cross, [2, 3], -4e-3)),
        ccd("ee", cross, shifted(cross, [2, 3], -5e-4)),
    ]
    # As many that hit as that miss.
    for kind in ("pt", "ee"):
        wanted = {True: 8, False: 8}
        while sum(wanted.values()):
            row = ccd(kind, random_points(), random_points())
            hit = row["tight"] is not None
            if wanted[hit]:
                wanted[hit] -= 1
                rows.append(row)
    return rows


def half_space():
    rows = []
    for z0, z1 in [(1e-3, -1e-3), (1e-3, 5e-4), (1e-3, -1e-5), (2e-4, -3e-3)]:
        p0, p1 = np.array([1e-3, 2e-3, z0]), np.array([0, 1e-3, z1])
        origin, normal = np.zeros(3), np.array([0.0, 0.0, 1.0])
        hit, toi = ipctk.point_static_plane_ccd(p0, p1, origin, normal, 0.9)
        rows.append({"d0": z0, "d1": z1, "toi": plain(toi) if hit else None})
    return rows


def main():
    cases = {
        "source": f"ipctk {importlib.metadata.version('ipctk')}, numpy {np.__version__}",
        "command": "tests/peers/ipctk_cases.py tests/data/ipctk_cases.json",
        "seed": SEED,
        "parameters": {
            "d_hat_m": D_HAT,
            "kappa_pa": KAPPA,
            "mu": MU,
            "epsilon_m": EPSILON,
            "additive_slack": 0.1,
        },
        "barrier": barrier(),
        "point_triangle": point_triangles(),
        "edge_edge": edge_edges(),
        "mollifier": mollifiers(),
        "friction": friction_scalars(),
        "potential": potentials(),
        "ccd": collisions(),
        "half_space": half_space(),
    }
    lines = []
    for key, value in cases.items():
        if isinstance(value, list):
            rows = ",\n".join(json.dumps(row, separators=(",", ":")) for row in value)
            lines.append(f"{json.dumps(key)}:[\n{rows}\n]")
        else:
            lines.append(f"{json.dumps(key)}:{json.dumps(value)}")
    with open(sys.argv[1], "w") as file:
        file.write("{\n" + ",\n".join(lines) + "\n}\n")


main()
