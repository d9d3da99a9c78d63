"""Runs the Python blocks of the how-to guide and the examples, and checks the reference page."""

from __future__ import annotations

import os
import re
import runpy
import shutil
import sys
from pathlib import Path

import gripcast
import gripcast.gym
import pytest

import api_reference
from conftest import ROOT

PAGE = ROOT / "docs/how-to/python.md"
# Arguments of the examples that need or take some.
ARGUMENTS = {
    "touch_batches": ["kitchen"],
    "learn_regrasp": ["--generations", "1", "--population", "2", "--episodes", "1", "--max-grasps", "1"],
}
BLOCK = re.compile(r"^(<!-- not run: [^\n]* -->\n)?```python\n(.*?)^```", re.M | re.S)


def test_reference_has_every_public_name() -> None:
    public = {*gripcast.__all__, *gripcast.gym.__all__} - {"__version__"}
    assert api_reference.listed() == public


def test_reference_page_is_that_of_the_package() -> None:
    page = api_reference.page()
    assert "|  |\n" not in page, "a member has no docstring"
    stored = (ROOT / "docs/reference/python-api.md").read_text()
    assert stored == page, "run python/tests/api_reference.py > docs/reference/python-api.md"


@pytest.fixture
def folder(dataset_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copytree(dataset_folder, tmp_path / "kitchen")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_quick_start_runs_as_it_stands(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    blocks = [text for skipped, text in BLOCK.findall(PAGE.read_text()) if not skipped]
    assert blocks
    names = {"__name__": "__main__"}
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), names)
    printed = capsys.readouterr().out
    assert printed.startswith("success ") and "(240, 320, 3)" in printed
    assert printed.count("stable (240, 320, 3)") == 1


def test_readme_runs_as_it_stands(capsys: pytest.CaptureFixture[str]) -> None:
    [(skipped, block)] = BLOCK.findall((ROOT / "README.md").read_text())
    assert not skipped
    exec(compile(block, "README.md", "exec"), {"__name__": "__main__"})
    printed = capsys.readouterr().out
    assert "<GraspResult success" in printed and "<Prediction stable" in printed


def test_examples_run(folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    for example in sorted((ROOT / "python/examples").glob("*.py")):
        monkeypatch.setattr(sys, "argv", [os.fspath(example), *ARGUMENTS.get(example.stem, [])])
        runpy.run_path(os.fspath(example), run_name="__main__")
    printed = capsys.readouterr().out
    assert "generation 1" in printed and "% hold" in printed
    assert "(2, 6, 240, 320): 1 of 2 stable" in printed
    assert " 20.0 N: success" in printed
