#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Installs what the build needs (as root, on Debian 12) and builds one preset.
#   build.sh PRESET [TARGET...]
set -euo pipefail
cd "$(dirname "$0")/.."
preset=$1
shift

# libopenimageio-dev: tests read with it what is written, and write what is read; its CMake file insists on the
# programs of openimageio-tools too.
# libboost-dev: OpenVDB's headers want it, its package does not ask for it; GDAL's brings it anyway.
packages=(g++ cmake ninja-build pkg-config libeigen3-dev libtbb-dev libxsimd-dev nlohmann-json3-dev libgdal-dev
  libopenimageio-dev openimageio-tools libopenvdb-dev libboost-dev libnanoflann-dev libcli11-dev
  libspdlog-dev libfmt-dev libssl-dev libbenchmark-dev doctest-dev)
missing=()
for package in "${packages[@]}"; do
  dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || missing+=("$package")
done
if [ ${#missing[@]} -gt 0 ]; then
  if [ "$(id -u)" -ne 0 ]; then
    echo "build.sh: packages are missing; as root: apt-get install --no-install-recommends ${missing[*]}" >&2
    exit 2
  fi
  export DEBIAN_FRONTEND=noninteractive
  apt-get update -q
  apt-get install -q -y --no-install-recommends "${missing[@]}"
fi

# A compiler takes up to 1.5 GB: as many as fit into memory, at most one per core.
memory_gb=$(awk '/MemAvailable/ { print int($2 / 1024 / 1024) }' /proc/meminfo)
jobs=$((memory_gb * 2 / 3))
cores=$(nproc)
[ "$jobs" -gt "$cores" ] && jobs=$cores
[ "$jobs" -lt 1 ] && jobs=1

cmake --preset "$preset"
targets=()
[ $# -gt 0 ] && targets=(--target "$@")
cmake --build --preset "$preset" -j "$jobs" "${targets[@]}"
