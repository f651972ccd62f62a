// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/version.h"

#include SATSURF_GIT_HASH_HEADER

namespace satsurf {

const char* program_version() { return SATSURF_VERSION; }
const char* program_git_hash() { return SATSURF_GIT_HASH; }

}  // namespace satsurf
