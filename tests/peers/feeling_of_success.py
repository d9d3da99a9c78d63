"""Writes the files of tests/data/import: the keys of the Feeling of Success, by what wrote its files.

    python3 -m venv venv
    venv/bin/pip install deepdish==0.3.7 numpy==1.23.5 tables==3.8.0 'scipy<1.12' 'setuptools<70'
    venv/bin/python tests/peers/feeling_of_success.py tests/data/import

The images are made up: each has its own colour, so that a test sees which went where.
"""

import pathlib
import sys

import deepdish
import numpy

folder = pathlib.Path(sys.argv[1])
folder.mkdir(parents=True, exist_ok=True)

COLOURS = {
    "gelsightA_before": (200, 40, 40),
    "gelsightA_during": (40, 200, 40),
    "gelsightA_after": (1, 2, 3),
    "gelsightB_before": (40, 40, 200),
    "gelsightB_during": (200, 200, 40),
    "gelsightB_after": (1, 2, 3),
    "kinectA_rgb_before": (1, 2, 3),
    "kinectA_rgb_during": (200, 40, 200),
    "kinectA_rgb_after": (1, 2, 3),
}


def grasp(number):
    # Arrays of more than 300 numbers are compressed, smaller ones are not.
    shape = (8, 12, 3) if number else (30, 40, 3)
    found = {
        key: numpy.full(shape, colour, numpy.uint8)
        for key, colour in COLOURS.items()
    }
    found["object_name"] = numpy.bytes_(b"duck") if number % 2 else numpy.bytes_(b"soap bar")
    found["is_gripping"] = numpy.bool_(number % 3 == 0)
    return found


# More than nine, so that i10 comes after i9 only as a number.
grasps = [grasp(number) for number in range(12)]
deepdish.io.save(str(folder / "deepdish.h5"), grasps)
deepdish.io.save(str(folder / "deepdish-blosc.h5"), grasps[:1], compression="blosc")
