// MaxBotix I2CXL sonar: trigger, wait by time, read; never blocks (datasheet PD11848).
#pragma once

#include <stdint.h>

#include "bus_recovery.h"
#include "parameters.h"
#include "ports.h"
#include "timing.h"

namespace echowing {

constexpr uint16_t kNearestCm = 20;    // nearer reads as this
constexpr uint16_t kFarthestCm = 765;  // no echo reads as this

struct Reading {
  uint16_t range_cm;  // kNearestCm to kFarthestCm
  Instant triggered;
};

enum class SonarEvent : uint8_t {
  kNone,
  kReading,    // `reading()` is new, by its own acknowledged trigger
  kFault,      // silent in spite of retries and bus recovery
  kRecovered,  // answers again
};

class SonarDriver {
 public:
  SonarDriver(const Parameters& parameters, uint32_t seed, Instant now);

  // One loop turn.
  SonarEvent step(const Instant& now, I2cBus& bus);
  const Reading& reading() const { return reading_; }
  // In this turn the sonar has sent a ping.
  bool pinged() const { return pinged_; }
  bool faulty() const { return faulty_; }
  // In this turn a transfer has ended by time-out: it has been a long one already.
  bool timed_out() const { return timed_out_; }
  // A reading is due within `span`, or overdue.
  bool reading_within(Microseconds now, Microseconds span) const;
  // Sends the address-change sequence as soon as the sonar listens, then uses the new address.
  // `address` is the 7-bit one; false if the sonar refuses it.
  bool change_address(uint8_t address);
  // Drops a change that the sonar has not been sent yet.
  void cancel_address_change() { new_address_ = 0; }
  uint8_t address() const;
  // True once after a change of address was acknowledged.
  bool take_address_changed();

 private:
  enum class Phase : uint8_t { kDiscard, kTrigger, kAwait, kRecover };

  SonarEvent proceed(const Instant& now, I2cBus& bus);
  SonarEvent discard(const Instant& now, I2cBus& bus);
  SonarEvent trigger(const Instant& now, I2cBus& bus);
  SonarEvent await(const Instant& now, I2cBus& bus);
  SonarEvent recover(const Instant& now, I2cBus& bus);
  SonarEvent silent(const Instant& now);
  SonarEvent answered(const Instant& now);
  void plan(Microseconds now);
  Microseconds jitter();

  const Parameters& parameters_;
  BusRecovery recovery_;
  Reading reading_ = {};
  Phase phase_ = Phase::kDiscard;
  Microseconds next_ = 0;      // nothing to do before this
  Microseconds read_due_ = 0;  // when the coming reading is wanted
  Timeout patience_;           // silence is no fault while it runs
  uint8_t recoveries_ = 0;
  uint8_t new_address_ = 0;  // 0: none wanted
  bool address_changed_ = false;
  bool faulty_ = false;
  bool timed_out_ = false;
  bool pinged_ = false;
  uint32_t random_;
};

}  // namespace echowing
