// The gimbal looks where it is ordered to: the axis in the earth frame, from the bytes of ATTITUDE
// and of the orders to the servos' pulses and back to what is told of each ping.
#include <doctest/doctest.h>

#include <cmath>
#include <limits>

#include "axis_vectors.h"
#include "look.h"
#include "rig.h"
#include "scan.h"

using namespace echowing;
using rig::AxisTold;
using rig::Rig;

namespace {

constexpr Microseconds ms(uint32_t count) { return count * 1000; }

constexpr double kDegree = 3.14159265358979 / 180;
constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr uint16_t kEarth = 4 | 8 | 16 | 64;

uint16_t nothing(Microseconds) { return 765; }

struct Turn {
  double roll_deg, pitch_deg, yaw_deg;
};

struct Order {
  double azimuth_deg, elevation_deg;
  double deviation_deg = 0;
  double azimuth_rate_dps = 0, elevation_rate_dps = 0;
  bool has_height = true;
};

mavlink_gimbal_device_set_attitude_t message(const Order& order) {
  const Quaternion q = nose(static_cast<float>(order.elevation_deg * kDegree),
                            static_cast<float>(order.azimuth_deg * kDegree));
  mavlink_gimbal_device_set_attitude_t told = {};
  told.target_system = 1;
  told.target_component = MAV_COMP_ID_ONBOARD_COMPUTER;
  told.flags = order.has_height ? kEarth : kEarth & ~GIMBAL_DEVICE_FLAGS_PITCH_LOCK;
  told.q[0] = q.w;
  told.q[1] = q.x;
  told.q[2] = q.y;
  told.q[3] = q.z;
  told.angular_velocity_x = static_cast<float>(order.deviation_deg * kDegree);
  told.angular_velocity_y = static_cast<float>(order.elevation_rate_dps * kDegree);
  told.angular_velocity_z = static_cast<float>(order.azimuth_rate_dps * kDegree);
  return told;
}

double degrees(float radians) { return radians / kDegree; }

// Azimuth and elevation of a rotation's forward axis, in degrees.
Order pointed(const Quaternion& q) {
  const Direction found = direction(forward(q));
  return {degrees(found.right_rad), degrees(found.up_rad)};
}

double apart_deg(const Order& a, const Order& b) {
  const double up = std::sin(a.elevation_deg * kDegree) * std::sin(b.elevation_deg * kDegree);
  const double level = std::cos(a.elevation_deg * kDegree) * std::cos(b.elevation_deg * kDegree) *
                       std::cos((a.azimuth_deg - b.azimuth_deg) * kDegree);
  return std::acos(std::min(1.0, up + level)) / kDegree;
}

// A board on a vehicle that turns as a test says, and whoever gives orders.
class Vehicle {
 public:
  explicit Vehicle(bool armed = true) {
    rig.sonar.listen = nothing;
    rig.sonar.ranging_us = 66000;
    rig.autopilot(1, armed);
  }

  // Runs on, with attitude 25 times a second and the order ten times, as far as they are there.
  void run(uint32_t span_ms) {
    for (uint32_t i = 0; i < span_ms; ++i) {
      if (attitude && t_ms % 40 == 0) send_attitude();
      if (order && t_ms % 100 == 0) rig.hear(0, message(order(seconds())), 245, 190);
      rig.run(ms(1), 500);  // turns of the slowest board
      ++t_ms;
      pulses_.push_back(rig.servos.last);
      if (each_ms) each_ms();
    }
  }

  void send_attitude() {
    const Turn now = attitude(seconds());
    const Turn soon = attitude(seconds() + 0.001);
    mavlink_attitude_t told = {};
    told.roll = static_cast<float>(now.roll_deg * kDegree);
    told.pitch = static_cast<float>(now.pitch_deg * kDegree);
    told.yaw = static_cast<float>(now.yaw_deg * kDegree);
    told.rollspeed = static_cast<float>((soon.roll_deg - now.roll_deg) * 1000 * kDegree);
    told.pitchspeed = static_cast<float>((soon.pitch_deg - now.pitch_deg) * 1000 * kDegree);
    told.yawspeed = static_cast<float>((soon.yaw_deg - now.yaw_deg) * 1000 * kDegree);
    rig.hear(0, told, 1, 1);
  }

  // Where servos point in the earth frame that take their pulses as the core thinks that they do.
  Order axis() const {
    const Aim aim = pulses_[pulses_.size() - 1 - kServoDelay];
    return pointed(product(rotation(), pointing(rig.core.parameters(), aim)));
  }

  Quaternion rotation() const {
    const Turn now = attitude ? attitude(seconds()) : Turn{0, 0, 0};
    return rolled(nose(static_cast<float>(now.pitch_deg * kDegree),
                       static_cast<float>(now.yaw_deg * kDegree)),
                  static_cast<float>(now.roll_deg * kDegree));
  }

  double seconds() const { return t_ms * 0.001; }
  AxisTold told() { return rig.axes().back(); }

  Rig rig;
  std::function<Turn(double)> attitude;
  std::function<Order(double)> order;
  std::function<void()> each_ms;
  uint32_t t_ms = 0;

 private:
  std::vector<Aim> pulses_;
};

Turn level(double) { return {0, 0, 0}; }

std::function<Order(double)> always(Order order) {
  return [order](double) { return order; };
}

double pan_deg(Aim aim) { return (aim.pan_us - 1380) / 10.0; }
double tilt_deg(Aim aim) { return (aim.tilt_us - 1400) / 10.0; }

}  // namespace

