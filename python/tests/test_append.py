"""Writing datasets: what is acknowledged survives, and the program reads it."""

from __future__ import annotations

import datetime
import multiprocessing
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest

import gripcast as gc
from conftest import Cli

SIDES = ("left", "right")


def images(number: int, size: int = 24) -> dict[str, np.ndarray[Any, Any]]:
    random = np.random.default_rng(number)
    return {side: random.integers(0, 256, (size, size + 8, 3), dtype=np.uint8) for side in SIDES}


def create(path: Path) -> gc.Dataset:
    return gc.Dataset.create(path, label_definition="stable = still held after the lift", licence="CC0-1.0")


def append(dataset: gc.Dataset, number: int, **more: Any) -> gc.Grasp:
    given: dict[str, Any] = {
        "object": f"cup-{number % 4}",
        "initial": images(2 * number),
        "grasp": images(2 * number + 1),
        "outcome": ("stable", "slip")[number % 2],
    }
    return dataset.append_grasp(**{**given, **more})


def test_appended_grasp_is_read_back(tmp_path: Path, cli: Cli) -> None:
    depth = np.arange(48, dtype=np.uint16).reshape(6, 8)
    markers = np.full((2, 3, 5), 0.5, dtype=np.float32)
    markers[1, 2] = np.nan
    pose = gc.Pose((0.01, 0.02, 0.03))
    with create(tmp_path / "cups") as dataset:
        grasp = append(
            dataset,
            1,
            grasp={**images(3), "rgb": images(9)["left"][::-1], "depth": depth},
            scene="table",
            operator="Ada",
            note="by a robot",
            t_object_gripper=pose,
            markers={"left": markers},
            m_per_px=3e-5,
            depth_unit_m=0.002,
            captured_at=datetime.datetime(2026, 11, 20, 10, 15, 3, tzinfo=datetime.timezone.utc),
        )
        assert len(dataset) == 1 and dataset[0].id == grasp.id == "2026-11-20T10-15-03Z-0000"
    again = gc.Dataset(tmp_path / "cups")
    assert again.name == "cups" and again.ids == [grasp.id]
    read = again[0]
    assert (read.object, read.outcome, read.scene, read.operator) == ("cup-1", "slip", "table", "Ada")
    assert read.record["note"] == "by a robot" and read.record["labelled_at"] == read.captured_at
    assert read.t_object_gripper == pose and not read.is_simulated
    for stage, number in (("initial", 2), ("grasp", 3)):
        for side in SIDES:
            np.testing.assert_array_equal(read.image(side, stage), images(number)[side])  # type: ignore[arg-type]
    np.testing.assert_array_equal(read.image("rgb"), images(9)["left"][::-1])
    np.testing.assert_allclose(read.depth_m().ravel()[1:], depth.ravel()[1:] * 0.002, rtol=1e-6)
    np.testing.assert_array_equal(read.markers("left"), markers)
    report = again.verify()
    assert report.grasps == 1 and report.problems == [] and report.pending == 0
    listed = cli("dataset", "verify", tmp_path / "cups", "--json")
    assert listed["problems"] == [] and listed["grasps"] == 1


def test_ids_stay_in_the_order_of_time(tmp_path: Path) -> None:
    with create(tmp_path / "d") as dataset:
        for number, second in enumerate((3, 1, 2, 2)):
            append(dataset, number, captured_at=f"2026-11-20T10:00:0{second}Z")
        assert dataset.ids == sorted(dataset.ids) and len(set(dataset.ids)) == 4
        assert dataset.ids == gc.Dataset(tmp_path / "d").ids
        assert [grasp.object for grasp in dataset] == ["cup-1", "cup-2", "cup-3", "cup-0"]


def test_second_writer_is_refused_until_the_first_closes(tmp_path: Path) -> None:
    first = create(tmp_path / "d")
    second = gc.Dataset(tmp_path / "d")
    append(first, 0)
    with pytest.raises(gc.BusyError, match=str(os.getpid())):
        append(second, 1)
    first.close()
    append(second, 1)
    assert len(gc.Dataset(tmp_path / "d")) == 2
    second.close()
    # A closed dataset opens again.
    append(first, 2)
    first.close()


def test_selection_cannot_be_appended_to(tmp_path: Path) -> None:
    with create(tmp_path / "d") as dataset:
        append(dataset, 0)
        for selection in (dataset[:], dataset.filter(object="cup-0")):
            with pytest.raises(gc.UsageError, match="selection"):
                append(selection, 1)


def test_invalid_grasps_change_nothing(tmp_path: Path) -> None:
    with create(tmp_path / "d") as dataset:
        wrong: list[tuple[dict[str, Any], type[gc.Error]]] = [
            ({"outcome": "fell"}, gc.UsageError),
            ({"object": ""}, gc.Error),
            ({"object": "a/b"}, gc.Error),
            ({"initial": {}}, gc.UsageError),
            ({"initial": {"lfet": images(0)["left"]}}, gc.UsageError),
            ({"initial": {"depth": np.zeros((4, 4), np.uint16)}}, gc.UsageError),
            ({"grasp": {"left": images(0)["left"].astype(np.float32)}}, gc.InputError),
            ({"grasp": {"left": images(0)["left"][..., 0]}}, gc.InputError),
            ({"grasp": {"depth": np.zeros((4, 4), np.float32)}}, gc.InputError),
            ({"depth_unit_m": 0.0}, gc.UsageError),
            ({"crop_profile": "none"}, gc.ConfigError),
            ({"captured_at": "yesterday"}, gc.UsageError),
            ({"captured_at": datetime.datetime(2026, 11, 20)}, gc.UsageError),
            ({"markers": {"left": np.zeros((2, 3, 5))}}, gc.UsageError),
            ({"markers": {"left": np.zeros((2, 3, 4))}, "m_per_px": 1e-5}, gc.InputError),
            ({"markers": {"left": np.full((2, 3, 5), np.inf)}, "m_per_px": 1e-5}, gc.InputError),
        ]
        for more, error in wrong:
            with pytest.raises(error):
                append(dataset, 0, **more)
        with pytest.raises(TypeError):
            append(dataset, 0, grasp=[images(0)])
        assert len(dataset) == 0
    assert gc.Dataset(tmp_path / "d").verify().pending == 0


