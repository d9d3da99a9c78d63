"""Reads the fields of a trace with numpy and checks that they add up.

    read_trace.py TRACE.bin
"""

import sys


# docs/reference/trace-format.md shows this function.
def read_fields(path):
    import json, os, struct
    import numpy as np

    with open(path, "rb") as file:
        length = struct.unpack_from("<I", file.read(32), 12)[0]
        fields = json.loads(file.read(length))["fields"]
    record = np.dtype([(c["name"], c["dtype"], tuple(c["shape"])) for c in fields["columns"]])
    start = os.path.getsize(path) - fields["steps"] * record.itemsize
    return fields, np.memmap(path, record, "r", start, fields["steps"])


def main():
    import numpy as np

    fields, data = read_fields(sys.argv[1])
    gels, rows, columns = data["contact"].shape[1:]
    assert (gels, rows, columns) == (fields["gels"], len(fields["y_m"]), len(fields["x_m"]))
    assert data.dtype.itemsize == fields["record_bytes"]
    area = np.array(fields["area_m2"])[..., None]
    force = (data["traction_pa"].astype(float) * area).sum(axis=(2, 3))
    error = abs(force - data["resultant_force_n"]).max()
    assert error < 1e-6, error
    # Only the face sinks in, where it is pressed.
    assert data["displacement_m"][..., 2].min() < -1e-5
    contact = [fields["contact"].index(name) for name in ("open", "stick", "slip")]
    assert contact == [0, 1, 2] and set(np.unique(data["contact"])) <= set(contact)
    stages = [fields["stage"][code] for code in np.unique(data["stage"])]
    print(len(data), gels, rows, columns, *stages)


if __name__ == "__main__":
    main()
