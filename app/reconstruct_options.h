// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/app/program.h"
#include "satsurf/reconstruct/plan.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/scene/user_images.h"

#include <array>
#include <filesystem>
#include <string>
#include <vector>

namespace satsurf::app {

/// How mesh.ply is made: of the fused heights of all views, or not at all.
enum class MeshKind { tsdf, none };
/// What becomes of water: a level surface, or what was found.
enum class Water { level, found };
/// What becomes of untextured places in doubt: they go along with their rims, or what was found.
enum class Untextured { even, found };
/// What the heights of dsm.tif are above.
enum class Geoid { none, egm96, egm2008 };
/// The same for a raster.
inline rpc::HeightDatum datum_of(Geoid geoid) {
  if (geoid == Geoid::egm96) return rpc::HeightDatum::egm96;
  return geoid == Geoid::egm2008 ? rpc::HeightDatum::egm2008 : rpc::HeightDatum::ellipsoid;
}
/// How the run is told to people: as a page, or not at all.
enum class ReportKind { html, none };

}  // namespace satsurf::app

template <>
struct satsurf::EnumNames<satsurf::app::MeshKind> {
  static constexpr std::array names{"tsdf", "none"};
};
template <>
struct satsurf::EnumNames<satsurf::app::Water> {
  static constexpr std::array names{"level", "found"};
};
template <>
struct satsurf::EnumNames<satsurf::app::Untextured> {
  static constexpr std::array names{"even", "found"};
};
template <>
struct satsurf::EnumNames<satsurf::app::Geoid> {
  static constexpr std::array names{"none", "egm96", "egm2008"};
};
template <>
struct satsurf::EnumNames<satsurf::app::ReportKind> {
  static constexpr std::array names{"html", "none"};
};

