#!/bin/sh
# init of the User-Mode-Linux guest. The host's / is its read-only root.
#
# GRIPCAST_OUT and GRIPCAST_DISK on the kernel's command line reach this script as environment:
#   GRIPCAST_OUT   directory of the host for results; holds command.sh, what the guest shall do
#   GRIPCAST_DISK  size of the guest's disk for the dataset, for instance 64m
# command.sh finds the results at $OUT and the disk at $DISK; its exit status goes to $OUT/rc.
#
# Plain sh and mount only: a busybox shell would start its applets through /proc/self/exe, which
# does not exist before /proc is mounted.
export PATH=/usr/sbin:/usr/bin:/sbin:/bin

mount -t proc proc /proc
mount -t sysfs sys /sys
mount -t devtmpfs dev /dev
mount -t tmpfs -o size=1m mnt /mnt
mkdir /mnt/out /mnt/disk /mnt/tmp
mount -t hostfs -o "${GRIPCAST_OUT:?missing on the kernel command line}" out /mnt/out
mount -t tmpfs -o "size=${GRIPCAST_DISK:-1g}" disk /mnt/disk
mount -t tmpfs tmp /mnt/tmp
export OUT=/mnt/out DISK=/mnt/disk TMPDIR=/mnt/tmp

exec >"$OUT/guest.log" 2>&1
sh "$OUT/command.sh"
echo $? >"$OUT/rc"
dmesg >"$OUT/dmesg.txt" 2>/dev/null
exec "$GRIPCAST_POWEROFF" poweroff
