# SPDX-License-Identifier: Apache-2.0
# Installs BUILD into WORK, builds the examples with what is there as a project of their own, and runs them: through
# find_package, and one of each library through pkg-config.
#   cmake -DBUILD=... -DWORK=... -DLIBRARY=ON|OFF -DGENERATOR=... -DCONFIG=... -DCXX=... -DFLAGS=... -P examples.cmake
# LIBRARY: more than the engine was built.
cmake_minimum_required(VERSION 3.25)
set(source ${CMAKE_CURRENT_LIST_DIR}/../examples)
set(prefix ${WORK}/prefix)
# Runs a command whose output nobody wants unless it fails.
function(quietly)
  execute_process(COMMAND ${ARGN} RESULT_VARIABLE result OUTPUT_VARIABLE output ERROR_VARIABLE output)
  if(NOT result EQUAL 0)
    list(JOIN ARGN " " command)
    message(FATAL_ERROR "${command}: ${result}\n${output}")
  endif()
endfunction()
set(components engine)
set(examples own_operator fit_surfels)
set(by_pkg_config own_operator:satsurf-engine)
if(LIBRARY)
  list(APPEND components library)
  list(APPEND examples train_on_samples reconstruct_in_memory)
  list(APPEND by_pkg_config train_on_samples:satsurf)
endif()

file(REMOVE_RECURSE ${WORK})
file(MAKE_DIRECTORY ${WORK})
foreach(component ${components})
  quietly(${CMAKE_COMMAND} --install ${BUILD} --prefix ${prefix} --component ${component}
                          --config ${CONFIG})
endforeach()
quietly(${CMAKE_COMMAND} -G ${GENERATOR} -S ${source} -B ${WORK}/build
                        -DCMAKE_BUILD_TYPE=${CONFIG} -DCMAKE_PREFIX_PATH=${prefix}
                        -DCMAKE_CXX_COMPILER=${CXX} -DCMAKE_CXX_FLAGS=${FLAGS})
quietly(${CMAKE_COMMAND} --build ${WORK}/build --config ${CONFIG})
foreach(example ${examples})
  message(STATUS ${example})
  execute_process(COMMAND ${WORK}/build/${example} WORKING_DIRECTORY ${WORK} COMMAND_ERROR_IS_FATAL ANY)
endforeach()

find_program(PKG_CONFIG pkg-config)
if(PKG_CONFIG)
  file(GLOB_RECURSE pc ${prefix}/*/satsurf-engine.pc)
  cmake_path(GET pc PARENT_PATH folder)
  separate_arguments(flags UNIX_COMMAND "${FLAGS}")
  foreach(pair ${by_pkg_config})
    string(REPLACE ":" ";" pair ${pair})
    list(GET pair 0 example)
    list(GET pair 1 package)
    message(STATUS "${example} by pkg-config ${package}")
    execute_process(COMMAND ${CMAKE_COMMAND} -E env PKG_CONFIG_PATH=${folder}
                            ${PKG_CONFIG} --cflags --libs ${package}
                    OUTPUT_VARIABLE arguments OUTPUT_STRIP_TRAILING_WHITESPACE COMMAND_ERROR_IS_FATAL ANY)
    separate_arguments(arguments UNIX_COMMAND "${arguments}")
    quietly(${CXX} -std=c++20 ${flags} ${source}/${example}.cpp -o ${WORK}/by-pkg-config
                            ${arguments} -Wl,-rpath,${folder}/..)
    quietly(${WORK}/by-pkg-config)
  endforeach()
endif()
