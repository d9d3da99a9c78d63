F=/work/shared/field/mesh-sim-pose
for d in $F/mtl-* $F/tex-* $F/glb-* $F/gltf-*; do n=$(basename $d)
 f=$(ls "$d"/*.obj "$d"/*.glb "$d"/*.gltf 2>/dev/null | head -1)
 u=""; case $f in *.obj) u="--unit mm";; esac
 timeout 120 ./gripcast render visual --object "$f" $u --view outside --size 120x90 --spp 8 --out img/$n.png > img/$n.txt 2>&1; echo "== $n rc=$?"; cat img/$n.txt; done
for f in $F/hdr/*.hdr; do n=hdr-$(basename $f .hdr)
 timeout 120 ./gripcast render visual --object builtin:box --view outside --hdri "$f" --size 120x90 --spp 8 --out img/$n.png > img/$n.txt 2>&1; echo "== $n rc=$?"; cat img/$n.txt; done
