"""Reads batches of tactile differences and labels from a dataset, as for training.

    python python/examples/touch_batches.py DATASET

With torch installed, `torch.from_numpy` makes tensors of the batches, and
`torch.utils.data.DataLoader(dataset, batch_size=32, num_workers=2, collate_fn=collate)` reads grasps
in several processes.
"""

import sys
from collections.abc import Iterator
from typing import Literal

import numpy as np
import numpy.typing as npt

import gripcast as gc

SIDES: tuple[Literal["left"], Literal["right"]] = ("left", "right")
Batch = tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]


def scaled(left: npt.NDArray[np.int16], right: npt.NDArray[np.int16], outcomes: list[str]) -> Batch:
    """Differences of both gels, batch × 6 × 240 × 320, from -1 to 1; 1 for a stable grasp."""
    touch = np.concatenate([left, right], axis=3).transpose(0, 3, 1, 2) / np.float32(255)
    return touch.astype(np.float32), np.array([outcome == "stable" for outcome in outcomes], dtype=np.float32)


def batches(dataset: gc.Dataset, size: int) -> Iterator[Batch]:
    for start in range(0, len(dataset), size):
        part = dataset[start : start + size]
        left, right = part.tactile_differences("left"), part.tactile_differences("right")
        yield scaled(left, right, [grasp.outcome for grasp in part])


def collate(grasps: list[gc.Grasp]) -> Batch:
    """A batch of the grasps that a `DataLoader` reads one by one."""
    left, right = (np.stack([grasp.tactile_difference(side) for grasp in grasps]) for side in SIDES)
    return scaled(left, right, [grasp.outcome for grasp in grasps])


def main(path: str) -> None:
    labelled = gc.Dataset(path).filter(outcome=["stable", "slip"])
    for touch, stable in batches(labelled, 2):
        print(f"{touch.shape}: {stable.sum():.0f} of {len(stable)} stable, strength {np.abs(touch).mean():.3f}")


if __name__ == "__main__":
    main(*sys.argv[1:])
