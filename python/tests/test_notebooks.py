"""Executes the notebooks in order, in one folder: the third one reads what the first one collects."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient

import gripcast as gc
from conftest import ROOT

NOTEBOOKS = sorted((ROOT / "python/notebooks").glob("*.ipynb"))
LIMIT_S = 150


def code_cells(notebook: Any) -> list[Any]:
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def printed(notebook: Any) -> str:
    """What the cells print and the text of their values."""
    outputs = [output for cell in code_cells(notebook) for output in cell.outputs]
    return "".join(output.get("text") or output.get("data", {}).get("text/plain", "") for output in outputs)


def figures(notebook: Any) -> int:
    outputs = [output for cell in code_cells(notebook) for output in cell.outputs]
    return sum("image/png" in output.get("data", {}) for output in outputs)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("notebooks")


@pytest.fixture(scope="module")
def executed(folder: Path) -> dict[str, Any]:
    """The notebooks after their execution, by the first character of their names."""
    programs = folder / "bin"
    programs.mkdir()
    (programs / "gripcast").symlink_to(Path(os.environ["GRIPCAST_BIN"]).resolve())
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PATH", f"{programs}{os.pathsep}{os.environ['PATH']}")
        patch.setenv("MPLBACKEND", "module://matplotlib_inline.backend_inline")
        patch.setenv("IPYTHONDIR", str(folder / "ipython"))
        patch.setenv("GRIPCAST__GUARDS__MIN_FREE_BYTES", "0")
        found = {}
        for path in NOTEBOOKS:
            notebook = nbformat.read(path, as_version=4)  # type: ignore[no-untyped-call]
            place = {"metadata": {"path": os.fspath(folder)}}
            NotebookClient(notebook, timeout=LIMIT_S, kernel_name="python3", resources=place).execute()
            found[path.name[0]] = notebook
    return found


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_stored_without_outputs(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)  # type: ignore[no-untyped-call]
    nbformat.validate(notebook)
    assert all(not cell.outputs and cell.execution_count is None for cell in code_cells(notebook))


def test_collecting_writes_ten_labelled_grasps(executed: dict[str, Any], folder: Path) -> None:
    kitchen = gc.Dataset(folder / "kitchen")
    truths = [grasp.record["truth"] for grasp in kitchen]
    assert len(kitchen) == 10 and {grasp.outcome for grasp in kitchen} == {"stable", "slip"}
    assert [grasp.outcome == "stable" for grasp in kitchen] == [truth["stable"] for truth in truths]
    assert [f"builtin:{grasp.object}" for grasp in kitchen] == [truth["object"] for truth in truths]
    assert "problems: []" in printed(executed["1"])
    assert "(4, 6, 240, 320)" in printed(executed["1"]) and figures(executed["1"]) == 2


def test_simulated_grasp_holds_and_its_markers_are_tracked(executed: dict[str, Any]) -> None:
    text = printed(executed["2"])
    assert "GraspResult success" in text and "slip, lifted" in text
    assert text.count("tracked 100 %") == 4 and figures(executed["2"]) == 3


def test_evaluation_agrees_with_the_program(executed: dict[str, Any], folder: Path) -> None:
    text = printed(executed["3"])
    assert "10 labelled grasps of 5 objects" in text
    # The daemon predicted from the same images.
    assert "largest difference: 0.0e+00" in text
    # Three grasps cannot show that a model is better.
    assert "an improvement over `gripcast-vt` is not shown" in text or "keep `gripcast-vt`" in text
    report = json.loads((folder / "eval/eval.json").read_text())
    rows = []
    for model in (model for model in report["models"] if model["modality"] == "VTD"):
        summary = model["summary"]
        confusion = summary["confusion"]
        correct = confusion["true_stable"] + confusion["true_slip"]
        # pandas prints as many digits as a column needs.
        accuracy = f"{summary['accuracy']:.3f}".rstrip("0")
        rows.append(rf" +{summary['n']} +{correct} +{re.escape(accuracy)}0*")
    assert re.search(rf"^test +gripcast-vt{rows[0]}\n +tuned{rows[1]}$", text, re.M), text
