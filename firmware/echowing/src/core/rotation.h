// Angles, directions and rotations in single precision. The library's functions, made for every
// angle, take 4 kB on the boards without a floating-point unit.
#pragma once

namespace echowing {

constexpr float kPi = 3.1415927f;
constexpr float kRadiansPerDegree = 0.017453293f;

struct SineCosine {
  float sine;
  float cosine;
};

// Of at most a quarter turn either way.
SineCosine sine_cosine(float angle_rad);
// Angle of the point (x, y), -pi to pi, as atan2; 0 for the origin.
float arc_tangent(float y, float x);
// The same angle within half a turn either way; of at most some turns.
float wrapped(float angle_rad);

// In the earth frame from north and the horizon, in the body frame from straight ahead: to the
// right, then up.
struct Direction {
  float right_rad;
  float up_rad;
};

// North-east-down, or forward-right-down.
struct Vector {
  float x;
  float y;
  float z;
};

// A rotation; need not be of length 1 unless a function says so.
struct Quaternion {
  float w;
  float x;
  float y;
  float z;
};

// The unit vector of a direction of at most half a turn to the right, a quarter up.
Vector vector(Direction direction);
// The direction of a vector of any length.
Direction direction(Vector vector);

// First `b`, then `a`.
Quaternion product(const Quaternion& a, const Quaternion& b);
Quaternion normalized(const Quaternion& q);
// Of length 1: yaw (or pan), then pitch (or tilt), by their half angles.
Quaternion from_halves(SineCosine yaw, SineCosine pitch);
// An attitude by its angles, each at most half a turn: yaw, then pitch; then rolled. Of length 1.
Quaternion nose(float pitch_rad, float yaw_rad);
Quaternion rolled(const Quaternion& nose, float roll_rad);
// Forward, turned by `q`; longer by the square of q's length.
Vector forward(const Quaternion& q);
// `vector` turned back by `q`; longer by the square of q's length.
Vector turned_back(const Quaternion& q, Vector vector);

}  // namespace echowing
