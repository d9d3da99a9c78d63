#!/bin/sh
# Simulates and renders the grasps of the built-in virtual rig again, into calib/virtual-rig/.
# About 20 CPU minutes. Usage: tools/virtual-rig.sh [GRIPCAST]
set -eu
cd "$(dirname "$0")/.."
gripcast=${1:-target/release/gripcast}
traces=$(mktemp -d)
trap 'rm -rf "$traces"' EXIT

# NAME SEED FINISH, then what `sim grasp` is told.
clip() {
    name=$1 seed=$2 finish=$3
    shift 3
    "$gripcast" -q sim grasp --width 0.08 "$@" --trace "$traces/$name.bin"
    "$gripcast" -q render clip --trace "$traces/$name.bin" --seed "$seed" --finish "$finish" \
        --out calib/virtual-rig
}

# Held.
clip mug 34 ceramic --object builtin:mug --yaw-deg 90 --offset-y -0.0165 --mass-kg 0.25 \
    --friction 0.5 --stop-force-n 30
clip ball 35 plastic --object builtin:ball --mass-kg 0.1 --friction 0.6 --stop-force-n 20
clip bottle 42 plastic --object builtin:bottle --height 0.093 --mass-kg 0.25 --friction 0.6 \
    --stop-force-n 25
clip box 14 print --object builtin:box --height 0.056 --mass-kg 0.15 --friction 0.5 \
    --stop-force-n 20
# Lost: too slippery and heavy, beside the middle, on slanted faces, too heavy for its end.
clip bottle-low 36 plastic --object builtin:bottle --height 0.035 --mass-kg 0.6 --friction 0.25 \
    --stop-force-n 8
clip ball-aside 31 wood --object builtin:ball --offset-y 0.016 --mass-kg 0.1 --stop-force-n 15
clip wedge 8 wood --object builtin:wedge --yaw-deg 20 --friction 0.2 --stop-force-n 20
clip box-end 32 print --object builtin:box --offset-y 0.017 --mass-kg 0.5 --friction 0.3 \
    --stop-force-n 6