TEST_CASE("the axis of the table that ground tool and applet share, and back") {
  for (const AxisVector& row : kAxisVectors) {
    CAPTURE(row.azimuth_deg);
    CAPTURE(row.elevation_deg);
    const Quaternion attitude = rolled(nose(static_cast<float>(row.pitch_deg * kDegree),
                                            static_cast<float>(row.yaw_deg * kDegree)),
                                       static_cast<float>(row.roll_deg * kDegree));
    const Direction wanted = {static_cast<float>(row.azimuth_deg * kDegree),
                              static_cast<float>(row.elevation_deg * kDegree)};
    const Direction body = direction(turned_back(attitude, sight(wanted)));
    // A pulse is good to 0.1 degrees.
    CHECK(std::fabs(degrees(body.right_rad) - row.pan_deg) < 0.01);
    CHECK(std::fabs(degrees(body.up_rad) - row.tilt_deg) < 0.01);
    const Quaternion gimbal =
        nose(static_cast<float>(row.tilt_deg * kDegree), static_cast<float>(row.pan_deg * kDegree));
    CHECK(apart_deg(pointed(product(attitude, gimbal)), {row.azimuth_deg, row.elevation_deg}) <
          0.03);  // of the arc cosine, in single precision
  }
}

TEST_CASE("the axis stays where it was ordered while the vehicle rolls, pitches and yaws") {
  Vehicle vehicle(false);  // on the ground no search moves it
  vehicle.order = always({20, 5});
  // Leans as a copter does that brakes and turns: rates up to 60 degrees a second.
  vehicle.attitude = [](double t) {
    return Turn{20 * std::sin(3 * t), 15 * std::sin(2 * t), 30 * std::sin(2 * t)};
  };
  vehicle.run(1000);
  double worst = 0;
  vehicle.each_ms = [&] { worst = std::max(worst, apart_deg(vehicle.axis(), {20, 5})); };
  vehicle.run(6000);
  // The body turns under the axis by up to 80 degrees a second: 0.8 degrees in the 10 ms to each
  // side of a pulse's middle, 0.5 in the 6 ms by which a message or a step comes late after a
  // reading. What it accelerates by, up to 180 degrees/s^2, is not known for 70 ms: 0.45 degrees.
  CHECK(worst < 1.75);
  CHECK(worst > 0.1);
}

TEST_CASE("a vehicle that yaws steadily leaves the axis neither ahead nor behind") {
  for (const double rate_dps : {-80.0, 80.0}) {
    CAPTURE(rate_dps);
    Vehicle vehicle(false);
    vehicle.order = always({0, 0});
    vehicle.attitude = [&](double t) { return Turn{0, 0, rate_dps * (t - 2.0) * 0.5}; };
    vehicle.run(1500);
    double sum_deg = 0;
    vehicle.each_ms = [&] { sum_deg += vehicle.axis().azimuth_deg; };
    vehicle.run(1000);
    CHECK(std::fabs(sum_deg / 1000) < 0.002 * 40);  // 2 ms
  }
}

TEST_CASE("attitude is carried on by its rates between two messages") {
  Vehicle vehicle(false);
  vehicle.order = always({0, 0});
  vehicle.attitude = [](double t) { return Turn{0, 0, 60 * t - 60}; };
  vehicle.run(1000);
  const Aim before = vehicle.rig.servos.last;
  vehicle.attitude = nullptr;  // none for 0.3 s
  vehicle.run(300);
  CHECK(pan_deg(before) - pan_deg(vehicle.rig.servos.last) == doctest::Approx(18).epsilon(0.1));
}

TEST_CASE("an order is carried on by its rates, for a second") {
  Vehicle vehicle(false);
  vehicle.attitude = level;
  vehicle.run(500);
  vehicle.rig.hear(0, message({-20, 0, 0, 30, 10}), 245, 190);
  vehicle.run(900);
  CHECK(pan_deg(vehicle.rig.servos.last) == doctest::Approx(-20 + 0.9 * 30).epsilon(0.1));
  CHECK(tilt_deg(vehicle.rig.servos.last) == doctest::Approx(0.9 * 10).epsilon(0.1));
  vehicle.run(150);
  CHECK(vehicle.rig.servos.last.pan_us == 1380);  // disarmed: straight ahead
  CHECK(vehicle.rig.servos.last.tilt_us == 1400);
}

TEST_CASE("rates that make no sense are none") {
  for (const float rate : {kNan, 4.1f, -std::numeric_limits<float>::infinity()}) {
    CAPTURE(rate);
    Vehicle vehicle(false);
    vehicle.attitude = level;
    vehicle.run(500);
    mavlink_gimbal_device_set_attitude_t told = message({-20, 0});
    told.angular_velocity_y = told.angular_velocity_z = rate;
    vehicle.rig.hear(0, told, 245, 190);
    vehicle.run(900);
    CHECK(vehicle.rig.servos.last.pan_us == 1180);
    CHECK(vehicle.rig.servos.last.tilt_us == 1400);
  }
}

