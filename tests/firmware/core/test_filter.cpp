#include <doctest/doctest.h>

#include <initializer_list>

#include "filter.h"

using namespace echowing;

namespace {

constexpr FilterSettings kUsual = {450, 800};

// A filter fed at a steady period, beginning just before the low bits of the clock wrap.
struct Steady {
  explicit Steady(Milliseconds period = 50) : period_ms(period) {}
  bool add(uint16_t range_cm, const FilterSettings& settings = kUsual) {
    now_ms += period_ms;
    return filter.add(now_ms, range_cm, settings);
  }
  RangeFilter filter;
  Milliseconds period_ms;
  Milliseconds now_ms = 65000;
};

}  // namespace

TEST_CASE("a first reading is held until the next confirms it") {
  Steady steady;
  CHECK_FALSE(steady.add(300));
  CHECK_FALSE(steady.filter.has_average());
  CHECK(steady.add(310));
  CHECK(steady.filter.average_cm() == 305);
}

TEST_CASE("the average spans 0.45 s at any period") {
  struct Row {
    Milliseconds period_ms;
    uint16_t mean_cm;
  };
  // Readings 1 cm apart that end with 330: at 50 ms ten of them, 321 to 330, and so on.
  for (const Row row : {Row{50, 326}, Row{100, 328}, Row{25, 321}, Row{200, 329}}) {
    CAPTURE(row.period_ms);
    Steady steady(row.period_ms);
    for (uint16_t range_cm = 290; range_cm <= 330; ++range_cm) steady.add(range_cm);
    CHECK(steady.filter.average_cm() == row.mean_cm);
  }
}

TEST_CASE("readings that come some milliseconds off their beat are still ten") {
  Steady steady;
  for (uint16_t i = 0; i < 40; ++i) {
    steady.period_ms = i % 2 == 0 ? 46 : 54;
    steady.add(static_cast<uint16_t>(300 + i));
  }
  CHECK(steady.filter.average_cm() == 335);  // 330 to 339 is 334.5
}

TEST_CASE("a lone wild reading leaves the average untouched") {
  Steady steady;
  for (int i = 0; i < 10; ++i) steady.add(300);
  CHECK_FALSE(steady.add(40));
  CHECK(steady.filter.average_cm() == 300);
  CHECK(steady.add(302));
  CHECK(steady.filter.average_cm() == 300);
}

TEST_CASE("two wild readings that agree do not count with a good one between them") {
  Steady steady;
  for (int i = 0; i < 10; ++i) steady.add(300);
  CHECK_FALSE(steady.add(200));
  CHECK(steady.add(300));
  CHECK_FALSE(steady.add(200));
  CHECK(steady.filter.average_cm() == 300);
}

TEST_CASE("a jump that lasts begins a new average") {
  Steady steady;
  for (int i = 0; i < 10; ++i) steady.add(300);
  CHECK_FALSE(steady.add(200));
  CHECK(steady.add(204));
  CHECK(steady.filter.average_cm() == 202);
}

TEST_CASE("two wild readings in a row that disagree change nothing") {
  Steady steady;
  for (int i = 0; i < 10; ++i) steady.add(300);
  CHECK_FALSE(steady.add(40));
  CHECK_FALSE(steady.add(120));
  CHECK(steady.filter.average_cm() == 300);
}

TEST_CASE("the gate is a speed: as far as the target can have moved, and the spread of its parts") {
  // 8 m/s: 40 cm in 50 ms, 80 cm in 100 ms, and 10 cm.
  for (const Milliseconds period_ms : {50, 100}) {
    CAPTURE(period_ms);
    const uint16_t gate_cm = static_cast<uint16_t>(10 + 800 * period_ms / 1000);
    Steady steady(period_ms);
    steady.add(300);
    CHECK(steady.add(static_cast<uint16_t>(300 + gate_cm)));
    CHECK_FALSE(steady.add(static_cast<uint16_t>(301 + 2 * gate_cm)));
  }
}

TEST_CASE("closing at 6 m/s every reading is taken, at any period") {
  for (const Milliseconds period_ms : {25, 50, 100, 200}) {
    CAPTURE(period_ms);
    Steady steady(period_ms);
    uint16_t range_cm = 440;
    steady.add(range_cm);
    while (range_cm > 600 * period_ms / 1000 + 20) {
      range_cm = static_cast<uint16_t>(range_cm - 600 * period_ms / 1000);
      CHECK(steady.add(range_cm));
    }
  }
}

TEST_CASE("no old reading survives a gap") {
  Steady steady;
  for (int i = 0; i < 10; ++i) steady.add(300);
  for (Milliseconds gone = 0; gone <= 450; ++gone) {
    steady.filter.expire(steady.now_ms + gone);
    REQUIRE(steady.filter.has_average());
  }
  steady.filter.expire(steady.now_ms + 451);
  CHECK_FALSE(steady.filter.has_average());
  steady.now_ms += 451;
  CHECK_FALSE(steady.add(300));  // as if it were the first
  CHECK(steady.add(310));
  CHECK(steady.filter.average_cm() == 305);
}

TEST_CASE("a held reading does not survive a gap, nor a clear") {
  Steady steady;
  steady.add(300);
  steady.filter.clear();
  CHECK_FALSE(steady.add(300));
  steady.now_ms += 500;
  CHECK_FALSE(steady.add(300));
}

TEST_CASE("a shorter window takes effect at once; of 0 it is the newest alone") {
  Steady steady;
  for (int i = 0; i < 10; ++i) steady.add(300);
  steady.add(340, {50, 800});
  CHECK(steady.filter.average_cm() == 320);
  steady.add(344, {0, 800});
  CHECK(steady.filter.average_cm() == 344);
}

TEST_CASE("the longest window at the shortest period neither overruns nor overflows") {
  Steady steady(25);
  for (int i = 0; i < 100; ++i) steady.add(765, {RangeFilter::kLongestWindow, 800});
  CHECK(steady.filter.average_cm() == 765);
  Steady flood(1);
  for (int i = 0; i < 1000; ++i) flood.add(765, {RangeFilter::kLongestWindow, 800});
  CHECK(flood.filter.average_cm() == 765);
}
