#include <doctest/doctest.h>

#include <initializer_list>

#include "rig.h"
#include "timing.h"

using namespace echowing;
using rig::Rig;

namespace {

constexpr Instant at(Milliseconds ms) { return {ms * 1000, ms}; }

// Minutes of flight in turns of the longest length, messages thrown away.
void fly(Rig& rig, int minutes) {
  for (int minute = 0; minute < minutes; ++minute) {
    rig.run(60000000, 2000);
    rig.forget();
  }
}

}  // namespace

TEST_CASE("reached is right across the wrap of the microseconds") {
  CHECK(reached(5, 0xfffffff0u));
  CHECK_FALSE(reached(0xfffffff0u, 5));
  CHECK(reached(7, 7));
}

TEST_CASE("a timeout ends in its millisecond and stays ended") {
  Timeout timeout;
  timeout.start(at(100), 50);
  CHECK(timeout.running(at(149)));
  CHECK_FALSE(timeout.running(at(150)));
  CHECK_FALSE(timeout.running(at(150 + 0x80000001u)));  // half the clock later it would look early
}

TEST_CASE("a timeout that nobody asked for 20 days has ended all the same") {
  for (const Milliseconds minutes : {30, 36, 71, 72, 108, 143, 20 * 24 * 60}) {
    CAPTURE(minutes);
    Timeout timeout;
    timeout.start(at(0xffffff00u), 1000);
    CHECK_FALSE(timeout.running(at(0xffffff00u + minutes * 60000)));
  }
}

TEST_CASE("a timeout runs across the wrap") {
  Timeout timeout;
  timeout.start(at(0xffffff00u), 1000);
  CHECK(timeout.running(at(0x10)));
  CHECK_FALSE(timeout.running(at(1000)));
}

TEST_CASE("uptime counts milliseconds through the wrap of the microseconds") {
  Uptime uptime(0);
  Microseconds now = 0;
  constexpr uint32_t kTurn = 100000000;  // 100 s
  for (int i = 0; i < 100; ++i) uptime.advance(now += kTurn);
  CHECK(uptime.ms() == 10000000);  // 10 000 s, more than two wraps
}

TEST_CASE("uptime loses no fraction of a millisecond") {
  Uptime uptime(0);
  for (Microseconds now = 0; now <= 9999; now += 333) uptime.advance(now);
  CHECK(uptime.ms() == 9);
}

// 50 minutes is more than half a wrap of the microseconds, and both clocks wrap on the way.
TEST_CASE("across both wraps, after a long silence of USB and sonar, all goes on") {
  const Milliseconds uptime_ms = 0xffffffffu - 20 * 60000u;
  Rig rig(0xffffffffu - 10 * 60000000u, rig::FakeMemory(), uptime_ms);
  rig.autopilot(1, true);
  rig.run(3000000);
  rig.serial[1].blocked = true;
  rig.sonar.plugged = false;
  fly(rig, 50);
  CHECK(rig.core.state() == DeviceState::kSonarFault);
  rig.serial[1].blocked = false;
  rig.sonar.plugged = true;
  rig.sonar.listen = [](Microseconds) { return 765; };
  rig.run(1000000);
  rig.forget();
  int moves = 0;
  Aim aim = rig.servos.last;
  for (int turn = 0; turn < 8000; ++turn) {
    rig.run(1000);
    moves += rig.servos.last.pan_us != aim.pan_us || rig.servos.last.tilt_us != aim.tilt_us;
    aim = rig.servos.last;
  }
  CHECK(moves >= 24);  // every 300 ms: it is not stuck at a point whose arrival seems to lie ahead
  for (const int port : {0, 1}) {
    CAPTURE(port);
    CHECK(rig.heartbeats(port).size() >= 7);
    CHECK(rig.ranges(port).size() >= 150);
    CHECK(rig.named("SNR_STATE", port).size() >= 7);
  }
  CHECK(rig.core.state() == DeviceState::kSearching);
}

TEST_CASE("a parameter set an hour after the last one is stored 2 s later") {
  Rig rig;
  rig.set_parameter("SCAN_DWELL", 310);
  rig.run(4000000);
  REQUIRE(rig.memory.flushes == 1);
  fly(rig, 50);
  rig.set_parameter("SCAN_DWELL", 320);
  rig.run(1900000);
  CHECK(rig.memory.flushes == 1);
  rig.run(600000);
  CHECK(rig.memory.flushes == 2);
}