TEST_CASE("without orders attitude changes nothing, not a byte of a report nor a pulse") {
  Vehicle with, without;
  with.attitude = [](double t) { return Turn{20 * std::sin(t), 10, 90 * std::sin(t)}; };
  for (int i = 0; i < 200; ++i) {
    const uint16_t heard = i % 40 < 20 ? 250 : 765;
    with.rig.sonar.listen = without.rig.sonar.listen = [heard](Microseconds) { return heard; };
    with.run(100);
    without.run(100);
    CHECK(with.rig.servos.last.pan_us == without.rig.servos.last.pan_us);
    CHECK(with.rig.servos.last.tilt_us == without.rig.servos.last.tilt_us);
  }
  const auto a = with.rig.ranges(), b = without.rig.ranges();
  REQUIRE(a.size() == b.size());
  for (size_t i = 0; i < a.size(); ++i) {
    CHECK(a[i].report.current_distance == b[i].report.current_distance);
    CHECK(a[i].report.time_boot_ms == b[i].report.time_boot_ms);
  }
}

TEST_CASE("without attitude orders change nothing") {
  Vehicle vehicle;
  vehicle.order = always({30, 10});
  vehicle.run(3000);
  for (int i = 0; i < 3000; ++i) {
    vehicle.run(1);
    CHECK(pan_deg(vehicle.rig.servos.last) <= 2);
  }
}

TEST_CASE("half a second without attitude, or a second without orders: the search of before") {
  for (const bool attitude_ends : {true, false}) {
    CAPTURE(attitude_ends);
    Vehicle vehicle;
    vehicle.attitude = level;
    vehicle.order = always({40, 10, 5});
    vehicle.run(2000);
    CHECK(pan_deg(vehicle.rig.servos.last) > 20);
    (attitude_ends ? (vehicle.attitude = nullptr, 0) : (vehicle.order = nullptr, 0));
    // The newest is up to 40, or 100, ms old.
    vehicle.run(attitude_ends ? 455 : 895);
    CHECK(pan_deg(vehicle.rig.servos.last) > 20);
    vehicle.run(110);
    // The first point: nothing has been seen. Then the figure of Appendix A, 300 ms each.
    const Parameters parameters;
    uint8_t point = 0;
    Aim aim = vehicle.rig.servos.last;
    uint32_t since_ms = 0;
    for (int i = 0; i < 4000; ++i) {
      CHECK(aim.pan_us == scan_point(parameters, point).pan_us);
      CHECK(aim.tilt_us == scan_point(parameters, point).tilt_us);
      vehicle.run(1);
      const Aim next = vehicle.rig.servos.last;
      if (next.pan_us == aim.pan_us && next.tilt_us == aim.tilt_us) continue;
      point = static_cast<uint8_t>((point + 1) % kScanPoints);
      if (since_ms != 0) CHECK(vehicle.t_ms - since_ms == doctest::Approx(300).epsilon(0.01));
      since_ms = vehicle.t_ms;
      aim = next;
    }
  }
}

TEST_CASE("a target that is held when the orders end stays held, with its average") {
  Vehicle vehicle;
  vehicle.attitude = level;
  vehicle.order = always({30, 0});
  vehicle.rig.sonar.listen = [](Microseconds) { return 300; };
  vehicle.run(3000);
  vehicle.order = nullptr;
  vehicle.run(200);
  const Aim held = vehicle.rig.servos.last;
  CHECK(pan_deg(held) == doctest::Approx(30).epsilon(0.01));
  vehicle.rig.forget();
  vehicle.run(3000);
  CHECK(vehicle.rig.servos.last.pan_us == held.pan_us);
  for (const auto& range : vehicle.rig.ranges()) CHECK(range.report.current_distance == 300);
}

TEST_CASE("the figure 8 lies round the ordered direction, with its points and its dwell") {
  Vehicle vehicle;
  vehicle.attitude = level;
  vehicle.order = always({25, 5});
  vehicle.run(2000);
  std::vector<Aim> seen;
  vehicle.each_ms = [&] {
    const Aim aim = vehicle.rig.servos.last;
    const bool same =
        !seen.empty() && seen.back().pan_us == aim.pan_us && seen.back().tilt_us == aim.tilt_us;
    if (!same) seen.push_back(aim);
  };
  vehicle.run(3700);
  REQUIRE(seen.size() >= 12);
  CHECK(seen.size() <= 14);
  // Twelve points of five columns and rows: 5 left to 2 right, 10 down to 10 up.
  for (size_t i = 0; i + 1 < seen.size(); ++i) {
    uint8_t point = 0;
    const Parameters parameters;
    const Aim off = {static_cast<uint16_t>(seen[i].pan_us - 250),
                     static_cast<uint16_t>(seen[i].tilt_us - 50)};
    while (point < kScanPoints && (scan_point(parameters, point).pan_us != off.pan_us ||
                                   scan_point(parameters, point).tilt_us != off.tilt_us)) {
      ++point;
    }
    CAPTURE(off.pan_us);
    CAPTURE(off.tilt_us);
    CHECK(point < kScanPoints);
  }
}

TEST_CASE("it begins with the ordered direction itself") {
  Vehicle vehicle;
  vehicle.attitude = level;
  vehicle.run(1000);
  vehicle.order = always({25, 5});
  vehicle.run(150);
  CHECK(pan_deg(vehicle.rig.servos.last) == doctest::Approx(25).epsilon(0.01));
  CHECK(tilt_deg(vehicle.rig.servos.last) == doctest::Approx(5).epsilon(0.02));
}

