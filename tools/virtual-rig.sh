#!/bin/sh
# Simulates and films the grasps of the built-in virtual rig again, into calib/virtual-rig/.
# About 40 CPU minutes. Usage: tools/virtual-rig.sh [GRIPCAST]
set -eu
cd "$(dirname "$0")/.."
gripcast=${1:-target/release/gripcast}
traces=$(mktemp -d)
trap 'rm -rf "$traces"' EXIT

# NAME SEED FINISH, then what `sim grasp` is told.
film() {
    name=$1 seed=$2 finish=$3
    shift 3
    "$gripcast" -q sim grasp --width 0.08 "$@" --trace "$traces/$name.bin"
    "$gripcast" -q render film --trace "$traces/$name.bin" --seed "$seed" --finish "$finish" \
        --out calib/virtual-rig
}

# Held.
film mug 34 ceramic --object builtin:mug --yaw-deg 90 --offset-y -0.0165 --mass-kg 0.25 \
    --friction 0.5 --stop-force-n 30
film ball 35 plastic --object builtin:ball --mass-kg 0.1 --friction 0.6 --stop-force-n 20
film bottle 42 plastic --object builtin:bottle --height 0.093 --mass-kg 0.25 --friction 0.6 \
    --stop-force-n 25
film box 14 print --object builtin:box --height 0.056 --mass-kg 0.15 --friction 0.5 \
    --stop-force-n 20
# Lost: too slippery and heavy, beside the middle, on slanted faces, too heavy for its end.
film bottle-low 36 plastic --object builtin:bottle --height 0.035 --mass-kg 0.6 --friction 0.25 \
    --stop-force-n 8
film ball-aside 31 wood --object builtin:ball --offset-y 0.016 --mass-kg 0.1 --stop-force-n 15
film wedge 8 wood --object builtin:wedge --yaw-deg 20 --friction 0.2 --stop-force-n 20
film box-end 32 print --object builtin:box --offset-y 0.017 --mass-kg 0.5 --friction 0.3 \
    --stop-force-n 6
