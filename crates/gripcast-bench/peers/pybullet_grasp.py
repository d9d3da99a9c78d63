"""Rigid grasps in PyBullet, from the cases that gripcast writes.

    python3 pybullet_grasp.py CASES.json [--runs N]     (or - for standard input)

The file holds `settings` (those of gripcast's rigid simulator), `refine` (time steps here for each
of the settings), `objects` (convex pieces, mass properties) and `grasps` (object, poses, opening,
friction, force), all SI. Prints one JSON object:
for each grasp whether it was `touched`, the `rise_m` of the centre of mass during the lift, the
`force_n` of both fingers at the end of the closing, and `seconds` (the shortest of `--runs` runs
of the time steps alone).

The gripper is a chain of prismatic joints: a carriage that moves along the world's z, and on it two
boxes along the gripper's x, each with a motor of its own. Exit code 3: PyBullet is absent.
"""

import argparse
import importlib.metadata
import json
import os
import sys
import tempfile
import time

# PyBullet prints lines of its own; only the answer may go to standard output.
ANSWER = os.fdopen(os.dup(1), "w", encoding="utf-8")
os.dup2(os.open(os.devnull, os.O_WRONLY), 1)

try:
    import pybullet as p
except ImportError:
    sys.exit(3)

FINGER_M = [0.004, 0.020, 0.025]
CARRIAGE_KG = 2.0
CARRIAGE_N = 1e4
NO_FORCE_N = 1e-3
FINGER_LINKS = [1, 2]


def xyzw(pose):
    w, x, y, z = pose["q_wxyz"]
    return [x, y, z, w]


def numbers(values):
    return " ".join(repr(float(v)) for v in values)


def inertial(mass, origin, tensor):
    (ixx, ixy, ixz), (_, iyy, iyz), (_, _, izz) = tensor
    return (
        f'<inertial><origin xyz="{numbers(origin)}" rpy="0 0 0"/><mass value="{mass!r}"/>'
        f'<inertia ixx="{ixx!r}" ixy="{ixy!r}" ixz="{ixz!r}" iyy="{iyy!r}" iyz="{iyz!r}" '
        f'izz="{izz!r}"/></inertial>'
    )


def write_object(folder, index, item):
    """URDF of an object with one collision hull for each convex piece."""
    collisions = []
    for number, piece in enumerate(item["pieces"]):
        name = f"{folder}/object{index}_{number}.obj"
        with open(name, "w", encoding="ascii") as out:
            for vertex in piece["vertices_m"]:
                out.write(f"v {numbers(vertex)}\n")
            for a, b, c in piece["triangles"]:
                out.write(f"f {a + 1} {b + 1} {c + 1}\n")
        collisions.append(
            f'<collision><geometry><mesh filename="{name}"/></geometry></collision>'
        )
    body = inertial(item["mass_kg"], item["center_of_mass_m"], item["inertia_kg_m2"])
    path = f"{folder}/object{index}.urdf"
    with open(path, "w", encoding="ascii") as out:
        out.write(
            f'<robot name="object"><link name="object">{body}{"".join(collisions)}</link></robot>'
        )
    return path




def write_gripper(folder, number, grasp, settings):
    """URDF of the gripper in its own frame: the carriage slides along the world's z."""
    _, back = p.invertTransform([0, 0, 0], xyzw(grasp["t_world_gripper"]))
    up, _ = p.multiplyTransforms([0, 0, 0], back, [0, 0, 1], [0, 0, 0, 1])
    ball = [[1e-2, 0, 0], [0, 1e-2, 0], [0, 0, 1e-2]]
    x = 0.5 * grasp["opening_m"] + 0.5 * FINGER_M[0]
    parts = [
        f'<robot name="gripper"><link name="base">{inertial(CARRIAGE_KG, [0, 0, 0], ball)}</link>',
        f'<link name="carriage">{inertial(CARRIAGE_KG, [0, 0, 0], ball)}</link>',
        '<joint name="lift" type="prismatic"><parent link="base"/><child link="carriage"/>'
        f'<axis xyz="{numbers(up)}"/><limit lower="-10" upper="10" effort="1e5" velocity="10"/>'
        "</joint>",
    ]
    for name, side in [("left", -1.0), ("right", 1.0)]:
        parts.append(
            f'<link name="{name}">{inertial(settings["finger_mass_kg"], [0, 0, 0], ball)}'
            f'<collision><geometry><box size="{numbers(FINGER_M)}"/></geometry></collision></link>'
            f'<joint name="{name}_slide" type="prismatic"><parent link="carriage"/>'
            f'<child link="{name}"/><origin xyz="{side * x!r} 0 0"/><axis xyz="{-side!r} 0 0"/>'
            '<limit lower="-1" upper="1" effort="1e5" velocity="10"/></joint>'
        )
    path = f"{folder}/gripper{number}.urdf"
    with open(path, "w", encoding="ascii") as out:
        out.write("".join(parts) + "</robot>")
    return path


def set_surface(body, links, friction, **more):
    for link in links:
        p.changeDynamics(
            body,
            link,
            lateralFriction=friction,
            rollingFriction=0.0,
            spinningFriction=0.0,
            linearDamping=0.0,
            angularDamping=0.0,
            jointDamping=0.0,
            **more,
        )