TEST_CASE("the search is as wide as the direction is unsure, as far as the servos reach") {
  struct Row {
    double deviation_deg;
    double left, right, low, high;
  };
  for (const Row& row : {Row{0, -5, 2, -10, 10}, Row{2, -5, 4, -10, 10}, Row{8, -16, 16, -16, 16},
                         Row{25, -50, 50, -30, 30}, Row{200, -60, 60, -30, 30}}) {
    CAPTURE(row.deviation_deg);
    Vehicle vehicle(false);
    vehicle.attitude = level;
    vehicle.order = always({0, 0, row.deviation_deg});
    vehicle.rig.set_parameter("PAN_MIDDLE", 1500);  // 60 degrees either way are within the pulses
    vehicle.rig.set_parameter("PAN_LEFT", 1450);
    vehicle.rig.set_parameter("PAN_RIGHT", 1520);
    vehicle.run(500);
    vehicle.rig.autopilot(1, true);
    vehicle.run(2000);
    double left = 0, right = 0, low = 0, high = 0;
    vehicle.each_ms = [&] {
      const double pan = (vehicle.rig.servos.last.pan_us - 1500) / 10.0;
      const double tilt = tilt_deg(vehicle.rig.servos.last);
      left = std::min(left, pan);
      right = std::max(right, pan);
      low = std::min(low, tilt);
      high = std::max(high, tilt);
    };
    vehicle.run(4000);
    // Aside and above at once a level direction is higher in the gimbal's own tilt.
    CHECK(left == doctest::Approx(row.left).epsilon(0.02));
    CHECK(right == doctest::Approx(row.right).epsilon(0.02));
    CHECK(low == doctest::Approx(row.low).epsilon(0.02));
    CHECK(high == doctest::Approx(row.high).epsilon(0.02));
  }
}

TEST_CASE("a scale near nought gives no endless turns") {
  Vehicle vehicle;
  vehicle.attitude = level;
  vehicle.order = always({0, 0, 5});
  vehicle.rig.autopilot(1, false);
  vehicle.run(500);
  for (const float scale : {1e-38f, -1e-38f, 0.0f}) {
    vehicle.rig.set_parameter("PAN_US_DEG", scale);
    vehicle.rig.autopilot(1, true);
    vehicle.run(4000);
    CHECK(std::isfinite(vehicle.told().q.w));
    vehicle.rig.autopilot(1, false);
    vehicle.run(100);
  }
}

TEST_CASE("a target heard aside keeps its average while the axis comes back, 1/e in a second") {
  Vehicle vehicle;
  vehicle.attitude = [](double t) { return Turn{5 * std::sin(4 * t), 0, 5 * std::sin(3 * t)}; };
  vehicle.order = always({0, 0, 9});
  vehicle.run(1000);
  // Heard from the first point that looks up by two standard deviations, and from then on.
  bool found = false;
  vehicle.rig.sonar.listen = [&](Microseconds) {
    found = found || vehicle.axis().elevation_deg > 17;
    return found ? uint16_t{300} : uint16_t{765};
  };
  for (int i = 0; i < 5000 && vehicle.rig.core.state() != DeviceState::kTracking; ++i) {
    vehicle.run(1);
  }
  REQUIRE(vehicle.rig.core.state() == DeviceState::kTracking);
  vehicle.run(200);  // a second reading has confirmed it
  const double first_deg = vehicle.axis().elevation_deg;
  vehicle.rig.forget();
  vehicle.run(1000);
  CHECK(vehicle.axis().elevation_deg == doctest::Approx(first_deg / 2.718).epsilon(0.1));
  vehicle.run(4000);
  CHECK(apart_deg(vehicle.axis(), {0, 0}) < 1);
  CHECK(vehicle.rig.ranges().size() >= 99);
  for (const auto& range : vehicle.rig.ranges()) CHECK(range.report.current_distance == 300);
}

TEST_CASE("an order without a height leaves it at the mean of those that had one") {
  Vehicle vehicle(false);
  vehicle.attitude = level;
  vehicle.order = [](double t) { return Order{30, 10 + 6 * std::cos(kPi * t)}; };  // once in 2 s
  vehicle.run(10000);
  vehicle.order = always({-20, 0, 0, 0, 15, false});  // nor a rate of it
  vehicle.run(1000);
  CHECK(std::fabs(vehicle.axis().azimuth_deg + 20) < 0.3);
  // A low pass of 2 s leaves a third of an oscillation of 2 s.
  CHECK(std::fabs(vehicle.axis().elevation_deg - 10) < 2.1);
  vehicle.order = always({-20, -10});
  vehicle.run(200);
  CHECK(std::fabs(vehicle.axis().elevation_deg + 10) < 0.3);
}

TEST_CASE("an order without a height comes first: it is level") {
  Vehicle vehicle(false);
  vehicle.attitude = level;
  vehicle.order = always({30, 10, 0, 0, 0, false});
  vehicle.run(500);
  CHECK(std::fabs(vehicle.axis().elevation_deg) < 0.3);
}

TEST_CASE("who orders no height only carries on: a target heard aside stays where it was heard") {
  Vehicle vehicle;
  vehicle.attitude = level;
  vehicle.order = always({0, 0, 9, 0, 0, false});
  vehicle.run(1000);
  bool found = false;
  vehicle.rig.sonar.listen = [&](Microseconds) {
    found = found || vehicle.axis().elevation_deg > 17;
    return found ? uint16_t{300} : uint16_t{765};
  };
  vehicle.run(5000);
  REQUIRE(found);
  CHECK(vehicle.axis().elevation_deg > 17);
}

