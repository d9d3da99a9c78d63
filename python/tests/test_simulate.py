from __future__ import annotations

import json
import math
import signal
import threading
from pathlib import Path
from types import FrameType

import numpy as np
import pytest

import gripcast as gc
from conftest import STOP_FORCE_N, Cli


def test_grasp_has_the_steps_of_the_program(result: gc.GraspResult, trace: Path) -> None:
    file = json.loads(trace.with_suffix(".json").read_text())
    header, steps = file["result"], file["steps"]
    assert result.outcome == header["outcome"] == "success"
    assert result.lifted_m == header["lifted_m"]
    assert result.force_n == (header["force_n"]["left"], header["force_n"]["right"])
    assert result.warnings == header["warnings"]
    assert result.friction_use == header["friction_use"]
    assert result.case.opening_m == header["pose"]["opening_m"]
    assert list(result.stage) == [step["stage"] for step in steps]
    exact = [
        (result.t_s, [step["t_s"] for step in steps]),
        (result.normal_force_n, [[gel["normal_n"] for gel in step["force"]] for step in steps]),
        (result.shear_force_n, [[gel["shear_n"] for gel in step["force"]] for step in steps]),
        (result.torque_n_m, [[gel["torque_n_m"] for gel in step["force"]] for step in steps]),
        (result.opening_m, [step["opening_m"] for step in steps]),
        (result.gripper_lift_m, [step["lifted_m"] for step in steps]),
        (result.t_world_object[:, :3, 3], [step["t_world_object"]["t_m"] for step in steps]),
        (result.min_gap_m, [[math.nan if gap is None else gap for gap in step["min_gap_m"]] for step in steps]),
    ]
    for ours, theirs in exact:
        np.testing.assert_array_equal(ours, np.array(theirs))
    for snapshot in file["snapshots"]:
        ours_at = result.snapshots[snapshot["stage"]]
        for nodes, gel in zip(ours_at.gel_nodes_m, snapshot["gels"], strict=True):
            np.testing.assert_array_equal(nodes, np.array(gel))


def test_result_says_what_it_is(result: gc.GraspResult) -> None:
    assert repr(result).startswith("<GraspResult success: lifted 49.9 mm")
    assert repr(result.case).startswith("<GraspCase of <Mesh builtin:sphere")
    assert list(result.snapshots) == ["closure", "adjustment", "lift"]
    assert "closure" in repr(result.snapshots["closure"])


def test_arrays_of_results_are_read_only(result: gc.GraspResult) -> None:
    with pytest.raises(ValueError, match="read-only"):
        result.t_s[0] = 1.0
    assert result.fields is not None
    with pytest.raises(ValueError, match="read-only"):
        result.fields.traction_pa[0] = 0.0


def test_tractions_sum_to_the_force_on_each_gel(result: gc.GraspResult) -> None:
    fields = result.fields
    assert fields is not None
    assert fields.stage == ["closure", "adjustment", "lift"]
    assert fields.traction_pa.shape == (3, 2, 11, 13, 3)
    assert fields.traction_pa.dtype == np.float32 and fields.contact.dtype == np.uint8
    sums = np.einsum("sgyxv,yx->sgv", fields.traction_pa.astype(float), fields.area_m2)
    np.testing.assert_allclose(sums, fields.force_n, atol=1e-4)
    at_end = np.array([np.flatnonzero(np.array(result.stage) == stage)[-1] for stage in fields.stage])
    np.testing.assert_allclose(-fields.force_n[:, :, 2], result.normal_force_n[at_end], atol=1e-3)
    assert set(np.unique(fields.contact)) <= {0, 1, 2} and (fields.contact > 0).any()


def test_batch_gives_the_results_of_single_grasps(sphere: gc.Object, result: gc.GraspResult) -> None:
    same = gc.GraspCase(sphere, gel="coarse", stop_force_n=STOP_FORCE_N)
    rigid = gc.GraspCase(sphere, engine="rigid", stop_force_n=STOP_FORCE_N)
    batch = gc.simulate_batch([same, rigid, same], threads=2)
    for one in (batch[0], batch[2]):
        np.testing.assert_array_equal(one.normal_force_n, result.normal_force_n)
        np.testing.assert_array_equal(one.t_world_object, result.t_world_object)
        assert one.fields is None
    alone = gc.simulate(sphere, engine="rigid", stop_force_n=STOP_FORCE_N)
    np.testing.assert_array_equal(batch[1].t_world_object, alone.t_world_object)
    assert alone.outcome == "success" and alone.reached_stop_force is None
    assert gc.simulate_batch([]) == []


def test_recorded_pose_is_the_placed_one(sphere: gc.Object, result: gc.GraspResult) -> None:
    placed = result.case
    relative = placed.t_world_object.inverse() @ placed.t_world_gripper
    for given in (relative, relative.matrix):
        pose = gc.GraspPose(given, placed.t_world_object, opening_m=placed.opening_m)
        case = gc.GraspCase(sphere, pose)
        np.testing.assert_allclose(case.t_world_gripper.matrix, placed.t_world_gripper.matrix, atol=1e-12)
        assert case.opening_m == placed.opening_m


