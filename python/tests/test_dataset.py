from __future__ import annotations

import multiprocessing
import pickle
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gripcast as gc
import sample_dataset as sample
from conftest import Cli


@pytest.fixture(scope="module")
def kitchen(dataset_folder: Path) -> gc.Dataset:
    return gc.Dataset(dataset_folder)


@pytest.fixture
def copy(dataset_folder: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(dataset_folder, tmp_path / "copy"))


def test_grasps_are_in_the_order_of_their_ids(kitchen: gc.Dataset) -> None:
    ids = [name for name, _, _ in sample.GRASPS]
    assert len(kitchen) == 3 and kitchen.ids == ids and kitchen.name == "kitchen"
    assert [grasp.id for grasp in kitchen] == ids
    assert [grasp.object for grasp in kitchen[::-1]] == ["mug", "bottle", "mug"]
    assert kitchen[-1].id == ids[2] and kitchen[1:][0].id == ids[1]
    assert kitchen.grasp(ids[1]).outcome == "slip"
    for index in (3, -4):
        with pytest.raises(IndexError, match="3 grasps"):
            kitchen[index]
    with pytest.raises(TypeError):
        kitchen["mug"]  # type: ignore[call-overload]


def test_filter_keeps_objects_and_outcomes(kitchen: gc.Dataset) -> None:
    assert kitchen.filter(object="mug").ids == [kitchen.ids[0], kitchen.ids[2]]
    assert kitchen.filter(object="mug", outcome="stable").ids == [kitchen.ids[0]]
    assert len(kitchen.filter(object=["mug", "bottle"], outcome=["stable", "slip"])) == 2
    assert len(kitchen[1:].filter(outcome="stable")) == 0
    with pytest.raises(gc.UsageError, match="did you mean stable"):
        kitchen.filter(outcome="stabl")  # type: ignore[arg-type]


def test_record_is_read(kitchen: gc.Dataset) -> None:
    first, second = kitchen[0], kitchen[1]
    assert (second.object, second.scene, second.operator) == ("bottle", "table", "Ada")
    assert second.captured_at == "2026-11-20T10:16:01Z" and not second.is_simulated
    assert first.prediction is None and first.t_object_gripper is None
    assert second.prediction is not None and second.t_object_gripper is not None
    assert (second.prediction.p_stable, second.prediction.predicted) == (0.75, "stable")
    assert second.t_object_gripper.t_m == (0.01, 0.02, 0.03)
    assert second.record["initial"]["trigger"] == "script"
    assert second.roles() == ["left", "right", "rgb", "depth"] and "depth" not in second.roles("initial")
    assert repr(second) == f"<Grasp {second.id}: bottle, slip>"


def test_images_are_those_that_were_stored(kitchen: gc.Dataset) -> None:
    grasp = kitchen[1]
    np.testing.assert_array_equal(grasp.image("rgb"), sample.gel(3, 120))
    np.testing.assert_array_equal(grasp.image("left", "initial"), sample.gel(2, 0))
    depth = grasp.depth_m()
    assert depth.dtype == np.float32 and np.isnan(depth[0, 0])
    np.testing.assert_allclose(depth.ravel()[1:], sample.depth(3).ravel()[1:] * sample.DEPTH_UNIT_M, rtol=1e-6)
    tactile = grasp.tactile_image("left")
    assert tactile.shape == (240, 320, 3) and tactile.dtype == np.uint8
    difference = grasp.tactile_difference("left")
    initial = grasp.tactile_image("left", "initial")
    np.testing.assert_array_equal(difference, tactile.astype(np.int16) - initial)
    np.testing.assert_array_equal(grasp.markers("left"), sample.markers(3))
    assert grasp.markers("right") is None and grasp.fields("left") == ["markers"]


def test_batches_are_the_images_of_the_grasps(kitchen: gc.Dataset) -> None:
    for stage in ("initial", "grasp"):
        images = [grasp.tactile_image("right", stage) for grasp in kitchen]
        np.testing.assert_array_equal(kitchen.tactile_images("right", stage), np.stack(images))
    differences = [grasp.tactile_difference("left") for grasp in kitchen]
    batch = kitchen.tactile_differences("left")
    np.testing.assert_array_equal(batch, np.stack(differences))
    assert batch.dtype == np.int16
    assert kitchen[:0].tactile_images("left").shape == (0, 240, 320, 3)
    with pytest.raises(gc.UsageError, match="left"):
        kitchen.tactile_images("top")  # type: ignore[arg-type]


