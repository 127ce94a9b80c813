#!/bin/sh
# A Debian with a Blender that has a window, in folder $1, of release $2 (trixie: Blender 4.3, sid: 5.2). Needs root and debootstrap.
set -e
root=$1 release=$2
cmp -s "$0" "$root/.ready" && exit 0  # made by this very script
command -v debootstrap >/dev/null || apt-get install -y -qq debootstrap ca-certificates >/dev/null
mirror=$(sed -n 's/^URIs: *//p' /etc/apt/sources.list.d/*.sources 2>/dev/null | head -1)
[ -n "$mirror" ] || mirror=$(sed -n 's/^deb \(\[[^]]*\] \)\?\([^ ]*\).*/\2/p' /etc/apt/sources.list 2>/dev/null | head -1)
grep -q '^ID=debian' /etc/os-release || mirror=""  # another system's mirror has no Debian
rm -rf --one-file-system "$root"  # not what a run that was cut off left mounted there
debootstrap --variant=minbase "$release" "$root" ${mirror:+"$mirror"} >/dev/null
cp /etc/ssl/certs/ca-certificates.crt "$root/etc/host-ca.crt"
cp /etc/resolv.conf "$root/etc/"
[ -f /etc/pip.conf ] && cp /etc/pip.conf "$root/etc/"
[ -d /etc/apt/apt.conf.d ] && cp -r /etc/apt/apt.conf.d/. "$root/etc/apt/apt.conf.d/" || true
extra=""
[ "$release" = sid ] && extra=python3-cattr
chroot "$root" apt-get -o Acquire::Check-Valid-Until=false -o Acquire::Check-Date=false update -qq
# nothing that the renderer needs: the extension brings it
chroot "$root" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends blender xvfb xauth libgl1-mesa-dri \
  libegl1 imagemagick xdotool python3-numpy $extra >/dev/null
cp "$0" "$root/.ready"
