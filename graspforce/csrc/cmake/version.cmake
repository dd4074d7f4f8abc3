# Read the version of the library from include/graspforce/version.h.
function(graspforce_read_version result)
  file(STRINGS "${CMAKE_CURRENT_FUNCTION_LIST_DIR}/../include/graspforce/version.h" line REGEX "define GF_VERSION +\"")
  string(REGEX REPLACE ".*\"([0-9.]+)\".*" "\\1" version "${line}")
  set(${result} "${version}" PARENT_SCOPE)
endfunction()
