# SPDX-License-Identifier: Apache-2.0
# Holds docs/reference.md against what the program says of itself.
#   cmake -DPROGRAM=... -DFILE=docs/reference.md -P reference.cmake
execute_process(COMMAND ${PROGRAM} help --markdown OUTPUT_VARIABLE said COMMAND_ERROR_IS_FATAL ANY)
file(READ ${FILE} written)
if(NOT said STREQUAL written)
  message(FATAL_ERROR "${FILE} is not what the program says; write it anew with: ${PROGRAM} help --markdown >${FILE}")
endif()
