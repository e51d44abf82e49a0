#include <doctest/doctest.h>

#include "bus_recovery.h"

using namespace echowing;

namespace {

// A slave reset in mid-byte: it holds data low until it has been clocked `bits` more times, and
// is only content with a STOP. Both lines have pull-ups; the master may only let go or pull low.
class StuckBus : public I2cBus {
 public:
  explicit StuckBus(int bits) : bits_left(bits) {}

  bool write(uint8_t, const uint8_t*, uint8_t) override { return freed(); }
  bool read(uint8_t, uint8_t*, uint8_t) override { return freed(); }
  bool take_timeout() override { return false; }
  void restart() override {}
  void take_lines() override { by_hand = true; }
  void return_lines() override { by_hand = false; }
  void drive_clock(bool high) override {
    REQUIRE(by_hand);
    if (high && !clock) ++clocks;
    if (!high && clock && bits_left > 0) --bits_left;  // the slave shifts on the falling edge
    clock = high;
  }
  void drive_data(bool high) override {
    REQUIRE(by_hand);
    const bool before = data();
    master_data = high;
    if (clock && !before && data()) ++stops;
    if (clock && before && !data()) ++starts;
  }

  bool data() const { return master_data && bits_left == 0; }
  bool freed() const { return !by_hand && data() && clock; }

  int bits_left;
  bool by_hand = false;
  bool clock = true;
  bool master_data = true;
  int clocks = 0;
  int stops = 0;
  int starts = 0;
};

int recover(StuckBus& bus) {
  BusRecovery recovery;
  recovery.start();
  int turns = 1;
  while (!recovery.step(bus)) ++turns;
  return turns;
}

}  // namespace

TEST_CASE("nine clocks and a STOP free a bus stuck at any bit of a byte") {
  for (int bits = 0; bits <= 9; ++bits) {
    CAPTURE(bits);
    StuckBus bus(bits);
    recover(bus);
    CHECK(bus.freed());
    CHECK(bus.stops == 1);
    CHECK(bus.starts == 0);
    CHECK(bus.clocks >= 9);
  }
}

TEST_CASE("each turn makes one edge, so none waits") {
  StuckBus bus(9);
  CHECK(recover(bus) == 23);  // 18 clock edges, 4 for the STOP, 1 to give the lines back
}