def test_placement_moves_the_gripper(sphere: gc.Object) -> None:
    case = gc.GraspCase(sphere, gc.Placement(yaw_deg=90.0, offset_m=(0.002, 0.0), opening_m=0.06))
    t = case.t_world_gripper.matrix
    np.testing.assert_allclose(t[:3, 0], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(t[:2, 3], [0, 0.002], atol=1e-9)
    assert case.opening_m == 0.06


def test_press_is_that_of_the_program(cli: Cli) -> None:
    theirs = cli(
        "sim", "press", "--indenter", "sphere", "--radius-m", 0.01, "--gel", "coarse",
        "--depth-m", "2e-4,4e-4", "--friction", 0.4, "--shift-m", "1e-4", "--json",
    )  # fmt: skip
    ours = gc.press(
        "sphere", radius_m=0.01, gel="coarse", depths_m=[2e-4, 4e-4], friction=0.4, shifts_m=[1e-4], fields="stages"
    )
    points = theirs["points"]
    np.testing.assert_array_equal(ours.normal_force_n, [point["normal_n"] for point in points])
    np.testing.assert_array_equal(ours.shear_force_n, [point["shear_n"] for point in points])
    assert ours.converged.all() and list(ours.gel_nodes) == theirs["gel_nodes"]
    assert ours.fields is not None and ours.fields.traction_pa.shape == (3, 1, 11, 13, 3)
    assert ours.fields.stage == ["press"] * 3


def test_press_takes_a_mesh() -> None:
    mesh = gc.Mesh.builtin("sphere", scale=0.3)
    pressed = gc.press(mesh, gel="coarse", depths_m=[3e-4])
    assert pressed.normal_force_n[0] > 0.01
    with pytest.raises(gc.UsageError, match="no radius"):
        gc.press(mesh, radius_m=0.01)


@pytest.mark.parametrize(
    ("settings", "error", "words"),
    [
        ({"stop_force": 3.0}, gc.UsageError, "stop_force_n"),
        ({"stop_force_n": -1.0}, gc.UsageError, "stop_force_n"),
        ({"stop_force_n": math.nan}, gc.UsageError, "stop_force_n"),
        ({"stop_force_n": "40 N"}, TypeError, "stop_force_n"),
        ({"gel": "corse"}, gc.UsageError, "coarse"),
        ({"engine": "mujoco"}, gc.UsageError, "rigid"),
        ({"engine": "rigid", "gel": "coarse"}, gc.UsageError, "gel"),
        ({"preset": "feats", "profile": "digit"}, gc.UsageError, "contradicts"),
        ({"gain_m_per_n": 1e-6}, gc.UsageError, "proportional"),
        ({"fields": "every:0"}, gc.UsageError, "every:10"),
        ({"max_iterations": 0}, gc.UsageError, "max_iterations"),
        ({"profile": "no-such-sensor"}, gc.ConfigError, "gelsight-mini"),
    ],
)
def test_wrong_settings_are_explained(sphere: gc.Object, settings: object, error: type, words: str) -> None:
    with pytest.raises(error) as caught:
        gc.GraspCase(sphere, **settings)  # type: ignore[arg-type]
    assert words in str(caught.value)


def test_remedies_name_arguments() -> None:
    with pytest.raises(gc.InputError) as caught:
        gc.GraspCase(gc.Object(gc.Mesh.builtin("sphere", scale=3.0)))
    error = caught.value
    assert "wider than the gripper's 90 mm" in error.what
    assert error.remedy is not None
    assert "max_opening_m" in error.remedy and "yaw_deg" in error.remedy and "--" not in error.remedy
    with pytest.raises(gc.InputError, match="stable pose 99"):
        gc.GraspCase(gc.Object(gc.Mesh.builtin("box")), gc.Placement(stable_pose=99))


def test_threads_out_of_range_are_refused(sphere: gc.Object) -> None:
    for threads in (0, 1000):
        with pytest.raises(gc.UsageError, match="from 1 to 256"):
            gc.simulate(sphere, gel="coarse", threads=threads)


def interrupt_after(seconds: float) -> None:
    def stop(_signal: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)


def test_interrupt_ends_a_simulation(sphere: gc.Object) -> None:
    case = gc.GraspCase(sphere, gel="fine", dt_s=1e-4)
    for call in (lambda: gc.simulate(sphere, gel="fine", dt_s=1e-4), lambda: gc.simulate_batch([case] * 3)):
        interrupt_after(0.1)
        with pytest.raises(KeyboardInterrupt):
            call()
    interrupt_after(0.1)
    with pytest.raises(KeyboardInterrupt):
        gc.press("sphere", radius_m=0.01, gel="refined")


def test_other_threads_run_during_a_simulation(sphere: gc.Object) -> None:
    started = threading.Event()

    def work() -> None:
        started.set()
        gc.simulate(sphere, gel="coarse", stop_force_n=STOP_FORCE_N)

    thread = threading.Thread(target=work)
    thread.start()
    started.wait()
    # With the lock held, this line would run only after the simulation.
    counted = sum(range(1000))
    assert thread.is_alive() and counted == 499500
    thread.join()
