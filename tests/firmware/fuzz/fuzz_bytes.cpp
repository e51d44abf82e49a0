// libFuzzer on the byte entry: whatever comes in on either port, the device goes on reporting and
// keeps its servos and parameters within their limits.
//
// The input is a row of records: a head byte, a length byte, that many bytes. Bit 0 of the head is
// the port; the rest picks a message to frame properly around the bytes, or none: raw bytes.

#include <stdlib.h>

#include <algorithm>

#include "../core/rig.h"

namespace {

using namespace echowing;
using rig::Rig;

// The longest that a turn may take; shorter ones make fewer inputs a second.
constexpr Microseconds kLongTurn = 2000;

struct Kind {
  uint16_t id;
  uint8_t crc_extra;
};

constexpr Kind kKinds[] = {
    {MAVLINK_MSG_ID_HEARTBEAT, MAVLINK_MSG_ID_HEARTBEAT_CRC},
    {MAVLINK_MSG_ID_PARAM_REQUEST_READ, MAVLINK_MSG_ID_PARAM_REQUEST_READ_CRC},
    {MAVLINK_MSG_ID_PARAM_REQUEST_LIST, MAVLINK_MSG_ID_PARAM_REQUEST_LIST_CRC},
    {MAVLINK_MSG_ID_PARAM_SET, MAVLINK_MSG_ID_PARAM_SET_CRC},
    {MAVLINK_MSG_ID_COMMAND_LONG, MAVLINK_MSG_ID_COMMAND_LONG_CRC},
    {MAVLINK_MSG_ID_COMMAND_INT, MAVLINK_MSG_ID_COMMAND_INT_CRC},
    {MAVLINK_MSG_ID_ATTITUDE, MAVLINK_MSG_ID_ATTITUDE_CRC},
    {MAVLINK_MSG_ID_GIMBAL_DEVICE_SET_ATTITUDE, MAVLINK_MSG_ID_GIMBAL_DEVICE_SET_ATTITUDE_CRC},
};
constexpr size_t kKindCount = sizeof(kKinds) / sizeof(kKinds[0]);

std::vector<uint8_t> frame(const Kind& kind, const uint8_t* payload, uint8_t length) {
  // Heartbeats come from several vehicles.
  const bool beat = kind.id == MAVLINK_MSG_ID_HEARTBEAT;
  const uint8_t system = static_cast<uint8_t>(beat ? 1 + (payload[0] & 3) : 1);
  const uint8_t id_low = static_cast<uint8_t>(kind.id & 0xff);
  const uint8_t id_high = static_cast<uint8_t>(kind.id >> 8);
  std::vector<uint8_t> bytes = {MAVLINK_STX, length, 0, 0, 0, system, 1, id_low, id_high, 0};
  bytes.insert(bytes.end(), payload, payload + length);
  uint16_t crc = crc_calculate(&bytes[1], static_cast<uint16_t>(bytes.size() - 1));
  crc_accumulate(kind.crc_extra, &crc);
  bytes.push_back(static_cast<uint8_t>(crc & 0xff));
  bytes.push_back(static_cast<uint8_t>(crc >> 8));
  return bytes;
}

void feed(Rig& rig, uint8_t head, const uint8_t* bytes, uint8_t length) {
  std::vector<uint8_t>& in = rig.serial[head & 1].in;
  const size_t kind = head >> 1;
  if (kind >= kKindCount || length == 0) {
    in.insert(in.end(), bytes, bytes + length);
    return;
  }
  const std::vector<uint8_t> framed = frame(kKinds[kind], bytes, length);
  in.insert(in.end(), framed.begin(), framed.end());
}

void require(bool holds) {
  if (!holds) abort();
}

void check(Rig& rig) {
  require(rig.servos.last.pan_us >= 800 && rig.servos.last.pan_us <= 2200);
  require(rig.servos.last.tilt_us >= 800 && rig.servos.last.tilt_us <= 2200);
  for (uint8_t i = 0; i < kParameterCount; ++i) {
    require(Parameters().set(i, rig.core.parameters().at(i)));
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  // The board of vehicle 1, or one that learns.
  Rig rig(0, rig::FakeMemory(), 0, static_cast<uint8_t>(size & 1));
  rig.run(100000, kLongTurn);
  while (size >= 2) {
    const uint8_t length = static_cast<uint8_t>(std::min<size_t>(data[1], size - 2));
    feed(rig, data[0], data + 2, length);
    rig.run(kLongTurn, kLongTurn);
    data += 2 + length;
    size -= 2 + length;
  }
  check(rig);
  // The sonar's address can be set to where nobody answers: but no input may stop the loop, the
  // heartbeat or the answers.
  rig.run(500000, kLongTurn);
  rig.forget();
  rig.run(2500000, kLongTurn);
  check(rig);
  require(rig.heartbeats(0).size() >= 2 && rig.heartbeats(1).size() >= 2);
  // It is its own vehicle's, or nobody's.
  const float own = rig.parameter(Parameter::kSystemId);
  require(rig.speaks_as() == (own == 0 ? 250 : own));
  return 0;
}
