#include <doctest/doctest.h>

#include <cmath>

#include "rig.h"
#include "scan.h"

using namespace echowing;
using rig::Rig;

namespace {

constexpr Microseconds ms(uint32_t count) { return count * 1000; }

uint16_t nothing(Microseconds) { return 765; }

struct Visit {
  Aim aim;
  Microseconds from;
  Microseconds until;
};

// Where the gimbal was sent, in turn, until `count` places are complete.
std::vector<Visit> visits(Rig& rig, size_t count) {
  std::vector<Visit> all;
  Aim aim = {};
  while (all.size() <= count) {
    rig.run(1000);
    const Aim next = rig.servos.last;
    if (next.pan_us == aim.pan_us && next.tilt_us == aim.tilt_us) continue;
    if (!all.empty()) all.back().until = rig.now;
    all.push_back({next, rig.now, 0});
    aim = next;
  }
  all.pop_back();
  return all;
}

bool at(Aim aim, uint16_t pan_us, uint16_t tilt_us) {
  return aim.pan_us == pan_us && aim.tilt_us == tilt_us;
}

// A rig that has held a target at 3 m straight ahead for a while, armed.
void hold_target(Rig& rig) {
  rig.autopilot(1, true);
  rig.run(ms(3000));
  REQUIRE(rig.core.state() == DeviceState::kTracking);
  rig.forget();
}

}  // namespace

TEST_CASE("with nothing in sight the gimbal goes round the twelve points, 300 ms each") {
  Rig rig;
  rig.sonar.listen = nothing;
  rig.sonar.ranging_us = 66000;
  const std::vector<Visit> all = visits(rig, 24);
  const Parameters parameters;
  for (size_t i = 0; i < all.size(); ++i) {
    CAPTURE(i);
    const Aim point = scan_point(parameters, static_cast<uint8_t>(i % kScanPoints));
    CHECK(at(all[i].aim, point.pan_us, point.tilt_us));
    CHECK(all[i].until - all[i].from >= ms(300));
    CHECK(all[i].until - all[i].from <= ms(302));
  }
}

TEST_CASE("every point gets a ping after the servo has arrived, even from a slow sonar") {
  Rig rig;
  rig.sonar.listen = nothing;
  rig.sonar.ranging_us = 118000;
  rig.set_parameter("SCAN_DWELL", 50);
  rig.set_parameter("SONAR_JITTER", 0);
  rig.run(ms(500));
  rig.sonar.pings.clear();
  const std::vector<Visit> all = visits(rig, 13);
  for (size_t i = 1; i < all.size(); ++i) {
    CAPTURE(i);
    // 100 us at 2500 us/s and a servo frame: 60 ms; 20 us take 28 ms, which is less.
    const bool tilts = all[i].aim.tilt_us != all[i - 1].aim.tilt_us;
    const Microseconds arrival = all[i].from + (tilts ? ms(60) : ms(28));
    const Microseconds latest = all[i].until - ms(118);
    int heard = 0;
    for (const Microseconds ping : rig.sonar.pings) heard += ping >= arrival && ping <= latest;
    CHECK(heard >= 1);
  }
}

TEST_CASE("a reading under 4.5 m freezes the gimbal, one at 4.5 m does not") {
  Rig rig;
  rig.sonar.listen = [](Microseconds) { return 450; };
  rig.run(ms(2000));
  CHECK(rig.core.state() == DeviceState::kSearching);
  rig.sonar.listen = [](Microseconds) { return 449; };
  rig.run(ms(200));
  CHECK(rig.core.state() == DeviceState::kTracking);
  const Aim frozen = rig.servos.last;
  rig.run(ms(5000));
  CHECK(at(rig.servos.last, frozen.pan_us, frozen.tilt_us));
}

TEST_CASE("the report is the average of the newest 0.45 s") {
  Rig rig;
  rig.set_parameter("SONAR_PERIOD", 50);
  uint16_t next = 300;
  rig.sonar.listen = [&](Microseconds) { return next++; };
  rig.run_until([&] { return next == 330; }, ms(5000));
  rig.run(ms(51));
  // The newest reading is 329: 320 to 329 is 324.5.
  CHECK(rig.ranges().back().report.current_distance == 325);
}

TEST_CASE("while searching the range is above the maximum") {
  Rig rig;
  rig.sonar.listen = nothing;
  rig.run(ms(2000));
  const auto report = rig.ranges().back().report;
  CHECK(report.current_distance > report.max_distance);
  CHECK(report.max_distance == 765);
  CHECK(report.min_distance == 20);
  CHECK(report.signal_quality == 1);
}

