// SPDX-License-Identifier: Apache-2.0
#pragma once

/// Everything that is installed: satsurf::engine, and where it is there, satsurf::satsurf. Programs
/// that build fast include the few headers they need.
#include "satsurf/engine.h"

#if __has_include("satsurf/reconstruct/reconstruct.h")
#include "satsurf/evaluate/confidence.h"
#include "satsurf/evaluate/evaluate.h"
#include "satsurf/evaluate/fill.h"
#include "satsurf/evaluate/image_metrics.h"
#include "satsurf/evaluate/metrics.h"
#include "satsurf/evaluate/table.h"
#include "satsurf/mesh/compare.h"
#include "satsurf/mesh/ply.h"
#include "satsurf/mesh/surface.h"
#include "satsurf/mesh/tsdf.h"
#include "satsurf/reconstruct/laid_surfels.h"
#include "satsurf/reconstruct/ortho.h"
#include "satsurf/reconstruct/reconstruct.h"
#include "satsurf/reconstruct/rendered_view.h"
#include "satsurf/reconstruct/warnings.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/rpc/read.h"
#include "satsurf/scene/crop.h"
#include "satsurf/scene/dataset.h"
#include "satsurf/scene/height_range.h"
#include "satsurf/scene/image_in_memory.h"
#include "satsurf/scene/pointing.h"
#include "satsurf/scene/pointing_file.h"
#include "satsurf/scene/scene.h"
#include "satsurf/scene/simulate/scene.h"
#include "satsurf/scene/user_images.h"
#include "satsurf/scene/validity.h"
#include "satsurf/scene/view_geometry.h"
#include "satsurf/train/mono_trainer.h"
#include "satsurf/train/surface_trainer.h"
#include "satsurf/train/trainer.h"
#endif
