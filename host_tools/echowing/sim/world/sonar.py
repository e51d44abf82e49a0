"""The gimballed MaxBotix sonar: what it hears, its servos, and its manners on the I2C bus.

One model for the flight simulator and for the emulated board. Figures are from the datasheet
PD11848 and thesis Table 5 unless a line says otherwise.
"""

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from echowing.analysis.thesis import TABLE_5
from echowing.flight.belief import Curve
from echowing.flight.sonar import PAN_CENTRE_US, SERVO_US_PER_DEG, TILT_CENTRE_US
from echowing.geo import Ned

# 0.12 s for 60 degrees: an ordinary micro servo at 5 V.
SERVO_SLEW_DPS = 500.0
# From the end of a pulse until the motor moves: its controller compares each pulse with the last
# one, and the motor has to start (assumed; no maker gives it). The frame of 20 ms, in which a new
# pulse is waited for, is a board's pin's or the world's step.
SERVO_DEAD_TIME_S = 0.005
# Play of gears and linkage: the axis stops half of it short of where it comes from (assumed; a
# worn micro servo has a degree).
SERVO_PLAY_DEG = 1.0

SHORTEST_M = 0.20
LONGEST_M = 7.65
SPEED_OF_SOUND_MPS = 343.0
# "40 Hz possible for near targets": 25 ms in all for a target under a metre.
PROCESSING_US = 20_000
# A wall met squarely is heard this far, though reported only up to 7.65 m: the rest are the late
# echoes that come back into a later reading.
SURFACE_RANGE_M = 10.0
# What a ping sends out has died away after this long, the datasheet's pause between readings (an
# echo from 17 m).
SOUND_DIES_S = 0.1
# Sonar face before the axes of its gimbal. The leader's reflecting legs (Fig. 26) are around its
# centre: the sonar reads less than the separation by this, by their distance, and by the boom.
LEVER_ARM_M = 0.10
# The tone of another sonar is there for so long, on average.
TONE_S = 1.0
# What gives a late echo stays before the sonar for so long (assumed).
LATE_S = 1.0
# Near its limit an echo comes and goes: from sure to never within so much either side.
FADES_SHARE = 0.05
# Nothing is lost, whatever it depends on.
ALL = Curve((0.0,), (1.0,))

DEFAULT_ADDRESS = 0x70
COMMAND_RANGE = 0x51
COMMAND_CHANGE = (0xAA, 0xA5)
REFUSED_ADDRESSES = (0, 80, 164, 170)
# What a read gives before the first command: part information, not a distance.
PART_INFORMATION = b"\x12\x02"


@dataclass(frozen=True, slots=True)
class TrueSonar:
    """A sonar as it is, whatever anybody believes of it.

    heard: share of its pings that bring an echo from the axis, over the range. half_rad: half angle
    of its beam for a vehicle, over the range; edge_rad: over this angle the beam begins. noise_m:
    standard deviation of a range. wild_share: of its readings that are anything at all, by
    propeller noise or otherwise. late_share: of them that are an echo of the ping before, off
    something beyond all ranges. stock_m, foil_m: how far an X8 without and with foil on its legs is
    heard. inset_m: how much less than the separation it reads straight ahead; boom_m: how far ahead
    of its vehicle's centre its gimbal is. deaf_share, deaf_s: share of the time in which it hears
    nothing, and how long that lasts on average. tone_share: share of the time in which the tone of
    a stranger's sonar reaches it. left: what propellers leave of the share heard, over the throttle
    (0 to 1).
    """

    heard: Curve
    half_rad: Curve
    edge_rad: float = 0.0
    noise_m: float = 0.01
    wild_share: float = 0.01
    late_share: float = 0.0
    stock_m: float = TABLE_5["MB1202"].stock_m
    foil_m: float = TABLE_5["MB1202"].foil_m
    inset_m: float = 0.2
    boom_m: float = 0.0
    deaf_share: float = 0.0
    deaf_s: float = 1.0
    tone_share: float = 0.0
    left: Curve = ALL

    @property
    def legs_m(self) -> float:
        """How far around a leader's centre the legs are that it hears."""
        return max(0.0, self.inset_m - self.boom_m - LEVER_ARM_M)

    @property
    def widest_rad(self) -> float:
        """Half angle of its beam for what is large: a wall, another sonar's tone."""
        return max(self.half_rad.values)

    def share(self, range_m: float, off_rad: float, widest_rad: float = math.inf) -> float:
        """Share of its pings that bring an echo from there; `widest_rad`: no beam is wider."""
        beyond_rad = off_rad - min(widest_rad, self.half_rad.at(range_m))
        if self.edge_rad == 0.0:
            return self.heard.at(range_m) if beyond_rad <= 0.0 else 0.0
        # Ten edges outside nothing is left of it.
        steps = min(20.0, beyond_rad / (0.5 * self.edge_rad))
        return self.heard.at(range_m) / (1.0 + math.exp(steps))


