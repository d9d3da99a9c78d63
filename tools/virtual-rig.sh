#!/bin/sh
# Simulates and films the grasps of the built-in virtual rig again, into calib/virtual-rig/.
# About 20 CPU minutes. Usage: tools/virtual-rig.sh [GRIPCAST]
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
    "$gripcast" render film --trace "$traces/$name.bin" --seed "$seed" --finish "$finish" \
        --out calib/virtual-rig
}

# Held.
film mug 34 ceramic --object builtin:mug --yaw-deg 90 --mass-kg 0.25 --friction 0.5 --stop-force-n 15
film ball 35 plastic --object builtin:sphere --mass-kg 0.05 --friction 0.6 --stop-force-n 12
film box 14 print --object builtin:box --yaw-deg 3 --mass-kg 0.15 --friction 0.5 --stop-force-n 10
film bar 5 brushed-metal --object builtin:bar --mass-kg 0.08 --friction 0.5 --stop-force-n 10
# Lost: too slippery, beside the middle, on slanted faces, too heavy for its end.
film cylinder 2 print --object builtin:cylinder --mass-kg 0.3 --friction 0.15 --stop-force-n 8
film ball-aside 7 wood --object builtin:sphere --offset-y 0.016 --mass-kg 0.05 --stop-force-n 15
film wedge 8 wood --object builtin:wedge --yaw-deg 20 --friction 0.2 --stop-force-n 20
film box-end 21 print --object builtin:box --offset-y 0.012 --mass-kg 0.25 --friction 0.3 --stop-force-n 4
