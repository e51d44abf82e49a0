// Whose co-processor it is: the vehicle forwards the heartbeats of others, in any order.
#include <doctest/doctest.h>

#include "rig.h"

using namespace echowing;
using rig::Rig;

namespace {

constexpr Microseconds ms(uint32_t count) { return count * 1000; }

constexpr uint8_t kStation = 255, kLeader = 1, kOwn = 7, kNobody = 250;
constexpr const char* kSeveral = "several vehicles detected";
constexpr const char* kOnlyOthers = "other vehicles detected";

uint16_t nothing(Microseconds) { return 765; }

// A board as it comes from its first flashing, with nothing in sight.
struct Fresh : Rig {
  explicit Fresh(const rig::FakeMemory& stored = rig::FakeMemory()) : Rig(0, stored, 0, 0) {
    sonar.listen = nothing;
  }
};

void hear_station(Rig& rig) {
  mavlink_heartbeat_t heartbeat = {};
  heartbeat.type = 6;
  heartbeat.autopilot = MAV_AUTOPILOT_INVALID;
  rig.hear(0, heartbeat, kStation, 190);
}

// Seconds in which the station, the leader and our own autopilot are heard, in this order.
void hear_all(Rig& rig, int seconds, bool leader_armed, bool own_armed) {
  for (int i = 0; i < seconds; ++i) {
    hear_station(rig);
    rig.hear_vehicle(kLeader, leader_armed);
    rig.run(ms(100));
    rig.hear_vehicle(kOwn, own_armed);
    rig.run(ms(900));
  }
}

bool scans(Rig& rig) {
  const Aim before = rig.servos.last;
  return rig.run_until([&] { return rig.servos.last.tilt_us != before.tilt_us; }, ms(1500));
}

bool spoke_as(Rig& rig, uint8_t system) {
  for (const auto& each : rig.sent()) {
    if (each.message.sysid == system) return true;
  }
  return false;
}

void command_from_station(Rig& rig, uint8_t system, uint16_t command, float first) {
  mavlink_command_long_t message = {};
  message.target_system = system;
  message.target_component = 191;
  message.command = command;
  message.param1 = first;
  rig.hear(0, message);
  rig.run(ms(20));
}

}  // namespace

TEST_CASE("before a vehicle is known it speaks as nobody") {
  Fresh rig;
  rig.run(ms(3000));
  CHECK(rig.speaks_as() == kNobody);
  CHECK(rig.sent().back().message.compid == 191);
}

TEST_CASE("a vehicle heard alone is learned, stored, and started from") {
  Fresh rig;
  rig.autopilot(kOwn, false);
  rig.run(ms(3500));
  CHECK(rig.speaks_as() == kNobody);  // another may still come
  rig.run(ms(1500));
  CHECK(rig.speaks_as() == kOwn);
  CHECK(rig.speaks_as(1) == kOwn);
  CHECK(rig.said("system id learned"));
  CHECK(rig.parameter(Parameter::kSystemId) == kOwn);
  rig.silence_autopilot();
  rig.run(ms(20000));
  CHECK(rig.speaks_as() == kOwn);

  Fresh later(rig.memory);
  later.run(ms(100));
  CHECK(later.sent().front().message.sysid == kOwn);
}

TEST_CASE("while it learns, the autopilot is heard and its arming counts") {
  Fresh rig;
  rig.autopilot(kOwn, false);
  rig.run(ms(1500));
  CHECK_FALSE(scans(rig));
  rig.autopilot(kOwn, true);
  rig.run(ms(100));
  CHECK(scans(rig));
}

TEST_CASE("a burst of heartbeats out of a radio's buffer teaches nothing") {
  Fresh rig;
  for (int i = 0; i < 20; ++i) rig.hear_vehicle(kLeader, false);
  rig.run(ms(1000));
  CHECK(rig.speaks_as() == kNobody);
}

TEST_CASE("only a heartbeat of component 1 with an autopilot, on its port, is a vehicle's") {
  Fresh rig;
  mavlink_heartbeat_t heartbeat = {};
  for (int i = 0; i < 8; ++i) {
    hear_station(rig);
    heartbeat.autopilot = 3;
    rig.hear(0, heartbeat, 40, 154);  // a gimbal
    rig.hear(1, heartbeat, 42, 1);    // on USB there is a bench, not a vehicle
    heartbeat.autopilot = MAV_AUTOPILOT_INVALID;
    rig.hear(0, heartbeat, 41, 1);
    rig.run(ms(1000));
  }
  CHECK(rig.speaks_as() == kNobody);
  CHECK(rig.core.led_state() == LedState::kNoAutopilot);
}

TEST_CASE("station, leader, own: a board that knows its vehicle is never the leader's") {
  Rig rig(0, rig::FakeMemory(), 0, kOwn);
  rig.sonar.listen = nothing;
  hear_all(rig, 8, true, false);
  CHECK_FALSE(spoke_as(rig, kLeader));
  CHECK(rig.speaks_as() == kOwn);
  CHECK_FALSE(scans(rig));  // the leader is armed, we are not
  rig.forget();
  command_from_station(rig, kOwn, 512, 148);
  CHECK(rig.acks().size() == 1);
  command_from_station(rig, kLeader, 512, 148);
  CHECK(rig.acks().size() == 1);
  hear_all(rig, 1, false, true);
  CHECK(scans(rig));
  CHECK_FALSE(rig.said("vehicles detected"));
}

