"""Rendering, prediction and tracking, against the files of the program."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gripcast as gc
from conftest import Cli, load_png, save_png

Image = np.ndarray[Any, Any]


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("moment", ["initial", "grasp"])
def test_image_is_that_of_the_program(
    result: gc.GraspResult, trace: Path, cli: Cli, tmp_path: Path, side: Any, moment: Any
) -> None:
    out = tmp_path / "image.png"
    cli(
        "render", "tactile", "--trace", trace, "--side", side, "--moment", moment, "--seed", 7, "--depth",
        "--out", out, "--quiet",
    )  # fmt: skip
    ours = gc.render_tactile(result, side=side, moment=moment, seed=7)
    np.testing.assert_array_equal(ours.image, load_png(out))
    depth_um = np.round(1e6 * ours.depth_m.astype(float)).astype(np.uint16)
    np.testing.assert_array_equal(depth_um, load_png(tmp_path / "image.depth.png"))
    assert (ours.contact_fraction > 0.0) == (moment == "grasp")


def test_kept_profile_renders_the_same_again(result: gc.GraspResult) -> None:
    profile = gc.SensorProfile("gelsight-mini")
    first, other, again = (gc.render_tactile(result, side=s, profile=profile) for s in ("left", "right", "left"))
    np.testing.assert_array_equal(first.image, again.image)
    assert (first.image != other.image).any()
    quiet = gc.render_tactile(result, profile=profile, seed=None)
    assert (quiet.image != first.image).any()


def test_press_of_a_mesh_is_that_of_the_program(cli: Cli, tmp_path: Path) -> None:
    out, pose = tmp_path / "press.png", tmp_path / "pose.json"
    pose.write_text(json.dumps({"t_sensor_object": {"t_m": [0.001, 0.0, 0.0], "q_wxyz": [0.6, 0.8, 0.0, 0.0]}}))
    cli("render", "tactile", "--object", "builtin:ball", "--pose", pose, "--press-m", 4e-4, "--profile",
        "gelsight-mini-markers", "--markers", "image,field", "--side", "left", "--out", out, "--quiet")  # fmt: skip
    at = gc.Pose((0.001, 0.0, 0.0), (0.6, 0.8, 0.0, 0.0))
    ours = gc.render_tactile(
        gc.Mesh.builtin("ball"), at, press_m=4e-4, profile="gelsight-mini-markers", markers=True
    )
    np.testing.assert_array_equal(ours.image, load_png(out))
    assert ours.markers is not None
    np.testing.assert_array_equal(ours.markers, np.load(tmp_path / "press.markers.npy"))
    assert ours.deepest_m == pytest.approx(4e-4, rel=1e-3)


def test_wrong_rendering_is_explained(result: gc.GraspResult, sphere: gc.Object) -> None:
    mesh = sphere.mesh
    for call, error, words in [
        (lambda: gc.render_tactile(result, markers=True), gc.ConfigError, "gel markers"),
        (lambda: gc.render_tactile(result, press_m=1e-3), gc.UsageError, "press_m"),
        (lambda: gc.render_tactile(mesh, moment="grasp"), gc.UsageError, "moment"),
        (lambda: gc.render_tactile(mesh, np.full((4, 4), np.nan)), gc.InputError, "t_sensor_object"),
        (lambda: gc.render_tactile(mesh, press_m=-1.0), gc.InputError, "depth"),
        (lambda: gc.render_tactile(result, side="top"), gc.UsageError, "right"),  # type: ignore[arg-type]
        (lambda: gc.render_tactile(result, mounting_deg=45), gc.InputError, "45"),
        (lambda: gc.render_tactile(result, profile="digit"), gc.InputError, "gel of"),
        (lambda: gc.render_tactile("mug"), gc.UsageError, "GraspResult"),  # type: ignore[arg-type]
        (lambda: gc.render_tactile(gc.simulate(sphere, engine="rigid")), gc.InputError, "rigid"),
    ]:
        with pytest.raises(error) as caught:
            call()  # type: ignore[no-untyped-call]
        assert words in str(caught.value)


@pytest.fixture(scope="module")
def touch(result: gc.GraspResult) -> tuple[tuple[Image, Image], tuple[Image, Image]]:
    def both(moment: Any) -> tuple[Image, Image]:
        left, right = (gc.render_tactile(result, side=side, moment=moment).image for side in ("left", "right"))
        return left, right

    return both("initial"), both("grasp")


def colour() -> Image:
    rows, columns, channels = np.indices((240, 320, 3))
    return np.asarray((rows + 2 * columns + 60 * channels) % 256, dtype=np.uint8)


@pytest.mark.parametrize("model", ["gripcast-vt", "baseline-contact"])
def test_prediction_is_that_of_the_program(touch: Any, cli: Cli, tmp_path: Path, model: str) -> None:
    initial, grasp = touch
    flags: list[object] = ["--rgb", save_png(tmp_path / "rgb.png", colour())]
    for stage, images in (("initial", initial), ("grasp", grasp)):
        for side, image in zip(("left", "right"), images, strict=True):
            flags += [f"--{stage}-{side}", save_png(tmp_path / f"{stage}-{side}.png", image)]
    theirs = cli("predict", "images", *flags, "--already-cropped", "--model", model, "--json", "--quiet")
    predictor = gc.Predictor(model)
    ours = predictor.predict(initial, grasp, colour())
    for key in ("p_stable", "ood_score", "threshold", "predicted", "unsure_reason", "model", "model_sha256"):
        assert getattr(ours, key) == theirs[key], key
    assert predictor.is_heuristic == (model == "baseline-contact")
    again = pickle.loads(pickle.dumps(predictor)).predict(initial, grasp, colour())
    assert again.p_stable == ours.p_stable


def test_lift_is_judged_image_by_image(touch: Any) -> None:
    initial, grasp = touch
    predictor = gc.Predictor()
    assert predictor.predict(initial, grasp).lift is None
    assert predictor.predict(initial, grasp, lift=[]).lift == []
    lift = [grasp, grasp, initial, initial]
    found = predictor.predict(initial, grasp, lift=lift, profile="gelsight-mini").lift
    assert found is not None and len(found) == 4
    held, lost = found[0], found[3]
    assert not held.is_slipping and lost.is_slipping and not lost.is_stable
    assert lost.p_stable < held.p_stable <= 1.0
    # A plate between the fingers, 9 mm above the table, that falls behind.
    depth = np.full((240, 320), 200, dtype=np.uint16)
    depth[60:180, 130:190] = 180
    depths = [depth, depth, depth + 4, depth + 8]
    moved = predictor.predict(initial, grasp, depth=depth, lift=[grasp] * 4, lift_depth=depths).lift
    assert moved is not None and len(moved) == 4
    assert moved[3].p_stable < moved[0].p_stable
    for missing in ({}, {"depth": depth, "lift_depth": depths[1:]}):
        with pytest.raises((gc.UsageError, gc.InputError), match="depth"):
            predictor.predict(initial, grasp, lift=[grasp] * 4, **{"lift_depth": depths, **missing})  # type: ignore[arg-type]
    large = np.repeat(np.repeat(grasp[0], 2, axis=0), 2, axis=1)
    with pytest.raises(gc.InputError, match=r"`lift\[1\]\[0\]` must be cropped"):
        predictor.predict(initial, grasp, lift=[grasp, (large, large)])
    with pytest.raises(gc.InputError, match=r"`lift\[0\]` must be the images \(left, right\) of both gels; found uint8"):
        predictor.predict(initial, grasp, lift=[grasp[0]])
    with pytest.raises(gc.UsageError, match="`initial`"):
        predictor.predict(rgb=colour(), lift=[grasp])
    with pytest.raises(gc.InputError, match="no verdict in the lift") as caught:
        gc.Predictor("baseline-contact").predict(initial, grasp, lift=[grasp])
    assert "gripcast-vt" in str(caught.value.remedy)


def test_frames_of_a_camera_need_a_crop(touch: Any) -> None:
    predictor = gc.Predictor("baseline-contact")
    large = np.zeros((480, 640, 3), np.uint8)
    with pytest.raises(gc.InputError) as caught:
        predictor.predict((large, large), (large, large))
    assert "found 640×480" in caught.value.what and "crop" in str(caught.value.remedy)
    assert predictor.crop_profile == "any"
    assert predictor.predict((large, large), (large, large), crop="gsmini-seventh-v1").predicted in ("slip", "unsure")
    with pytest.raises(gc.Error, match="unknown crop profile"):
        predictor.predict(*touch, crop="gsmini")


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (np.zeros((240, 320, 3)), "uint8 of shape (height, width, 3), RGB; found float64"),
        (np.zeros((240, 320), np.uint8), "of shape [240, 320]"),
        (np.zeros((240, 320, 4), np.uint8), "of shape [240, 320, 4]"),
        (np.zeros((0, 320, 3), np.uint8), "found 320×0"),
        ([[1, 2], [3, 4]], "found list"),
        (None, "found NoneType"),
    ],
)
def test_wrong_images_are_explained(touch: Any, image: Any, words: str) -> None:
    initial, grasp = touch
    with pytest.raises(gc.InputError) as caught:
        gc.Predictor("baseline-contact").predict(initial, (grasp[0], image))
    assert "`grasp[1]`" in str(caught.value) and words in str(caught.value)


def test_images_of_any_layout_are_read(touch: Any) -> None:
    initial, grasp = touch
    predictor = gc.Predictor("baseline-contact")
    plain = predictor.predict(initial, grasp).p_stable
    fortran = tuple(np.asfortranarray(image) for image in initial)
    doubled = tuple(np.repeat(image, 2, axis=1)[:, ::2] for image in grasp)
    assert not doubled[0].flags.contiguous
    assert predictor.predict(fortran, doubled).p_stable == plain


def test_missing_images_are_named(touch: Any) -> None:
    initial, grasp = touch
    # The built-in classifier also predicts from touch alone.
    assert gc.Predictor().predict(initial, grasp).inputs == "T"
    with pytest.raises(gc.UsageError, match="cannot predict"):
        gc.Predictor().predict()
    with pytest.raises(gc.UsageError, match="initial"):
        gc.Predictor("baseline-contact").predict(None, grasp)
    with pytest.raises(gc.NotFoundError, match="gripcast-vt"):
        gc.Predictor("no-such-model.onnx")


def test_markers_are_tracked_as_by_the_program(result: gc.GraspResult, cli: Cli, tmp_path: Path) -> None:
    moments: list[Any] = ["initial", "closure", "grasp", "lift"]
    profile = gc.SensorProfile("gelsight-mini-markers")
    rendered = [gc.render_tactile(result, moment=moment, profile=profile, markers=True) for moment in moments]
    frames = [one.image for one in rendered]
    folder = tmp_path / "frames"
    folder.mkdir()
    for index, frame in enumerate(frames):
        save_png(folder / f"{index}.png", frame)
    out = tmp_path / "track.npy"
    theirs = cli("tactile", "track", folder, "--initial", 0, "--profile", profile.name, "--out", out, "--json",
                 "--quiet")  # fmt: skip
    ours = gc.track_markers(frames, profile=profile)
    assert ours.source == theirs["source"] == "markers" and ours.m_per_px == profile.m_per_px
    assert ours.markers is not None and ours.max_displacement_mm is not None
    assert ours.markers.shape == (4, theirs["rows"], theirs["columns"], 5)
    assert ours.max_displacement_mm.max() == theirs["max_displacement_mm"]
    table = np.load(out)
    np.testing.assert_array_equal(ours.markers[..., 2:4], table[..., :2] if table.shape[-1] < 5 else table[..., 2:4])
    # The contact is above noise only once the gripper is closed.
    assert ours.contact_fraction[0] == 0.0 and ours.contact_fraction[2] > 0.01
    stacked = gc.track_markers(np.stack(frames), profile=profile)
    np.testing.assert_array_equal(stacked.max_displacement_mm, ours.max_displacement_mm)


def test_frames_before_the_initial_one_have_no_slip_ratio(result: gc.GraspResult) -> None:
    profile = gc.SensorProfile("gelsight-mini-markers")
    moments: list[Any] = ["grasp", "closure", "initial"]
    frames = [gc.render_tactile(result, moment=moment, profile=profile).image for moment in moments]
    track = gc.track_markers(frames, initial=2)
    assert np.isnan(track.slip_ratio[:2]).all() and track.contact_fraction[0] > 0.01
    assert track.max_displacement_mm is None and track.m_per_px is None


def test_wrong_frames_are_explained() -> None:
    frame = np.zeros((240, 320, 3), np.uint8)
    for call, error, words in [
        (lambda: gc.track_markers([]), gc.UsageError, "0 frames"),
        (lambda: gc.track_markers([frame], initial=1), gc.UsageError, "initial"),
        (lambda: gc.track_markers([frame, frame.astype(float)]), gc.InputError, "frames[1]"),
        (lambda: gc.track_markers([frame], m_per_px=0.0), gc.UsageError, "m_per_px"),
        (lambda: gc.track_markers([frame], m_per_px=3e-5, profile="digit"), gc.UsageError, "contradicts"),
    ]:
        with pytest.raises(error) as caught:
            call()  # type: ignore[no-untyped-call]
        assert words in str(caught.value)


def test_shipped_profiles_have_names(tmp_path: Path) -> None:
    assert "digit" in gc.SensorProfile.SHIPPED
    mini = gc.SensorProfile()
    assert mini.name == "gelsight-mini" and mini.size_px == (320, 240) and not mini.has_markers
    with pytest.raises(gc.NotFoundError):
        gc.SensorProfile(tmp_path / "lost.toml")
