#include <doctest/doctest.h>

#include "timing.h"

using namespace echowing;

TEST_CASE("reached is right across the wrap of the microseconds") {
  CHECK(reached(5, 0xfffffff0u));
  CHECK_FALSE(reached(0xfffffff0u, 5));
  CHECK(reached(7, 7));
}

TEST_CASE("a timeout that has ended stays ended for ever") {
  Timeout timeout;
  timeout.start(100, 50);
  CHECK(timeout.running(149));
  CHECK_FALSE(timeout.running(150));
  CHECK_FALSE(timeout.running(150 + 0x80000001u));  // half the clock later it would look early
}

TEST_CASE("a timeout runs across the wrap") {
  Timeout timeout;
  timeout.start(0xffffff00u, 1000);
  CHECK(timeout.running(0x10));
  CHECK_FALSE(timeout.running(1000));
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
