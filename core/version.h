// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace satsurf {

/// The version of this program, e.g. `0.1.0`.
const char* program_version();
/// The commit it was built from, `-dirty` behind it where files differed from that, or `unknown`
/// outside a git checkout.
const char* program_git_hash();

}  // namespace satsurf
