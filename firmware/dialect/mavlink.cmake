# Generates the MAVLink C headers from the one dialect, where the sketch and every other build
# find them. Needs PYTHON (with pymavlink) and FIRMWARE.
set(MAVLINK_HEADERS ${FIRMWARE}/echowing/src/mavlink)
add_custom_command(
  OUTPUT ${MAVLINK_HEADERS}/echowing/mavlink.h
  COMMAND ${PYTHON} -m pymavlink.tools.mavgen --lang C --wire-protocol 2.0
          --output ${MAVLINK_HEADERS} ${FIRMWARE}/dialect/echowing.xml
  DEPENDS ${FIRMWARE}/dialect/echowing.xml
  COMMENT "MAVLink headers from echowing.xml"
  VERBATIM)
add_custom_target(mavlink_headers DEPENDS ${MAVLINK_HEADERS}/echowing/mavlink.h)
