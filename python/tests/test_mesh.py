from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

import gripcast as gc

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float) * 0.04
FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
     [1, 5, 7], [1, 7, 3]]
)  # fmt: skip


def test_cube_from_arrays_has_its_volume() -> None:
    mesh = gc.Mesh.from_arrays(CUBE, FACES)
    assert mesh.volume_m3 == pytest.approx(0.04**3)
    assert mesh.center_of_mass_m == pytest.approx((0.02, 0.02, 0.02))
    assert mesh.size_m == pytest.approx((0.04, 0.04, 0.04))
    assert mesh.vertices_m.shape == (8, 3) and mesh.triangles.shape == (12, 3)
    assert mesh.warnings == [] and repr(mesh) == "<Mesh arrays: 12 triangles, 40.0 × 40.0 × 40.0 mm>"


@pytest.mark.parametrize(
    "vertices",
    [CUBE.astype(np.float32), np.asfortranarray(CUBE), np.repeat(CUBE, 2, axis=0)[::2], CUBE.tolist()],
    ids=["float32", "fortran", "strided", "list"],
)
def test_any_layout_of_real_numbers_is_read(vertices: object) -> None:
    faces = np.repeat(FACES.astype(np.uint8), 2, axis=1)[:, ::2]
    faces.flags.writeable = False
    mesh = gc.Mesh.from_arrays(vertices, faces)  # type: ignore[arg-type]
    assert mesh.volume_m3 == pytest.approx(0.04**3)


@pytest.mark.parametrize(
    ("vertices", "faces", "words"),
    [
        (CUBE[:, :2], FACES, "shape (n, 3); found float64 of shape [8, 2]"),
        (CUBE.astype(complex), FACES, "real numbers"),
        (CUBE.astype(str), FACES, "real numbers"),
        (np.where(CUBE > 0.03, np.nan, CUBE), FACES, "found NaN in row 1"),
        (CUBE, FACES.astype(float), "integers of shape (n, 3)"),
        (CUBE, FACES - 1, "indices from 0 to 7, found -1 in row 0"),
        (CUBE, FACES + 1, "found 8 in row 2"),
        (CUBE * 1000, FACES, "longer than the limit"),
        ([[0, 1], [2]], FACES, "real numbers"),
    ],
)
def test_wrong_arrays_are_explained(vertices: object, faces: object, words: str) -> None:
    with pytest.raises(gc.InputError) as caught:
        gc.Mesh.from_arrays(vertices, faces)  # type: ignore[arg-type]
    assert words in str(caught.value)


def test_open_surface_is_no_object() -> None:
    with pytest.raises(gc.InputError):
        gc.Object(gc.Mesh.from_arrays(CUBE[:3], FACES[:1] * 0 + [[0, 1, 2]], surface_only=True))


def test_file_is_read_in_its_unit(tmp_path: Path) -> None:
    path = tmp_path / "cube.obj"
    lines = [f"v {x} {y} {z}" for x, y, z in CUBE * 1e3] + [f"f {a} {b} {c}" for a, b, c in FACES + 1]
    path.write_text("\n".join(lines))
    mesh = gc.Mesh.load(path, unit="mm")
    assert mesh.volume_m3 == pytest.approx(0.04**3) and mesh.source == str(path)
    with pytest.raises(gc.InputError, match="unit"):
        gc.Mesh.load(path)
    with pytest.raises(gc.NotFoundError) as caught:
        gc.Mesh.load(tmp_path / "lost.obj")
    assert caught.value.where is not None and "lost.obj" in caught.value.where


def test_builtin_shapes_have_names() -> None:
    assert "mug" in gc.Mesh.BUILTIN
    assert gc.Mesh.builtin("mug").sha256 == gc.Mesh.builtin("builtin:mug").sha256
    with pytest.raises(gc.Error, match="mugg"):
        gc.Mesh.builtin("mugg")


@pytest.mark.parametrize(("mass_kg", "friction"), [(0.0, 0.4), (float("nan"), 0.4), (60, 0.4), (6, 0.4), (0.06, -0.1)])
def test_object_needs_a_mass_and_a_friction(mass_kg: float, friction: float) -> None:
    with pytest.raises(gc.InputError, match="mass_kg|friction"):
        gc.Object(gc.Mesh.builtin("box"), mass_kg, friction)


def test_mesh_says_how_it_is_made() -> None:
    with pytest.raises(TypeError, match="Mesh.load"):
        gc.Mesh("cup.stl")  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType]


def test_pose_and_matrix_are_the_same() -> None:
    pose = gc.Pose((0.1, 0.2, 0.3), (0.5, 0.5, 0.5, 0.5))
    np.testing.assert_allclose(pose.matrix[:3, :3], [[0, 0, 1], [1, 0, 0], [0, 1, 0]], atol=1e-15)
    back = gc.Pose.from_matrix(pose.matrix)
    assert back.t_m == pose.t_m and back.q_wxyz == pytest.approx(pose.q_wxyz)
    np.testing.assert_allclose((pose @ pose.inverse()).matrix, np.eye(4), atol=1e-15)
    assert pickle.loads(pickle.dumps(pose)) == pose and hash(pose) == hash(gc.Pose(pose.t_m, pose.q_wxyz))


@pytest.mark.parametrize(
    "matrix", [np.eye(3), np.diag([1, 1, -1, 1]), np.diag([2, 2, 2, 1]), np.full((4, 4), np.nan), np.eye(4) * 2]
)
def test_only_rigid_transforms_are_poses(matrix: object) -> None:
    with pytest.raises(gc.InputError, match="matrix"):
        gc.Pose.from_matrix(matrix)  # type: ignore[arg-type]


def test_quaternion_must_be_a_unit() -> None:
    with pytest.raises(gc.InputError, match="unit quaternion"):
        gc.Pose((0, 0, 0), (1, 1, 0, 0))
