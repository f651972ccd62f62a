// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"
#include "satsurf/rpc/raster.h"

namespace satsurf::rpc {

/// Heights of a geoid above the WGS84 ellipsoid, m, by the grids that come with PROJ (Debian's
/// proj-data has that of EGM96).
/// geoid     egm96 or egm2008
/// lon_lat   degrees on WGS84, one pair for each result
/// throws    IoError where PROJ finds no grid of the geoid, and for positions that its grid does not
///           hold; Error for a datum that is no geoid
std::vector<double> geoid_heights(HeightDatum geoid,
                                  const std::vector<std::array<double, 2>>& lon_lat);

/// Makes heights above the ellipsoid those above a geoid, which is taken to be smooth within 64
/// cells.
/// heights  [H W] m, NaN where unknown
/// grid     of the heights; its system is a zone of UTM
/// throws   as `geoid_heights`; Error for a grid in another system
void refer_to_geoid(Tensor& heights, const GeoGrid& grid, HeightDatum geoid);

}  // namespace satsurf::rpc
