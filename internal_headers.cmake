# SPDX-License-Identifier: Apache-2.0
# Headers below app that users of the libraries do not get, as regular expressions over "/ROOM/FILE": for install()
# and for tests/layers.cmake.
set(satsurf_internal_headers
  "_kernels\\.h$"
  "/core/(box_filters|simd|fields_json|files|hash|memory_limits|whole)\\.h$"
  "/ops/weighted_sum\\.h$" "/ops/window_correlation\\.h$"
  "/ops/conv/(axes|engine|kernels|slab|weights|winograd)\\.h$"
  "/splat/bin\\.h$"
  "/rpc/(camera_check|gdal|picture)\\.h$"
  "/nn/(parameter_limit|shown_pixel|squeezed)\\.h$"
  "/mesh/(geometry|sampled_view)\\.h$"
  "/scene/(believable_span|grey_pyramid|height_sweep|ray_walk|satnerf|sight_lines|whu)\\.h$"
  "/scene/simulate/(city|conditions|develop|draw|dress|given|layout|natural|noise|orbit|render|texture)\\.h$"
  "/reconstruct/(cast|cell_count|cell_links|cell_mode|cell_slopes|cell_surfels|cross_check|fusion|horizon|level_water|narrow|quantile|shown_place|surface_input|tile_cut|trust|untextured)\\.h$"
  "/train/(draw|sample_batch)\\.h$"
  "/evaluate/score_views\\.h$")
# Of the readers' room the engine has the cameras alone.
set(satsurf_reader_headers "/rpc/(area|crs|drivers|geoid|ground_raster|raster|read|warp)\\.h$")
