"""Times PyPI's ipctk on the scene of `gripcast bench contact`, one thread; prints one JSON object.

    python3 benches/peers/ipctk_contact.py SCENE.json [--runs 20]

SCENE `-` reads standard input. Ends with code 3 when ipctk or numpy is absent.

Phases of one Newton iteration: `build` of the collision set by its own broad phase, swept
`candidates`, `ccd` step, `energy`, `gradient`, and `hessian` with each local block projected
(CLAMP). `build_kept` is the collision set from candidates that were gathered before with the
margin that gripcast keeps, `gather` is that gathering.

It also sums gripcast's energy and gradient over all pairs of gel and sphere nearer than d_hat, with
ipctk's distances, areas, barrier and mollifier and gripcast's weights (a quarter of the area;
ipctk's own potentials weigh and merge pairs differently).
"""

import argparse
import importlib.metadata
import json
import sys
import time

try:
    import ipctk
    import numpy as np
except ImportError:
    sys.exit(3)

FRACTION = 0.25


def timed(work, runs):
    """Last result, minimum and lower median of the process' CPU time in ms.

    On a busy machine, wall time would count what others take from phases of many ms.
    """
    work()
    took = []
    for _ in range(runs):
        started = time.process_time()
        result = work()
        took.append((time.process_time() - started) * 1e3)
    took.sort()
    return result, {"min": took[0], "median": took[(len(took) - 1) // 2]}


def matrix(rows, dtype=np.float64):
    return np.asfortranarray(np.array(rows, dtype=dtype))


def same_energy(scene, mesh, vertices):
    """Gripcast's energy, the length of its gradient on the gels, pairs and smallest distance."""
    d_hat, kappa, first = scene["d_hat_m"], scene["kappa_pa"], scene["first_of_sphere"]
    rest, edges, faces = mesh.rest_positions, mesh.edges, mesh.faces
    barrier = ipctk.NormalizedClampedLogBarrier()
    candidates = ipctk.Candidates()
    candidates.build(mesh, vertices, d_hat)
    energy, nearest, pairs = 0.0, np.inf, [0, 0]
    gradient = np.zeros((len(vertices), 3))
    kinds = [candidates.fv_candidates, candidates.ee_candidates]
    for kind, candidate in ((k, c) for k in (0, 1) for c in kinds[k]):
        ids = [i for i in candidate.vertex_ids(edges, faces) if i >= 0]
        on_sphere = [i >= first for i in ids]
        if on_sphere[0] == on_sphere[-1]:
            continue
        squared = candidate.compute_distance(vertices, edges, faces)
        if squared >= d_hat**2:
            continue
        pairs[kind] += 1
        nearest = min(nearest, squared**0.5)
        factor, slope = 1.0, np.zeros(12)
        if kind == 0:
            area = mesh.vertex_area(ids[0])
        else:
            area = mesh.edge_area(candidate.edge0_id) + mesh.edge_area(candidate.edge1_id)
            threshold = ipctk.edge_edge_mollifier_threshold(*rest[ids])
            factor = ipctk.edge_edge_mollifier(*vertices[ids], threshold)
            slope = np.asarray(ipctk.edge_edge_mollifier_gradient(*vertices[ids], threshold)).ravel()
        scale = FRACTION * area * d_hat * kappa
        value = barrier(squared, d_hat**2)
        energy += scale * factor * value
        force = candidate.compute_distance_gradient(vertices, edges, faces)
        force = factor * barrier.first_derivative(squared, d_hat**2) * force + value * slope
        gradient[ids] += scale * np.reshape(force, (-1, 3))
    return {
        "vertex_triangle_pairs": pairs[0],
        "edge_edge_pairs": pairs[1],
        "min_distance_m": nearest,
        "energy_j": energy,
        "gradient_n": float(np.linalg.norm(gradient[:first])),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene")
    parser.add_argument("--runs", type=int, default=20)
    args = parser.parse_args()
    with sys.stdin if args.scene == "-" else open(args.scene) as file:
        scene = json.load(file)

    ipctk.set_num_threads(1)
    rest, vertices, moved = (matrix(scene[key]) for key in ("rest", "vertices", "moved"))
    faces = matrix(scene["faces"], np.int32)
    mesh = ipctk.CollisionMesh(rest, ipctk.edges(faces), faces)
    d_hat, runs = scene["d_hat_m"], args.runs

    def build():
        collisions = ipctk.NormalCollisions()
        collisions.use_area_weighting = True
        collisions.build(mesh, vertices, d_hat)
        return collisions

    def gather():
        candidates = ipctk.Candidates()
        candidates.build(mesh, vertices, 0.5 * (d_hat + scene["candidate_margin_m"]))
        return candidates

    def swept():
        candidates = ipctk.Candidates()
        candidates.build(mesh, vertices, moved)
        return candidates

    phases = {}
    collisions, phases["build"] = timed(build, runs)
    kept, phases["gather"] = timed(gather, runs)

    def build_kept():
        ipctk.NormalCollisions().build(kept, mesh, vertices, d_hat)

    _, phases["build_kept"] = timed(build_kept, runs)
    candidates, phases["candidates"] = timed(swept, runs)
    step = lambda: candidates.compute_collision_free_stepsize(mesh, vertices, moved)
    free_fraction, phases["ccd"] = timed(step, runs)
    barrier = ipctk.NormalizedClampedLogBarrier()
    potential = ipctk.BarrierPotential(barrier, d_hat, scene["kappa_pa"])
    _, phases["energy"] = timed(lambda: potential(collisions, mesh, vertices), runs)
    _, phases["gradient"] = timed(lambda: potential.gradient(collisions, mesh, vertices), runs)
    clamp = ipctk.PSDProjectionMethod.CLAMP
    hessian = lambda: potential.hessian(collisions, mesh, vertices, clamp)
    _, phases["hessian"] = timed(hessian, runs)
    json.dump(
        {
            "phases": phases,
            "collisions": len(collisions),
            "own_min_distance_m": collisions.compute_minimum_distance(mesh, vertices) ** 0.5,
            "free_fraction": free_fraction,
            "state": same_energy(scene, mesh, vertices),
            "version": importlib.metadata.version("ipctk"),
        },
        sys.stdout,
        sort_keys=True,
    )
    print()


if __name__ == "__main__":
    main()
