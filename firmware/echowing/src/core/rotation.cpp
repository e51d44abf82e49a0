#include "rotation.h"

#include <math.h>

namespace echowing {
namespace {

// Of at most half a turn either way, by the half angle.
SineCosine of_half_turn(float angle_rad) {
  const SineCosine half = sine_cosine(0.5f * angle_rad);
  return {2 * half.sine * half.cosine, 1 - 2 * half.sine * half.sine};
}

}  // namespace

// Taylor's series, good to 4e-6 for the quarter turn that is the most asked here.
SineCosine sine_cosine(float angle_rad) {
  const float x2 = angle_rad * angle_rad;
  const float s = 1 - x2 * (1 / 20.0f) * (1 - x2 * (1 / 42.0f) * (1 - x2 * (1 / 72.0f)));
  const float c = 1 - x2 * (1 / 30.0f) * (1 - x2 * (1 / 56.0f) * (1 - x2 * (1 / 90.0f)));
  return {angle_rad * (1 - x2 * (1 / 6.0f) * s), 1 - x2 * 0.5f * (1 - x2 * (1 / 12.0f) * c)};
}

// Abramowitz and Stegun 4.4.49, good to 1e-5.
float arc_tangent(float y, float x) {
  const float beside = fabsf(y);
  const float along = fabsf(x);
  const bool steep = beside > along;
  const float longer = steep ? beside : along;
  if (longer == 0.0f) return 0.0f;
  const float t = (steep ? along : beside) / longer;
  const float t2 = t * t;
  const float series =
      0.9998660f + t2 * (-0.3302995f + t2 * (0.1801410f + t2 * (-0.0851330f + t2 * 0.0208351f)));
  float angle = t * series;
  if (steep) angle = 0.5f * kPi - angle;
  if (x < 0.0f) angle = kPi - angle;
  return y < 0.0f ? -angle : angle;
}

float wrapped(float angle_rad) {
  while (angle_rad > kPi) angle_rad -= 2 * kPi;
  while (angle_rad < -kPi) angle_rad += 2 * kPi;
  return angle_rad;
}

Vector vector(Direction direction) {
  const SineCosine right = of_half_turn(direction.right_rad);
  const SineCosine up = sine_cosine(direction.up_rad);
  return {up.cosine * right.cosine, up.cosine * right.sine, -up.sine};
}

Direction direction(Vector vector) {
  const float level = sqrtf(vector.x * vector.x + vector.y * vector.y);
  return {arc_tangent(vector.y, vector.x), arc_tangent(-vector.z, level)};
}

Quaternion product(const Quaternion& a, const Quaternion& b) {
  return {
      a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z, a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
      a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x, a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w};
}

Quaternion normalized(const Quaternion& q) {
  const float by = 1 / sqrtf(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
  return {by * q.w, by * q.x, by * q.y, by * q.z};
}

Quaternion from_halves(SineCosine yaw, SineCosine pitch) {
  return {yaw.cosine * pitch.cosine, -yaw.sine * pitch.sine, yaw.cosine * pitch.sine,
          yaw.sine * pitch.cosine};
}

Quaternion nose(float pitch_rad, float yaw_rad) {
  return from_halves(sine_cosine(0.5f * yaw_rad), sine_cosine(0.5f * pitch_rad));
}

Quaternion rolled(const Quaternion& nose, float roll_rad) {
  const SineCosine roll = sine_cosine(0.5f * roll_rad);
  return {nose.w * roll.cosine - nose.x * roll.sine, nose.w * roll.sine + nose.x * roll.cosine,
          nose.y * roll.cosine + nose.z * roll.sine, nose.z * roll.cosine - nose.y * roll.sine};
}

Vector forward(const Quaternion& q) {
  return {q.w * q.w + q.x * q.x - q.y * q.y - q.z * q.z, 2 * (q.x * q.y + q.w * q.z),
          2 * (q.x * q.z - q.w * q.y)};
}

Vector turned_back(const Quaternion& q, Vector vector) {
  const float same = q.w * q.w - q.x * q.x - q.y * q.y - q.z * q.z;
  const float along = 2 * (q.x * vector.x + q.y * vector.y + q.z * vector.z);
  const float across = 2 * q.w;
  return {same * vector.x + along * q.x + across * (vector.y * q.z - vector.z * q.y),
          same * vector.y + along * q.y + across * (vector.z * q.x - vector.x * q.z),
          same * vector.z + along * q.z + across * (vector.x * q.y - vector.y * q.x)};
}

}  // namespace echowing
