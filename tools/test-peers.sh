#!/usr/bin/env bash
# tools/test-peers.sh: the longer checks against other programs' libraries: models on onnxruntime,
# shards, the black box, a collected dataset and its exports as Python users read them. `make test`
# runs the quick ones, also of a dataset whose first grasps lack label, prediction and images.
set -euo pipefail
cd "$(dirname "$0")/.."
python=${GRIPCAST_PYTHON:-$(tools/peers.sh path)}
gripcast=target/release/gripcast
export HF_HUB_OFFLINE=1
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
export HF_HOME=$folder/cache

for model in models/*.onnx; do
    "$python" tests/peers/check_onnx.py "$model" --gripcast "$gripcast"
done
"$gripcast" -q synth plan --preset tiny --out "$folder/plan" >/dev/null
"$gripcast" -q synth run --plan "$folder/plan" >/dev/null
"$gripcast" -q synth merge --plan "$folder/plan" --out "$folder/shards" --partial >/dev/null ||
    [ $? -eq 3 ] # Grasps without a result are left out.
"$python" tests/peers/read_shards.py "$folder/shards" --rewrite "$folder/rewritten"
GRIPCAST__GUARDS__MAX_FRAME_AGE_MS=2000 GRIPCAST__GUARDS__MAX_SKEW_MS=2000 \
    "$gripcast" -q collect --rig virtual --script tests/data/three-grasps.txt --black-box \
    --dataset "$folder/collected" >/dev/null
"$python" tests/peers/read_black_box.py "$folder/collected" --require
"$python" tests/peers/load_imagefolder.py "$folder/collected"
exports=()
for format in parquet webdataset lerobot zarr; do
    "$gripcast" -q dataset export "$folder/collected" --to "$format" --out "$folder/$format" >/dev/null
    exports+=("--$format" "$folder/$format")
done
"$python" tests/peers/load_exports.py "$folder/collected" "${exports[@]}"