TEST_CASE("an order that has learned where the target was heard does not push the axis beyond") {
  Vehicle vehicle;
  vehicle.attitude = level;
  Order order = {0, 0, 9};  // heard two deviations aside, which is less than half the beam
  vehicle.order = [&](double) { return order; };
  vehicle.run(1000);
  vehicle.rig.sonar.listen = [&](Microseconds) {
    return vehicle.axis().azimuth_deg > 15 ? uint16_t{300} : uint16_t{765};
  };
  for (int i = 0; i < 5000 && vehicle.rig.core.state() != DeviceState::kTracking; ++i) {
    vehicle.run(1);
  }
  REQUIRE(vehicle.rig.core.state() == DeviceState::kTracking);
  vehicle.rig.forget();
  const double heard_deg = vehicle.axis().azimuth_deg;
  order = {heard_deg, 0, 2};
  double most = 0;
  vehicle.each_ms = [&] { most = std::max(most, vehicle.axis().azimuth_deg); };
  vehicle.run(3000);
  CHECK(most < heard_deg + 1);
  CHECK(vehicle.axis().azimuth_deg == doctest::Approx(heard_deg).epsilon(0.05));
  // What goes on from there moves the axis at once.
  order = {heard_deg + 8, 0, 2};
  vehicle.run(150);
  CHECK(vehicle.axis().azimuth_deg == doctest::Approx(heard_deg + 8).epsilon(0.05));
}

TEST_CASE("a step of the order within half a beam keeps the average, a wider one forgets it") {
  for (const double step_deg : {19.0, 21.0}) {
    CAPTURE(step_deg);
    Vehicle vehicle;
    vehicle.attitude = level;
    Order order = {-10, 0};
    vehicle.order = [&](double) { return order; };
    vehicle.rig.sonar.listen = [](Microseconds) { return 300; };
    vehicle.run(5000);
    vehicle.rig.forget();
    order = {-10 + step_deg, 0};
    vehicle.run(500);
    size_t without = 0;
    for (const auto& range : vehicle.rig.ranges()) without += range.report.current_distance > 765;
    CHECK((without > 0) == (step_deg > 20));
    CHECK(pan_deg(vehicle.rig.servos.last) == doctest::Approx(-10 + step_deg).epsilon(0.02));
  }
}

TEST_CASE("orders that begin within half a beam keep what is held, others forget it") {
  for (const double azimuth_deg : {19.0, 21.0}) {
    CAPTURE(azimuth_deg);
    Vehicle vehicle(false);
    vehicle.attitude = level;
    vehicle.rig.sonar.listen = [](Microseconds) { return 300; };
    vehicle.run(2000);
    vehicle.rig.forget();
    vehicle.order = always({azimuth_deg, 0});
    vehicle.run(500);
    size_t without = 0;
    for (const auto& range : vehicle.rig.ranges()) without += range.report.current_distance > 765;
    CHECK((without > 0) == (azimuth_deg > 20));
  }
}

TEST_CASE("pulses for a direction that are found when the orders have just ended do not count") {
  const Parameters parameters;
  Tracker tracker(parameters, {0, 0});
  tracker.step({1000, 1}, GimbalMode::kLookRound, 0.0f);
  tracker.steady({2000, 2}, {1600, 1500}, true);
  CHECK(tracker.aim().pan_us == 1600);
  tracker.step({3000, 3}, GimbalMode::kScan, 0.0f);
  tracker.steady({4000, 4}, {1700, 1500}, true);
  CHECK(tracker.aim().pan_us == scan_point(parameters, 0).pan_us);
}

TEST_CASE("very long turns tell the axis and its limits as well") {
  Vehicle vehicle(false);
  vehicle.attitude = level;
  vehicle.order = always({70, 0});
  vehicle.run(1000);
  vehicle.rig.forget();
  vehicle.rig.sonar.ranging_us = 30000;  // read in the turn after the ping
  vehicle.rig.run(ms(300), ms(50));
  vehicle.rig.run(ms(30), ms(1));  // what waits leaves
  REQUIRE_FALSE(vehicle.rig.axes().empty());
  for (const AxisTold& told : vehicle.rig.axes()) {
    CHECK(told.failure_flags == 4);
    CHECK(apart_deg(pointed(told.q), {60, 0}) < 0.2);
  }
}

TEST_CASE("each reading is told with its axis right after it, of the same time, once") {
  Vehicle vehicle(false);
  vehicle.attitude = level;
  vehicle.order = always({15, -5});
  vehicle.run(2000);
  vehicle.rig.forget();
  vehicle.run(3000);
  for (const int port : {0, 1}) {
    const auto& sent = vehicle.rig.sent(port);
    size_t axes = 0;
    for (size_t i = 1; i < sent.size(); ++i) {
      if (sent[i].message.msgid != MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS) continue;
      ++axes;
      mavlink_named_value_float_t raw;
      REQUIRE(sent[i - 1].message.msgid == MAVLINK_MSG_ID_NAMED_VALUE_FLOAT);
      mavlink_msg_named_value_float_decode(&sent[i - 1].message, &raw);
      CHECK(std::string(raw.name, 7) == "SNR_RAW");
      CHECK(mavlink_msg_gimbal_device_attitude_status_get_time_boot_ms(&sent[i].message) ==
            raw.time_boot_ms);
    }
    CHECK(axes == vehicle.rig.named("SNR_RAW", port).size());
    CHECK(axes == 30);
  }
  for (const AxisTold& told : vehicle.rig.axes()) {
    CHECK(told.flags == kEarth);
    CHECK(told.failure_flags == 0);
    CHECK(apart_deg(pointed(told.q), {15, -5}) < 0.2);
    CHECK(told.length == 37);  // what is nought at the end stays off the wire
  }
}