namespace satsurf::app {

/// `--surface` of a reconstruction and of those that `evaluate` scores.
inline Field surface_field() {
  return {.help =
              "how the images' heights become one surface: refined by a surface network, plain (in "
              "each cell the densest mode, weighed by what the images say of one another) or "
              "splatted from above; automatic refines if the weights have such a network, else "
              "splats"};
}

/// What a surface depends on: a run's record repeats it, images included.
struct ReconstructConfig {
  std::vector<std::filesystem::path> images, image_dirs;
  std::vector<double> nodata;     ///< values that say nothing, besides those the files declare
  std::filesystem::path weights;  ///< empty for the shipped ones
  OptionalPair height_range;      ///< m above the ellipsoid
  Index max_views = scene::kMostViews;
  std::string pointing = "shift";  ///< "shift", "affine", "off" or a file
  reconstruct::Surface surface = reconstruct::Surface::automatic;
  Water water = Water::level;
  Untextured untextured = Untextured::even;
  double resolution = 0;     ///< m, 0 for the images' own
  std::string crs = "auto";  ///< of the rasters: "auto", a code, WKT or a string of PROJ
  Geoid geoid = Geoid::none;
  double min_coverage = 0;  ///< share of the common ground that must have a height
  Index max_surfels = 0;    ///< of surfels.ply, 0 for all
  MeshKind mesh = MeshKind::tsdf;
  double voxel = 0;                 ///< of the mesh, m; 0 for two pixels on the ground
  std::vector<double> bbox;         ///< west, south, east, north in degrees; empty for all ground
  std::filesystem::path aoi;        ///< polygons around the ground wanted; empty for all
  std::filesystem::path mask;       ///< ground that is not wanted; empty for none
  std::vector<double> mask_values;  ///< of a raster; empty for all but 0 and nodata
  std::filesystem::path dem;        ///< model of the terrain that says the heights; empty for none
  std::string max_memory;           ///< of the program, e.g. "4GB"; empty for any
  ReportKind report = ReportKind::html;

  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("images", s.images,
      Field{.help = "rasters or Sat-NeRF JSON files, two or more, see --max-views; all of them "
                    "here or all in the "
                    "file of --config",
            .flag = "images",
            .placeholder = "IMG"});
    v("image_dirs", s.image_dirs,
      Field{.help = "where else to look for the images JSON files name",
            .flag = "--image-dir",
            .placeholder = "DIR"});
    v("nodata", s.nodata,
      Field{.help = "values of pixels that say nothing, where every band has one; borders of one "
                    "value are found without being named",
            .automatic = "what the files declare"});
    v("weights", s.weights,
      Field{.help = "network weights", .automatic = "the shipped ones, or SATSURF_WEIGHTS"});
    v("max_views", s.max_views,
      Field{.help = "most images that are used for one place; of more, those that go best together "
                    "by their common ground, parallax, suns and dates: of all the ground, or of "
                    "each tile of large images, which may have 16 between them",
            .min = 2,
            .max = 16,
            .flag = "--max-views"});
    v("height_range", s.height_range,
      Field{.help = "heights above the ellipsoid to search",
            .unit = "m",
            .min = -12000,
            .max = 10000,
            .automatic = "of --dem, else from metadata, else found",
            .flag = "--height-range",
            .placeholder = "LOW HIGH"});
    v("pointing", s.pointing,
      Field{.help = "cameras that disagree: `shift` measures it and shifts each image's where one "
                    "is off by more than 0.3 px, `affine` by what changes linearly within each "
                    "image, for long images, `off` takes them as they are, a FILE "
                    "(pointing.json of a run) says the shifts",
            .placeholder = "shift|affine|off|FILE"});
    v("surface", s.surface, surface_field());
    v("water", s.water,
      Field{
          .help =
              "what becomes of water, and of other areas of 2000 m² and more where no image tells "
              "the height: level gives them the height of their shore where that is level, found "
              "leaves what was found; of refined surfaces"});
    v("untextured", s.untextured,
      Field{.help = "what becomes of roofs and sealed ground without texture, whose heights the "
                    "images do not tell: even lets what is in doubt go along with the sure heights "
                    "around it, as far as the colour goes, found leaves what was found; of refined "
                    "surfaces"});
    v("resolution", s.resolution,
      Field{.help = "cell of the surface",
            .unit = "m",
            .min = 0.01,
            .max = 1000,
            .automatic = "size of a pixel on the ground"});
    v("crs", s.crs,
      Field{.help = "system of dsm.tif and the other rasters: a code such as EPSG:31370, WKT or a "
                    "string of PROJ, projected, in metres; `auto` is the UTM zone of the images. "
                    "Pictures, mesh and surfels stay in that zone, --bbox in degrees",
            .placeholder = "auto|CRS"});
    v("geoid", s.geoid,
      Field{.help =
                "heights of dsm.tif above this geoid instead of the ellipsoid, its system then a "
                "compound one; PROJ has to have its grid (Debian's proj-data: egm96). All else "
                "stays above the ellipsoid"});
    v("min_coverage", s.min_coverage,
      Field{.help =
                "share of the images' common ground that must have a height; with less the files "
                "are written all the same, and the exit code is 1",
            .min = 0,
            .max = 1,
            .flag = "--min-coverage"});
    v("max_surfels", s.max_surfels,
      Field{.help = "most surfels that surfels.ply may hold; fewer are larger, and the rasters and "
                    "the mesh are made of all",
            .min = 1,
            .automatic = "all",
            .flag = "--max-surfels"});
    v("mesh", s.mesh,
      Field{.help = "how to make mesh.ply: of the fused heights of all views (of what is made in "
                    "tiles, between the heights of at most a million cells), or not at all"});
    v("voxel", s.voxel,
      Field{.help = "detail of the mesh",
            .unit = "m",
            .min = 0.01,
            .max = 1000,
            .automatic = "two pixels on the ground"});
    v("bbox", s.bbox,
      Field{.help =
                "only this part of the ground: west, south, east and north, with west above east "
                "across the antimeridian; only what shows it is read",
            .unit = "deg",
            .min = -180,
            .max = 180,
            .automatic = "all that two images see",
            .flag = "--bbox",
            .placeholder = "W,S,E,N"});
    v("aoi", s.aoi,
      Field{.help = "only the ground inside the polygons of this vector file, in any reference "
                    "system (GeoJSON, GeoPackage, shapefile, KML and alike)",
            .automatic = "all that two images see",
            .flag = "--aoi"});
    v("mask", s.mask,
      Field{.help =
                "ground that is not wanted, water or clouds: polygons of a vector file, or the "
                "cells of a raster that are neither 0 nor nodata, see --mask-values, in any "
                "reference system. It "
                "stays nodata in all files, and its heights do not count where the height "
                "range is found. Rasters of DFC2019 have their place in a text file beside them",
            .automatic = "none",
            .placeholder = "FILE"});
    v("mask_values", s.mask_values,
      Field{.help = "values of the --mask raster that are not wanted, of one with classes: 9 is "
                    "water and 17 are bridges in DFC2019",
            .automatic = "all but 0 and nodata",
            .flag = "--mask-values",
            .placeholder = "VALUE"});
    v("dem", s.dem,
      Field{.help = "a raster of terrain heights in m, in any reference system: the heights to "
                    "search are its own over the images' ground and 20 m below to 80 m above, tile "
                    "by tile. A compound system says what its heights are above; without one they "
                    "may be above the ellipsoid or EGM96",
            .automatic = "none",
            .placeholder = "FILE"});
    v("max_memory", s.max_memory,
      Field{
          .help =
              "memory that the program may take, e.g. 4GB: the tiles that large images are "
              "worked on in are as large as it allows, and 2048 px at most; small images are, too, "
              "where their surface would take more, and a mesh that would is left out",
          .automatic = "tiles of 1280 px",
          .flag = "--max-memory",
          .placeholder = "SIZE"});
    v("report", s.report,
      Field{.help = "how to tell people of the run: report.html, one page that opens from disk, or "
                    "not at all"});
  }
};

