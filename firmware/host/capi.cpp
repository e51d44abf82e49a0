#include <string.h>

#include <algorithm>
#include <vector>

#include "coprocessor.h"
#include "echowing_core.h"

namespace {

using namespace echowing;

// About what a turn takes on the slowest board.
constexpr uint64_t kTurn_us = 500;

constexpr ew_parameter kRows[] = {
#define ECHOWING_PARAMETER(identifier, name, normal, least, most, whole, in_flight, unit, text) \
  {name, normal, least, most, whole, unit, text},
#include "parameter_table.h"
#undef ECHOWING_PARAMETER
};

class HostSerial : public SerialPort {
 public:
  uint8_t read(uint8_t* bytes, uint8_t capacity) override {
    const size_t count = std::min<size_t>(capacity, in_.size() - in_next_);
    std::copy_n(in_.begin() + static_cast<std::ptrdiff_t>(in_next_), count, bytes);
    in_next_ += count;
    if (in_next_ == in_.size()) {
      in_.clear();
      in_next_ = 0;
    }
    return static_cast<uint8_t>(count);
  }
  uint8_t write(const uint8_t* bytes, uint8_t count) override {
    out_.insert(out_.end(), bytes, bytes + count);
    return count;
  }
  void feed(const uint8_t* bytes, size_t count) { in_.insert(in_.end(), bytes, bytes + count); }
  size_t take(uint8_t* bytes, size_t capacity) {
    const size_t count = std::min(capacity, out_.size());
    std::copy_n(out_.begin(), count, bytes);
    out_.erase(out_.begin(), out_.begin() + static_cast<std::ptrdiff_t>(count));
    return count;
  }

 private:
  std::vector<uint8_t> in_;
  size_t in_next_ = 0;
  std::vector<uint8_t> out_;
};

class HostBus : public I2cBus {
 public:
  HostBus(ew_bus_write on_write, ew_bus_read on_read) : write_(on_write), read_(on_read) {}
  bool write(uint8_t address, const uint8_t* bytes, uint8_t count) override {
    return write_(now_us, address, bytes, count) != 0;
  }
  bool read(uint8_t address, uint8_t* bytes, uint8_t count) override {
    return read_(now_us, address, bytes, count) != 0;
  }
  bool take_timeout() override { return false; }
  void restart() override {}
  // The simulated bus has no lines to hold low.
  void take_lines() override {}
  void drive_clock(bool) override {}
  void drive_data(bool) override {}
  void return_lines() override {}

  uint64_t now_us = 0;

 private:
  ew_bus_write write_;
  ew_bus_read read_;
};

class HostServos : public ServoOutput {
 public:
  void write(Aim) override {}
};

class HostMemory : public SlotMemory {
 public:
  HostMemory() { memset(slots_, 0xff, sizeof(slots_)); }
  uint8_t read(uint8_t slot, uint16_t offset) override { return slots_[slot][offset]; }
  bool busy() override { return false; }
  void write(uint8_t slot, uint16_t offset, uint8_t value) override {
    slots_[slot][offset] = value;
  }
  void flush(uint8_t) override {}

 private:
  uint8_t slots_[2][ParameterStore::kSlotSize];
};

class HostBoard : public Board {
 public:
  ResetCause reset_cause() const override { return ResetCause::kUnknown; }
  const char* git_hash() const override { return "host"; }
  void reboot(bool) override { ++reboots; }
  unsigned reboots = 0;
};

}  // namespace

struct ew_core {
  ew_core(ew_bus_write write, ew_bus_read read, uint32_t seed, uint64_t start_us)
      : bus(write, read),
        now_us(start_us),
        core({serial[0], serial[1], bus, servos, memory, board}, seed,
             static_cast<Microseconds>(start_us)) {}

  HostSerial serial[2];
  HostBus bus;
  HostServos servos;
  HostMemory memory;
  HostBoard board;
  uint64_t now_us;
  Coprocessor core;
};

ew_core* ew_create(ew_bus_write write, ew_bus_read read, uint32_t seed, uint64_t start_us) {
  return new ew_core(write, read, seed, start_us);
}

void ew_destroy(ew_core* core) { delete core; }

void ew_run_until(ew_core* core, uint64_t t_us) {
  while (core->now_us < t_us) {
    core->now_us = std::min(core->now_us + kTurn_us, t_us);
    core->bus.now_us = core->now_us;
    core->core.step(static_cast<Microseconds>(core->now_us));
  }
}

void ew_feed(ew_core* core, int port, const uint8_t* bytes, size_t count) {
  core->serial[port].feed(bytes, count);
}

size_t ew_take(ew_core* core, int port, uint8_t* bytes, size_t capacity) {
  return core->serial[port].take(bytes, capacity);
}

double ew_pan_us(const ew_core* core) { return core->core.aim().pan_us; }
double ew_tilt_us(const ew_core* core) { return core->core.aim().tilt_us; }
int ew_led(const ew_core* core) { return core->core.led_on() ? 1 : 0; }
unsigned ew_reboots(const ew_core* core) { return core->board.reboots; }

int ew_parameter_count() { return kParameterCount; }
ew_parameter ew_parameter_row(int index) { return kRows[index]; }

float ew_get_parameter(const ew_core* core, int index) {
  return core->core.parameters().at(static_cast<uint8_t>(index));
}

int ew_set_parameter(ew_core* core, int index, float value) {
  return core->core.set_parameter(static_cast<uint8_t>(index), value) ? 1 : 0;
}
