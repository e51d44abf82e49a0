#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>

#include "rig.h"

using namespace echowing;
using rig::Report;
using rig::Rig;

namespace {

constexpr Microseconds ms(uint32_t count) { return count * 1000; }

uint16_t nothing(Microseconds) { return 765; }

}  // namespace

TEST_CASE("reports come at 20 Hz within 2 ms, tracking as well as searching") {
  for (const bool target : {true, false}) {
    CAPTURE(target);
    Rig rig;
    if (!target) {
      rig.sonar.listen = nothing;
      rig.sonar.ranging_us = 66000;
    }
    rig.run(ms(2000));
    rig.forget();
    rig.run(ms(5000));
    const auto ranges = rig.ranges();
    CHECK(ranges.size() >= 99);
    CHECK(ranges.size() <= 101);
    for (size_t i = 1; target && i < ranges.size(); ++i) {
      CHECK(std::abs(static_cast<int>(ranges[i].at - ranges[i - 1].at) - 50000) <= 2000);
    }
  }
}

// It is queued in the turn after, and its 51 bytes go to the port in three turns of 24.
TEST_CASE("a second after start a report leaves right after its reading") {
  Rig rig;
  rig.run(ms(1000));
  rig.forget();
  rig.run(ms(3000));
  uint32_t told_ms = 0;
  int readings = 0;
  for (const auto& range : rig.ranges()) {
    if (range.report.time_boot_ms == told_ms) continue;  // the same reading again
    told_ms = range.report.time_boot_ms;
    ++readings;
    CHECK(range.at / 1000 - told_ms <= 3);
  }
  CHECK(readings >= 29);
}

TEST_CASE("the rate is settable from 5 to 40 Hz, by parameter and by command") {
  Rig rig;
  for (const int rate : {5, 10, 40}) {
    CAPTURE(rate);
    rig.set_parameter("REPORT_RATE", static_cast<float>(rate));
    rig.run(ms(1000));
    rig.forget();
    rig.run(ms(4000));
    CHECK(std::abs(static_cast<int>(rig.ranges().size()) - 4 * rate) <= 1);
  }
  CHECK(rig.command(511, 132, 100000) == MAV_RESULT_ACCEPTED);
  rig.run(ms(1000));
  rig.forget();
  rig.run(ms(4000));
  CHECK(std::abs(static_cast<int>(rig.ranges().size()) - 40) <= 1);
  CHECK(std::abs(static_cast<int>(rig.ranges(1).size()) - 160) <= 1);  // the other port: as before
}

TEST_CASE("message intervals: usual, off, out of limits, unknown") {
  Rig rig;
  CHECK(rig.command(511, 132, 24999) == MAV_RESULT_DENIED);
  CHECK(rig.command(511, 132, 200001) == MAV_RESULT_DENIED);
  CHECK(rig.command(511, 132, -2) == MAV_RESULT_DENIED);
  CHECK(rig.command(511, 132, std::nanf("")) == MAV_RESULT_DENIED);
  CHECK(rig.command(511, 33, 100000) == MAV_RESULT_UNSUPPORTED);
  CHECK(rig.command(511, -5, 100000) == MAV_RESULT_DENIED);
  CHECK(rig.command(511, 132, -1) == MAV_RESULT_ACCEPTED);
  rig.run(ms(500));
  rig.forget();
  rig.run(ms(1000));
  CHECK(rig.ranges().empty());
  CHECK(rig.command(511, 132, 0) == MAV_RESULT_ACCEPTED);
  rig.run(ms(1000));
  CHECK(rig.ranges().size() >= 19);
}

TEST_CASE("single readings can be slowed down or switched off") {
  Rig rig;
  CHECK(rig.command(511, 251, 500000) == MAV_RESULT_ACCEPTED);
  rig.run(ms(1000));
  rig.forget();
  rig.run(ms(5000));
  CHECK(std::abs(static_cast<int>(rig.named("SNR_RAW").size()) - 10) <= 1);
  CHECK(rig.command(511, 251, -1) == MAV_RESULT_ACCEPTED);
  rig.forget();
  rig.run(ms(2000));
  CHECK(rig.named("SNR_RAW").empty());
  CHECK(rig.named("SNR_PAN").empty());
}

TEST_CASE("reports stop 300 ms after the newest reading") {
  Rig rig;
  rig.run(ms(2000));
  rig.sonar.plugged = false;
  rig.run(ms(3000));
  const auto last = rig.ranges().back();
  CHECK(last.at - last.report.time_boot_ms * 1000 < ms(300));
  CHECK(last.at - last.report.time_boot_ms * 1000 > ms(200));
}

TEST_CASE("the fixed fields of a report") {
  Rig rig;
  rig.set_parameter("SENSOR_ID", 7);
  rig.run(ms(1000));
  const auto report = rig.ranges().back().report;
  CHECK(report.orientation == 0);  // forward
  CHECK(report.type == MAV_DISTANCE_SENSOR_ULTRASOUND);
  CHECK(report.id == 7);
  CHECK(report.covariance == 255);
  CHECK(report.horizontal_fov == doctest::Approx(40.0 * 3.14159265 / 180));
  CHECK(report.vertical_fov == report.horizontal_fov);
}

