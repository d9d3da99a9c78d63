"""Whatever is passed, the answer is a result or an explained error."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import hypothesis.extra.numpy as npst
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import gripcast as gc

Array = np.ndarray[Any, Any]

quick = settings(
    max_examples=60,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
shapes = npst.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=6)
dtypes = st.one_of(
    npst.scalar_dtypes(), npst.byte_string_dtypes(), st.just(np.dtype(object)), st.just(np.dtype([("a", "i4")]))
)


@st.composite
def arrays(draw: st.DrawFn, like: tuple[Any, tuple[int, ...]] | None = None) -> Any:
    """Arrays of any type, shape, order and flags, often nearly right; now and then something else."""
    if draw(st.integers(0, 9)) == 0:
        return draw(st.sampled_from([None, 3, "left", [[1, 2], [3]], b"\xff\xd8\xff", object()]))
    if like is not None and draw(st.booleans()):
        dtype, shape = like
        elements = st.floats(width=32) if np.dtype(dtype).kind == "f" else None
        array = draw(npst.arrays(dtype, shape, elements=elements, fill=None if elements is None else st.nothing()))
    else:
        array = np.zeros(draw(shapes), dtype=draw(dtypes))
    how = draw(st.sampled_from(["plain", "reversed", "transposed", "strided", "fortran", "read-only", "swapped"]))
    if how == "reversed" and array.ndim:
        array = array[::-1]
    elif how == "transposed":
        array = array.T
    elif how == "strided" and array.ndim:
        array = np.repeat(array, 2, axis=0)[::2]
    elif how == "fortran":
        array = np.asfortranarray(array)
    elif how == "read-only":
        array = array.copy()
        array.flags.writeable = False
    elif how == "swapped" and array.dtype.kind in "iuf":
        array = array.astype(array.dtype.newbyteorder())
    return array


numbers = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True), st.integers(-(2**70), 2**70), st.none(), st.just("1"), st.booleans()
)


def explained(call: Callable[[], object]) -> None:
    try:
        call()
    except gc.InternalError:
        raise
    except (gc.Error, TypeError, OverflowError):
        pass


@quick
@given(vertices=arrays((np.float64, (4, 3))), triangles=arrays((np.int64, (4, 3))), wall=numbers)
def test_meshes(vertices: Any, triangles: Any, wall: Any) -> None:
    explained(lambda: gc.Mesh.from_arrays(vertices, triangles, wall_thickness_m=wall))


@quick
@given(matrix=arrays((np.float64, (4, 4))), t=st.tuples(numbers, numbers, numbers))
def test_poses(matrix: Any, t: Any) -> None:
    explained(lambda: gc.Pose.from_matrix(matrix))
    explained(lambda: gc.Pose(t))
    explained(lambda: gc.GraspPose(matrix))


@quick
@given(one=arrays((np.uint8, (6, 6, 3))), two=arrays((np.uint8, (6, 6, 3))), initial=numbers, scale=numbers)
def test_images(one: Any, two: Any, initial: Any, scale: Any) -> None:
    explained(lambda: gc.track_markers([one, two], initial=initial, m_per_px=scale))
    explained(lambda: gc.detect_markers(one))
    explained(lambda: PREDICTOR.predict([one, two], [two, one]))


@quick
@given(mass=numbers, friction=numbers, force=numbers, yaw=numbers, opening=numbers, offset=st.tuples(numbers, numbers))
def test_grasps_are_placed_or_refused(mass: Any, friction: Any, force: Any, yaw: Any, opening: Any, offset: Any) -> None:
    def case() -> object:
        bar = gc.Object(BOX, mass, friction)
        return gc.GraspCase(bar, gc.Placement(yaw_deg=yaw, opening_m=opening, offset_m=offset), stop_force_n=force)

    explained(case)


@quick
@given(opening=numbers, moved=st.tuples(numbers, numbers, numbers), steps=st.sampled_from([0, 1, -1, None, 2**70]))
def test_steps_are_made_or_refused(opening: Any, moved: Any, steps: Any) -> None:
    simulation = SIMULATION
    before = simulation.state
    explained(lambda: simulation.step(opening, moved, steps=steps))
    after = simulation.state
    assert after.t_s >= before.t_s and np.isfinite(after.t_world_object.matrix).all()


@quick
@given(
    initial=st.dictionaries(st.sampled_from(["left", "depth", "lfet", 3]), arrays((np.uint8, (4, 4, 3))), max_size=2),
    grasp=st.dictionaries(st.sampled_from(["left", "depth"]), arrays((np.uint16, (4, 4))), max_size=2),
    markers=st.one_of(st.none(), st.dictionaries(st.sampled_from(["left", "rgb"]), arrays((np.float32, (2, 2, 5))))),
    scale=numbers,
    name=st.text(max_size=6),
)
def test_grasps_are_saved_or_refused(
    scratch: gc.Dataset, initial: Any, grasp: Any, markers: Any, scale: Any, name: Any
) -> None:
    before = len(scratch)
    explained(
        lambda: scratch.append_grasp(
            object=name, initial=initial, grasp=grasp, markers=markers, m_per_px=scale, note=name
        )
    )
    assert len(gc.Dataset(scratch.path)) == len(scratch) in (before, before + 1)


@pytest.fixture(scope="module")
def scratch(tmp_path_factory: pytest.TempPathFactory) -> gc.Dataset:
    folder = tmp_path_factory.mktemp("fuzz") / "d"
    return gc.Dataset.create(folder, label_definition="none", licence="CC0-1.0")


def test_saved_grasps_are_sound(scratch: gc.Dataset) -> None:
    scratch.close()
    kinds = {problem.kind for problem in scratch.verify().problems}
    # Empty images are equal.
    assert kinds <= {"duplicate"}


BOX = gc.Mesh.builtin("box")
PREDICTOR = gc.Predictor("baseline-contact")
SIMULATION = gc.Simulation(gc.Object(BOX), gel="coarse")


def test_closed_dataset_still_reads(tmp_path: Path) -> None:
    image = np.zeros((4, 4, 3), np.uint8)
    with gc.Dataset.create(tmp_path / "d", label_definition="none", licence="CC0-1.0") as dataset:
        dataset.append_grasp(object="cup", initial={"left": image}, grasp={"left": image + 1})
    assert dataset[0].object == "cup"
    dataset.close()
    assert dataset[0].image("left").max() == 1


SHUTDOWN = {
    "simulation in a daemon thread": """