def test_missing_files_are_named(kitchen: gc.Dataset) -> None:
    grasp = kitchen[0]
    for call, error, words in [
        (lambda: grasp.image("external"), gc.NotFoundError, "external"),
        (lambda: grasp.image("depth"), gc.UsageError, "depth_m"),
        (lambda: grasp.image("lfet"), gc.UsageError, "left"),  # type: ignore[arg-type]
        (lambda: grasp.image("left", "lift"), gc.UsageError, "initial"),  # type: ignore[arg-type]
        (lambda: grasp.field("pressure", "left"), gc.NotFoundError, "pressure"),
        (lambda: kitchen.grasp("20261120T101500Z-000f"), gc.NotFoundError, "000f"),
        (lambda: kitchen.grasp("../kitchen"), gc.Error, "id"),
    ]:
        with pytest.raises(error) as caught:
            call()  # type: ignore[no-untyped-call]
        assert words in str(caught.value)


def test_no_dataset_is_explained(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "lost"):
        with pytest.raises(gc.NotFoundError, match="dataset"):
            gc.Dataset(path)


def test_moved_dataset_is_explained(copy: Path) -> None:
    dataset = gc.Dataset(copy)
    grasp = dataset[0]
    copy.rename(copy.with_name("elsewhere"))
    for call in (lambda: dataset[1], lambda: grasp.image("rgb"), dataset.verify, lambda: dataset.filter(object="mug")):
        with pytest.raises(gc.NotFoundError) as caught:
            call()
        assert "moved or deleted" in caught.value.what and caught.value.where == str(copy)


def test_damage_is_found(copy: Path, cli: Cli) -> None:
    dataset = gc.Dataset(copy)
    assert dataset.verify().problems == []
    image = copy / "grasps" / dataset.ids[0] / "grasp.rgb.png"
    image.write_bytes(image.read_bytes()[:100])
    report = dataset.verify()
    assert report.grasps == 3 and report.unlabelled == 1
    altered = next(problem for problem in report.problems if problem.kind == "altered")
    assert altered.grasp == dataset.ids[0] and "rgb" in str(altered.file) and altered.remedy
    with pytest.raises(gc.InputError):
        dataset[0].image("rgb")
    (copy / "grasps" / dataset.ids[1] / "grasp.json").write_text("{")
    with pytest.raises(gc.InputError) as caught:
        dataset.filter(object="mug")
    assert dataset.ids[1] in str(caught.value)


def test_relative_path_survives_a_change_of_folder(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(copy.parent)
    dataset = gc.Dataset("copy")
    monkeypatch.chdir("/")
    assert dataset[0].object == "mug"


def batch(grasps: list[gc.Grasp]) -> tuple[np.ndarray[Any, Any], list[bool]]:
    """What a `collate_fn` of a torch DataLoader does."""
    images = np.stack([grasp.tactile_difference("left") for grasp in grasps])
    return images, [grasp.outcome == "stable" for grasp in grasps]


def load(dataset: gc.Dataset, indices: list[int]) -> tuple[np.ndarray[Any, Any], list[bool]]:
    return batch([dataset[index] for index in indices])


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_workers_read_what_the_parent_reads(kitchen: gc.Dataset, method: str) -> None:
    # Threads of the parent, which a forked child does not have.
    assert kitchen.verify().problems == []
    view = kitchen[:2]
    with multiprocessing.get_context(method).Pool(1) as workers:
        images, labels = workers.apply(load, (view, [1, 0]))
        problems = workers.apply(problem_count, (kitchen,))
        with pytest.raises(IndexError):
            workers.apply(load, (view, [2]))
        with pytest.raises(gc.NotFoundError) as caught:
            workers.apply(gc.Dataset, ("/no/such/dataset",))
    assert caught.value.what and problems == 0
    np.testing.assert_array_equal(images, load(view, [1, 0])[0])
    assert labels == [False, True]


def problem_count(dataset: gc.Dataset) -> int:
    return len(dataset.verify().problems)


def test_datasets_and_grasps_pickle_by_path(kitchen: gc.Dataset) -> None:
    view = pickle.loads(pickle.dumps(kitchen.filter(object="mug")))
    assert view.ids == [kitchen.ids[0], kitchen.ids[2]]
    assert len(pickle.dumps(kitchen)) < 2000
    assert pickle.loads(pickle.dumps(kitchen[1])).object == "bottle"
