#!/usr/bin/env bash
# Compare the bytes that aarch64 gives with those in the package, by user-mode emulation on Debian:
#
#     bash bench/aarch64.sh [FOLDER]
#
# Debian's qemu-user-static, its arm64 Python and the aarch64 wheels of constraints.txt are unpacked into the folder
# (500 MB; nothing is installed), then `robustflow corrupt --check` runs in them. A first run is slow, because numba
# compiles for the emulated processor; its cache stays in the folder.
set -euo pipefail
here="$(cd "$(dirname "$0")/.." && pwd)"
folder="$(mkdir -p "${1:-/tmp/robustflow-aarch64}" && cd "${1:-/tmp/robustflow-aarch64}" && pwd)"
cd "$folder"

mkdir -p apt/lists/partial apt/cache/archives/partial qemu root site
touch apt/status
apt=(-o Dir::State::Lists="$folder/apt/lists" -o Dir::Cache="$folder/apt/cache" -o Dir::State::status="$folder/apt/status"
    -o APT::Sandbox::User=root -o APT::Install-Recommends=0 -o APT::Keep-Downloaded-Packages=true -o Debug::NoLocking=1
    -o Acquire::IndexTargets::deb::DEP-11::DefaultEnabled=false)
if [ ! -e unpacked ]; then
    apt-get -qq "${apt[@]}" -o APT::Architecture=amd64 -o APT::Architectures::=amd64 -o APT::Architectures::=arm64 update
    (cd qemu && apt-get -qq "${apt[@]}" -o APT::Architectures::=amd64 -o APT::Architectures::=arm64 download qemu-user-static:amd64)
    dpkg -x qemu/*.deb qemu
    apt-get -qq "${apt[@]}" -o APT::Architecture=arm64 -o APT::Architectures::=arm64 -y -d install python3.11 libstdc++6
    for package in apt/cache/archives/*_arm64.deb apt/cache/archives/*_all.deb; do dpkg -x "$package" root; done
    touch unpacked
fi
if [ ! -e site/numba ]; then
    platforms=()
    for platform in manylinux_2_28 manylinux_2_27 manylinux_2_26 manylinux_2_24 manylinux_2_17 manylinux2014; do
        platforms+=(--platform "${platform}_aarch64")
    done
    python3 -c "
import sys, tomllib
print(*tomllib.load(open(sys.argv[1], 'rb'))['project']['dependencies'], sep='\n')" "$here/pyproject.toml" >base.txt
    python3 -m pip install --quiet --target site "${platforms[@]}" --python-version 3.11 --implementation cp \
        --only-binary=:all: -c "$here/constraints.txt" -r base.txt
fi
export PYTHONPATH="$here/src:$folder/site" NUMBA_CACHE_DIR="$folder/numba-cache" OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1
exec qemu/usr/bin/qemu-aarch64-static -L "$folder/root" root/usr/bin/python3.11 -m robustflow corrupt --check
