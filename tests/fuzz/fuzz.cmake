# SPDX-License-Identifier: Apache-2.0
# The fuzz targets, included by the root CMakeLists.txt with SATSURF_FUZZ. Of the project only what they need is compiled:
# cameras, readers, scenes, plans and weights; neither simulator nor training, nor most of the program.
if(NOT CMAKE_CXX_COMPILER_ID STREQUAL Clang)
  message(FATAL_ERROR "SATSURF_FUZZ: the compiler is ${CMAKE_CXX_COMPILER_ID}, expected Clang, which has libFuzzer")
endif()

# What files are read with: all that the short run of .ci/run compiles.
add_library(satsurf_fuzzed_readers STATIC
  ${PROJECT_SOURCE_DIR}/mesh/ply.cpp ${PROJECT_SOURCE_DIR}/scene/pointing_file.cpp ${PROJECT_SOURCE_DIR}/splat/ply.cpp)
foreach(room core rpc readers)
  target_sources(satsurf_fuzzed_readers PRIVATE $<TARGET_OBJECTS:satsurf_${room}>)
endforeach()
target_link_libraries(satsurf_fuzzed_readers PUBLIC satsurf_flags GDAL::GDAL)
target_include_directories(satsurf_fuzzed_readers PUBLIC ${PROJECT_SOURCE_DIR})

# What is made of them. The operators and their kernels are linked for the sake of the network that a file of weights
# makes; no file reaches them.
foreach(room ops ops_baseline ops_avx2 ops_avx512 splat_baseline splat_avx2 splat_avx512)
  set_target_properties(satsurf_${room} PROPERTIES SATSURF_LINKED_ONLY ON)
endforeach()
get_target_property(splat_sources satsurf_splat SOURCES)
list(REMOVE_ITEM splat_sources splat/ply.cpp)
get_target_property(scene_sources satsurf_scene SOURCES)
list(FILTER scene_sources EXCLUDE REGEX "^scene/(simulate/|pointing_file)")
set(fuzzed ${splat_sources} ${scene_sources} reconstruct/plan.cpp reconstruct/tile_cut.cpp reconstruct/tiling.cpp app/log.cpp app/record.cpp
    app/sha256.cpp app/tile_store.cpp)
list(TRANSFORM fuzzed PREPEND ${PROJECT_SOURCE_DIR}/)
add_library(satsurf_fuzzed STATIC ${fuzzed})
foreach(room nn ops ops_baseline ops_avx2 ops_avx512 splat_baseline splat_avx2 splat_avx512)
  target_sources(satsurf_fuzzed PRIVATE $<TARGET_OBJECTS:satsurf_${room}>)
endforeach()
target_link_libraries(satsurf_fuzzed PUBLIC satsurf_fuzzed_readers spdlog::spdlog fmt::fmt OpenSSL::Crypto)

# Comparisons of numbers in inner loops teach the search nothing and take half of the time of `cameras` and `scene`.
set(numeric rpc/fit.cpp rpc/frame.cpp rpc/model.cpp scene/believable_span.cpp scene/grey_pyramid.cpp scene/height_range.cpp scene/height_sweep.cpp scene/tie_points.cpp)
list(TRANSFORM numeric PREPEND ${PROJECT_SOURCE_DIR}/)
if(SATSURF_FUZZ STREQUAL sanitizers)
  set_source_files_properties(${numeric} PROPERTIES COMPILE_OPTIONS -fno-sanitize-coverage=trace-cmp)
endif()

set(satsurf_fuzz_link_sanitizers -fsanitize=address,undefined)
set(satsurf_fuzz_link_coverage -fprofile-instr-generate)
# One program per file; tests/fuzz/run.sh finds them by their names.
function(satsurf_fuzz_program name library)
  add_executable(fuzz_${name} ${PROJECT_SOURCE_DIR}/tests/fuzz/fuzz_${name}.cpp)
  target_link_libraries(fuzz_${name} PRIVATE ${library})
  target_link_options(fuzz_${name} PRIVATE ${satsurf_fuzz_link_${SATSURF_FUZZ}} ${ARGN})
endfunction()
foreach(target safetensors surfels_ply mesh_ply pointing camera_file satnerf raster sidecar dfc_grid area picture)
  satsurf_fuzz_program(${target} satsurf_fuzzed_readers -fsanitize=fuzzer)
endforeach()
foreach(target weights json tile dataset cameras scene)
  satsurf_fuzz_program(${target} satsurf_fuzzed -fsanitize=fuzzer)
endforeach()
# What targets begin with.
satsurf_fuzz_program(make_files satsurf_fuzzed_readers)
satsurf_fuzz_program(make_networks satsurf_fuzzed)
