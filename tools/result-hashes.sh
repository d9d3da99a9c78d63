#!/usr/bin/env bash
# tools/result-hashes.sh BINARY FOLDER: hashes of what one build of gripcast computes, one line a
# result, on stdout and in FOLDER/hashes. Two builds agree where the files are the same:
#
#     tools/result-hashes.sh OLD old; tools/result-hashes.sh NEW new; diff old/hashes new/hashes
#
# `gripcast-bench` is expected beside BINARY (cargo build --release -p gripcast -p gripcast-bench); a
# binary from before it has all benches itself.
# Times, paths and versions are left out. The cases of `bench grasp` with meshes of the shared
# folder are skipped without it.
set -euo pipefail
binary=$(realpath "$1")
mkdir -p "$2"
folder=$(realpath "$2")
cd "$(dirname "$0")/.."
rm -rf "$folder"/{hashes,plan,data,run,images} "$folder"/*.json
mkdir -p "$folder/images"

bench=("$(dirname "$binary")/gripcast-bench" -q)
if "$binary" bench grasp --help >/dev/null 2>&1; then
    bench=("$binary" -q bench)
fi

# Earlier binaries have other names of these flags.
spp=--spp batch=--batch-size
"$binary" render visual --help | grep -- "$spp" >/dev/null || spp=--samples
"$binary" train --help | grep -- "$batch" >/dev/null || batch=--batch

note() { # NAME, the bytes on stdin
    printf '%s  %s\n' "$(sha256sum | cut -c1-64)" "$1" | tee -a "$folder/hashes"
}

# The JSON of a bench without what a clock gave.
untimed() {
    python3 -c '
import json, re, sys
timed = re.compile(r"^ms$|(_s|_ms|_us|times|per_s|ratio|speed\w*|throughput\w*|threads)$|_per_s_|_ms_|_s_")
def strip(value):
    if isinstance(value, dict):
        return {k: strip(v) for k, v in value.items() if not timed.search(k)}
    if isinstance(value, list):
        return [strip(v) for v in value]
    return value
print(json.dumps(strip(json.load(sys.stdin)), sort_keys=True))'
}

for threads in 1 2; do
    "${bench[@]}" grasp --no-throughput --threads "$threads" --json >"$folder/grasp.json" ||
        [ $? -eq 3 ] # Cases without their mesh are skipped.
    untimed <"$folder/grasp.json" | note "bench grasp, $threads threads"
    for object in box mug jack; do
        trace=$folder/$object-$threads.json
        "$binary" -q sim grasp --object "builtin:$object" --gel coarse --stop-force-n 20 \
            --threads "$threads" --trace "$trace" >/dev/null
        untimed <"$trace" | note "sim grasp $object, $threads threads: states"
    done
done
trace=$folder/mug-1.json
"$binary" -q render tactile --trace "$trace" --object builtin:mug --seed 1 --out "$folder/images/tactile" >/dev/null
"$binary" -q render visual --trace "$trace" --object builtin:mug --seed 1 "$spp" 16 --size 160x120 \
    --out "$folder/images/visual.png" >/dev/null
(cd "$folder/images" && find . -name '*.png' | sort | xargs sha256sum) | note "render tactile, render visual"
"${bench[@]}" pose --images 20 --json | untimed | note "bench pose"
"$binary" -q synth plan --preset tiny --out "$folder/plan" >/dev/null
"$binary" -q synth run --plan "$folder/plan" >/dev/null
"$binary" -q synth merge --plan "$folder/plan" --out "$folder/data" --partial >/dev/null
(cd "$folder/data" && find . -name '*.parquet' | sort | xargs sha256sum) | note "synth --preset tiny"
"$binary" -q train --data "$folder/data" --out "$folder/run" --epochs 2 "$batch" 4 --seed 1 --headless >/dev/null
(cd "$folder/run" && find . -name '*.onnx' | sort | xargs sha256sum) | note "train, two epochs"
