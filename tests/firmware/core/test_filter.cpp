#include <doctest/doctest.h>

#include "filter.h"

using echowing::RangeFilter;

namespace {

constexpr uint8_t kCount = 10;
constexpr uint16_t kGate = 50;

bool add(RangeFilter& filter, uint16_t range_cm) { return filter.add(range_cm, kCount, kGate); }

}  // namespace

TEST_CASE("a first reading is held until the next confirms it") {
  RangeFilter filter;
  CHECK_FALSE(add(filter, 300));
  CHECK_FALSE(filter.has_average());
  CHECK(add(filter, 310));
  CHECK(filter.average_cm() == 305);
}

TEST_CASE("the average is of the newest ten") {
  RangeFilter filter;
  for (uint16_t range_cm = 300; range_cm <= 320; ++range_cm) add(filter, range_cm);
  CHECK(filter.average_cm() == 316);  // 311 to 320 is 315.5
}

TEST_CASE("a lone wild reading leaves the average untouched") {
  RangeFilter filter;
  for (int i = 0; i < 10; ++i) add(filter, 300);
  CHECK_FALSE(add(filter, 40));
  CHECK(filter.average_cm() == 300);
  CHECK(add(filter, 302));
  CHECK(filter.average_cm() == 300);
}

TEST_CASE("two wild readings that agree do not count with a good one between them") {
  RangeFilter filter;
  for (int i = 0; i < 10; ++i) add(filter, 300);
  CHECK_FALSE(add(filter, 200));
  CHECK(add(filter, 300));
  CHECK_FALSE(add(filter, 200));
  CHECK(filter.average_cm() == 300);
}

TEST_CASE("a jump that lasts begins a new average") {
  RangeFilter filter;
  for (int i = 0; i < 10; ++i) add(filter, 300);
  CHECK_FALSE(add(filter, 200));
  CHECK(add(filter, 204));
  CHECK(filter.average_cm() == 202);
}

TEST_CASE("two wild readings in a row that disagree change nothing") {
  RangeFilter filter;
  for (int i = 0; i < 10; ++i) add(filter, 300);
  CHECK_FALSE(add(filter, 40));
  CHECK_FALSE(add(filter, 120));
  CHECK(filter.average_cm() == 300);
}

TEST_CASE("the gate is inclusive") {
  RangeFilter filter;
  add(filter, 300);
  CHECK(add(filter, 350));
  CHECK_FALSE(add(filter, 401));
}

TEST_CASE("a held reading does not survive a clear") {
  RangeFilter filter;
  add(filter, 300);
  filter.clear();
  CHECK_FALSE(add(filter, 300));
}

TEST_CASE("a smaller count takes effect at once") {
  RangeFilter filter;
  for (int i = 0; i < 10; ++i) filter.add(300, 10, kGate);
  filter.add(340, 2, kGate);
  CHECK(filter.average_cm() == 320);
}

TEST_CASE("the largest count neither overruns nor overflows") {
  RangeFilter filter;
  for (int i = 0; i < 100; ++i) filter.add(765, RangeFilter::kCapacity, kGate);
  CHECK(filter.average_cm() == 765);
}
