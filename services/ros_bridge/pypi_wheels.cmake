# Read at the start of the build of curobo_msgs against the ROS packages of PyPI; see build_messages.py.
#
# Those wheels were built elsewhere, and libraries of their Python generators name directories of that machine, which
# CMake would refuse. They are taken out as soon as the libraries are known, which is before the package asks for them itself.
find_package(ament_cmake REQUIRED)
find_package(action_msgs REQUIRED)
find_package(geometry_msgs REQUIRED)
find_package(sensor_msgs REQUIRED)
find_package(std_msgs REQUIRED)
get_property(imported DIRECTORY PROPERTY IMPORTED_TARGETS)
foreach(target ${imported})
  if(target MATCHES "__rosidl_generator_py$")
    set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "")
  endif()
endforeach()
