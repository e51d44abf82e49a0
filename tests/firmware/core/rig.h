// A bench for the core: every port faked, time in the test's hands, MAVLink read back.
#pragma once

#include <stdint.h>
#include <string.h>

#include <functional>
#include <string>
#include <vector>

#include "coprocessor.h"

namespace rig {

using namespace echowing;

class FakeSerial : public SerialPort {
 public:
  uint8_t read(uint8_t* bytes, uint8_t capacity) override;
  uint8_t write(const uint8_t* bytes, uint8_t count) override;

  std::vector<uint8_t> in;
  std::vector<uint8_t> out;
  bool blocked = false;  // nobody takes what is sent
};

// The sonar of datasheet PD11848 on its bus: part information first, deaf while it ranges.
class FakeSonar : public I2cBus {
 public:
  bool write(uint8_t address, const uint8_t* bytes, uint8_t count) override;
  bool read(uint8_t address, uint8_t* bytes, uint8_t count) override;
  bool take_timeout() override {
    const bool happened = timed_out;
    timed_out = false;
    return happened;
  }
  void restart() override { ++restarts; }
  void take_lines() override { ++recoveries; }
  void drive_clock(bool) override {}
  void drive_data(bool) override {}
  void return_lines() override {}

  // Range in centimetres of the ping at that time; 765 for no echo.
  std::function<uint16_t(Microseconds)> listen = [](Microseconds) { return 300; };
  uint32_t ranging_us = 40000;
  uint8_t address = 0x70;
  bool plugged = true;
  Microseconds now = 0;
  std::vector<Microseconds> pings;
  bool held = false;       // something holds the lines: every transfer ends by time-out
  bool timed_out = false;  // the newest one did
  int restarts = 0;
  int recoveries = 0;
  int accesses = 0;

 private:
  bool answers(uint8_t asked);

  uint16_t answer_ = 0x1202;
  bool ranging_ = false;
  Microseconds busy_until_ = 0;
};

class FakeServos : public ServoOutput {
 public:
  void write(Aim aim) override { last = aim; }
  Aim last = {};
};

// Two slots; power can be cut after any number of bytes.
class FakeMemory : public SlotMemory {
 public:
  FakeMemory() { memset(slots, 0xff, sizeof(slots)); }
  uint8_t read(uint8_t slot, uint16_t offset) override { return slots[slot][offset]; }
  bool busy() override { return is_busy; }
  void write(uint8_t slot, uint16_t offset, uint8_t value) override;
  void flush(uint8_t) override { ++flushes; }

  uint8_t slots[2][ParameterStore::kSlotSize];
  bool is_busy = false;
  int writes = 0;
  int flushes = 0;
  int power_lost_after = -1;
  int stuck_at = -1;  // this byte of both slots cannot be changed any more
};

class FakeBoard : public Board {
 public:
  explicit FakeBoard(ResetCause why) : cause(why) {}
  ResetCause reset_cause() const override { return cause; }
  const char* git_hash() const override { return "0123abcd"; }
  void reboot(bool into_bootloader) override {
    ++reboots;
    bootloader = into_bootloader;
  }
  ResetCause cause;
  int reboots = 0;
  bool bootloader = false;
};

// A frame that left a port, and when its loop turn was.
struct Sent {
  Microseconds at;
  mavlink_message_t message;
};

// DISTANCE_SENSOR and PARAM_VALUE unpacked, so that assertions can refer to their fields.
struct Report {
  uint32_t time_boot_ms;
  uint16_t min_distance, max_distance, current_distance;
  uint8_t type, id, orientation, covariance, signal_quality;
  float horizontal_fov, vertical_fov;
  float quaternion[4];
};

struct Range {
  Microseconds at;
  Report report;
};

// GIMBAL_DEVICE_ATTITUDE_STATUS unpacked, and its payload's length on the wire.
struct AxisTold {
  Microseconds at;
  uint32_t time_boot_ms;
  uint16_t flags;
  uint32_t failure_flags;
  Quaternion q;
  uint8_t length;
};

struct Value {
  std::string name;
  float value;
  uint8_t type;
  uint16_t count, index;
};

struct Ack {
  uint16_t command;
  uint8_t result;
};

class Rig {
 public:
  // The board of vehicle `system`; 0: of whatever vehicle the memory says, if any.
  explicit Rig(Microseconds start = 0, FakeMemory stored = FakeMemory(), uint32_t uptime_ms = 0,
               uint8_t system = 1, ResetCause cause = ResetCause::kUnknown);

