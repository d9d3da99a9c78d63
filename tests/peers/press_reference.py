"""Condenses the finite-element press study into tests/data/press_reference.json.

    python3 tests/peers/press_reference.py STUDY.json > tests/data/press_reference.json

The study (three material laws, every mesh of every solver) was computed with CalculiX 2.20
and a second, independent solver; only the mesh-converged estimates for the simulator's own law and
their error bars are kept.
"""

import json
import sys

PROVENANCE = {
    "problem": "gel block 25 x 20 x 4 mm, E 1 MPa, nu 0.3, back face clamped, sides free, "
    "quasi-static; forces of the whole gel; depth from first touch of the undeformed face",
    "law": "log neo-Hookean: mu/2 (tr C - 3) - mu ln J + lambda/2 (ln J)^2",
    "solvers": [
        "CalculiX 2.20, C3D20R, surface-to-surface contact, the law as a user material",
        "own second solver: hex20, 3x3x3 Gauss, penalty contact against the analytic surface, "
        "exact tangents; 9-node axisymmetric quads for the spheres",
    ],
    "estimate": "mean of the finest meshes of both solvers with the penalty's compliance removed "
    "to first order; friction: the finest run of the second solver, because CalculiX exceeds its "
    "own Coulomb limit in sliding",
    "error_n": "largest of last mesh step, Richardson remainder, half the difference of the "
    "solvers, half the penalty correction and a floor of 0.1 to 1 %",
}


def row(result):
    kept = {
        "depth_m": result["delta_m"],
        "force_n": result["force_n"],
        "error_n": result["error_bar_n"],
    }
    if "shift_x_m" in result:
        kept["shift_m"] = result["shift_x_m"]
        kept["shear_n"] = result["tangential_n"]
        kept["shear_error_n"] = result["tangential_error_bar_n"]
    return kept


def main():
    with open(sys.argv[1], encoding="utf-8") as file:
        study = json.load(file)
    cases = {
        case["case"]: {
            "indenter": case["geometry"],
            "friction": case["friction"],
            "rows": [row(result) for result in case["results"]],
        }
        for case in study["cases"]
        if case["material_law"] == "log"
    }
    text = json.dumps({"provenance": PROVENANCE, "cases": cases}, indent=1)
    # One row a line.
    for key in ("depth_m", "force_n", "error_n", "shift_m", "shear_n", "shear_error_n"):
        text = text.replace(f'\n     "{key}"', f' "{key}"')
    print(text.replace("\n    }", " }"))


if __name__ == "__main__":
    main()