TEST_CASE("without attitude the axis is told in the body frame") {
  Vehicle vehicle(false);
  vehicle.run(1000);
  CHECK(vehicle.rig.command(1000, -10, 20) == MAV_RESULT_ACCEPTED);
  vehicle.run(1000);
  CHECK(vehicle.told().flags == 32);
  CHECK(apart_deg(pointed(vehicle.told().q), {20, -10}) < 0.1);
}

TEST_CASE("with attitude and no order the axis is told in the earth frame") {
  Vehicle vehicle(false);
  vehicle.attitude = [](double) { return Turn{0, 12, 70}; };
  vehicle.run(2000);
  CHECK(vehicle.told().flags == kEarth);
  CHECK(apart_deg(pointed(vehicle.told().q), {70, 12}) < 0.1);
}

TEST_CASE("the axis told is where servos of SERVO_RATE were at the ping") {
  Vehicle vehicle(false);
  vehicle.run(1000);
  const size_t pings = vehicle.rig.sonar.pings.size();
  vehicle.rig.command(183, 1, 1380);
  // Right before a ping the pan servo is sent 50 degrees to the right: 500 us.
  while (vehicle.rig.sonar.pings.size() == pings) vehicle.run(1);
  vehicle.run(60);  // the next ping is 95 to 105 ms after this one
  mavlink_command_long_t move = {};
  move.target_system = 1;
  move.target_component = MAV_COMP_ID_ONBOARD_COMPUTER;
  move.command = 183;
  move.param1 = 1;
  move.param2 = 1880;
  vehicle.rig.hear(1, move);
  Microseconds moved_us = 0;
  while (vehicle.rig.sonar.pings.size() == pings + 1) {
    vehicle.run(1);
    if (moved_us == 0 && vehicle.rig.servos.last.pan_us == 1880) moved_us = vehicle.rig.now;
  }
  REQUIRE(moved_us != 0);
  const double after_ms = (vehicle.rig.sonar.pings.back() - moved_us) / 1000.0;
  vehicle.rig.forget();
  while (vehicle.rig.axes().empty()) vehicle.run(1);
  // 15 ms until it begins, then 2500 us, which are 250 degrees, a second.
  const double expected_deg = std::max(0.0, std::min(50.0, (after_ms - kServoDelay) * 0.25));
  CHECK(expected_deg > 1);
  CHECK(expected_deg < 20);
  CHECK(std::fabs(pointed(vehicle.told().q).azimuth_deg - expected_deg) <= 0.5);
}

TEST_CASE("the axis told is of the attitude at the ping, not of that at the reading") {
  Vehicle vehicle(false);
  vehicle.attitude = [](double t) { return Turn{0, 0, 50 * std::sin(2 * t)}; };
  vehicle.run(1000);
  for (int i = 0; i < 30; ++i) {
    const size_t pings = vehicle.rig.sonar.pings.size();
    while (vehicle.rig.sonar.pings.size() == pings) vehicle.run(1);
    const double yaw_deg = vehicle.attitude(vehicle.seconds()).yaw_deg;
    vehicle.rig.forget();
    while (vehicle.rig.axes().empty()) vehicle.run(1);
    // 100 degrees a second; the message is taken for 6 ms old, and comes at once here.
    CHECK(std::fabs(pointed(vehicle.told().q).azimuth_deg - yaw_deg) < 1.0);
  }
}

TEST_CASE("what an order means that is damaged, not finite, or not for us: nothing") {
  using Message = mavlink_gimbal_device_set_attitude_t;
  const std::function<void(Message&)> faults[] = {
      [](Message& m) { m.q[0] = kNan; },
      [](Message& m) { m.q[2] = std::numeric_limits<float>::infinity(); },
      [](Message& m) {
        for (float& part : m.q) part *= 1.12f;
      },
      [](Message& m) {
        for (float& part : m.q) part *= 0.88f;
      },
      [](Message& m) {
        for (float& part : m.q) part = 0;
      },
      [](Message& m) { m.flags = 4 | 8 | 32; },       // in the vehicle's frame
      [](Message& m) { m.flags = 4 | 8 | 16 | 32; },  // locked, and in the vehicle's frame
      [](Message& m) { m.flags = 0; },
      [](Message& m) { m.target_system = 2; },
      [](Message& m) { m.target_component = 154; },
      [](Message& m) { m.target_component = 0; },
      [](Message& m) { m.flags |= 1; },  // retract
      [](Message& m) { m.flags |= 2; },  // neutral
  };
  for (const auto& fault : faults) {
    CAPTURE(&fault - faults);
    Vehicle vehicle(false);
    vehicle.attitude = level;
    vehicle.run(500);
    mavlink_gimbal_device_set_attitude_t told = message({30, 10});
    fault(told);
    vehicle.rig.hear(0, told, 245, 190);
    vehicle.run(100);
    CHECK(vehicle.rig.servos.last.pan_us == 1380);
    CHECK(vehicle.rig.servos.last.tilt_us == 1400);
    // And the sender of it keeps nobody out.
    vehicle.rig.hear(0, message({-30, 10}), 1, 1);
    vehicle.run(100);
    CHECK(vehicle.rig.servos.last.pan_us == 1080);
  }
}

TEST_CASE("an order whose length is a little off is taken") {
  for (const float scale : {0.92f, 1.08f}) {
    Vehicle vehicle(false);
    vehicle.attitude = level;
    mavlink_gimbal_device_set_attitude_t told = message({30, 10});
    for (float& part : told.q) part *= scale;
    vehicle.run(500);
    vehicle.rig.hear(1, told, 245, 190);  // from USB as well
    vehicle.run(100);
    CHECK(vehicle.rig.servos.last.pan_us == 1680);
    CHECK(vehicle.rig.servos.last.tilt_us == 1500);
  }
}