/// What `reconstruct` is asked.
struct ReconstructCommand : ReconstructConfig {
  std::filesystem::path out, config_file;  ///< config_file may be empty
  bool overwrite = false;
  bool resume = false;   ///< go on with the tiles that a stopped run has left
  bool dry_run = false;  ///< only say what would be done; `out` may be empty

  /// Of the options those that are no configuration.
  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("out", s.out,
      Field{.help = "folder to make (required unless --dry-run or --print-config)",
            .placeholder = "DIR"});
    v("overwrite", s.overwrite,
      Field{.help = "replace what an earlier run left in that folder", .flag = "--overwrite"});
    v("resume", s.resume,
      Field{.help = "go on with the tiles of large images that a stopped or killed run has left in "
                    "OUT.tiles, to the same bytes; the run must be the same",
            .flag = "--resume"});
    v("dry_run", s.dry_run,
      Field{.help = "read everything, say ground, cells, tiles, memory and time, write nothing",
            .flag = "--dry-run"});
  }
};

/// The files in its folder.
inline std::vector<WrittenFile> written_by_reconstruct() {
  return {
      {"dsm.tif",
       "heights above the WGS84 ellipsoid or the --geoid, m, Float32, UTM or --crs, nodata -9999; "
       "the "
       "grid's corner is "
       "a whole multiple of its cell; as all rasters here a cloud-optimised GeoTIFF"},
      {"confidence.tif",
       "confidence of the surface, 0 to 1, on the same grid, Float32, nodata -9999"},
      {"height_sigma.tif",
       "expected error of the heights, m, on the same grid: some seven in ten are within it "
       "and "
       "more than nine in ten within twice as much; only of a refined surface"},
      {"views.tif",
       "how many images see the cell, those not counted from which the surface hides it, on the "
       "same grid, nodata 255"},
      {"ortho.tif",
       "every cell as the steepest image that sees it shows it, where two others outvote that (a "
       "cloud) as the next steepest, on the same grid: the bands that the network saw as red, "
       "green and blue, or the one of grey images, in the images' "
       "own 8 or 16 bits; nodata 0, where no image sees the cell, which may have a height all the "
       "same"},
      {"surfels.ply",
       "the surface as Gaussian surfels in a local metric frame, which the header names"},
      {"mesh.ply", "the surface as triangles with colours, in the same frame; see --mesh"},
      {"height.png",
       "map of the heights above the ellipsoid, dark low and bright high, with a legend below"},
      {"hillshade.png", "map of the surface lit from the north-west"},
      {"confidence.png", "map of the confidence, dark low and bright high, with a legend below"},
      {"*.pgw, *.png.aux.xml", "where these maps lie and in which system, for GIS programs"},
      {"views/NAME_source.png", "every image, as the network sees it"},
      {"views/NAME_render.png", "the surface rendered into its camera"},
      {"pointing.json",
       "how the cameras agree and their shifts, for --pointing; see docs/pointing.md"},
      {"report.html",
       "all of it on one page: maps with legends, the surface to turn with the mouse, inputs, "
       "residuals, warnings; it needs no network; see --report"},
      {"run.json", "the record of the run"}};
}