TEST_CASE("signal quality is the share of good readings among ten") {
  Rig rig;
  rig.set_parameter("MISS_LIMIT", 5);
  size_t count = 0;
  rig.sonar.listen = [&](Microseconds) { return ++count % 5 == 0 ? uint16_t{765} : uint16_t{300}; };
  rig.run(ms(3000));
  CHECK(rig.ranges().back().report.signal_quality == 80);
}

TEST_CASE("the quaternion says where the gimbal points") {
  struct Row {
    float pitch_deg, yaw_deg;
  };
  for (const Row row : {Row{0, 0}, Row{10, 0}, Row{0, 20}, Row{-10, 5}}) {
    CAPTURE(row.pitch_deg);
    CAPTURE(row.yaw_deg);
    Rig rig;
    rig.command(1000, row.pitch_deg, row.yaw_deg);
    rig.run(ms(500));
    const Report report = rig.ranges().back().report;
    const float* q = report.quaternion;
    // Forward axis turned by the quaternion: forward, right, down.
    const double forward = 1 - 2 * (q[2] * q[2] + q[3] * q[3]);
    const double right = 2 * (q[1] * q[2] + q[0] * q[3]);
    const double down = 2 * (q[1] * q[3] - q[0] * q[2]);
    const double degree = 3.14159265358979 / 180;
    CHECK(forward == doctest::Approx(cos(row.pitch_deg * degree) * cos(row.yaw_deg * degree)));
    CHECK(right == doctest::Approx(cos(row.pitch_deg * degree) * sin(row.yaw_deg * degree)));
    CHECK(down == doctest::Approx(-sin(row.pitch_deg * degree)));
  }
}

TEST_CASE("the quaternion keeps its length up to straight back, where the angle ends") {
  for (const uint16_t pan_us : {800, 1100, 1500, 1700, 2200}) {
    for (const float scale : {10.0f, 4.0f, -10.0f, 0.001f}) {
      CAPTURE(pan_us);
      CAPTURE(scale);
      Parameters parameters;
      REQUIRE(parameters.set(static_cast<uint8_t>(Parameter::kPanScale), scale));
      const Quaternion q = pointing(parameters, {pan_us, 1500});
      const double half_tilt = 5.0 * 3.14159265 / 180;
      const double degrees = std::max(-180.0, std::min((pan_us - 1380) / double{scale}, 180.0));
      CHECK(q.w == doctest::Approx(cos(degrees / 360 * 3.14159265) * cos(half_tilt)).epsilon(1e-5));
      CHECK(q.z == doctest::Approx(sin(degrees / 360 * 3.14159265) * cos(half_tilt)).epsilon(1e-5));
      const float length = q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z;
      CHECK(length == doctest::Approx(1.0).epsilon(1e-5));
    }
  }
}

TEST_CASE("a servo scale of nought makes no infinities") {
  Rig rig;
  rig.set_parameter("PAN_US_DEG", 0);
  rig.run(ms(1000));
  const Report report = rig.ranges().back().report;
  const float* q = report.quaternion;
  CHECK(q[0] == doctest::Approx(1.0));
}

TEST_CASE("on USB pan, tilt and state travel when they change, and once a second anyway") {
  Rig rig;
  rig.autopilot(1, false);
  rig.run(ms(1000));
  rig.forget();
  rig.run(ms(5000));
  CHECK(std::abs(static_cast<int>(rig.named("SNR_PAN", 1).size()) - 5) <= 1);
  CHECK(rig.named("SNR_PAN", 1).back() == 1380);
  CHECK(rig.named("SNR_STATE", 1).back() == 2);
  rig.command(183, 1, 1500);
  rig.run(ms(60));
  CHECK(rig.named("SNR_PAN", 1).back() == 1500);
  CHECK(rig.named("SNR_TILT", 1).back() == 1400);
}

TEST_CASE("to the autopilot pan, tilt and state go at INFO_RATE, however fast they change") {
  for (const int rate : {2, 1, 10}) {
    CAPTURE(rate);
    Rig rig;
    rig.sonar.listen = nothing;
    rig.autopilot(1, true);
    rig.set_parameter("SCAN_DWELL", 50);
    rig.set_parameter("INFO_RATE", static_cast<float>(rate));
    rig.run(ms(2000));
    rig.forget();
    rig.run(ms(5000));
    for (const char* name : {"SNR_PAN", "SNR_TILT", "SNR_STATE"}) {
      CHECK(std::abs(static_cast<int>(rig.named(name).size()) - 5 * rate) <= 2);
    }
    // What the applet and the ground's estimate live on keeps its rate.
    CHECK(rig.named("SNR_RAW").size() >= 45);
    CHECK(rig.ranges().size() >= 95);
  }
}

