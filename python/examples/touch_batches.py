"""Reads batches of tactile differences and labels from a dataset, as for training.

    python python/examples/touch_batches.py DATASET

With torch installed, `torch.utils.data.DataLoader(dataset, batch_size=32, num_workers=2,
collate_fn=collate)` does the same in several processes.
"""

import sys
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

import gripcast as gc

Batch = tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]


def collate(grasps: list[gc.Grasp]) -> Batch:
    """Differences of both gels, batch × 6 × 240 × 320, from -1 to 1; 1 for a stable grasp."""
    both = [[grasp.tactile_difference("left"), grasp.tactile_difference("right")] for grasp in grasps]
    touch = np.concatenate([np.stack(pair).transpose(0, 3, 1, 2).reshape(1, 6, 240, 320) for pair in both])
    stable = np.array([grasp.outcome == "stable" for grasp in grasps], dtype=np.float32)
    return (touch / np.float32(255)).astype(np.float32), stable


def batches(dataset: gc.Dataset, size: int) -> Iterator[Batch]:
    for start in range(0, len(dataset), size):
        yield collate(list(dataset[start : start + size]))


def main(path: str) -> None:
    labelled = gc.Dataset(path).filter(outcome=["stable", "slip"])
    for touch, stable in batches(labelled, 2):
        print(f"{touch.shape}: {stable.sum():.0f} of {len(stable)} stable, strength {np.abs(touch).mean():.3f}")


if __name__ == "__main__":
    main(*sys.argv[1:])
