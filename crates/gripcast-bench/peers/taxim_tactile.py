"""Times PyPI's taxim on the press of `gripcast bench render`, on the CPU; prints one JSON object.

    python3 benches/peers/taxim_tactile.py PRESS.json [--runs 30]

PRESS `-` reads standard input: {"width", "height", "depth_m"}, the depths of a press row by row, m.
Ends with code 3 when taxim, or both of jax and torch with torch-scatter, are absent.

`tactile_ms` is an image from the height map without shadow, `tactile_shadow_ms` with it. taxim
starts from a height map, so reading the object is not part of it. Its calibration is that of its
GelSight Mini, resampled to the size of the image.
"""

import argparse
import json
import os
import sys
import time
from importlib.metadata import version

os.environ["JAX_PLATFORMS"] = "cpu"

try:
    import numpy as np
    from taxim import CALIB_GELSIGHT_MINI, Taxim

    SIMULATOR = Taxim(CALIB_GELSIGHT_MINI, device="cpu")
except ImportError:
    sys.exit(3)

# Where nothing touches, the object is this far from the gel, mm.
AWAY_MM = 1.0


def timed(work, runs):
    """Minimum and lower median of the process' CPU time in ms.

    On a busy machine, wall time would count what others take.
    """
    work()
    took = []
    for _ in range(runs):
        started = time.process_time()
        work()
        took.append((time.process_time() - started) * 1e3)
    took.sort()
    return {"min": took[0], "median": took[(len(took) - 1) // 2]}


def finished(image):
    """jax answers before it has computed."""
    wait = getattr(image, "block_until_ready", None)
    return wait() if wait else image


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("press")
    parser.add_argument("--runs", type=int, default=30)
    arguments = parser.parse_args()
    source = sys.stdin if arguments.press == "-" else open(arguments.press)
    press = json.load(source)
    depth = np.array(press["depth_m"], dtype=np.float32)
    depth = 1e3 * depth.reshape(press["height"], press["width"])
    heights = SIMULATOR.convert_height_map(np.where(depth > 0, -depth, AWAY_MM))

    def image(with_shadow):
        return finished(SIMULATOR.render_direct(heights, with_shadow=with_shadow))

    report = {
        "taxim": version("taxim"),
        "backend": SIMULATOR.backend_name,
        "tactile_ms": timed(lambda: image(False), arguments.runs),
        "tactile_shadow_ms": timed(lambda: image(True), arguments.runs),
        "mean_rgb": np.asarray(SIMULATOR.img_to_numpy(image(False))).mean((0, 1)).tolist(),
    }
    json.dump(report, sys.stdout)
    print()


if __name__ == "__main__":
    main()