TEST_CASE("both ports get the same reports") {
  Rig rig;
  rig.run(ms(3000));
  CHECK(rig.ranges(0).size() == rig.ranges(1).size());
  CHECK(rig.ranges(1).back().report.current_distance == 300);
}

TEST_CASE("a port that takes nothing does not hold up the other") {
  Rig rig;
  rig.serial[1].blocked = true;
  rig.run(ms(2000));
  rig.forget();
  rig.run(ms(2000));
  CHECK(rig.ranges(0).size() == 40);
  rig.serial[1].blocked = false;
  rig.run(ms(1000));
  CHECK(rig.ranges(1).size() >= 19);
  CHECK(rig.stray_bytes(1) == 0);  // what had been queued were whole frames
}

TEST_CASE("the wire is kept free for a range whatever else is asked for") {
  Rig rig;
  rig.run(ms(1000));
  rig.forget();
  mavlink_param_request_list_t list = {};
  list.target_system = 1;
  list.target_component = MAV_COMP_ID_ONBOARD_COMPUTER;
  for (int i = 0; i < 10; ++i) {
    rig.hear(0, list);
    rig.run(ms(100));
  }
  for (const auto& range : rig.ranges()) {
    const Microseconds reading = range.report.time_boot_ms * 1000;
    for (const auto& each : rig.sent())
      CHECK_FALSE((each.at > reading - 4000 && each.at < reading));
  }
}

TEST_CASE("a pause of the loop is not made up for by a burst") {
  ReportClock clock;
  clock.due(0, true, true, ms(50));
  CHECK(clock.due(ms(250), false, true, ms(50)));
  for (uint32_t now_ms = 251; now_ms < 300; ++now_ms)
    CHECK_FALSE(clock.due(ms(now_ms), false, true, ms(50)));
  CHECK(clock.due(ms(302), false, true, ms(50)));
}

TEST_CASE("the beat of the reports locks on to readings at whatever distance they begin") {
  for (uint32_t offset_ms = 0; offset_ms < 50; ++offset_ms) {
    CAPTURE(offset_ms);
    ReportClock clock;
    uint32_t late = 0;
    for (uint32_t now_ms = 0; now_ms < 3000; ++now_ms) {
      const bool reading = now_ms % 50 == offset_ms;
      const bool due = clock.due(ms(now_ms), reading, true, ms(50));
      if (now_ms >= 1000) late += due != reading;
    }
    CHECK(late == 0);
  }
}

TEST_CASE("time goes on through the wrap of the microseconds, unnoticed") {
  Rig rig(0xffffffffu - 3000000u);
  rig.run(ms(6000));
  const auto ranges = rig.ranges();
  CHECK(ranges.size() >= 115);
  for (size_t i = 1; i < ranges.size(); ++i) {
    const uint32_t gap = ranges[i].report.time_boot_ms - ranges[i - 1].report.time_boot_ms;
    CHECK(gap <= 102);
  }
  CHECK(rig.texts().size() == 1);  // started
}

TEST_CASE("the 49.7th day passes unnoticed: reports, states and tracking go on through it") {
  Rig rig(0, rig::FakeMemory(), 0xffffffffu - 3000u);
  rig.run(ms(6000));
  const auto ranges = rig.ranges();
  CHECK(ranges.size() >= 115);
  CHECK(ranges.front().report.time_boot_ms > 0xfffff000u);
  CHECK(ranges.back().report.time_boot_ms < 3000);
  for (size_t i = 1; i < ranges.size(); ++i) {
    const uint32_t gap = ranges[i].report.time_boot_ms - ranges[i - 1].report.time_boot_ms;
    CHECK(gap <= 102);
    CHECK(ranges[i].report.current_distance == 300);
  }
  CHECK(rig.texts().size() == 1);  // started
}

TEST_CASE("values come no more often than reports may, so that they cannot fill the wire") {
  Rig rig;
  CHECK(rig.command(511, MAVLINK_MSG_ID_NAMED_VALUE_FLOAT, 24999) == MAV_RESULT_DENIED);
  CHECK(rig.command(511, MAVLINK_MSG_ID_NAMED_VALUE_FLOAT, 25000) == MAV_RESULT_ACCEPTED);
}

TEST_CASE("with all that can be asked for, and the longest turns, neither port starves") {
  Rig rig;
  rig.sonar.ranging_us = 20000;
  rig.set_parameter("SONAR_PERIOD", 25);
  for (int port : {0, 1}) {
    rig.command(511, MAVLINK_MSG_ID_DISTANCE_SENSOR, 25000, port);
    rig.command(511, MAVLINK_MSG_ID_NAMED_VALUE_FLOAT, 25000, port);
  }
  rig.forget();
  rig.run(ms(5000), 2000);
  for (int port : {0, 1}) {
    CHECK(rig.heartbeats(port).size() >= 4);
    CHECK(rig.ranges(port).size() >= 90);
  }
}
