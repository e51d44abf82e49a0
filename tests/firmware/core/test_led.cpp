#include <doctest/doctest.h>

#include "led.h"

using namespace echowing;

namespace {

// Rising edges in the two seconds of a pattern.
int flashes(LedState state) {
  int count = 0;
  for (uint32_t ms = 0; ms < 2000; ++ms) {
    count += led_on(state, 2000 + ms) && !led_on(state, 2000 + ms - 1);
  }
  return count;
}

}  // namespace

TEST_CASE("every state has a light of its own") {
  CHECK(flashes(LedState::kStarting) == 8);
  CHECK(flashes(LedState::kSearching) == 2);
  CHECK(flashes(LedState::kTracking) == 0);
  CHECK(led_on(LedState::kTracking, 12345));
  CHECK(flashes(LedState::kSonarFault) == 3);
  CHECK(flashes(LedState::kNoAutopilot) == 2);
  // Searching is even, no autopilot two short flashes and a pause.
  CHECK(led_on(LedState::kSearching, 400));
  CHECK_FALSE(led_on(LedState::kNoAutopilot, 600));
}
