"""What OpenCV needs to turn one full-size gel frame into a 320x240 image, on one thread.

Reads one JPEG from stdin; prints one JSON object. Exit code 3: OpenCV cannot be imported.
"""

import argparse
import json
import statistics
import sys
import time

try:
    import cv2
    import numpy
except ImportError:
    sys.exit(3)

parser = argparse.ArgumentParser()
parser.add_argument("input", choices=["-"], help="the JPEG comes from standard input")
parser.add_argument("--runs", type=int, default=30)
runs = parser.parse_args().runs

cv2.setNumThreads(1)
jpeg = numpy.frombuffer(sys.stdin.buffer.read(), numpy.uint8)
times_ms = []
for _ in range(runs):
    started = time.process_time()
    image = cv2.imdecode(jpeg, cv2.IMREAD_COLOR)
    height, width = image.shape[:2]
    inside = image[height // 7 : height - height // 7, width // 7 : width - width // 7]
    cv2.resize(inside, (320, 240), interpolation=cv2.INTER_AREA)
    times_ms.append((time.process_time() - started) * 1e3)
print(
    json.dumps(
        {
            "version": cv2.__version__,
            "decode_ms_min": min(times_ms),
            "decode_ms_median": statistics.median(times_ms),
        }
    )
)
