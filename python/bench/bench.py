"""Measures the Python package beside other programs.

    python python/bench/bench.py [--json] [--quick] [--program GRIPCAST]

render_tactile beside `taxim` (with jax), and batches of a dataset beside `datasets`, where these are
installed; `simulate_batch` with two threads beside one; `simulate` beside the same call of the program
(`--program`, built with the same profile), in pairs: its overhead is the median of their ratios. Each
other figure is the best of several runs; the hundred grasps of `simulate_batch` run once for each number of
threads, after one run that warms up.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import gripcast as gc

STOP_FORCE_N = 8.0


def times_s(work: Callable[[], object], runs: int) -> list[float]:
    """Times of several runs, after one that warms up."""
    work()
    times = []
    for _ in range(runs):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return times


def best_s(work: Callable[[], object], runs: int) -> float:
    """Time of the fastest of several runs, after one that warms up."""
    return min(times_s(work, runs))


def ball() -> gc.Object:
    return gc.Object(gc.Mesh.builtin("sphere"), mass_kg=0.06, friction=0.6)


def rendering(runs: int) -> dict[str, Any]:
    sensor = gc.SensorProfile("gelsight-mini")
    mesh = gc.Mesh.builtin("sphere", scale=0.2)
    times = times_s(lambda: gc.render_tactile(mesh, press_m=5e-4, profile=sensor), runs)
    found: dict[str, Any] = {
        "size_px": sensor.size_px,
        "render_tactile_ms": 1e3 * min(times),
        "render_tactile_median_ms": 1e3 * float(np.median(times)),
    }
    try:
        import jax  # pyright: ignore[reportMissingImports]
        from taxim import CALIB_GELSIGHT_MINI, Taxim  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        return {**found, "taxim": f"not installed: {error}"}
    taxim = Taxim(CALIB_GELSIGHT_MINI, backend="jax", device="cpu")
    height_mm = np.full((taxim.height, taxim.width), 5.0, dtype=np.float32)
    row, column = np.indices(height_mm.shape)
    distance = np.hypot(row - taxim.height / 2, column - taxim.width / 2) * 0.0295
    height_mm = np.where(distance < 5.0, 5.0 - np.sqrt(np.maximum(25.0 - distance**2, 0.0)), 5.0).astype(np.float32)
    for name, shadow in (("taxim_ms", False), ("taxim_with_shadow_ms", True)):

        def render(shadow: bool = shadow) -> object:
            return jax.block_until_ready(taxim.render(height_mm, with_shadow=shadow, press_depth=0.5))

        found[name] = 1e3 * best_s(render, runs)
    return {**found, "taxim_size_px": [taxim.width, taxim.height]}


def batch(count: int) -> dict[str, Any]:
    forces = np.linspace(STOP_FORCE_N, 20, count)
    cases = [gc.GraspCase(ball(), gel="coarse", stop_force_n=force) for force in forces]
    one, two = (best_s(lambda: gc.simulate_batch(cases, threads=threads), 1) for threads in (1, 2))
    return {"grasps": len(cases), "one_thread_s": one, "two_threads_s": two, "speed_up": one / two}


def overhead(program: str | None, runs: int) -> dict[str, Any]:
    settings: dict[str, Any] = {"gel": "coarse", "stop_force_n": STOP_FORCE_N}
    # The program's time is that of the simulation alone, so the gripper is placed before.
    case = gc.GraspCase(ball(), **settings)
    call_s = best_s(lambda: gc.simulate_batch([], threads=1), 5 * runs)
    if program is None:
        whole = best_s(lambda: gc.simulate_batch([case], threads=1), runs)
        return {"simulate_s": whole, "call_s": call_s, "program": "not measured: --program names it"}
    command = [
        program, "sim", "grasp", "--object", "builtin:sphere", "--mass-kg", "0.06", "--friction", "0.6",
        "--gel", "coarse", "--stop-force-n", str(STOP_FORCE_N), "--threads", "1", "--json", "--quiet",
    ]  # fmt: skip
    gc.simulate_batch([case], threads=1)

    def package_s() -> float:
        began = time.perf_counter()
        gc.simulate_batch([case], threads=1)
        return time.perf_counter() - began

    def program_s() -> float:
        answer = subprocess.run(command, capture_output=True, check=True).stdout
        return float(json.loads(answer)["wall_s"])

    # Pairs, so that both see the same machine; every second one the other way round.
    ours, theirs = [], []
    for turn in range(runs):
        for is_package in (turn % 2 == 0, turn % 2 == 1):
            if is_package:
                ours.append(package_s())
            else:
                theirs.append(program_s())
    low, middle, high = np.percentile(np.divide(ours, theirs) - 1, [25, 50, 75])
    return {
        "simulate_s": min(ours),
        "program_s": min(theirs),
        "overhead_fraction": float(middle),
        "overhead_fraction_quartiles": [float(low), float(high)],
        "overhead_fraction_of_best": min(ours) / min(theirs) - 1,
        "call_s": call_s,
    }


def loading(count: int, runs: int) -> dict[str, Any]:
    random = np.random.default_rng(0)
    # Smooth, as images of a gel are: noise does not compress.
    rows, columns, channels = np.indices((240, 320, 3))

    def image() -> Any:
        phase, x, y = random.uniform(0, 6, 3)
        wave = 110 + 40 * np.sin(phase + channels + columns / (20 + 10 * x)) * np.cos(rows / (20 + 10 * y))
        return (wave + random.normal(0, 1.5, wave.shape)).clip(0, 255).astype(np.uint8)

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "d"
        with gc.Dataset.create(path, label_definition="none", licence="CC0-1.0") as dataset:
            began = time.perf_counter()
            for _ in range(count):
                dataset.append_grasp(
                    object="cup",
                    initial={"left": image(), "right": image()},
                    grasp={"left": image(), "right": image()},
                    outcome="stable",
                )
            append_s = time.perf_counter() - began

        def read() -> int:
            total = 0
            for start in range(0, count, 32):
                total += dataset[start : start + 32].tactile_images("left").shape[0]
            return total

        found: dict[str, Any] = {
            "grasps": count,
            "append_grasp_ms": 1e3 * append_s / count,
            "samples_per_s": count / best_s(read, runs),
        }
        try:
            from datasets import load_dataset  # pyright: ignore[reportMissingImports]
        except ImportError as error:
            return {**found, "imagefolder": f"not installed: {error}"}
        folder_of_images = load_dataset("imagefolder", data_dir=str(path), split="train", cache_dir=folder + "/cache")
        images = folder_of_images.select_columns(["grasp_left"])

        def read_peer() -> int:
            batches = images.iter(batch_size=32)
            return sum(np.stack([np.asarray(image) for image in batch["grasp_left"]]).shape[0] for batch in batches)

        return {**found, "imagefolder_samples_per_s": count / best_s(read_peer, runs)}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--quick", action="store_true", help="few runs, for tests")
    parser.add_argument("--program", metavar="GRIPCAST", help="program to compare `simulate` with")
    arguments = parser.parse_args()
    runs = 1 if arguments.quick else 5
    report = {
        "version": gc.__version__,
        "rendering": rendering(runs if arguments.quick else 50),
        "simulate_batch": batch(4 if arguments.quick else 100),
        "overhead": overhead(arguments.program, runs if arguments.quick else 30),
        "loading": loading(8 if arguments.quick else 128, runs),
    }
    if arguments.json:
        print(json.dumps(report, indent=2))
        return
    for name, figures in report.items():
        if isinstance(figures, dict):
            print(name)
            for key, value in figures.items():
                print(f"  {key:<28} {value if not isinstance(value, float) else format(value, '.4g')}")


if __name__ == "__main__":
    main()
