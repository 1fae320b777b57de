# SPDX-License-Identifier: Apache-2.0
# Read right after project() when the package is built upon wheels, by pip or by colcon.

# The wheels' CMake targets name include directories of the machine that built them. CMake refuses
# a target with a directory that does not exist, so drop those before anything is generated.
function(microhand_drop_missing_include_directories)
  get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(directories ${target} INTERFACE_INCLUDE_DIRECTORIES)
    if(NOT directories)
      continue()
    endif()
    set(kept "")
    foreach(directory IN LISTS directories)
      if(directory MATCHES "^\\$<" OR EXISTS "${directory}")
        list(APPEND kept "${directory}")
      endif()
    endforeach()
    set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${kept}")
  endforeach()
endfunction()

if(CMAKE_SOURCE_DIR STREQUAL CMAKE_CURRENT_SOURCE_DIR)
  cmake_language(DEFER CALL microhand_drop_missing_include_directories)
endif()

if(SKBUILD)
  # Any Python of the environment finds the interfaces of the ament index without a setup script.
  install(FILES ${CMAKE_CURRENT_LIST_DIR}/microhand_msgs_py.pth DESTINATION ${SKBUILD_PLATLIB_DIR})
endif()
