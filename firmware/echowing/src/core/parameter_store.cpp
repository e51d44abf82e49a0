#include "parameter_store.h"

#include <string.h>

#include "crc.h"

namespace echowing {
namespace {

constexpr uint8_t kSlots = 2;
constexpr Milliseconds kCalm = 2000;
// Read back in a turn: 16 us each on the slowest board.
constexpr uint8_t kReadPerTurn = 8;

uint16_t read_word(SlotMemory& memory, uint8_t slot, uint16_t offset) {
  const uint8_t low = memory.read(slot, offset);
  return static_cast<uint16_t>(low | memory.read(slot, offset + 1) << 8);
}

constexpr uint16_t image_size(uint8_t count) {
  return static_cast<uint16_t>(ParameterStore::kHeaderSize + count * sizeof(float));
}
static_assert(image_size(kParameterCount) == ParameterStore::kImageSize, "two sizes of an image");

bool holds(SlotMemory& memory, uint8_t slot, uint8_t count) {
  if (read_word(memory, slot, 0) != parameter_layout(count)) return false;
  const uint16_t size = image_size(count);
  uint16_t crc = kCrcStart;
  for (uint16_t offset = 0; offset < size; ++offset) {
    crc = crc_add(crc, memory.read(slot, offset));
  }
  return crc == read_word(memory, slot, size);
}

// How many values an intact slot holds; 0 for any other.
uint8_t values_in(SlotMemory& memory, uint8_t slot) {
  if (holds(memory, slot, kParameterCount)) return kParameterCount;
  return holds(memory, slot, kFormerParameterCount) ? kFormerParameterCount : 0;
}

// Erased memory reads as ones.
bool blank(SlotMemory& memory, uint8_t slot) {
  for (uint16_t offset = 0; offset < ParameterStore::kSlotSize; ++offset) {
    if (memory.read(slot, offset) != 0xff) return false;
  }
  return true;
}

void read_values(SlotMemory& memory, uint8_t slot, uint8_t count, Parameters& parameters) {
  uint16_t offset = ParameterStore::kHeaderSize;
  for (uint8_t index = 0; index < count; ++index) {
    uint8_t bytes[sizeof(float)];
    for (uint8_t& byte : bytes) byte = memory.read(slot, offset++);
    float value;
    memcpy(&value, bytes, sizeof(value));
    parameters.set(index, value);  // out of today's limits: the default stays
  }
}

}  // namespace

ParameterStore::Loaded ParameterStore::load(SlotMemory& memory, Parameters& parameters) {
  const uint8_t count[kSlots] = {values_in(memory, 0), values_in(memory, 1)};
  if (count[0] == 0 && count[1] == 0) {
    return blank(memory, 0) && blank(memory, 1) ? Loaded::kBlank : Loaded::kCorrupt;
  }
  const uint16_t sequence[kSlots] = {read_word(memory, 0, 2), read_word(memory, 1, 2)};
  const bool second_newer = static_cast<int16_t>(sequence[1] - sequence[0]) > 0;
  slot_ = count[0] == 0 || (count[1] != 0 && second_newer) ? 1 : 0;
  sequence_ = sequence[slot_];
  read_values(memory, slot_, count[slot_], parameters);
  return Loaded::kStored;
}

void ParameterStore::touch(const Instant& now) {
  wanted_ = true;
  calm_.start(now, kCalm);
}

bool ParameterStore::sound(SlotMemory& memory) const {
  return values_in(memory, slot_) != 0 || (blank(memory, 0) && blank(memory, 1));
}

StoreEvent ParameterStore::step(const Instant& now, bool allowed, SlotMemory& memory,
                                const Parameters& parameters) {
  const bool calm = !calm_.running(now);
  if (!allowed || memory.busy()) return StoreEvent::kNone;
  switch (phase_) {
    case Phase::kWriting: write_next(memory, parameters); break;
    case Phase::kReadingBack: return read_back(memory);
    default:
      if (wanted_ && calm) begin();
  }
  return StoreEvent::kNone;
}

// A change that comes while bytes are written asks for another round: the set then stored first
// may mix old and new values, each of them valid.
void ParameterStore::begin() {
  wanted_ = false;
  phase_ = Phase::kWriting;
  offset_ = 0;
  crc_ = kCrcStart;
  ++sequence_;
}

void ParameterStore::write_next(SlotMemory& memory, const Parameters& parameters) {
  if (offset_ == kSlotSize) {
    memory.flush(other_slot());
    phase_ = Phase::kReadingBack;
    offset_ = 0;
    read_crc_ = kCrcStart;
    return;
  }
  const uint8_t byte = image_byte(offset_, parameters);
  memory.write(other_slot(), offset_, byte);
  if (offset_ < kImageSize) crc_ = crc_add(crc_, byte);
  ++offset_;
}

// The older set stays in force until the new one has been read as it was written, some bytes a
// turn.
StoreEvent ParameterStore::read_back(SlotMemory& memory) {
  const uint8_t slot = other_slot();
  for (uint8_t count = 0; count < kReadPerTurn && offset_ < kImageSize; ++count) {
    read_crc_ = crc_add(read_crc_, memory.read(slot, offset_++));
  }
  if (offset_ < kImageSize) return StoreEvent::kNone;
  phase_ = Phase::kIdle;
  if (read_crc_ != crc_ || read_word(memory, slot, kImageSize) != crc_) return StoreEvent::kFailed;
  slot_ = slot;
  return StoreEvent::kStored;
}

uint8_t ParameterStore::image_byte(uint16_t offset, const Parameters& parameters) const {
  if (offset >= kImageSize) return static_cast<uint8_t>(crc_ >> 8 * (offset - kImageSize));
  if (offset < 2) return static_cast<uint8_t>(parameter_layout(kParameterCount) >> 8 * offset);
  if (offset < kHeaderSize) return static_cast<uint8_t>(sequence_ >> 8 * (offset - 2));
  const uint16_t place = offset - kHeaderSize;
  const float value = parameters.at(static_cast<uint8_t>(place / sizeof(float)));
  uint8_t bytes[sizeof(float)];
  memcpy(bytes, &value, sizeof(value));
  return bytes[place % sizeof(float)];
}

}  // namespace echowing