# One on a desk, without propellers: it hears all that is in its beam. Twenty degrees is what the
# ArduCopter SITL formation flights were flown with.
ON_A_DESK = TrueSonar(heard=ALL, half_rad=Curve((0.0,), (math.radians(20.0),)))


@dataclass(slots=True)
class Pose:
    """Where a sonar's gimbal is (NED metres), and the unit vector along which it looks.

    beam_half_angle_rad: the beam is nowhere wider. throttle: of its vehicle, 0 to 1.
    """

    position_ned_m: Ned
    axis_ned: Ned
    beam_half_angle_rad: float = ON_A_DESK.widest_rad
    throttle: float = 0.0


@dataclass(frozen=True, slots=True)
class Target:
    """A vehicle to be heard: centre, how far it is heard, and how far out its legs are."""

    position_ned_m: Ned
    heard_to_m: float = ON_A_DESK.foil_m
    radius_m: float = ON_A_DESK.inset_m - LEVER_ARM_M


@dataclass(frozen=True, slots=True)
class Surface:
    """A flat surface: a point on it and its unit normal towards the vehicles, NED."""

    point_ned_m: Ned
    normal_ned: Ned


GROUND = Surface((0.0, 0.0, 0.0), (0.0, 0.0, -1.0))


class Servo:
    """What a servo makes of its pulses: a dead time, a limited rate, and play at the axis."""

    def __init__(self) -> None:
        self.axis_deg = 0.0
        self._gear_deg = 0.0
        self._goal_deg = 0.0
        self._coming: list[tuple[float, float]] = []  # until it counts, and the goal

    def step(self, dt_s: float, pulse_deg: float) -> None:
        """Move for `dt_s`, in which the pulses say `pulse_deg`."""
        newest_deg = self._coming[-1][1] if self._coming else self._goal_deg
        if pulse_deg != newest_deg:
            self._coming.append((SERVO_DEAD_TIME_S, pulse_deg))
        while self._coming and self._coming[0][0] <= dt_s:
            wait_s, goal_deg = self._coming.pop(0)
            self._move(wait_s)
            self._goal_deg = goal_deg
            dt_s -= wait_s
            self._wait(wait_s)
        self._wait(dt_s)
        self._move(dt_s)

    def _wait(self, span_s: float) -> None:
        self._coming = [(wait_s - span_s, goal_deg) for wait_s, goal_deg in self._coming]

    def _move(self, dt_s: float) -> None:
        self._gear_deg = _approach(self._gear_deg, self._goal_deg, SERVO_SLEW_DPS * dt_s)
        play_deg = SERVO_PLAY_DEG / 2.0
        least_deg, most_deg = self._gear_deg - play_deg, self._gear_deg + play_deg
        self.axis_deg = max(least_deg, min(most_deg, self.axis_deg))


