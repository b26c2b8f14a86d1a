#!/usr/bin/env bash
# Proves the set-up on a bare machine: makes a minimal Debian 12 in a folder, clones this repository into it, and runs
# a make target there. Needs root, debootstrap, and whatever apt and pip configuration this machine has.
#   scripts/fresh_debian.sh FOLDER demo|test
set -euo pipefail
root=$(realpath -m "${1:?give an empty folder}")
target=${2:-demo}
[ "$(id -u)" = 0 ] || { echo "run this as root: it makes a Debian in $root" >&2; exit 2; }
command -v debootstrap >/dev/null || { echo "there is no debootstrap: apt-get install debootstrap" >&2; exit 2; }
repository=$(git -C "$(dirname "$0")" rev-parse --show-toplevel)

if [ ! -d "$root/usr" ]; then
    # either form of apt's sources may be absent; without any, Debian's own mirror
    mirror=$(cat /etc/apt/sources.list /etc/apt/sources.list.d/* 2>/dev/null |
        sed -n 's/^URIs: *//p; s/^deb \(\[[^]]*\] \)\?\([^ ]*\).*/\2/p' | sed -n 1p || true)
    echo "making a minimal Debian 12 in $root (log: $root.log)"
    debootstrap --variant=minbase --include=make,git,ca-certificates bookworm "$root" \
        "${mirror:-http://deb.debian.org/debian}" >"$root.log" 2>&1 || { tail "$root.log" >&2; exit 1; }
fi
for file in /etc/pip.conf /etc/resolv.conf /etc/hosts; do [ -e "$file" ] && cp -L "$file" "$root$file"; done
cp -rL /etc/apt/. "$root/etc/apt/"
cp -rL /etc/ssl/certs/. "$root/etc/ssl/certs/" 2>/dev/null || true

cleanup() { umount -R -l "$root/dev" "$root/proc" 2>/dev/null || true; }
trap cleanup EXIT
mount -t proc proc "$root/proc"
mount --rbind /dev "$root/dev" && mount --make-rslave "$root/dev" # slave: unmounting it later leaves the host's alone

rm -rf "$root/root/sagoma"
git clone -q "$repository" "$root/root/sagoma"
env -i HOME=/root PATH=/usr/sbin:/usr/bin:/sbin:/bin LANG=C.UTF-8 ${PIP_INDEX_URL:+PIP_INDEX_URL=$PIP_INDEX_URL} \
    ${HTTPS_PROXY:+HTTPS_PROXY=$HTTPS_PROXY} ${HTTP_PROXY:+HTTP_PROXY=$HTTP_PROXY} \
    chroot "$root" make -C /root/sagoma "$target"
