"""Where a sonar's gimbal points. Pure."""

import math

# Gimbal straight ahead (thesis Appendix A, channels 6 and 7; the co-processor's PAN_MIDDLE).
PAN_CENTRE_US = 1380.0
TILT_CENTRE_US = 1400.0
# Usual for hobby servos (1000 us over about 90-100 degrees); the thesis gives none. The
# co-processor's PAN_US_DEG.
SERVO_US_PER_DEG = 10.0


def pan_rad(pan_us: float) -> float:
    """How far right of straight ahead the gimbal points, with the co-processor's defaults."""
    return math.radians((pan_us - PAN_CENTRE_US) / SERVO_US_PER_DEG)
