# SPDX-License-Identifier: Apache-2.0
# Writes the commit that is being built into a header, `-dirty` behind it where files differ from it; run at each build,
# touches the header only for another text.
#   cmake -DSOURCE=folder -DHEADER=file -P git_hash.cmake
cmake_minimum_required(VERSION 3.25)
execute_process(COMMAND git -C ${SOURCE} describe --always --dirty --abbrev=40 "--exclude=*"
                OUTPUT_VARIABLE hash OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET RESULT_VARIABLE failed)
if(failed)
  set(hash unknown)
endif()
file(CONFIGURE OUTPUT ${HEADER} CONTENT "#define SATSURF_GIT_HASH \"@hash@\"\n" @ONLY)