  void run(Microseconds span, Microseconds turn = 1000);
  // True if `happened` became true within `limit`; stops there.
  bool run_until(const std::function<bool()>& happened, Microseconds limit);

  // The autopilot's heartbeat, repeated once a second while running.
  void autopilot(uint8_t system, bool armed);
  void silence_autopilot() { beating_ = false; }
  // A single heartbeat of some vehicle's autopilot.
  void hear_vehicle(uint8_t system, bool armed);

  template <typename Message>
  void hear(int port, const Message& message, uint8_t system = 255, uint8_t component = 190) {
    const std::vector<uint8_t> bytes = frame(message, system, component);
    serial[port].in.insert(serial[port].in.end(), bytes.begin(), bytes.end());
  }
  void set_parameter(const char* name, float value, int port = 0);
  uint8_t command(uint16_t id, float first = 0, float second = 0, int port = 0);

  // What has been sent on a port so far, decoded.
  const std::vector<Sent>& sent(int port = 0) { return sent_[port]; }
  std::vector<Range> ranges(int port = 0);
  std::vector<std::string> texts(int port = 0);
  std::vector<Ack> acks(int port = 0);
  std::vector<Value> values(int port = 0);
  std::vector<mavlink_heartbeat_t> heartbeats(int port = 0);
  std::vector<AxisTold> axes(int port = 0);
  std::vector<float> named(const char* name, int port = 0);
  bool said(const char* part, int port = 0);
  // Bytes that left a port and belonged to no frame.
  size_t stray_bytes(int port) const { return bytes_[port] - framed_bytes_[port]; }
  void forget();

  float parameter(Parameter which) const { return core.parameters().get(which); }
  // Who sent the newest message.
  uint8_t speaks_as(int port = 0) { return sent_[port].back().message.sysid; }

  static std::vector<uint8_t> frame(const mavlink_heartbeat_t&, uint8_t system, uint8_t component);
  static std::vector<uint8_t> frame(const mavlink_param_set_t&, uint8_t system, uint8_t component);
  static std::vector<uint8_t> frame(const mavlink_param_request_read_t&, uint8_t system,
                                    uint8_t component);
  static std::vector<uint8_t> frame(const mavlink_param_request_list_t&, uint8_t system,
                                    uint8_t component);
  static std::vector<uint8_t> frame(const mavlink_command_long_t&, uint8_t system,
                                    uint8_t component);
  static std::vector<uint8_t> frame(const mavlink_command_int_t&, uint8_t system,
                                    uint8_t component);
  static std::vector<uint8_t> frame(const mavlink_attitude_t&, uint8_t system, uint8_t component);
  static std::vector<uint8_t> frame(const mavlink_gimbal_device_set_attitude_t&, uint8_t system,
                                    uint8_t component);

  FakeSerial serial[2];
  FakeSonar sonar;
  FakeServos servos;
  FakeMemory memory;
  FakeBoard board;
  Microseconds now;
  Coprocessor core;

 private:
  void turn(Microseconds length);
  void collect(int port);

  std::vector<Sent> sent_[2];
  size_t bytes_[2] = {};
  size_t framed_bytes_[2] = {};
  mavlink_message_t incoming_[2] = {};
  mavlink_status_t parser_[2] = {};
  bool beating_ = false;
  bool armed_ = false;
  uint8_t vehicle_ = 1;
  Microseconds next_beat_ = 0;
};

}  // namespace rig
