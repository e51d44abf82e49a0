// libFuzzer on the parameter store: whatever the memory holds, what is loaded is within limits,
// and what is stored next can be loaded again, even when power is lost in between.

#include <stdlib.h>

#include <algorithm>

#include "../core/rig.h"
#include "crc.h"

namespace {

using namespace echowing;
using rig::FakeMemory;
using Loaded = ParameterStore::Loaded;

void require(bool holds) {
  if (!holds) abort();
}

void require_limits(const Parameters& parameters) {
  for (uint8_t i = 0; i < kParameterCount; ++i) require(Parameters().set(i, parameters.at(i)));
}

// Gives a slot today's layout and a good CRC, which a fuzzer would hardly find.
void seal(uint8_t* slot) {
  slot[0] = static_cast<uint8_t>(parameter_layout(kParameterCount) & 0xff);
  slot[1] = static_cast<uint8_t>(parameter_layout(kParameterCount) >> 8);
  uint16_t crc = kCrcStart;
  for (uint16_t i = 0; i < ParameterStore::kImageSize; ++i) crc = crc_add(crc, slot[i]);
  slot[ParameterStore::kImageSize] = static_cast<uint8_t>(crc & 0xff);
  slot[ParameterStore::kImageSize + 1] = static_cast<uint8_t>(crc >> 8);
}

void store(ParameterStore& store, FakeMemory& memory, const Parameters& parameters) {
  store.touch({0, 0});
  for (Milliseconds ms = 1; ms <= 3000; ++ms) {
    store.step({ms * 1000, ms}, true, memory, parameters);
  }
}

}  // namespace

// Two bytes say which slots to seal and where power is lost; the rest is the memory.
extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size < 2) return 0;
  FakeMemory memory;
  const size_t taken = std::min(size - 2, sizeof(memory.slots));
  memcpy(memory.slots, data + 2, taken);
  if (data[0] & 1) seal(memory.slots[0]);
  if (data[0] & 2) seal(memory.slots[1]);

  ParameterStore kept;
  Parameters before;
  const Loaded loaded = kept.load(memory, before);
  require_limits(before);
  if (data[0] & 3) require(loaded == Loaded::kStored);

  Parameters changed = before;
  changed.set(static_cast<uint8_t>(Parameter::kDwell), 777);
  memory.power_lost_after = data[1];
  store(kept, memory, changed);
  Parameters after;
  const Loaded again = ParameterStore().load(memory, after);
  require_limits(after);
  const bool whole = data[1] >= ParameterStore::kSlotSize;
  if (whole) require(after.get(Parameter::kDwell) == 777);
  if (!whole && loaded == Loaded::kStored) {
    require(again == Loaded::kStored);
    // The new set is whole early if the bytes not written were there by chance.
    const float dwell = after.get(Parameter::kDwell);
    require(dwell == before.get(Parameter::kDwell) || dwell == 777);
  }
  return 0;
}