def build(cases, grasp, object_file, gripper_file):
    settings = cases["settings"]
    p.resetSimulation()
    p.setGravity(0, 0, -settings["gravity_m_s2"])
    p.setPhysicsEngineParameter(fixedTimeStep=settings["dt_s"] / cases["refine"])
    plane = p.createMultiBody(0, p.createCollisionShape(p.GEOM_PLANE))
    pose = grasp["t_world_object"]
    thing = p.loadURDF(
        object_file, pose["t_m"], xyzw(pose), flags=p.URDF_USE_INERTIA_FROM_FILE
    )
    pose = grasp["t_world_gripper"]
    gripper = p.loadURDF(
        gripper_file,
        pose["t_m"],
        xyzw(pose),
        useFixedBase=True,
        flags=p.URDF_USE_INERTIA_FROM_FILE,
    )
    # Bullet multiplies the coefficients of both surfaces.
    set_surface(plane, [-1], 1.0)
    set_surface(thing, [-1], grasp["friction"], activationState=p.ACTIVATION_STATE_DISABLE_SLEEPING)
    set_surface(gripper, [-1, 0, 1, 2], 1.0)
    for link in FINGER_LINKS:
        p.setCollisionFilterPair(plane, gripper, -1, link, 0)
    p.setCollisionFilterPair(gripper, gripper, *FINGER_LINKS, 0)
    return thing, gripper


def step(settings, gripper, grasp, lift_speed):
    p.setJointMotorControl2(
        gripper, 0, p.VELOCITY_CONTROL, targetVelocity=lift_speed, force=CARRIAGE_N
    )
    states = p.getJointStates(gripper, FINGER_LINKS)
    # Both joints count along their closing directions, which are opposite.
    common = 0.5 * (states[0][1] - states[1][1])
    mass = settings["finger_mass_kg"]
    axis = p.multiplyTransforms(
        [0, 0, 0], xyzw(grasp["t_world_gripper"]), [1, 0, 0], [0, 0, 0, 1]
    )[0]
    force = [-mass * common / settings["centring_s"] * x for x in axis]
    # A gripper's drive carries the weight of its fingers.
    force[2] += mass * settings["gravity_m_s2"]
    most = settings["closing_speed_m_s"]
    for link, state in zip(FINGER_LINKS, states):
        to_go = 0.5 * grasp["opening_m"] - state[0]
        speed = min(most, max(-most, settings["position_gain_per_s"] * to_go))
        p.setJointMotorControl2(
            gripper, link, p.VELOCITY_CONTROL, targetVelocity=speed, force=grasp["force_n"]
        )
        p.applyExternalForce(
            gripper, link, force, p.getLinkState(gripper, link)[0], p.WORLD_FRAME
        )
    p.stepSimulation()


def finger_forces(gripper, thing):
    def force(link):
        return sum(c[9] for c in p.getContactPoints(gripper, thing, linkIndexA=link))

    return [force(link) for link in FINGER_LINKS]


def run(cases, grasp, files):
    settings = cases["settings"]
    thing, gripper = build(cases, grasp, *files)

    def height():
        return p.getBasePositionAndOrientation(thing)[0][2]

    touched = False
    start = time.perf_counter()
    for _ in range(settings["closing_steps"] * cases["refine"]):
        step(settings, gripper, grasp, 0.0)
        touched = touched or any(f > NO_FORCE_N for f in finger_forces(gripper, thing))
    before, forces = height(), finger_forces(gripper, thing)
    speed = settings["lift_step_m"] / (settings["lift_ticks"] * settings["dt_s"])
    # The fingers set off with the carriage.
    p.resetJointState(gripper, 0, p.getJointState(gripper, 0)[0], speed)
    for _ in range(settings["lift_steps"] * settings["lift_ticks"] * cases["refine"]):
        step(settings, gripper, grasp, speed)
    seconds = time.perf_counter() - start
    return {
        "name": grasp["name"],
        "touched": touched,
        "rise_m": height() - before,
        "force_n": forces,
        "seconds": seconds,
    }


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("cases")
    parser.add_argument("--runs", type=int, default=1)
    args = parser.parse_args()
    if args.cases == "-":
        cases = json.load(sys.stdin)
    else:
        with open(args.cases, encoding="utf-8") as source:
            cases = json.load(source)
    answers = []
    p.connect(p.DIRECT)
    with tempfile.TemporaryDirectory() as folder:
        objects = [write_object(folder, i, o) for i, o in enumerate(cases["objects"])]
        for number, grasp in enumerate(cases["grasps"]):
            gripper = write_gripper(folder, number, grasp, cases["settings"])
            files = (objects[grasp["object"]], gripper)
            runs = [run(cases, grasp, files) for _ in range(max(1, args.runs))]
            best = dict(runs[0], seconds=min(r["seconds"] for r in runs))
            answers.append(best)
    json.dump({"version": importlib.metadata.version("pybullet"), "grasps": answers}, ANSWER)
    ANSWER.write("\n")
    ANSWER.close()


main()
