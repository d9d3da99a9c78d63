"""Loads a gripcast dataset as Python users would, and holds it against its records.

    python -m venv venv && venv/bin/pip install datasets pandas pillow polars duckdb
    venv/bin/python tests/peers/load_imagefolder.py DATASET

Prints the columns. Exits 1 when an image column is missing, is no image, or differs from the
records, or when a library changes an object name; depth must come as 16 bit.
"""

import json
import pathlib
import sys

import datasets
import duckdb
import pandas
import polars
from datasets import load_dataset

root = pathlib.Path(sys.argv[1])
records = {
    record["id"]: record
    for record in (json.loads(path.read_text()) for path in root.glob("grasps/2*/grasp.json"))
}
stored = {
    f"{stage}_{role}"
    for record in records.values()
    for stage in ("initial", "grasp")
    for role in record[stage]["cameras"]
}

# Without `dtype`, pandas reads the object 001 as the number 1.
table = pandas.read_json(root / "metadata.jsonl", lines=True, dtype={"object": str})
loaded = load_dataset("imagefolder", data_dir=str(root), split="train")
faults = []
if len(table) != len(records) or loaded.num_rows != len(records):
    faults.append(f"{len(records)} records, {len(table)} index rows, {loaded.num_rows} loaded")

index = str(root / "metadata.jsonl")
objects = [records[id]["object"] for id in sorted(records)]
frame = polars.read_ndjson(index, infer_schema_length=None)
rows = duckdb.sql("SELECT object FROM read_json(?) ORDER BY id", params=[index]).fetchall()
for library, found in (
    ("pandas", table["object"].tolist()),
    ("datasets", loaded["object"][:]),
    ("polars", frame["object"].to_list()),
    ("duckdb", [row[0] for row in rows]),
):
    if found != objects:
        faults.append(f"objects by {library}: {found}, expected {objects}")

print(f"polars {polars.__version__}, duckdb {duckdb.__version__}")
print(f"datasets {datasets.__version__}, pandas {pandas.__version__}, {loaded.num_rows} rows")
for name, feature in loaded.features.items():
    print(f"  {name}: {feature}")

for column in sorted(stored):
    feature = loaded.features.get(column)
    if not isinstance(feature, datasets.Image):
        faults.append(f"column {column} is {feature}, not an image")
        continue
    for row in loaded:
        record = records[row["id"]]
        stage, role = column.split("_")
        camera = record[stage]["cameras"].get(role)
        image = row[column]
        if (image is None) != (camera is None):
            faults.append(f"{row['id']} {column}: {image} where the record says {camera}")
        elif image is not None:
            if image.size != (camera["width"], camera["height"]):
                faults.append(f"{row['id']} {column}: {image.size}")
            if camera["format"] == "Z16" and image.mode not in ("I;16", "I"):
                faults.append(f"{row['id']} {column}: depth came as {image.mode}")

for fault in faults:
    print(f"FAULT {fault}", file=sys.stderr)
print(f"{len(stored)} image columns: {', '.join(sorted(stored))}")
sys.exit(1 if faults else 0)