/// The `results` of its record.
inline std::vector<WrittenFile> told_by_reconstruct() {
  return {
      {"completeness",
       "share of the cells of the images' common ground, what --mask covers not counted, that have "
       "a height"},
      {"cells", "rows and columns of the rasters"},
      {"resolution", "side of a cell, m"},
      {"crs", "system of dsm.tif and the other rasters: its code, or its name where it has none"},
      {"frame_crs", "EPSG code of the UTM zone of all else"},
      {"vertical_datum", "of the heights in dsm.tif"},
      {"height_range",
       "lowest and highest height that were asked for or found, m above the "
       "ellipsoid"},
      {"height_range_source", "where it came from"},
      {"height_range_searched", "what was searched of it: less where it was generous"},
      {"pointing",
       "applied, verdict, ties, across_before and across_after (px, mean over the tie points), "
       "largest_shift (px); null with --pointing off"},
      {"lowest, highest", "of the surface, m above the ellipsoid"},
      {"mean_confidence", "0 to 1"},
      {"levelled_area",
       "m² that got the height of their shore, see --water; where tiles overlap, of each"},
      {"evened_area", "m² in doubt and without texture, see --untextured; alike"},
      {"image_correlation",
       "-1 to 1, mean of every two images where they show the surface: wrong cameras and heights "
       "lower it; small differences decide nothing"},
      {"height_agreement",
       "0 to 1: how often two images found the same height at the same place, to a pixel of "
       "parallax "
       "(0.5 to 2.5 m), before one surface was made of them; places that one of them does not see "
       "count as disagreement. Null of a splatted surface"},
      {"surfels", "how many"},
      {"images",
       "of each image: name, bands, type, rgb_bands (counted from 1), stretch (values that "
       "became black and white: 0 and 255 of uint8, else the 1st and 99th percentile of the "
       "valid pixels), border (share that was left out as one)"},
      {"left_out", "of each image that was not used: image, why"},
      {"tiles", "in how many parts the work was done"},
      {"camera_fit_max_px", "how well the cameras were fitted, px"},
      {"planned_memory_bytes", "what the plan foresaw"},
      {"memory_by_part",
       "of each part of the work, where it was done as a whole: part, bytes, planned_bytes"},
      {"tile_table",
       "only of large images and parts of the ground: of each tile row, column, ground (least "
       "easting, least northing, largest easting, largest northing), corners (of a turned tile; "
       "easting, northing), status (done, empty: fewer "
       "than two images see it, failed), seconds, completeness, and of those done "
       "height_range_searched, window (rows and columns, px), surfels and images (names); of those "
       "failed error"},
      {"mesh", "voxel (m), vertices, faces, seconds; null without one"},
      {"reconstruct_seconds", "how long the surface took without reading and writing"}};
}

}  // namespace satsurf::app
