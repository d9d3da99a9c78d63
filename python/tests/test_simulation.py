"""The stepwise simulation."""

from __future__ import annotations

import numpy as np
import pytest

import gripcast as gc


@pytest.fixture
def simulation(sphere: gc.Object) -> gc.Simulation:
    return gc.Simulation(sphere, gel="coarse")


def close(simulation: gc.Simulation, force_n: float) -> gc.SimulationState:
    state = simulation.state
    while state.normal_force_n.min() < force_n:
        state = simulation.step(state.opening_m - 2e-4)
    return state


def test_closing_has_the_forces_of_simulate(sphere: gc.Object, result: gc.GraspResult) -> None:
    simulation = gc.Simulation(sphere, gel="coarse", max_speed_m_s=0.01)
    closing = [i for i, stage in enumerate(result.stage) if stage == "closure"]
    state = simulation.state
    for i in closing:
        state = simulation.step(float(result.opening_m[i]))
        np.testing.assert_allclose(state.normal_force_n, result.normal_force_n[i], atol=1e-6)
        assert state.t_s == result.t_s[i] and state.converged
    assert state.normal_force_n.min() > 1.0


def test_held_object_follows_the_gripper(simulation: gc.Simulation) -> None:
    closed = close(simulation, 6.0)
    assert closed.object_height_m < 1e-3
    lifted = simulation.step(moved_m=(0.005, 0.0, 0.01), steps=30)
    np.testing.assert_allclose(lifted.moved_m, (0.005, 0.0, 0.01), atol=1e-12)
    rise = np.subtract(lifted.t_world_object.t_m, closed.t_world_object.t_m)
    np.testing.assert_allclose(rise, lifted.moved_m, atol=1e-3)
    gripper = np.subtract(lifted.t_world_gripper.t_m, closed.t_world_gripper.t_m)
    np.testing.assert_allclose(gripper, lifted.moved_m, atol=1e-12)
    assert lifted.object_height_m > 0.008 and lifted.opening_m == closed.opening_m
    # The weight, 0.06 kg, hangs on both gels.
    assert abs(lifted.shear_force_n[:, 1].sum()) == pytest.approx(0.06 * 9.81, rel=0.1)
    released = simulation.step(lifted.opening_m + 0.02, steps=60)
    assert released.object_height_m < 1e-3 and np.isnan(released.min_gap_m).all()


def test_speed_is_limited(simulation: gc.Simulation) -> None:
    before = simulation.state
    after = simulation.step(before.opening_m + 0.004, (0.0, 0.03, 0.0))
    assert after.opening_m - before.opening_m == pytest.approx(2 * 0.05 * 0.01)
    np.testing.assert_allclose(after.moved_m, (0.0, 0.05 * 0.01, 0.0))


def test_same_steps_have_the_same_bits(sphere: gc.Object) -> None:
    def run(threads: int) -> list[bytes]:
        simulation = gc.Simulation(sphere, gel="coarse", threads=threads)
        close(simulation, 2.0)
        state = simulation.step(moved_m=(0.0, 0.0, 0.002), steps=6)
        return [state.normal_force_n.tobytes(), state.t_world_object.matrix.tobytes()]

    assert run(1) == run(2)


def test_gel_is_rendered_as_it_is(simulation: gc.Simulation) -> None:
    before = gc.render_tactile(simulation, seed=None)
    assert before.contact_fraction == 0.0
    close(simulation, 6.0)
    touched = gc.render_tactile(simulation, side="right", seed=None)
    assert touched.contact_fraction > 0.01 and touched.deepest_m > 1e-4
    with pytest.raises(gc.UsageError, match="moment"):
        gc.render_tactile(simulation, moment="grasp")
    with pytest.raises(gc.UsageError, match="press_m"):
        gc.render_tactile(simulation, press_m=1e-4)


def test_wrong_targets_are_refused(simulation: gc.Simulation, sphere: gc.Object) -> None:
    for opening, moved in [(-0.01, None), (1.0, None), (float("nan"), None), (None, (0.0, 0.0, -1e-3))]:
        with pytest.raises(gc.UsageError):
            simulation.step(opening, moved)
    with pytest.raises(gc.UsageError, match="steps"):
        simulation.step(steps=0)
    assert simulation.state.t_s == 0.0
    with pytest.raises(gc.UsageError, match="stop_force_n"):
        gc.Simulation(sphere, stop_force_n=3)  # type: ignore[call-arg]
    with pytest.raises(gc.UsageError, match="max_speed_m_s"):
        gc.Simulation(sphere, gel="coarse", max_speed_m_s=0.0)
    with pytest.raises(gc.Error, match="inside|penetrat"):
        gc.Simulation(sphere, gc.Placement(opening_m=0.01), gel="coarse")
