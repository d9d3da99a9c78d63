"""Reads Parquet shards as Python users would, and can write them again with other programs.

    python -m venv venv && venv/bin/pip install datasets pandas pillow pyarrow
    venv/bin/python tests/peers/read_shards.py DATASET [--rewrite FOLDER] [--rows N]

DATASET has data/SPLIT-00000-of-00003.parquet. Prints the columns. Exits 1 when pandas, pyarrow or
datasets find something else than a shard should have. With --rewrite the first rows are written as
pandas, datasets and pyarrow write them, in several encodings, for our reader to read.
"""

import argparse
import io
import json
import pathlib
import sys
import tempfile

import datasets
import pandas
import pyarrow
import pyarrow.parquet as pq
from PIL import Image

from comparison import expect, faults

TEXTS = "id simulation object category engine outcome outcome_detail appearance crop_profile".split()
NUMBERS = "stop_force_n friction mass_kg lifted_m opening_m".split()
IMAGES = "initial_left initial_right grasp_left grasp_right grasp_rgb".split()
NULLABLE_IMAGES = ["initial_rgb", "grasp_depth"]

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("dataset", type=pathlib.Path)
parser.add_argument("--rewrite", type=pathlib.Path, metavar="FOLDER")
parser.add_argument("--rows", type=int, default=1000, help="rows of the rewritten files")
args = parser.parse_args()
files = sorted((args.dataset / "data").glob("*.parquet"))
cache = tempfile.TemporaryDirectory()
datasets.disable_progress_bars()


def check_features(features, where):
    for column in IMAGES + NULLABLE_IMAGES:
        expect(isinstance(features.get(column), datasets.Image), f"{where}: {column} is no image")
    label = features.get("label")
    names = getattr(label, "names", None)
    expect(names == ["slip", "stable"], f"{where}: label is {label}")


def check_row(row, where):
    expect(row["label"] == ["slip", "stable"].index(row["outcome"]), f"{where}: label, outcome")
    expect(len(row["pose_t_m"]) == 3 and len(row["pose_q_wxyz"]) == 4, f"{where}: pose")
    for column in IMAGES + NULLABLE_IMAGES:
        image = row[column]
        if image is None:
            expect(column in NULLABLE_IMAGES, f"{where}: {column} is null")
            continue
        if not isinstance(image, Image.Image):
            faults.append(f"{where}: {column} is {type(image)}")
            continue
        image.load()
        if column == "grasp_depth":
            expect(image.mode in ("I;16", "I"), f"{where}: depth came as {image.mode}")


def read_all():
    print(f"datasets {datasets.__version__}, pandas {pandas.__version__}, pyarrow {pyarrow.__version__}")
    rows = 0
    for path in files:
        table = pandas.read_parquet(path)
        rows += len(table)
        expect(table["id"].is_unique, f"{path.name}: ids are not unique")
        expect(not table[TEXTS].isna().any().any(), f"{path.name}: a text is null")
        expect(all(table[c].dtype == "float64" for c in NUMBERS), f"{path.name}: {table.dtypes}")
        expect(table["label"].dtype == "int64", f"{path.name}: label is {table['label'].dtype}")
        for cell in table["grasp_rgb"][:1]:
            expect(Image.open(io.BytesIO(cell["bytes"])).size[0] > 0, f"{path.name}: grasp_rgb")
        groups = pq.ParquetFile(path).metadata
        sizes = [groups.row_group(i).total_byte_size for i in range(groups.num_row_groups)]
        expect(max(sizes, default=0) <= 16 << 20 or len(table) == len(sizes), f"{path.name}: {sizes}")
        metadata = groups.metadata or {}
        expect(json.loads(metadata.get(b"gripcast", b"{}")).get("version") == 1, f"{path.name}: version")
    single = datasets.load_dataset(
        "parquet", data_files=[str(path) for path in files], split="train", cache_dir=cache.name
    )
    check_features(single.features, "data_files")
    expect(single.num_rows == rows, f"data_files: {single.num_rows} rows, pandas {rows}")
    for name, feature in single.features.items():
        print(f"  {name}: {feature}")
    by_split = datasets.load_dataset(str(args.dataset), cache_dir=cache.name)
    splits = {path.name.split("-")[0] for path in files}
    expect(set(by_split) == splits, f"splits {set(by_split)}, expected {splits}")
    expect(sum(part.num_rows for part in by_split.values()) == rows, "rows of the splits")
    for split, part in by_split.items():
        check_features(part.features, split)
        if faults:
            return single
        for row in part.select(range(min(50, part.num_rows))):
            check_row(row, f"{split} {row['id']}")
    streamed = datasets.load_dataset(str(args.dataset), streaming=True)
    for split, part in streamed.items():
        for row in part.take(2):
            check_row(row, f"streamed {split} {row['id']}")
    print(f"{rows} rows, splits {', '.join(sorted(splits))}")
    return single


def rewrite(loaded, folder):
    folder.mkdir(parents=True, exist_ok=True)
    some = loaded.select(range(min(args.rows, loaded.num_rows)))
    some.to_parquet(folder / "datasets.parquet")
    table = pandas.concat([pandas.read_parquet(path) for path in files])[: args.rows]
    table.to_parquet(folder / "pandas.parquet")
    table.to_parquet(folder / "pandas-zstd.parquet", compression="zstd")
    frame = table.copy()
    for column in ("object", "category", "engine"):
        frame[column] = frame[column].astype("category")
    frame["label"] = frame["label"].astype("int32")
    frame["fault"] = None
    frame["note"] = "further columns are ignored"
    frame.drop(columns=["grasp_depth"]).to_parquet(folder / "pandas-changed.parquet", compression="gzip")
    arrow = pyarrow.Table.from_pandas(table, preserve_index=False)
    large = pyarrow.schema(
        field.with_type(pyarrow.large_string()) if field.type == pyarrow.string() else field
        for field in arrow.schema
    )
    pq.write_table(
        arrow.cast(large),
        folder / "pyarrow-v2.parquet",
        compression="zstd",
        data_page_version="2.0",
        use_dictionary=False,
        column_encoding={"mass_kg": "BYTE_STREAM_SPLIT", "id": "PLAIN"},
        write_page_checksum=True,
        data_page_size=1000,
    )
    pq.write_table(arrow, folder / "pyarrow-plain.parquet", compression="none", use_dictionary=False)
    print(f"{len(table)} rows written again in {folder}")


if not files:
    sys.exit(f"there is no shard in {args.dataset / 'data'}")
loaded = read_all()
if args.rewrite and not faults:
    rewrite(loaded, args.rewrite)
for fault in faults:
    print(f"FAULT {fault}", file=sys.stderr)
sys.exit(1 if faults else 0)
