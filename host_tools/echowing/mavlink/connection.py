"""What a connection is, for every verb's help: read without the MAVLink library."""

DEFAULT_BAUD = 57_600  # of telemetry radios and of ArduPilot's SERIAL1
CONN = (
    "udpin:PORT (on all addresses of this computer), udpin:HOST:PORT, udpout:HOST:PORT, "
    "tcp:HOST:PORT, tcpin:[HOST:]PORT or a serial device"
)
