#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Builds everything and runs all tests; as root on a fresh Debian 12 it installs the packages first.
set -euo pipefail
cd "$(dirname "$0")"
tests/build.sh release
ctest --preset release "$@"