class Gimbal:
    """Pan and tilt servos.

    Pan turns right and tilt turns up with longer pulses. Angles are in degrees off straight
    ahead.
    """

    def __init__(self) -> None:
        self._pan = Servo()
        self._tilt = Servo()
        self.jammed = False

    @property
    def pan_deg(self) -> float:
        """Where the axis is, to the right."""
        return self._pan.axis_deg

    @property
    def tilt_deg(self) -> float:
        """Where the axis is, up."""
        return self._tilt.axis_deg

    def step(self, dt_s: float, pan_us: float, tilt_us: float) -> None:
        """Move for `dt_s` towards the pulses in force, unless jammed."""
        if self.jammed:
            return
        self._pan.step(dt_s, (pan_us - PAN_CENTRE_US) / SERVO_US_PER_DEG)
        self._tilt.step(dt_s, (tilt_us - TILT_CENTRE_US) / SERVO_US_PER_DEG)

    def axis_body(self) -> Ned:
        """Unit vector of the beam, forward-right-down."""
        pan, tilt = math.radians(self.pan_deg), math.radians(self.tilt_deg)
        return math.cos(tilt) * math.cos(pan), math.cos(tilt) * math.sin(pan), -math.sin(tilt)


def _approach(value: float, wanted: float, most: float) -> float:
    return value + max(-most, min(most, wanted - value))


def body_to_ned(vector: Ned, roll_rad: float, pitch_rad: float, yaw_rad: float) -> Ned:
    """Rotate a body vector (forward-right-down) into NED by the usual yaw-pitch-roll angles."""
    x, y, z = vector
    sin_r, cos_r = math.sin(roll_rad), math.cos(roll_rad)
    sin_p, cos_p = math.sin(pitch_rad), math.cos(pitch_rad)
    sin_y, cos_y = math.sin(yaw_rad), math.cos(yaw_rad)
    level_y = cos_r * y - sin_r * z
    rolled_z = sin_r * y + cos_r * z
    level_x = cos_p * x + sin_p * rolled_z
    return (
        cos_y * level_x - sin_y * level_y,
        sin_y * level_x + cos_y * level_y,
        -sin_p * x + cos_p * rolled_z,
    )


def target_range_m(pose: Pose, target: Target) -> tuple[float, float]:
    """Distance from the sonar's face to a vehicle, and how far off the axis that is, rad."""
    ax, ay, az = pose.axis_ned
    px, py, pz = pose.position_ned_m
    tx, ty, tz = target.position_ned_m
    dx, dy, dz = tx - px - LEVER_ARM_M * ax, ty - py - LEVER_ARM_M * ay, tz - pz - LEVER_ARM_M * az
    distance_m = math.sqrt(dx * dx + dy * dy + dz * dz)
    # Within a body's own size the beam cannot miss it.
    if distance_m <= target.radius_m:
        return 0.0, 0.0
    along = (dx * ax + dy * ay + dz * az) / distance_m
    return distance_m - target.radius_m, math.acos(max(-1.0, min(1.0, along)))


def surface_range_m(pose: Pose, surface: Surface) -> float | None:
    """Distance along the beam to a flat surface, by its squarest ray; None if it is not heard.

    A smooth surface throws sound away when it is met aslant: the distance at which it is still
    heard falls with the square of the cosine of that angle (assumed).
    """
    (px, py, pz), (sx, sy, sz) = pose.position_ned_m, surface.point_ned_m
    nx, ny, nz = surface.normal_ned
    height_m = (px - sx) * nx + (py - sy) * ny + (pz - sz) * nz
    if height_m <= 0.0 or height_m > SURFACE_RANGE_M:
        return None
    ax, ay, az = pose.axis_ned
    facing = max(-1.0, min(1.0, -(ax * nx + ay * ny + az * nz)))
    slant_rad = max(0.0, math.acos(facing) - pose.beam_half_angle_rad)
    if slant_rad >= math.pi / 2.0:
        return None
    range_m = height_m / math.cos(slant_rad)
    return range_m if range_m <= SURFACE_RANGE_M * math.cos(slant_rad) ** 2 else None