TEST_CASE("attitude that is not finite and plausible, or another vehicle's, is not there") {
  const std::function<void(mavlink_attitude_t&)> faults[] = {
      [](mavlink_attitude_t& m) { m.roll = kNan; },
      [](mavlink_attitude_t& m) { m.yaw = std::numeric_limits<float>::infinity(); },
      [](mavlink_attitude_t& m) { m.pitch = 1.6f; },
      [](mavlink_attitude_t& m) { m.yaw = 3.2f; },
      [](mavlink_attitude_t& m) { m.rollspeed = 36.0f; },
      [](mavlink_attitude_t& m) { m.yawspeed = kNan; },
  };
  for (const auto& fault : faults) {
    CAPTURE(&fault - faults);
    Vehicle vehicle(false);
    vehicle.order = always({30, 10});
    for (int i = 0; i < 20; ++i) {
      mavlink_attitude_t told = {};
      fault(told);
      vehicle.rig.hear(0, told, 1, 1);
      vehicle.run(40);
    }
    CHECK(vehicle.rig.servos.last.pan_us == 1380);
  }
  struct Sender {
    int port;
    uint8_t system, component;
  };
  for (const Sender& from : {Sender{0, 2, 1}, Sender{0, 1, 154}, Sender{1, 1, 1}}) {
    CAPTURE(from.port);
    Vehicle vehicle(false);
    vehicle.order = always({30, 10});
    for (int i = 0; i < 20; ++i) {
      vehicle.rig.hear(from.port, mavlink_attitude_t{}, from.system, from.component);
      vehicle.run(40);
    }
    CHECK(vehicle.rig.servos.last.pan_us == 1380);
  }
}

TEST_CASE("one sender at a time: another one's turn comes after a second's silence, or the end") {
  Vehicle vehicle(false);
  vehicle.attitude = level;
  vehicle.run(500);
  const auto first = [&] { vehicle.rig.hear(0, message({20, 0}), 245, 190); };
  const auto second = [&](uint8_t system, uint8_t component) {
    vehicle.rig.hear(0, message({-20, 0}), system, component);
    vehicle.run(50);
  };
  first();
  vehicle.run(50);
  second(1, 1);
  CHECK(vehicle.rig.servos.last.pan_us == 1580);
  second(245, 191);
  CHECK(vehicle.rig.servos.last.pan_us == 1580);
  vehicle.run(800);
  second(1, 1);
  CHECK(vehicle.rig.servos.last.pan_us == 1580);
  vehicle.run(50);  // a second after the first one's
  second(1, 1);
  CHECK(vehicle.rig.servos.last.pan_us == 1180);
  first();
  vehicle.run(50);
  CHECK(vehicle.rig.servos.last.pan_us == 1180);
  mavlink_gimbal_device_set_attitude_t end = message({0, 0});
  end.flags |= 1;
  vehicle.rig.hear(0, end, 245, 190);  // not its order
  vehicle.run(50);
  CHECK(vehicle.rig.servos.last.pan_us == 1180);
  end.q[0] = kNan;  // of an end nothing else counts
  vehicle.rig.hear(0, end, 1, 1);
  vehicle.run(50);
  CHECK(vehicle.rig.servos.last.pan_us == 1380);
  first();
  vehicle.run(50);
  CHECK(vehicle.rig.servos.last.pan_us == 1580);
}

TEST_CASE("beyond its reach the axis goes as far as it can and says so") {
  struct Row {
    double azimuth_deg, elevation_deg;
    double pan_deg, tilt_deg;
    uint32_t limits;
  };
  for (const Row& row : {Row{50, 25, 50, 25, 0}, Row{70, 0, 60, 0, 4}, Row{-90, 0, -58, 0, 4},
                         Row{0, 40, 0, 30, 2}, Row{65, -35, 60, -30, 6}}) {
    CAPTURE(row.azimuth_deg);
    Vehicle vehicle(false);
    vehicle.attitude = level;
    vehicle.order = always({row.azimuth_deg, row.elevation_deg});
    vehicle.run(2000);
    // To the left the pulse ends first, at 800 us.
    CHECK(pan_deg(vehicle.rig.servos.last) == doctest::Approx(row.pan_deg));
    CHECK(tilt_deg(vehicle.rig.servos.last) == doctest::Approx(row.tilt_deg));
    CHECK(vehicle.told().failure_flags == row.limits);
  }
}

TEST_CASE("a search that ends at the reach does not say that the order lies beyond it") {
  Vehicle vehicle;
  vehicle.attitude = level;
  vehicle.order = always({55, 0, 20});
  vehicle.run(1000);
  vehicle.rig.forget();
  vehicle.run(4000);
  for (const AxisTold& told : vehicle.rig.axes()) CHECK(told.failure_flags == 0);
  vehicle.order = always({70, 0, 20});
  vehicle.run(500);
  vehicle.rig.forget();
  vehicle.run(4000);
  for (const AxisTold& told : vehicle.rig.axes()) CHECK(told.failure_flags == 4);
}

