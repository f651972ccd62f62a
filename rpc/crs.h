// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

namespace satsurf::rpc {

/// A reference system in the words of OGC's WKT 1, as files beside pictures have it.
/// throws  Error for a code GDAL does not know
std::string crs_wkt(int epsg);

}  // namespace satsurf::rpc
