#include <doctest/doctest.h>

#include <algorithm>

#include "rig.h"

using namespace echowing;
using rig::Rig;

namespace {

constexpr Microseconds ms(uint32_t count) { return count * 1000; }

uint16_t nothing(Microseconds) { return 765; }

}  // namespace

TEST_CASE("the first read, part information, is no range") {
  Rig rig;
  rig.run(ms(1000));
  for (const float raw : rig.named("SNR_RAW")) CHECK(raw == doctest::Approx(3.0));
  CHECK(rig.named("SNR_RAW").size() >= 9);
}

TEST_CASE("a target is read on a steady grid, at most 54 ms after its ping") {
  for (const uint32_t period_ms : {50, 100, 200}) {
    CAPTURE(period_ms);
    Rig rig;
    rig.set_parameter("SONAR_PERIOD", static_cast<float>(period_ms));
    rig.run(ms(2000));
    uint32_t before_ms = 0;
    for (int i = 0; i < 10; ++i) {
      const size_t known = rig.named("SNR_RAW").size();
      REQUIRE(rig.run_until([&] { return rig.named("SNR_RAW").size() > known; }, ms(300)));
      // The echo of 4.5 m takes 46 ms, the jitter 5; and three turns until it is sent.
      CHECK(rig.now - rig.sonar.pings.back() <= ms(54));
      const uint32_t now_ms = rig.now / 1000;
      if (i > 0) CHECK(now_ms - before_ms == period_ms);
      before_ms = now_ms;
    }
  }
}

TEST_CASE("a period that freshness does not allow is refused") {
  Rig rig;
  rig.set_parameter("SONAR_PERIOD", 201);
  rig.run(ms(100));
  CHECK(rig.parameter(Parameter::kSonarPeriod) == 100);
  rig.set_parameter("SONAR_PERIOD", 200);
  rig.run(ms(2000));
  rig.forget();
  // One reading in two is a miss: the range goes on all the same.
  size_t count = 0;
  rig.sonar.listen = [&](Microseconds) { return ++count % 2 == 0 ? uint16_t{765} : uint16_t{300}; };
  rig.run(ms(3000));
  CHECK(rig.ranges().size() >= 59);
  for (const auto& range : rig.ranges()) CHECK(range.report.current_distance == 300);
}

TEST_CASE("turns that do not divide the period do not stretch it") {
  Rig rig;
  rig.run(ms(2000), 700);
  rig.forget();
  rig.run(ms(20000), 700);
  CHECK(rig.named("SNR_RAW").size() == 200);
}

TEST_CASE("pings are jittered by up to 5 ms, and more than one value") {
  Rig rig;
  rig.run(ms(4000), 100);
  const auto& pings = rig.sonar.pings;
  std::vector<uint32_t> gaps;
  for (size_t i = 5; i < pings.size(); ++i) gaps.push_back(pings[i] - pings[i - 1]);
  const auto ends = std::minmax_element(gaps.begin(), gaps.end());
  CHECK(*ends.first >= ms(95) - 200);
  CHECK(*ends.second <= ms(105) + 200);
  CHECK(*ends.second - *ends.first >= ms(5));
}

TEST_CASE("the period is settable") {
  Rig rig;
  rig.set_parameter("SONAR_PERIOD", 80);
  rig.run(ms(1000));
  rig.sonar.pings.clear();
  rig.run(ms(2000));
  CHECK(rig.sonar.pings.size() == 25);
}

TEST_CASE("a sonar that ranges longer than the period is waited for and is no fault") {
  Rig rig;
  rig.set_parameter("SONAR_PERIOD", 50);
  rig.sonar.ranging_us = 100000;
  rig.sonar.listen = nothing;
  rig.run(ms(5000));
  CHECK_FALSE(rig.said("does not answer"));
  CHECK(rig.heartbeats().back().system_status == MAV_STATE_ACTIVE);
  CHECK(rig.sonar.recoveries == 0);
  CHECK(rig.sonar.pings.size() >= 45);  // 100 ms, up to 5 ms of jitter, up to 2 ms of asking
}

TEST_CASE("a sonar that was never there is told within a second, and heartbeats turn critical") {
  Rig rig;
  rig.sonar.plugged = false;
  rig.run(ms(1000));
  CHECK(rig.said("does not answer"));
  CHECK(rig.sonar.recoveries >= 2);  // retried, recovered, retried before it is said
  rig.run(ms(1000));
  CHECK(rig.heartbeats().back().system_status == MAV_STATE_CRITICAL);
  CHECK(rig.core.state() == DeviceState::kSonarFault);
  CHECK(rig.ranges().empty());
}

TEST_CASE("an unplugged sonar: reports stop, it is said once; plugged again, that is said too") {
  Rig rig;
  rig.run(ms(3000));
  rig.sonar.plugged = false;
  rig.forget();
  rig.run(ms(3000));
  const auto last = rig.ranges().back();
  CHECK(last.at <= ms(3000 + 300 + 50));
  CHECK(last.at - last.report.time_boot_ms * 1000 <= ms(300));
  const std::vector<std::string> told = rig.texts();
  CHECK(std::count(told.begin(), told.end(), "Echowing: sonar does not answer") == 1);
  rig.sonar.plugged = true;
  rig.forget();
  rig.run(ms(2000));
  CHECK(rig.said("answers again"));
  CHECK(rig.ranges().back().report.current_distance == 300);
  CHECK(rig.heartbeats().back().system_status == MAV_STATE_ACTIVE);
}