def test_existing_dataset_is_not_created_again(tmp_path: Path) -> None:
    create(tmp_path / "d").close()
    with pytest.raises(gc.UsageError, match="already"):
        create(tmp_path / "d")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").touch()
    with pytest.raises(gc.InputError):
        create(tmp_path / "other")
    with pytest.raises(gc.UsageError, match="licence"):
        gc.Dataset.create(tmp_path / "new", label_definition="x", licence=" ")
    assert not (tmp_path / "new").exists()


def test_parts_of_a_split_share_no_object(tmp_path: Path) -> None:
    with create(tmp_path / "d") as dataset:
        for number in range(12):
            append(dataset, number)
        parts = dataset.make_split("by-object", {"train": 0.5, "val": 0.25, "held-out": 0.25}, seed=3)
        assert dataset.splits == ["by-object"]
        again = dataset.split("by-object")
    assert {name: part.ids for name, part in parts.items()} == {name: part.ids for name, part in again.items()}
    objects = {name: {grasp.object for grasp in part} for name, part in parts.items()}
    assert sum(map(len, objects.values())) == 4 == len(set().union(*objects.values()))
    assert sorted(id for part in parts.values() for id in part.ids) == dataset.ids
    with pytest.raises(gc.Error, match="lost"):
        dataset.split("lost")
    with pytest.raises(gc.UsageError):
        dataset.make_split("b", {"train": 0.5})
    with pytest.raises(gc.UsageError, match="scene"):
        dataset.make_split("b", {"train": 1.0}, by="scnee")  # type: ignore[arg-type]


def test_table_is_that_of_the_index(tmp_path: Path) -> None:
    with create(tmp_path / "d") as dataset:
        for number in range(3):
            append(dataset, number, object=f"00{number}")
        table = dataset.to_pandas()
        part = dataset[1:].to_pandas()
    index = pandas.read_json(tmp_path / "d" / "metadata.jsonl", lines=True, dtype={"object": str})
    assert list(table.columns) == list(index.columns) and list(table["id"]) == dataset.ids
    assert list(table["object"]) == ["000", "001", "002"] and list(part["outcome"]) == ["slip", "stable"]
    assert (tmp_path / "d" / table["grasp_left_file_name"][0]).is_file()


# A file larger than the limit kills the process in the middle of its write.
KILLED = """
import os, resource, signal, sys
from pathlib import Path
import test_append
dataset = test_append.create(Path(sys.argv[1]))
for number in range(3):
    print(test_append.append(dataset, number).id, flush=True)
dataset.close()
limit = int(sys.argv[2])
if limit == 0:
    print(test_append.append(dataset, 3).id, flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
small = test_append.images(50, 2)
big = test_append.images(51, 64)
where = sys.argv[3]
test_append.append(
    dataset, 3,
    initial=big if where == "initial" else small,
    grasp=big if where == "grasp" else small,
    note="x" * 9000 if where == "record" else "",
)
print("survived", flush=True)
"""


@pytest.mark.parametrize(
    ("where", "limit", "leftovers"),
    [("after", 0, 0), ("initial", 6000, 0), ("grasp", 6000, 1), ("record", 6000, 1)],
)
def test_killed_writer_loses_nothing_acknowledged(tmp_path: Path, where: str, limit: int, leftovers: int) -> None:
    folder = tmp_path / "d"
    run = subprocess.run(
        [sys.executable, "-c", KILLED, str(folder), str(limit), where],
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
    )
    killed = signal.SIGKILL if where == "after" else signal.SIGXFSZ
    assert run.returncode == -killed, run.stderr
    acknowledged = run.stdout.split()
    assert len(acknowledged) == (4 if where == "after" else 3) and "survived" not in acknowledged
    dataset = gc.Dataset(folder)
    assert dataset.ids == acknowledged
    for number, grasp in enumerate(dataset):
        np.testing.assert_array_equal(grasp.image("left"), images(2 * number + 1)["left"])
    assert dataset.verify().pending == leftovers
    # The dead process holds no lock, and its leftovers are no problem.
    with dataset:
        append(dataset, 4)
    report = gc.Dataset(folder).verify()
    assert report.grasps == len(acknowledged) + 1 and report.problems == []


def count_of(dataset: gc.Dataset) -> int:
    return len(list(dataset))


def test_forked_worker_neither_writes_nor_unlocks(tmp_path: Path) -> None:
    with create(tmp_path / "d") as dataset:
        append(dataset, 0)
        with multiprocessing.get_context("fork").Pool(1) as workers:
            assert workers.apply(count_of, (dataset,)) == 1
        append(dataset, 1)
        with pytest.raises(gc.BusyError):
            append(gc.Dataset(tmp_path / "d"), 2)
