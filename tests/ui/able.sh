#!/bin/sh
# Whether a window can be tested here: 0, or 1 and one line that says why not.
no() { echo "$1"; exit 1; }
[ "$(id -u)" = 0 ] || no "it needs root"
command -v apt-get >/dev/null || no "it needs apt-get"
folder=$(mktemp -d)
mount --bind "$folder" "$folder" 2>/dev/null || no "it may not mount anything"
umount "$folder" && rmdir "$folder"
apt-get -o APT::Update::Error-Mode=any update -qq >/dev/null 2>&1 || no "there is no way to Debian's packages"
command -v debootstrap >/dev/null || apt-get install -y -qq debootstrap >/dev/null 2>&1 || no "apt-get has no debootstrap"