TEST_CASE("the reach is a parameter, and a reversed servo reaches as far") {
  Vehicle vehicle(false);
  vehicle.attitude = level;
  vehicle.order = always({45, 20});
  vehicle.rig.set_parameter("PAN_REACH", 30);
  vehicle.rig.set_parameter("TILT_REACH", 10);
  vehicle.rig.set_parameter("PAN_US_DEG", -10);
  vehicle.run(1000);
  CHECK(vehicle.rig.servos.last.pan_us == 1380 - 300);
  CHECK(vehicle.rig.servos.last.tilt_us == 1400 + 100);
}

TEST_CASE("attitude is asked for once the vehicle is known, every two seconds while it is slow") {
  const auto requests = [](Rig& rig, int port) {
    std::vector<mavlink_command_long_t> found;
    for (const auto& each : rig.sent(port)) {
      if (each.message.msgid != MAVLINK_MSG_ID_COMMAND_LONG) continue;
      mavlink_command_long_t asked;
      mavlink_msg_command_long_decode(&each.message, &asked);
      found.push_back(asked);
    }
    return found;
  };
  SUBCASE("not before") {
    Rig rig(0, rig::FakeMemory(), 0, 0);
    rig.run(ms(5000));
    CHECK(requests(rig, 0).empty());
    rig.autopilot(9, false);
    rig.run(ms(4500));
    REQUIRE(requests(rig, 0).size() == 1);
    CHECK(requests(rig, 0)[0].target_system == 9);
  }
  SUBCASE("every two seconds") {
    Vehicle vehicle;
    vehicle.run(20000);
    const auto asked = requests(vehicle.rig, 0);
    CHECK(asked.size() == 10);
    CHECK(requests(vehicle.rig, 1).empty());
    for (const auto& each : asked) {
      CHECK(each.target_system == 1);
      CHECK(each.target_component == MAV_COMP_ID_AUTOPILOT1);
      CHECK(each.command == 511);
      CHECK(each.param1 == MAVLINK_MSG_ID_ATTITUDE);
      CHECK(each.param2 == 40000);
      CHECK(each.param3 == 0);
    }
    Microseconds before = 0;
    for (const auto& each : vehicle.rig.sent(0)) {
      if (each.message.msgid != MAVLINK_MSG_ID_COMMAND_LONG) continue;
      // Each waits for a free place on the wire, until the reading after the next at the most.
      if (before != 0) CHECK(each.at - before >= ms(1900));
      before = each.at;
    }
  }
  SUBCASE("not while it comes") {
    Vehicle vehicle;
    vehicle.attitude = level;
    vehicle.run(4000);
    vehicle.rig.forget();
    vehicle.run(20000);
    CHECK(requests(vehicle.rig, 0).empty());
    vehicle.attitude = nullptr;
    vehicle.run(4000);
    CHECK(requests(vehicle.rig, 0).size() >= 1);
  }
}

TEST_CASE("the axis follows the interval of the readings, and can be switched off alone") {
  Vehicle vehicle(false);
  vehicle.run(1000);
  const auto counts = [&] {
    vehicle.rig.forget();
    vehicle.run(2000);
    return std::make_pair(vehicle.rig.named("SNR_RAW").size(), vehicle.rig.axes().size());
  };
  CHECK(counts() == std::make_pair(size_t{20}, size_t{20}));
  CHECK(vehicle.rig.command(511, 285, -1) == MAV_RESULT_ACCEPTED);
  CHECK(counts() == std::make_pair(size_t{20}, size_t{0}));
  CHECK(vehicle.rig.command(511, 285, 100000) == MAV_RESULT_UNSUPPORTED);
  CHECK(vehicle.rig.command(511, 285, 0) == MAV_RESULT_ACCEPTED);
  CHECK(vehicle.rig.command(511, 251, 500000) == MAV_RESULT_ACCEPTED);
  const auto slow = counts();
  CHECK(slow.first == slow.second);
  CHECK(slow.first <= 5);
  CHECK(vehicle.rig.command(511, 251, -1) == MAV_RESULT_ACCEPTED);
  CHECK(counts() == std::make_pair(size_t{0}, size_t{0}));
  CHECK(vehicle.rig.command(511, 285, -1) == MAV_RESULT_ACCEPTED);
  vehicle.rig.autopilot(1, true);
  vehicle.run(1000);
  CHECK(vehicle.rig.command(511, 285, -1) == MAV_RESULT_TEMPORARILY_REJECTED);
  CHECK(counts() == std::make_pair(size_t{20}, size_t{20}));
}

TEST_CASE("what the bench has ordered goes before, until arming ends it") {
  Vehicle vehicle(false);
  vehicle.attitude = level;
  vehicle.order = always({30, 0});
  vehicle.run(1000);
  REQUIRE(vehicle.rig.servos.last.pan_us == 1680);
  struct Bench {
    uint16_t command;
    float first, second;
    uint16_t pan_us;
  };
  for (const Bench& bench :
       {Bench{183, 1, 1200, 1200}, Bench{1000, 0, -10, 1280}, Bench{31010, 2, 0, 1380}}) {
    CAPTURE(bench.command);
    CHECK(vehicle.rig.command(bench.command, bench.first, bench.second) == MAV_RESULT_ACCEPTED);
    vehicle.run(500);
    CHECK(vehicle.rig.servos.last.pan_us == bench.pan_us);
  }
  CHECK(vehicle.rig.command(31010, 0) == MAV_RESULT_ACCEPTED);
  vehicle.run(200);
  CHECK(vehicle.rig.servos.last.pan_us == 1680);
  vehicle.rig.command(183, 1, 1200);
  vehicle.rig.autopilot(1, true);
  vehicle.run(300);
  CHECK(pan_deg(vehicle.rig.servos.last) >= 24);
}
