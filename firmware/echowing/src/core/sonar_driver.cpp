#include "sonar_driver.h"

namespace echowing {
namespace {

constexpr uint8_t kCommandRange = 81;
constexpr uint8_t kCommandUnlock[] = {170, 165};
// On the wire addresses are 8-bit; the sonar refuses these.
constexpr uint8_t kRefusedAddresses[] = {0, 80, 164, 170};

// 80 ms to the result at full range, with room for slow specimens and our own turns.
constexpr Milliseconds kLongestRanging = 120;
// From ping to result for a target at the 4.5 m to which one is tracked: 26 ms of flight, and 20 ms
// in the sensor (40 readings a second are possible for near targets). One that is farther, or a
// slower sensor, is asked again until it answers.
constexpr Microseconds kTrackedEcho = milliseconds(46);
// The sensor needs a moment after power-on; it is asked meanwhile.
constexpr Milliseconds kPowerUp = 500;
// Asking once again while the sensor ranges costs one address byte, 0.2 ms at 50 kHz.
constexpr Microseconds kPollInterval = milliseconds(2);
// A supply that dips or a bus that glitches is over within this; more is a fault to report.
constexpr uint8_t kRecoveriesBeforeFault = 2;
constexpr Microseconds kRetryInterval = milliseconds(10);
constexpr Microseconds kFaultRetryInterval = milliseconds(200);

}  // namespace

SonarDriver::SonarDriver(const Parameters& parameters, uint32_t seed, Instant now)
    : parameters_(parameters), next_(now.us), read_due_(now.us), random_(seed) {
  patience_.start(now, kPowerUp);
}

SonarEvent SonarDriver::step(const Instant& now, I2cBus& bus) {
  pinged_ = false;
  const SonarEvent event = proceed(now, bus);
  // Some peripherals do not come back by themselves from a transfer that was broken off.
  timed_out_ = bus.take_timeout();
  if (timed_out_) bus.restart();
  return event;
}

SonarEvent SonarDriver::proceed(const Instant& now, I2cBus& bus) {
  if (phase_ == Phase::kRecover) return recover(now, bus);
  if (!reached(now.us, next_)) return SonarEvent::kNone;
  switch (phase_) {
    case Phase::kDiscard: return discard(now, bus);
    case Phase::kTrigger: return trigger(now, bus);
    default: return await(now, bus);
  }
}

// The first read after power-on gives part information, not a range.
SonarEvent SonarDriver::discard(const Instant& now, I2cBus& bus) {
  uint8_t bytes[2];
  if (!bus.read(address(), bytes, sizeof(bytes))) return silent(now);
  phase_ = Phase::kTrigger;
  return answered(now);
}

SonarEvent SonarDriver::trigger(const Instant& now, I2cBus& bus) {
  if (new_address_ != 0) {
    const uint8_t sequence[] = {kCommandUnlock[0], kCommandUnlock[1],
                                static_cast<uint8_t>(new_address_ << 1)};
    if (!bus.write(address(), sequence, sizeof(sequence))) return silent(now);
    address_changed_ = true;
    new_address_ = 0;
    next_ = now.us + kRetryInterval;
    return answered(now);
  }
  if (!bus.write(address(), &kCommandRange, 1)) return silent(now);
  reading_.triggered = now;
  pinged_ = true;
  phase_ = Phase::kAwait;
  next_ = read_due_;
  const SonarEvent event = answered(now);
  // Not asked before the reading is due, it cannot be late before.
  const Microseconds wait = reached(now.us, read_due_) ? 0 : read_due_ - now.us;
  patience_.start(now, kLongestRanging + wait / kMillisecond);
  return event;
}

SonarEvent SonarDriver::await(const Instant& now, I2cBus& bus) {
  uint8_t bytes[2];
  if (!bus.read(address(), bytes, sizeof(bytes))) return silent(now);
  answered(now);
  plan(now.us);
  const uint16_t range_cm = static_cast<uint16_t>(bytes[0] << 8 | bytes[1]);
  if (range_cm < kNearestCm || range_cm > kFarthestCm) return SonarEvent::kNone;
  reading_.range_cm = range_cm;
  return SonarEvent::kReading;
}

// Readings keep to a regular grid; it is the ping before each that is delayed at random, so that
// the late echo of one ping falls at another distance of the next each time. With a long period
// the ping waits, so that the reading is no older than with a short one.
void SonarDriver::plan(Microseconds now) {
  const Microseconds period = milliseconds(parameters_.whole(Parameter::kSonarPeriod));
  const Microseconds most_jitter = milliseconds(parameters_.whole(Parameter::kSonarJitter));
  const Microseconds ping = read_due_ + period - kTrackedEcho - most_jitter;
  const bool behind = reached(now, ping);
  const bool late = reached(now, read_due_ + kPollInterval);
  read_due_ = (behind && late ? now : read_due_) + period;
  phase_ = Phase::kTrigger;
  next_ = (behind ? now : ping) + jitter();
}

SonarEvent SonarDriver::silent(const Instant& now) {
  next_ = now.us + kPollInterval;
  if (patience_.running(now)) return SonarEvent::kNone;
  recovery_.start();
  phase_ = Phase::kRecover;
  return SonarEvent::kNone;
}

SonarEvent SonarDriver::recover(const Instant& now, I2cBus& bus) {
  if (!recovery_.step(bus)) return SonarEvent::kNone;
  phase_ = Phase::kDiscard;
  read_due_ = now.us;
  next_ = now.us + (faulty_ ? kFaultRetryInterval : kRetryInterval);
  if (faulty_ || ++recoveries_ < kRecoveriesBeforeFault) return SonarEvent::kNone;
  faulty_ = true;
  return SonarEvent::kFault;
}

SonarEvent SonarDriver::answered(const Instant& now) {
  patience_.start(now, kLongestRanging);
  recoveries_ = 0;
  if (!faulty_) return SonarEvent::kNone;
  faulty_ = false;
  return SonarEvent::kRecovered;
}

bool SonarDriver::reading_within(Microseconds now, Microseconds span) const {
  return phase_ == Phase::kAwait && reached(now + span, next_);
}

bool SonarDriver::change_address(uint8_t address) {
  if (address < 8 || address > 119) return false;  // the rest of 7 bits is reserved by I2C
  for (const uint8_t refused : kRefusedAddresses) {
    if (address << 1 == refused) return false;
  }
  new_address_ = address;
  return true;
}

uint8_t SonarDriver::address() const {
  return static_cast<uint8_t>(parameters_.whole(Parameter::kSonarAddress));
}

bool SonarDriver::take_address_changed() {
  const bool changed = address_changed_;
  address_changed_ = false;
  return changed;
}

// Linear congruential, constants of Numerical Recipes; its high bits are good enough for a delay.
Microseconds SonarDriver::jitter() {
  random_ = random_ * UINT32_C(1664525) + UINT32_C(1013904223);
  const uint32_t most_us = milliseconds(parameters_.whole(Parameter::kSonarJitter));
  return (random_ >> 16) * (most_us + 1) >> 16;
}

}  // namespace echowing
