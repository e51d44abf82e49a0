// What the bench may not do once the autopilot is armed.
#include <doctest/doctest.h>

#include <initializer_list>

#include "rig.h"

using namespace echowing;
using rig::Rig;

namespace {

constexpr Microseconds ms(uint32_t count) { return count * 1000; }

uint16_t nothing(Microseconds) { return 765; }

float limit_other_than(uint8_t index, float value) {
  const ParameterInfo info = parameter_info(index);
  return value == info.most ? info.least : info.most;
}

}  // namespace

TEST_CASE("in flight nothing that would blind it can be set; the rest can") {
  Rig rig;
  rig.autopilot(1, true);
  rig.run(ms(500));
  const char* refused[] = {"SYS_ID",     "COMP_ID",     "SONAR_ADDR", "SONAR_PERIOD",
                           "GATE_SPEED", "TRACK_RANGE", "PAN_MIDDLE", "TILT_HIGH",
                           "PAN_US_DEG", "REPORT_RATE", "SENSOR_ID",  "SERVO_RATE"};
  for (const char* name : refused) {
    CAPTURE(name);
    const uint8_t index = static_cast<uint8_t>(Parameters::find(name));
    const float before = rig.core.parameters().at(index);
    rig.forget();
    rig.set_parameter(name, limit_other_than(index, before));
    rig.run(ms(100));
    CHECK(rig.core.parameters().at(index) == before);
    REQUIRE(rig.values().size() == 1);
    CHECK(rig.values()[0].value == before);
    CHECK(rig.said("not changed in flight"));
  }
  rig.forget();
  for (const char* name : {"AVG_WINDOW", "MISS_LIMIT", "SCAN_DWELL", "SONAR_JITTER"}) {
    CAPTURE(name);
    const uint8_t index = static_cast<uint8_t>(Parameters::find(name));
    rig.set_parameter(name, parameter_info(index).most);
    rig.run(ms(100));
    CHECK(rig.core.parameters().at(index) == parameter_info(index).most);
  }
  CHECK_FALSE(rig.said("not changed"));
}

TEST_CASE("in flight too when the autopilot has fallen silent") {
  Rig rig;
  rig.autopilot(1, true);
  rig.run(ms(500));
  rig.silence_autopilot();
  rig.run(ms(20000));
  rig.set_parameter("SONAR_ADDR", 100);
  rig.run(ms(100));
  CHECK(rig.parameter(Parameter::kSonarAddress) == 0x70);
}

TEST_CASE("in flight reports cannot be thinned or switched off") {
  Rig rig;
  rig.autopilot(1, true);
  rig.run(ms(500));
  for (const float id : {132.0f, 251.0f}) {
    for (const int port : {0, 1}) {
      CHECK(rig.command(511, id, -1, port) == MAV_RESULT_TEMPORARILY_REJECTED);
      CHECK(rig.command(511, id, 200000, port) == MAV_RESULT_TEMPORARILY_REJECTED);
    }
  }
  rig.forget();
  rig.run(ms(2000));
  CHECK(rig.ranges().size() >= 39);
  CHECK(rig.named("SNR_RAW").size() >= 19);
}

TEST_CASE("an order for fewer reports given on the ground ends with arming") {
  for (const float interval : {-1.0f, 200000.0f}) {
    CAPTURE(interval);
    Rig rig;
    rig.autopilot(1, false);
    rig.run(ms(500));
    CHECK(rig.command(511, 132, interval) == MAV_RESULT_ACCEPTED);
    CHECK(rig.command(511, 251, interval) == MAV_RESULT_ACCEPTED);
    rig.run(ms(500));
    rig.forget();
    rig.run(ms(2000));
    CHECK(rig.ranges().size() <= 11);
    rig.autopilot(1, true);
    rig.run(ms(200));
    rig.forget();
    rig.run(ms(2000));
    CHECK(rig.ranges().size() >= 39);
    CHECK(rig.named("SNR_RAW").size() >= 19);
  }
}

TEST_CASE("a change of address that waits for the sonar is dropped by arming") {
  Rig rig;
  rig.autopilot(1, false);
  rig.run(ms(500));
  rig.sonar.plugged = false;
  rig.run(ms(100));
  CHECK(rig.command(31011, 0x35) == MAV_RESULT_ACCEPTED);
  rig.autopilot(1, true);
  rig.run(ms(1000));
  rig.sonar.plugged = true;
  rig.run(ms(2000));
  CHECK(rig.sonar.address == 0x70);
  CHECK(rig.ranges().back().report.current_distance == 300);
}

TEST_CASE("a restart that is ordered just before arming does not happen") {
  Rig rig;
  rig.autopilot(1, false);
  rig.run(ms(500));
  CHECK(rig.command(246, 1) == MAV_RESULT_ACCEPTED);
  rig.autopilot(1, true);
  rig.run(ms(1000));
  CHECK(rig.board.reboots == 0);
}

TEST_CASE("in flight only what asks for a message is obeyed") {
  Rig rig;
  rig.sonar.listen = nothing;
  rig.autopilot(1, true);
  rig.run(ms(500));
  struct Row {
    uint16_t number;
    float first;
    bool allowed;
  };
  const Row rows[] = {{183, 1, false},      {245, 2, false},  {246, 1, false},  {511, 132, false},
                      {512, 148, true},     {520, 1, true},   {1000, 0, false}, {31010, 1, false},
                      {31011, 0x35, false}, {31012, 0, false}};
  for (const Row& row : rows) {
    CAPTURE(row.number);
    const uint8_t result = rig.command(row.number, row.first);
    CHECK(result == (row.allowed ? MAV_RESULT_ACCEPTED : MAV_RESULT_TEMPORARILY_REJECTED));
  }
  CHECK(rig.command(400, 1) == MAV_RESULT_UNSUPPORTED);
}
