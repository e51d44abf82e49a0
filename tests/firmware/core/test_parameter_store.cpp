#include <doctest/doctest.h>

#include <cstdlib>
#include <cstring>

#include "rig.h"

using namespace echowing;
using rig::FakeMemory;
using Loaded = ParameterStore::Loaded;

namespace {

constexpr Instant at(Milliseconds ms) { return {ms * 1000, ms}; }

constexpr uint8_t kDwellIndex = static_cast<uint8_t>(Parameter::kDwell);

// Steps the store until it has written a set, or gives up.
bool store(ParameterStore& store, FakeMemory& memory, const Parameters& parameters,
           Milliseconds& now) {
  store.touch(at(now));
  for (int turn = 0; turn < 5000; ++turn) {
    if (store.step(at(++now), true, memory, parameters) == StoreEvent::kStored) return true;
  }
  return false;
}

// Memory in which `count` sets with SCAN_DWELL 100, 200, 300 ... were stored one after the other.
FakeMemory memory_with(int count) {
  FakeMemory memory;
  ParameterStore kept;
  Parameters parameters;
  Milliseconds now = 0;
  kept.load(memory, parameters);
  for (int i = 1; i <= count; ++i) {
    parameters.set(kDwellIndex, static_cast<float>(100 * i));
    store(kept, memory, parameters, now);
  }
  return memory;
}

// Gives a forged slot a good CRC (CRC-16/CCITT-FALSE, low byte first).
void seal(uint8_t* slot, uint16_t size = ParameterStore::kImageSize) {
  uint16_t crc = 0xffff;
  for (uint16_t i = 0; i < size; ++i) {
    crc ^= static_cast<uint16_t>(slot[i] << 8);
    for (int bit = 0; bit < 8; ++bit) {
      crc = static_cast<uint16_t>(crc & 0x8000 ? crc << 1 ^ 0x1021 : crc << 1);
    }
  }
  slot[size] = static_cast<uint8_t>(crc & 0xff);
  slot[size + 1] = static_cast<uint8_t>(crc >> 8);
}

float stored_dwell(FakeMemory& memory, Loaded expected) {
  ParameterStore fresh;
  Parameters parameters;
  CHECK(fresh.load(memory, parameters) == expected);
  return parameters.at(kDwellIndex);
}

}  // namespace

TEST_CASE("a set of the firmware before is taken, and goes on as one of today's") {
  FakeMemory memory = memory_with(2);
  // What that firmware has written: its layout and its values, then the CRC, then nothing.
  const uint16_t former = ParameterStore::kHeaderSize + kFormerParameterCount * sizeof(float);
  for (auto& slot : memory.slots) {
    slot[0] = static_cast<uint8_t>(parameter_layout(kFormerParameterCount) & 0xff);
    slot[1] = static_cast<uint8_t>(parameter_layout(kFormerParameterCount) >> 8);
    memset(slot + former, 0xff, ParameterStore::kSlotSize - former);
    seal(slot, former);
  }
  ParameterStore kept;
  Parameters parameters;
  REQUIRE(kept.load(memory, parameters) == Loaded::kStored);
  CHECK(kept.sound(memory));
  CHECK(parameters.get(Parameter::kDwell) == 200);
  CHECK(parameters.get(Parameter::kPanReach) == 60);
  CHECK(parameters.get(Parameter::kTiltReach) == 30);
  REQUIRE(parameters.set(static_cast<uint8_t>(Parameter::kPanReach), 45));
  Milliseconds now = 0;
  REQUIRE(store(kept, memory, parameters, now));
  ParameterStore again;
  Parameters loaded;
  REQUIRE(again.load(memory, loaded) == Loaded::kStored);
  CHECK(loaded.get(Parameter::kDwell) == 200);
  CHECK(loaded.get(Parameter::kPanReach) == 45);
}

TEST_CASE("the layout of the firmware before is the one that its boards have in memory") {
  // As 0.2.0 had it: CRC-16/CCITT-FALSE of its 23 names, 16 bytes each.
  CHECK(parameter_layout(kFormerParameterCount) == 0xb42c);
}

TEST_CASE("erased memory gives defaults without complaint") {
  FakeMemory memory;
  CHECK(stored_dwell(memory, Loaded::kBlank) == 300);
}

TEST_CASE("the newest set comes back") {
  for (int count = 1; count <= 5; ++count) {
    FakeMemory memory = memory_with(count);
    CHECK(stored_dwell(memory, Loaded::kStored) == 100 * count);
  }
}

TEST_CASE("the order of the slots survives the wrap of the sequence number") {
  FakeMemory memory = memory_with(1);  // in slot 0
  memory.slots[0][2] = 0xff;
  memory.slots[0][3] = 0xff;
  seal(memory.slots[0]);
  ParameterStore kept;
  Parameters parameters;
  Milliseconds now = 0;
  kept.load(memory, parameters);
  parameters.set(kDwellIndex, 222);
  CHECK(store(kept, memory, parameters, now));
  CHECK(memory.slots[1][2] == 0);
  CHECK(stored_dwell(memory, Loaded::kStored) == 222);
}