class _Bursts:
    """Something that comes for a while, and goes: so much of the time, so long on average."""

    def __init__(self, share: float, mean_s: float, chance: random.Random) -> None:
        self._chance = chance
        # Of what is never, and of what is always, nothing changes.
        self._changes = 0.0 < share < 1.0
        self._is_on = chance.random() < share
        self._means_s = {True: mean_s, False: mean_s * (1.0 - share) / share if share else 0.0}
        self._until_s = self._lasts_s()

    def is_on(self, t_s: float) -> bool:
        """Whether it is there; times only rise."""
        while self._changes and t_s >= self._until_s:
            self._is_on = not self._is_on
            self._until_s += self._lasts_s()
        return self._is_on

    def _lasts_s(self) -> float:
        return self._chance.expovariate(1.0) * self._means_s[self._is_on]


class _Late:
    """Echoes of the ping before.

    Something far away stays there for a while: pings at equal intervals show it at one place.
    """

    def __init__(self, share: float, chance: random.Random) -> None:
        self._share, self._chance = share, chance
        self._far_m, self._until_s, self._before_s = 0.0, -math.inf, -math.inf

    def ranges_m(self, t_s: float) -> list[float]:
        """Where it seems to be at this ping, if it is heard."""
        late_m = (t_s - self._before_s) * SPEED_OF_SOUND_MPS / 2.0
        self._before_s = t_s
        if not math.isfinite(late_m):
            return []  # the first ping: nothing is on its way
        if t_s >= self._until_s or not SHORTEST_M <= self._far_m - late_m <= LONGEST_M:
            self._far_m = self._chance.uniform(SHORTEST_M, LONGEST_M) + late_m
            self._until_s = t_s + LATE_S
        return [self._far_m - late_m] if self._chance.random() < self._share else []


class Ear:
    """Pings: from what is in the beam to a range, with noise, wild readings and ghosts.

    chance(name): a stream of chance for each of what may happen. Each takes as much of its own at
    every ping, so that another sonar changes nothing else in a flight.
    """

    def __init__(
        self, chance: Callable[[str], random.Random], sonar: TrueSonar = ON_A_DESK
    ) -> None:
        self.sonar = sonar
        self._echo, self._wild, self._noise = chance("echo"), chance("wild"), chance("noise")
        self._deaf = _Bursts(sonar.deaf_share, sonar.deaf_s, chance("deaf"))
        self._tone = _Bursts(sonar.tone_share, TONE_S, chance("tone"))
        self._late = _Late(sonar.late_share, chance("late readings"))
        self._pings: list[tuple[float, list[float]]] = []  # time, and what they bring back when

    def ping(
        self,
        t_s: float,
        pose: Pose,
        targets: Sequence[Target],
        surfaces: Sequence[Surface] = (GROUND,),
        other_sonars: Sequence[Pose] = (),
    ) -> float | None:
        """Range of the nearest echo in metres, 1 cm steps; None: nothing came back."""
        echoes_m = self._echoes_m(pose, targets, surfaces)
        heard = [range_m for range_m in echoes_m if range_m <= LONGEST_M] + self._ghosts_m(t_s)
        heard += self._late.ranges_m(t_s)
        self._pings.append((t_s, echoes_m))
        is_wild = self._wild.random() < self.sonar.wild_share
        anything_m = self._wild.uniform(SHORTEST_M, LONGEST_M)
        toned = self._tone.is_on(t_s) or any(hears_tone(pose, other) for other in other_sonars)
        off_m = self._noise.gauss(0.0, 1.0) * self.sonar.noise_m
        if is_wild or toned:
            heard.append(anything_m)
        if self._deaf.is_on(t_s) or not heard:
            return None
        return max(SHORTEST_M, math.floor((min(heard) + off_m) * 100.0) / 100.0)

    def _echoes_m(
        self, pose: Pose, targets: Sequence[Target], surfaces: Sequence[Surface]
    ) -> list[float]:
        ranges = [
            range_m for target in targets if (range_m := self._echo_m(pose, target)) is not None
        ]
        for surface in surfaces:
            range_m = surface_range_m(pose, surface)
            if range_m is not None:
                ranges.append(range_m)
        return ranges

    def _echo_m(self, pose: Pose, target: Target) -> float | None:
        """Distance to a vehicle whose echo comes back."""
        reaches_m = self._echo.uniform(1.0 - FADES_SHARE, 1.0 + FADES_SHARE) * target.heard_to_m
        drawn = self._echo.random()
        range_m, off_rad = target_range_m(pose, target)
        if range_m > reaches_m:
            return None
        # Small targets shorten the beam, and narrow it: as if they were further away.
        as_foil_m = range_m * self.sonar.foil_m / target.heard_to_m
        share = self.sonar.share(as_foil_m, off_rad, pose.beam_half_angle_rad)
        return range_m if drawn < share * self.sonar.left.at(pose.throttle) else None

    def _ghosts_m(self, t_s: float) -> list[float]:
        """Echoes of earlier pings that arrive now, at the distance they then seem to have."""
        self._pings = [ping for ping in self._pings if t_s - ping[0] < SOUND_DIES_S]
        ghosts = [
            range_m - (t_s - ping_s) * SPEED_OF_SOUND_MPS / 2.0
            for ping_s, ranges in self._pings
            for range_m in ranges
        ]
        return [range_m for range_m in ghosts if SHORTEST_M <= range_m <= LONGEST_M]


