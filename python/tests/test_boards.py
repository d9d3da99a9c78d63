"""Marker boards, camera images and fitted sensors, each beside the program."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gripcast as gc
from conftest import Cli, load_png, save_png

Image = np.ndarray[Any, Any]

# A sheet of 100 dots per inch seen from straight above: 0.254 m at 1000 px.
DPI, FOCAL_PX, DISTANCE_M = 100, 1000.0, 0.254


@pytest.fixture(scope="module")
def board() -> gc.Board:
    return gc.Board.make(gc.Mesh.builtin("mug"), name="mug")


@pytest.fixture(scope="module")
def sheet(board: gc.Board, tmp_path_factory: pytest.TempPathFactory) -> Image:
    path = tmp_path_factory.mktemp("sheet") / "mug.png"
    board.save_sheet(path, dpi=DPI)
    image = load_png(path)
    return np.repeat(image[..., None], 3, axis=2) if image.ndim == 2 else np.ascontiguousarray(image[..., :3])


def camera(image: Image) -> gc.Intrinsics:
    height, width = image.shape[:2]
    return gc.Intrinsics((width, height), (FOCAL_PX, FOCAL_PX), ((width - 1) / 2, (height - 1) / 2))


def test_board_is_that_of_the_program(board: gc.Board, tmp_path: Path, cli: Cli) -> None:
    made = cli(
        "board", "make", "--object", "builtin:mug", "--name", "mug", "--out", tmp_path / "mug.svg", "--json"
    )  # fmt: skip
    assert (board.hash, board.dictionary, board.name) == (made["hash"], made["dictionary"], "mug")
    assert sorted(board.corners_m) == made["ids"]
    board.save_sheet(tmp_path / "own.svg")
    assert (tmp_path / "own.svg").read_bytes() == (tmp_path / "mug.svg").read_bytes()
    board.save(tmp_path / "own.toml")
    read = gc.Board.load(tmp_path / "own.toml")
    assert read.hash == board.hash
    with pytest.raises(gc.UsageError, match="no sheet"):
        read.save_sheet(tmp_path / "again.pdf")
    with pytest.raises(gc.UsageError, match="svg"):
        board.save_sheet(tmp_path / "own.sgv")
    assert gc.Board.gripper_umi().corners_m


def test_pose_of_a_sheet_is_found(board: gc.Board, sheet: Image) -> None:
    markers = gc.detect_markers(sheet, board=board)
    assert [marker.id for marker in markers] == sorted(board.corners_m)
    assert markers[0].corners_px.shape == (4, 2) and markers[0].corrected_bits == 0
    assert {marker.dictionary for marker in gc.detect_markers(sheet)} <= {"DICT_6X6_50", "DICT_6X6_100", "DICT_6X6_250"}
    found = gc.solve_pose(markers, board, camera(sheet))
    assert found.rms_px < 0.5 and found.used_markers == len(markers) and found.opening_m is None
    assert found.covariance.shape == (6, 6) and np.linalg.eigvalsh(found.covariance).min() > 0
    corners = np.concatenate([board.corners_m[marker.id] for marker in markers])
    matrix = found.t_camera_board.matrix
    seen = corners @ matrix[:3, :3].T + matrix[:3, 3]
    np.testing.assert_allclose(seen[:, 2], DISTANCE_M, atol=2e-3)


def test_intrinsics_survive_a_file(sheet: np.ndarray, tmp_path: Path) -> None:
    intrinsics = camera(sheet)
    intrinsics.save(tmp_path / "camera.toml")
    read = gc.Intrinsics.load(tmp_path / "camera.toml")
    assert (read.size_px, read.focal_px, read.center_px) == (
        intrinsics.size_px,
        intrinsics.focal_px,
        intrinsics.center_px,
    )


def test_wrong_boards_and_cameras_are_explained(board: gc.Board, sheet: Image) -> None:
    markers = gc.detect_markers(sheet, board=board)
    other = gc.Intrinsics((640, 480), (600.0, 600.0), (320.0, 240.0))
    for call, error in [
        (lambda: gc.solve_pose(markers, board, other), gc.Error),
        (lambda: gc.solve_pose([], board, camera(sheet)), gc.InputError),
        (lambda: gc.detect_markers(sheet, board=board, dictionary="36h11"), gc.UsageError),
        (lambda: gc.detect_markers(sheet, dictionary="DICT_7x7"), gc.Error),
        (lambda: gc.detect_markers(sheet[:8, :8]), gc.InputError),
        (lambda: gc.Intrinsics((0, 0), (1.0, 1.0), (0.0, 0.0)), gc.ConfigError),
        (lambda: gc.Board.make(gc.Mesh.builtin("mug"), paper="A5"), gc.Error),  # type: ignore[arg-type]
        (lambda: gc.Board.make(gc.Mesh.builtin("mug"), marker_m=float("nan")), gc.UsageError),
    ]:
        with pytest.raises(error):
            call()  # type: ignore[no-untyped-call]


def test_camera_image_is_that_of_the_program(
    result: gc.GraspResult, trace: Path, tmp_path: Path, cli: Cli
) -> None:
    for view in ("hand", "outside"):
        out = tmp_path / f"{view}.png"
        cli(
            "render", "visual", "--trace", trace, "--out", out, "--view", view, "--finish", "steel",
            "--spp", 2, "--size", "64x48", "--seed", 4, "--quiet",
        )  # fmt: skip
        mine = gc.render_visual(result, view=view, size_px=(64, 48), samples=2, seed=4, finish="steel")
        np.testing.assert_array_equal(mine.image, load_png(out))
    assert mine.depth_m.shape == (48, 64) and np.nanmin(mine.depth_m) > 0.1
    first = gc.render_visual(result, moment="initial", size_px=(32, 24), samples=1)
    assert (first.image != gc.render_visual(result, size_px=(32, 24), samples=1).image).any()


def test_camera_image_needs_gels_and_a_size(result: gc.GraspResult, sphere: gc.Object) -> None:
    for call in (
        lambda: gc.render_visual(sphere),  # type: ignore[arg-type]
        lambda: gc.render_visual(result, size_px=(0, 24)),
        lambda: gc.render_visual(result, samples=0),
        lambda: gc.render_visual(result, view="above"),  # type: ignore[arg-type]
        lambda: gc.render_visual(result, finish="invisible"),
        lambda: gc.render_visual(gc.simulate(sphere, engine="rigid", stop_force_n=5)),
    ):
        with pytest.raises(gc.Error):
            call()  # type: ignore[no-untyped-call]


def test_sensor_is_fitted_as_by_the_program(result: gc.GraspResult, tmp_path: Path, cli: Cli) -> None:
    sensor = gc.SensorProfile("gelsight-mini")
    ball_m, press_m = 0.006, 5e-4
    ball = gc.Mesh.builtin("sphere", scale=ball_m / gc.Mesh.builtin("sphere").size_m[0])
    folder = tmp_path / "presses"
    folder.mkdir()
    save_png(folder / "no_contact.png", gc.render_tactile(result, moment="initial", profile=sensor, seed=None).image)
    radius_px = float(np.sqrt(press_m * (ball_m - press_m))) / sensor.m_per_px
    presses = []
    for number, (x, y) in enumerate((x, y) for x in (-70, 0, 70) for y in (-45, 45)):
        at = gc.Pose((x * sensor.m_per_px, y * sensor.m_per_px, 0.0))
        image = gc.render_tactile(ball, at, press_m=press_m, profile=sensor, seed=number).image
        save_png(folder / f"press_{number}.png", image)
        presses.append({"file": f"press_{number}.png", "center_px": [159.5 + x, 119.5 + y], "radius_px": radius_px})
    listed = {"no_contact": "no_contact.png", "ball_diameter_m": ball_m, "m_per_px": sensor.m_per_px}
    (folder / "presses.json").write_text(json.dumps({**listed, "presses": presses}))
    fit = gc.SensorProfile.fit(folder, name="mine", seed=1)
    expected = cli(
        "render", "calibrate", "--presses", folder, "--name", "mine", "--seed", 1, "--out", tmp_path / "p.toml", "--json"
    )  # fmt: skip
    assert fit.fve == expected["fve"] > 0.5 and fit.report["presses"] == expected["presses"]
    fit.profile.save(tmp_path / "mine.toml")
    assert (tmp_path / "mine.toml").read_text() == (tmp_path / "p.toml").read_text().replace("p.background", "mine.background")
    read = gc.SensorProfile(tmp_path / "mine.toml")
    assert read.name == "mine" and read.size_px == (320, 240)
    with pytest.raises(gc.NotFoundError):
        gc.SensorProfile.fit(tmp_path / "lost")
    with pytest.raises(gc.UsageError, match="train_fraction"):
        gc.SensorProfile.fit(folder, train_fraction=float("nan"))