TEST_CASE("station, leader, own: a board that learns takes neither, says so, and plays safe") {
  Fresh rig;
  hear_all(rig, 8, true, false);
  CHECK_FALSE(spoke_as(rig, kLeader));
  CHECK_FALSE(spoke_as(rig, kOwn));
  CHECK(rig.said(kSeveral));
  CHECK(scans(rig));  // one of them is armed
  command_from_station(rig, kNobody, 183, 1);
  CHECK(rig.acks().back().result == MAV_RESULT_TEMPORARILY_REJECTED);
  hear_all(rig, 8, false, false);
  CHECK_FALSE(scans(rig));
  hear_all(rig, 1, false, true);
  CHECK(scans(rig));
}

TEST_CASE("the conflict is settled by the parameter, or by the leader going away") {
  Fresh set;
  hear_all(set, 3, false, false);
  REQUIRE(set.speaks_as() == kNobody);
  mavlink_param_set_t message = {};
  message.target_system = kNobody;
  message.target_component = 191;
  memcpy(message.param_id, "SYS_ID", 6);
  message.param_value = kOwn;
  set.hear(1, message);
  set.run(ms(100));
  CHECK(set.speaks_as() == kOwn);

  Fresh alone;
  hear_all(alone, 3, false, false);
  alone.autopilot(kOwn, false);
  alone.run(ms(5500));
  CHECK(alone.speaks_as() == kOwn);
}

TEST_CASE("a reset in mid-flight: it starts as its own vehicle, whoever is heard first") {
  Fresh rig;
  rig.autopilot(kOwn, false);
  rig.run(ms(8000));
  REQUIRE(rig.memory.flushes == 1);

  Fresh later(rig.memory);
  later.hear_vehicle(kLeader, true);
  later.run(ms(100));
  command_from_station(later, kOwn, 246, 1);
  CHECK(later.acks().back().result == MAV_RESULT_TEMPORARILY_REJECTED);  // before its own is heard
  hear_all(later, 3, true, true);
  CHECK(scans(later));
  for (const auto& each : later.sent()) CHECK(each.message.sysid == kOwn);
  CHECK(later.memory.writes == rig.memory.writes);
}

TEST_CASE("a reset in mid-flight before it ever learned: it scans, and stores nothing") {
  Fresh rig;
  hear_all(rig, 4, false, true);
  CHECK(scans(rig));
  CHECK(rig.speaks_as() == kNobody);
  rig.autopilot(kOwn, true);
  rig.run(ms(10000));
  CHECK(rig.speaks_as() == kOwn);
  CHECK(rig.memory.writes == 0);
  rig.autopilot(kOwn, false);
  rig.run(ms(3000));
  CHECK(rig.memory.flushes == 1);
}

TEST_CASE("a board of another vehicle says so, again and again, and any armed one is ours") {
  Rig rig(0, rig::FakeMemory(), 0, kOwn);
  rig.sonar.listen = nothing;
  rig.autopilot(kLeader, false);
  rig.run(ms(4500));
  CHECK_FALSE(rig.said(kOnlyOthers));  // our autopilot may still be starting
  rig.run(ms(1500));
  CHECK(rig.said(kOnlyOthers));
  rig.forget();
  rig.run(ms(25000));
  CHECK_FALSE(rig.said(kOnlyOthers));
  rig.run(ms(10000));
  CHECK(rig.said(kOnlyOthers));
  CHECK(rig.speaks_as() == kOwn);
  rig.autopilot(kLeader, true);
  rig.run(ms(100));
  command_from_station(rig, kOwn, 183, 1);
  CHECK(rig.acks().back().result == MAV_RESULT_TEMPORARILY_REJECTED);
}

TEST_CASE("another vehicle's heartbeat changes nothing while ours is heard, or was in flight") {
  Rig rig(0, rig::FakeMemory(), 0, kOwn);
  rig.autopilot(kOwn, true);
  rig.run(ms(500));
  rig.silence_autopilot();
  for (int i = 0; i < 20; ++i) {
    rig.hear_vehicle(5, false);
    rig.run(ms(1000));
  }
  CHECK(rig.speaks_as() == kOwn);
  command_from_station(rig, kOwn, 246, 1);
  CHECK(rig.acks().back().result == MAV_RESULT_TEMPORARILY_REJECTED);
}

TEST_CASE("with SYS_ID 0 it learns anew") {
  Rig rig(0, rig::FakeMemory(), 0, kOwn);
  rig.set_parameter("SYS_ID", 0);  // to vehicle 1, as the rig speaks
  rig.run(ms(100));
  CHECK(rig.parameter(Parameter::kSystemId) == kOwn);
  CHECK(rig.core.set_parameter(static_cast<uint8_t>(Parameter::kSystemId), 0));
  rig.autopilot(5, false);
  rig.run(ms(6000));
  CHECK(rig.speaks_as() == 5);
}