def hears_tone(pose: Pose, other: Pose) -> bool:
    """Whether another sonar's own tone reaches us: each is in the other's cone, and near."""
    dx, dy, dz = (b - a for a, b in zip(pose.position_ned_m, other.position_ned_m, strict=True))
    distance_m = math.sqrt(dx * dx + dy * dy + dz * dz)
    if not 0.0 < distance_m <= LONGEST_M:
        return False
    limit_m = distance_m * math.cos(pose.beam_half_angle_rad)
    others_limit_m = distance_m * math.cos(other.beam_half_angle_rad)
    (ax, ay, az), (bx, by, bz) = pose.axis_ned, other.axis_ned
    faces_it = ax * dx + ay * dy + az * dz >= limit_m
    return faces_it and -(bx * dx + by * dy + bz * dz) >= others_limit_m


class MaxSonar:
    """The sensor on its bus: commands, readings, and silence while it ranges.

    `listen(t_s)` is asked at each ping for the range in metres, None for nothing heard.
    `plugged` may be cleared: then nothing is acknowledged.
    """

    def __init__(self, listen: Callable[[float], float | None]) -> None:
        self._listen = listen
        self.address = DEFAULT_ADDRESS
        self.plugged = True
        self.last_range_m: float | None = None
        self._busy_until_us = -1
        self._answer = PART_INFORMATION

    def write(self, t_us: int, address: int, data: bytes) -> bool:
        """A bus write; True if acknowledged. While ranging, the address is not."""
        if not self._answers(t_us, address):
            return False
        if data[:1] == bytes([COMMAND_RANGE]):
            self._range(t_us)
        elif len(data) == 3 and tuple(data[:2]) == COMMAND_CHANGE:
            self._change_address(data[2])
        return True

    def read(self, t_us: int, address: int, count: int) -> bytes | None:
        """A bus read of centimetres, high byte first; None if not acknowledged."""
        if not self._answers(t_us, address):
            return None
        return (self._answer + b"\xff" * count)[:count]

    def _answers(self, t_us: int, address: int) -> bool:
        return self.plugged and address == self.address and t_us >= self._busy_until_us

    def _range(self, t_us: int) -> None:
        range_m = self._listen(t_us / 1e6)
        self.last_range_m = range_m
        reported_m = LONGEST_M if range_m is None else min(LONGEST_M, max(SHORTEST_M, range_m))
        self._answer = round(reported_m * 100.0).to_bytes(2, "big")
        flight_us = 2e6 * reported_m / SPEED_OF_SOUND_MPS
        self._busy_until_us = t_us + PROCESSING_US + round(flight_us)

    def _change_address(self, new_address: int) -> None:
        """Addresses on the wire are 8-bit, even, and a few are refused."""
        if new_address % 2 == 0 and new_address not in REFUSED_ADDRESSES:
            self.address = new_address >> 1
