"""What the range of a sonar means. Pure."""

# From where a range is no target (thesis 3.3.3: an X8 gives a consistent return out to 4.5 m).
DETECTION_LIMIT_M = 4.5