import threading
started = threading.Event()
def work():
    started.set()
    gc.simulate(gc.Object(gc.Mesh.builtin("sphere")), gel="coarse")
threading.Thread(target=work, daemon=True).start()
started.wait()
""",
    "open writer": """
import numpy as np, sys
dataset = gc.Dataset.create(sys.argv[1] + "/d", label_definition="none", licence="CC0-1.0")
image = np.zeros((4, 4, 3), np.uint8)
dataset.append_grasp(object="cup", initial={"left": image}, grasp={"left": image + 1})
""",
    "objects in a cycle": """
kept = [gc.Simulation(gc.Object(gc.Mesh.builtin("box")), gel="coarse"), gc.Predictor("baseline-contact")]
kept.append(kept)
""",
    "work in atexit": """
import atexit
atexit.register(lambda: gc.Mesh.builtin("box").vertices_m.sum())
""",
}


@pytest.mark.parametrize("what", SHUTDOWN)
def test_interpreter_ends_in_silence(what: str, tmp_path: Path) -> None:
    code = "import gripcast as gc\n" + SHUTDOWN[what]
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_free_threaded_python_is_refused_with_the_reason() -> None:
    code = """
import sysconfig
sysconfig.get_config_vars()["Py_GIL_DISABLED"] = 1
try:
    import gripcast
except ImportError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "free-threaded" in done.stdout and "stable ABI" in done.stdout