TEST_CASE("one wild reading does not lose the leader nor touch the average") {
  for (const uint16_t wild : {765, 40}) {
    CAPTURE(wild);
    Rig rig;
    hold_target(rig);
    size_t count = 0;
    rig.sonar.listen = [&](Microseconds) { return ++count == 5 ? wild : uint16_t{300}; };
    rig.run(ms(2000));
    CHECK(rig.core.state() == DeviceState::kTracking);
    for (const auto& range : rig.ranges()) CHECK(range.report.current_distance == 300);
  }
}

TEST_CASE("two misses in a row start a search; three may be asked for") {
  for (const int limit : {2, 3}) {
    CAPTURE(limit);
    Rig rig;
    rig.set_parameter("MISS_LIMIT", static_cast<float>(limit));
    hold_target(rig);
    rig.sonar.pings.clear();
    rig.sonar.listen = nothing;
    rig.run_until([&] { return rig.core.state() == DeviceState::kSearching; }, ms(1000));
    // The reading under way when the target vanished was still good.
    CHECK(rig.sonar.pings.size() >= static_cast<size_t>(limit));
    CHECK(rig.sonar.pings.size() <= static_cast<size_t>(limit + 1));
  }
}

TEST_CASE("a stream of wild readings does not keep an old average alive") {
  Rig rig;
  hold_target(rig);
  size_t count = 0;
  const uint16_t wild[] = {40, 120, 400, 210};
  rig.sonar.listen = [&](Microseconds) { return wild[++count % 4]; };
  rig.run(ms(300));
  rig.forget();
  rig.run(ms(2000));
  for (const auto& range : rig.ranges()) CHECK(range.report.current_distance != 300);
}

TEST_CASE("the average after a search holds nothing from before it") {
  Rig rig;
  hold_target(rig);
  rig.sonar.listen = nothing;
  rig.run(ms(300));
  rig.forget();
  rig.sonar.listen = [](Microseconds) { return 420; };
  rig.run(ms(1000));
  for (const auto& range : rig.ranges()) {
    CHECK((range.report.current_distance == 420 || range.report.current_distance > 765));
  }
  CHECK(rig.ranges().back().report.current_distance == 420);
}

TEST_CASE("the search starts where the target was last seen, then goes on in order") {
  Rig rig;
  rig.sonar.listen = nothing;
  rig.run_until([&] { return at(rig.servos.last, 1380, 1300); }, ms(5000));
  rig.sonar.listen = [](Microseconds) { return 300; };
  rig.run(ms(1000));
  REQUIRE(at(rig.servos.last, 1380, 1300));
  rig.sonar.listen = nothing;
  rig.run_until([&] { return rig.core.state() == DeviceState::kSearching; }, ms(1000));
  const std::vector<Visit> all = visits(rig, 3);
  CHECK(at(all[0].aim, 1380, 1300));
  CHECK(all[0].until - all[0].from >= ms(298));
  CHECK(at(all[1].aim, 1400, 1300));
  CHECK(at(all[2].aim, 1400, 1400));
}

TEST_CASE("a single wild reading during the search does not send it back") {
  Rig rig;
  rig.sonar.listen = nothing;
  rig.run_until([&] { return at(rig.servos.last, 1330, 1300); }, ms(5000));
  bool wild = true;
  rig.sonar.listen = [&](Microseconds) {
    const uint16_t range = wild ? 200 : 765;
    wild = false;
    return range;
  };
  const std::vector<Visit> all = visits(rig, 3);
  CHECK(at(all[0].aim, 1330, 1300));
  CHECK(at(all[1].aim, 1380, 1300));
  CHECK(at(all[2].aim, 1400, 1300));
  for (const auto& range : rig.ranges()) CHECK(range.report.current_distance > 765);
}

TEST_CASE("the search still works after an hour of tracking") {
  Rig rig;
  rig.autopilot(1, true);
  rig.run(ms(1000));
  // 67 minutes: past half the range of the microseconds, and nearly all of it.
  for (int minute = 0; minute < 67; ++minute) {
    rig.run(ms(60000), 20000);
    rig.forget();
  }
  REQUIRE(rig.core.state() == DeviceState::kTracking);
  rig.sonar.listen = nothing;
  rig.run(ms(500));
  const std::vector<Visit> all = visits(rig, 3);
  for (const Visit& visit : all) CHECK(visit.until - visit.from <= ms(310));
}

TEST_CASE("disarmed the gimbal is centred while ranging and reporting go on") {
  Rig rig;
  rig.sonar.listen = nothing;
  rig.autopilot(1, false);
  rig.run(ms(5000));
  CHECK(at(rig.servos.last, 1380, 1400));
  rig.forget();
  rig.run(ms(2000));
  CHECK(at(rig.servos.last, 1380, 1400));
  CHECK(rig.ranges().size() >= 39);
  rig.sonar.listen = [](Microseconds) { return 250; };
  rig.run(ms(1000));
  CHECK(rig.ranges().back().report.current_distance == 250);
}