TEST_CASE("one missed acknowledgement passes unnoticed") {
  Rig rig;
  rig.run(ms(3000));
  rig.forget();
  rig.sonar.plugged = false;
  rig.run(ms(60));
  rig.sonar.plugged = true;
  rig.run(ms(1000));
  CHECK(rig.texts().empty());
  CHECK(rig.sonar.recoveries == 0);
}

TEST_CASE("with a slow period too, one missed acknowledgement is asked for again") {
  Rig rig;
  rig.set_parameter("SONAR_PERIOD", 200);
  rig.run(ms(5000));
  rig.forget();
  rig.run_until([&] { return rig.named("SNR_RAW").size() == 1; }, ms(2000));
  rig.run(ms(190));
  rig.sonar.plugged = false;
  rig.run(ms(60));
  rig.sonar.plugged = true;
  rig.run(ms(3000));
  CHECK(rig.sonar.recoveries == 0);
  CHECK(rig.named("SNR_RAW").size() >= 13);
}

TEST_CASE("a sonar that browns out between ping and reading tells nothing false") {
  Rig rig;
  rig.run(ms(3000));
  rig.forget();
  // After its reset it answers a read with part information, far beyond the span.
  rig.sonar.listen = [](Microseconds) { return uint16_t{0x1202}; };
  rig.run(ms(1000));
  CHECK(rig.named("SNR_RAW").size() <= 1);
  for (const auto& range : rig.ranges()) CHECK(range.report.current_distance == 300);
  CHECK(rig.ranges().size() <= 7);  // 300 ms of old news, then silence
}

TEST_CASE("values outside 20 to 765 are no readings, the limits are") {
  for (const uint16_t value : {0, 19, 766, 0x8000, 0xffff}) {
    CAPTURE(value);
    Rig rig;
    rig.sonar.listen = [value](Microseconds) { return value; };
    rig.run(ms(1000));
    CHECK(rig.named("SNR_RAW").empty());
    CHECK(rig.ranges().empty());
  }
  for (const uint16_t value : {20, 765}) {
    CAPTURE(value);
    Rig rig;
    rig.sonar.listen = [value](Microseconds) { return value; };
    rig.run(ms(1000));
    CHECK_FALSE(rig.named("SNR_RAW").empty());
  }
}

TEST_CASE("the newest reading travels as it is, nothing heard as more than the longest range") {
  Rig rig;
  rig.sonar.listen = [](Microseconds) { return 512; };
  rig.run(ms(500));
  CHECK(rig.named("SNR_RAW").back() == doctest::Approx(5.12));
  rig.sonar.listen = nothing;
  rig.run(ms(500));
  CHECK(rig.named("SNR_RAW").back() == doctest::Approx(7.66));
}

TEST_CASE("a target that stands still gives the same centimetre and stays fresh") {
  Rig rig;
  rig.run(ms(10000));
  rig.forget();
  rig.run(ms(2000));
  CHECK(rig.ranges().size() == 40);
}

TEST_CASE("the address can be changed by command, and is remembered") {
  Rig rig;
  rig.run(ms(500));
  CHECK(rig.command(31011, 0x35) == MAV_RESULT_ACCEPTED);
  rig.run(ms(500));
  CHECK(rig.sonar.address == 0x35);
  CHECK(rig.parameter(Parameter::kSonarAddress) == 0x35);
  CHECK(rig.said("address changed"));
  rig.forget();
  rig.run(ms(500));
  CHECK(rig.named("SNR_RAW").size() >= 4);
}

TEST_CASE("addresses that the sonar or the bus refuses are denied") {
  Rig rig;
  rig.run(ms(500));
  for (const float address : {0.0f, 40.0f, 82.0f, 85.0f, 7.0f, 120.0f, 128.0f, -1.0f}) {
    CAPTURE(address);
    CHECK(rig.command(31011, address) == MAV_RESULT_DENIED);
  }
  rig.run(ms(500));
  CHECK(rig.sonar.address == 0x70);
}

TEST_CASE("after a time-out the bus is initialised anew; a missing acknowledgement is none") {
  Rig rig;
  rig.run(ms(2000));
  rig.sonar.plugged = false;
  rig.run(ms(500));
  CHECK(rig.sonar.restarts == 0);
  rig.sonar.plugged = true;
  rig.run(ms(1000));
  rig.sonar.held = true;
  rig.run(ms(60));
  CHECK(rig.sonar.restarts >= 1);
  rig.sonar.held = false;
  rig.forget();
  rig.run(ms(1000));
  CHECK(rig.named("SNR_RAW").size() >= 9);
  const int restarts = rig.sonar.restarts;
  rig.run(ms(1000));
  CHECK(rig.sonar.restarts == restarts);
}
