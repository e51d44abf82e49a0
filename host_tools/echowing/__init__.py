"""Formation flight for small ArduPilot copters, held together by a cheap sonar."""

__version__ = "0.2.0"
