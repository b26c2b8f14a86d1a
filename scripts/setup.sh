#!/usr/bin/env bash
# Makes .venv with everything sagoma needs, on Debian 12 or Ubuntu 24.04; `setup.sh dev` adds what tests and checks need.
# Runs again at no cost when nothing changed.
set -euo pipefail
cd "$(dirname "$0")/.."
venv=${VENV:-.venv}
python=/usr/bin/python3 # the system's: Aravis reaches Python through the distribution's PyGObject

say() { if [ -t 1 ] && [ -z "${NO_COLOR:-}" ]; then printf '\033[1m%s\033[0m\n' "$*"; else printf '%s\n' "$*"; fi; }

# tick WHAT SETUP: says what is being done and for how long: on a terminal in one line, else every ten seconds
tick() {
    local began=$SECONDS passed
    while sleep 1 && kill -0 "$2" 2>/dev/null; do
        passed=$((SECONDS - began))
        if [ -t 2 ]; then
            [ "$passed" -lt 3 ] || printf '\r\033[K%s ... %d s' "$1" "$passed" >&2
        elif [ "$passed" -ge 10 ] && [ $((passed % 10)) -eq 0 ]; then
            printf '%s ... %d s\n' "$1" "$passed" >&2
        fi
    done
}

# during WHAT COMMAND...: runs the command, saying so when it takes long
during() {
    local what=$1 status=0 ticker
    shift
    tick "$what" $$ &
    ticker=$!
    "$@" || status=$?
    kill "$ticker" 2>/dev/null || true
    wait "$ticker" 2>/dev/null || true
    [ ! -t 2 ] || printf '\r\033[K' >&2
    return "$status"
}

as_root() {
    if [ "$(id -u)" = 0 ]; then "$@"; elif command -v sudo >/dev/null && sudo -n true 2>/dev/null; then sudo "$@"; else return 1; fi
}

missing_packages() {
    [ -x "$python" ] || echo python3
    "$python" -c 'import ensurepip' 2>/dev/null || echo python3-venv
    "$python" -c 'import gi; gi.require_version("Aravis", "0.8"); from gi.repository import Aravis' 2>/dev/null \
        || echo python3-gi gir1.2-aravis-0.8
    ldconfig -p 2>/dev/null | grep -q libEGL.so.1 || echo libegl1
    ldconfig -p 2>/dev/null | grep -q libOpenGL.so.0 || echo libopengl0
    ls /usr/lib/*/dri/swrast_dri.so /usr/lib/*/dri/*_dri.so >/dev/null 2>&1 || echo libegl-mesa0 libgl1-mesa-dri
}

install_system_packages() {
    local packages
    packages=$(missing_packages | xargs)
    [ -z "$packages" ] && return
    say "installing system packages: $packages"
    # shellcheck disable=SC2086
    if ! { during "asking for the packages of the system" as_root apt-get update -qq && during "installing system packages" as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq $packages; }; then
        echo "could not install them (no root and no sudo, or apt failed). As root: apt-get install $packages"
        "$python" -c 'import ensurepip' 2>/dev/null || exit 1 # nothing works without these
        echo "going on without: cameras need Aravis, the OpenGL backend needs EGL; footage and the CPU backend need neither"
    fi
}

have_system_ros() { [ "${ROS_DISTRO:-}" = jazzy ] && "$python" -c 'import rclpy' 2>/dev/null; }

pip() { "$venv/bin/python" -m pip install --quiet --disable-pip-version-check "$@" 2>&1 | { grep -v '^WARNING: Location' || true; }; }

# uv takes a fifth of pip's time, but brings its own certificates, and knows no other index of pip: pip has the last word
install_packages() { UV_SYSTEM_CERTS=1 "$venv/bin/uv" pip install --quiet --python "$venv/bin/python" "$@" 2>/dev/null || pip "$@"; }

fingerprint() { cat requirements.txt requirements-ros.txt scripts/setup.sh src/*/setup.py | sha256sum | cut -d' ' -f1; echo "$PWD"; have_system_ros && echo system-ros || echo wheels; }

sources() { find src -name '*.py' -not -path '*/test/*' | LC_ALL=C sort | xargs cat | sha256sum; }

# those of which no source changed are taken from the cache (capture_rig/kernel_cache.py)
compile_kernels() {
    [ "$(cat "$venv/.sagoma-kernels" 2>/dev/null)" = "$(sources)" ] && return
    say "compiling the numerical kernels"
    during "compiling the numerical kernels" "$venv/bin/python" -m sagoma_tools.warm_up
    sources >"$venv/.sagoma-kernels"
}

install_for_development() {
    sha256sum --check --status "$venv/.sagoma-dev" 2>/dev/null && return
    during "installing what tests and checks need" install_packages -r requirements-dev.txt
    sha256sum requirements-dev.txt >"$venv/.sagoma-dev"
}

stamp="$venv/.sagoma-setup"
if [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$(fingerprint)" ]; then
    [ "${1:-}" != dev ] || install_for_development
    compile_kernels
    exit 0
fi

install_system_packages
say "making $venv ($("$python" --version))"
"$python" -m venv --system-site-packages "$venv"
during "installing uv" pip uv || true
if have_system_ros; then
    echo "using the ROS 2 Jazzy that is sourced"
    during "installing the Python packages" install_packages -r requirements.txt
else
    say "installing ROS 2 and the Python packages"
    during "installing the Python packages" install_packages -r requirements-ros.txt -r requirements.txt
fi
editable=()
for package in src/*/; do editable+=(-e "$package"); done
during "installing the packages of this repository" install_packages --no-build-isolation --no-deps "${editable[@]}"
[ "${1:-}" != dev ] || install_for_development
compile_kernels
fingerprint >"$stamp"
