"""What the tests share."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import gripcast as gc
from sample_dataset import write_dataset

ROOT = Path(__file__).resolve().parents[2]
STOP_FORCE_N = 12.0

Cli = Callable[..., Any]


@pytest.fixture(scope="session")
def cli() -> Cli:
    """Runs the program and returns what it prints as JSON, if it prints any."""
    program = os.environ.get("GRIPCAST_BIN")
    if program is None:
        pytest.fail("GRIPCAST_BIN must name the program: `make python` builds it")

    def run(*arguments: object) -> Any:
        command = [program, *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == 0, f"{command}: {done.stderr}"
        return json.loads(done.stdout) if "--json" in command else None

    return run


@pytest.fixture(scope="session")
def sphere() -> gc.Object:
    return gc.Object(gc.Mesh.builtin("sphere"), mass_kg=0.06, friction=0.6)


@pytest.fixture(scope="session")
def result(sphere: gc.Object) -> gc.GraspResult:
    return gc.simulate(sphere, gel="coarse", stop_force_n=STOP_FORCE_N, fields="stages")


@pytest.fixture(scope="session")
def trace(cli: Cli, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The trace of the same grasp by the program, binary; `.json` beside it."""
    folder = tmp_path_factory.mktemp("trace")
    for name in ("sphere.bin", "sphere.json"):
        cli(
            "sim", "grasp", "--object", "builtin:sphere", "--mass-kg", 0.06, "--friction", 0.6,
            "--gel", "coarse", "--stop-force-n", STOP_FORCE_N, "--trace", folder / name, "--quiet",
        )  # fmt: skip
    return folder / "sphere.bin"


@pytest.fixture(scope="session")
def dataset_folder(cli: Cli, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data") / "kitchen"
    write_dataset(folder)
    cli("dataset", "reindex", folder, "--json")
    return folder


def save_png(path: Path, image: np.ndarray[Any, Any]) -> Path:
    Image.fromarray(image).save(path)
    return path


def load_png(path: Path) -> np.ndarray[Any, Any]:
    return np.asarray(Image.open(path))
