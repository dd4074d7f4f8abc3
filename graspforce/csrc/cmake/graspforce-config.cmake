# find_package(graspforce) from the Python package: builds the C library from its sources as a part of the calling project.
#
#     cmake -S . -B build -Dgraspforce_DIR="$(python -c 'import graspforce; print(graspforce.get_cmake_dir())')"
if(NOT TARGET graspforce::graspforce)
  add_subdirectory("${CMAKE_CURRENT_LIST_DIR}/.." "${CMAKE_BINARY_DIR}/graspforce-from-source" EXCLUDE_FROM_ALL)
endif()
