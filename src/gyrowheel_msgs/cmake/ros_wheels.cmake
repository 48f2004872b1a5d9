# Only used when pip builds this package against the PyPI "ros-*" wheels
# (pyproject.toml passes it as CMAKE_PROJECT_TOP_LEVEL_INCLUDES); colcon never
# sees it.
#
# 1. The wheels unpack share/, lib/ and include/ into the prefix of the
#    environment; under pip's build isolation that is a temporary one which
#    only sys.path knows: find it from an installed module.
if(NOT Python3_EXECUTABLE)
  find_program(Python3_EXECUTABLE NAMES python3 REQUIRED)
endif()
execute_process(
  COMMAND "${Python3_EXECUTABLE}" -c
    "import pathlib, ament_package as m; print(pathlib.Path(m.__file__).parents[4])"
  OUTPUT_VARIABLE _ros_prefix
  OUTPUT_STRIP_TRAILING_WHITESPACE
  COMMAND_ERROR_IS_FATAL ANY
)
message(STATUS "ROS wheels prefix: ${_ros_prefix}")
list(PREPEND CMAKE_PREFIX_PATH "${_ros_prefix}")
set(ENV{AMENT_PREFIX_PATH} "${_ros_prefix}")

# 2. Their exported <pkg>__rosidl_generator_py targets carry include directories
#    of the machine the wheels were built on (their builder's python).
#    Drop those that do not exist once the directory is processed.
function(_ros_wheels_drop_missing_includes)
  get_property(_targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(_target IN LISTS _targets)
    get_target_property(_dirs ${_target} INTERFACE_INCLUDE_DIRECTORIES)
    if(NOT _dirs)
      continue()
    endif()
    set(_keep)
    foreach(_dir IN LISTS _dirs)
      if(_dir MATCHES "[$]<" OR EXISTS "${_dir}")
        list(APPEND _keep "${_dir}")
      endif()
    endforeach()
    set_property(TARGET ${_target} PROPERTY INTERFACE_INCLUDE_DIRECTORIES "${_keep}")
  endforeach()
endfunction()
cmake_language(DEFER DIRECTORY "${CMAKE_SOURCE_DIR}" CALL _ros_wheels_drop_missing_includes)