TEST_CASE("arming starts the scan, disarming ends it, silence starts it again") {
  Rig rig;
  rig.sonar.listen = nothing;
  rig.autopilot(1, false);
  rig.run(ms(2000));
  REQUIRE(at(rig.servos.last, 1380, 1400));
  rig.autopilot(1, true);
  rig.run(ms(100));
  CHECK(at(rig.servos.last, 1330, 1400));
  rig.autopilot(1, false);
  rig.run(ms(100));
  CHECK(at(rig.servos.last, 1380, 1400));
  rig.silence_autopilot();
  rig.run(ms(4800));
  CHECK(at(rig.servos.last, 1380, 1400));
  rig.run(ms(400));
  CHECK_FALSE(at(rig.servos.last, 1380, 1400));
}

TEST_CASE("losing the autopilot in flight does not stop the scan") {
  Rig rig;
  rig.sonar.listen = nothing;
  rig.autopilot(1, true);
  rig.run(ms(2000));
  rig.silence_autopilot();
  rig.run(ms(10000));
  CHECK(visits(rig, 3).size() == 3);
}

TEST_CASE("bench commands: scan, stop, aim by pulse and by angle, automatic again") {
  Rig rig;
  rig.sonar.listen = nothing;
  rig.autopilot(1, false);
  rig.run(ms(1000));
  CHECK(rig.command(31010, 1) == MAV_RESULT_ACCEPTED);
  rig.run(ms(1000));
  CHECK_FALSE(at(rig.servos.last, 1380, 1400));
  CHECK(rig.command(31010, 2) == MAV_RESULT_ACCEPTED);
  rig.run(ms(100));
  CHECK(at(rig.servos.last, 1380, 1400));
  CHECK(rig.command(183, 1, 1500) == MAV_RESULT_ACCEPTED);
  CHECK(at(rig.servos.last, 1500, 1400));
  CHECK(rig.command(183, 2, 1250) == MAV_RESULT_ACCEPTED);
  CHECK(at(rig.servos.last, 1500, 1250));
  CHECK(rig.command(1000, 5, -10) == MAV_RESULT_ACCEPTED);  // 5 up, 10 left at 10 us a degree
  CHECK(at(rig.servos.last, 1280, 1450));
  rig.run(ms(3000));
  CHECK(at(rig.servos.last, 1280, 1450));
  CHECK(rig.command(31010, 0) == MAV_RESULT_ACCEPTED);
  CHECK(at(rig.servos.last, 1380, 1400));
}

TEST_CASE("impossible bench commands are denied") {
  Rig rig;
  CHECK(rig.command(183, 1, 100) == MAV_RESULT_DENIED);
  CHECK(rig.command(183, 3, 1500) == MAV_RESULT_DENIED);
  CHECK(rig.command(183, 1, std::nanf("")) == MAV_RESULT_DENIED);
  CHECK(rig.command(1000, 0, 400) == MAV_RESULT_DENIED);
  CHECK(rig.command(31010, 7) == MAV_RESULT_DENIED);
}

TEST_CASE("in flight the bench is refused, and taking off ends what it had ordered") {
  Rig rig;
  rig.sonar.listen = nothing;
  rig.autopilot(1, false);
  rig.run(ms(500));
  CHECK(rig.command(183, 1, 1500) == MAV_RESULT_ACCEPTED);
  rig.autopilot(1, true);
  rig.run(ms(1000));
  CHECK_FALSE(at(rig.servos.last, 1500, 1400));
  CHECK(rig.command(183, 1, 1500) == MAV_RESULT_TEMPORARILY_REJECTED);
  CHECK(rig.command(31010, 2) == MAV_RESULT_TEMPORARILY_REJECTED);
  CHECK(rig.command(246, 1) == MAV_RESULT_TEMPORARILY_REJECTED);
}

TEST_CASE("turning the gimbal by hand forgets what was heard from the old direction") {
  Rig rig;
  rig.autopilot(1, false);
  rig.run(ms(1000));
  REQUIRE(rig.ranges().back().report.current_distance == 300);
  rig.sonar.listen = [](Microseconds) { return 120; };
  rig.command(183, 1, 1800);
  rig.forget();
  rig.run(ms(1000));
  for (const auto& range : rig.ranges()) {
    CHECK((range.report.current_distance == 120 || range.report.current_distance > 765));
  }
}

TEST_CASE("the light follows the state") {
  Rig rig;
  CHECK(rig.core.led_state() == LedState::kStarting);
  rig.run(ms(500));
  CHECK(rig.core.led_state() == LedState::kNoAutopilot);
  rig.autopilot(1, true);
  rig.run(ms(500));
  CHECK(rig.core.led_state() == LedState::kTracking);
  rig.sonar.listen = nothing;
  rig.run(ms(500));
  CHECK(rig.core.led_state() == LedState::kSearching);
  rig.sonar.plugged = false;
  rig.run(ms(500));
  CHECK(rig.core.led_state() == LedState::kSonarFault);
}