TEST_CASE("losing power at any byte leaves the set before or the new one") {
  const int size = ParameterStore::kSlotSize;
  for (int lost = 0; lost <= size; ++lost) {
    CAPTURE(lost);
    FakeMemory memory = memory_with(2);
    ParameterStore kept;
    Parameters parameters;
    Milliseconds now = 0;
    kept.load(memory, parameters);
    parameters.set(kDwellIndex, 777);
    memory.writes = 0;
    memory.power_lost_after = lost;
    store(kept, memory, parameters, now);
    memory.power_lost_after = -1;
    CHECK(stored_dwell(memory, Loaded::kStored) == (lost == size ? 777 : 200));
  }
}

TEST_CASE("a flipped bit anywhere costs one slot, not the parameters") {
  const FakeMemory good = memory_with(2);
  for (int bit = 0; bit < 8 * ParameterStore::kSlotSize; ++bit) {
    for (int slot = 0; slot < 2; ++slot) {
      FakeMemory memory = good;
      memory.slots[slot][bit / 8] ^= static_cast<uint8_t>(1 << bit % 8);
      const float dwell = stored_dwell(memory, Loaded::kStored);
      REQUIRE(dwell == (slot == 0 ? 200 : 100));  // the second set went into slot 1
    }
  }
}

TEST_CASE("both slots broken: defaults, and it is said") {
  FakeMemory memory = memory_with(2);
  memory.slots[0][10] ^= 1;
  memory.slots[1][10] ^= 1;
  CHECK(stored_dwell(memory, Loaded::kCorrupt) == 300);
}

TEST_CASE("random memory never loads") {
  std::srand(1);
  for (int trial = 0; trial < 2000; ++trial) {
    FakeMemory memory;
    for (auto& slot : memory.slots) {
      for (uint8_t& byte : slot) byte = static_cast<uint8_t>(std::rand());
    }
    REQUIRE(stored_dwell(memory, Loaded::kCorrupt) == 300);
  }
}

TEST_CASE("nothing is written before two quiet seconds, each change counted anew") {
  FakeMemory memory;
  ParameterStore kept;
  const Parameters parameters;
  kept.touch(at(0));
  for (Milliseconds now = 0; now < 1500; ++now) kept.step(at(now), true, memory, parameters);
  kept.touch(at(1500));
  for (Milliseconds now = 1500; now < 3500; ++now) kept.step(at(now), true, memory, parameters);
  CHECK(memory.writes == 0);
  kept.step(at(3500), true, memory, parameters);
  kept.step(at(3501), true, memory, parameters);
  CHECK(memory.writes == 1);
}

TEST_CASE("one byte a turn, none while the memory is busy or writing is not allowed") {
  FakeMemory memory;
  ParameterStore kept;
  const Parameters parameters;
  kept.touch(at(0));
  Milliseconds now = 2000;
  kept.step(at(now), true, memory, parameters);
  for (int turn = 1; turn <= 10; ++turn) {
    kept.step(at(++now), true, memory, parameters);
    CHECK(memory.writes == turn);
  }
  memory.is_busy = true;
  for (int turn = 0; turn < 10; ++turn) kept.step(at(++now), true, memory, parameters);
  memory.is_busy = false;
  for (int turn = 0; turn < 10; ++turn) kept.step(at(++now), false, memory, parameters);
  CHECK(memory.writes == 10);
  CHECK(memory.flushes == 0);
}

TEST_CASE("a set is flushed once, when whole") {
  FakeMemory memory = memory_with(1);
  CHECK(memory.flushes == 1);
  CHECK(memory.writes == int{ParameterStore::kSlotSize});
}

TEST_CASE("a stored value outside today's limits gives way to the default") {
  FakeMemory memory = memory_with(1);
  // Forge a set with SCAN_DWELL 40 ms, below its least, and a good CRC.
  ParameterStore kept;
  Parameters parameters;
  kept.load(memory, parameters);
  uint8_t* slot = memory.slots[0];
  const float forged = 40;
  memcpy(slot + ParameterStore::kHeaderSize + kDwellIndex * sizeof(float), &forged, sizeof(forged));
  seal(slot);
  CHECK(stored_dwell(memory, Loaded::kStored) == 300);
}

TEST_CASE("stored is said only of what was read back; the set before stays in force") {
  FakeMemory memory = memory_with(1);  // in slot 0
  memory.stuck_at = ParameterStore::kHeaderSize + kDwellIndex * sizeof(float) + 2;
  ParameterStore kept;
  Parameters parameters;
  kept.load(memory, parameters);
  parameters.set(kDwellIndex, 1234);
  kept.touch(at(0));
  int stored = 0, failed = 0;
  for (Milliseconds now = 0; now < 5000; ++now) {
    const StoreEvent event = kept.step(at(now), true, memory, parameters);
    stored += event == StoreEvent::kStored;
    failed += event == StoreEvent::kFailed;
  }
  CHECK(stored == 0);
  CHECK(failed == 1);
  CHECK(kept.sound(memory));
  CHECK(stored_dwell(memory, Loaded::kStored) == 100);
  memory.stuck_at = -1;
  Milliseconds now = 5000;
  CHECK(store(kept, memory, parameters, now));
  CHECK(stored_dwell(memory, Loaded::kStored) == 1234);
}
