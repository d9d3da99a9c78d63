"""Times PyPI's onnxruntime on a gripcast model, one thread, and prints one JSON object.

    python3 benches/peers/onnxruntime_predict.py MODEL.onnx [--runs 100]

MODEL `-` reads the file from standard input. Ends with code 3 when onnxruntime or numpy is absent.
"""

import argparse
import json
import sys
import time

try:
    import numpy as np
    import onnxruntime as ort
except ImportError:
    sys.exit(3)

WARM_UP = 3
LOADS = 5


def pattern(shift):
    """The image that `gripcast bench predict` uses: height x width x RGB, 8 bits."""
    y, x = np.mgrid[0:240, 0:320]
    return ((np.stack([x, y, x * y], axis=-1) + shift) % 256).astype(np.int16)


def tensors(session):
    """Inputs by name: a tactile difference, or an image scaled to [0, 1]."""
    difference = (pattern(40) - pattern(0)) / 255
    image = pattern(40) / 255
    return {
        i.name: np.ascontiguousarray(
            (image if i.name == "rgb" else difference).transpose(2, 0, 1)[None], dtype=np.float32
        )
        for i in session.get_inputs()
    }


def timed(work, runs):
    """Results' last value, minimum and lower median in ms."""
    took = []
    for _ in range(runs):
        started = time.perf_counter()
        result = work()
        took.append((time.perf_counter() - started) * 1e3)
    took.sort()
    return result, took[0], took[(len(took) - 1) // 2]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("model")
    parser.add_argument("--runs", type=int, default=100)
    args = parser.parse_args()
    if args.model == "-":
        model = sys.stdin.buffer.read()
    else:
        with open(args.model, "rb") as file:
            model = file.read()

    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    providers = ["CPUExecutionProvider"]
    session, load_min, load_median = timed(
        lambda: ort.InferenceSession(model, options, providers=providers), LOADS
    )
    feed = tensors(session)
    run = lambda: session.run(None, feed)[0]
    timed(run, WARM_UP)
    output, engine_min, engine_median = timed(run, args.runs)
    json.dump(
        {
            "engine_ms_median": engine_median,
            "engine_ms_min": engine_min,
            "load_ms_median": load_median,
            "load_ms_min": load_min,
            "p_stable": float(output.ravel()[0]),
            "version": ort.__version__,
        },
        sys.stdout,
        sort_keys=True,
    )
    print()


if __name__ == "__main__":
    main()
