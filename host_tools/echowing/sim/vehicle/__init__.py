"""The replica of ArduCopter: how it flies, what it answers on MAVLink, and its scripting engine."""
