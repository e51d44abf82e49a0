#include "link.h"

namespace echowing {

const mavlink_message_t* Link::receive(SerialPort& port) {
  if (received_next_ == received_count_) {
    received_count_ = port.read(received_, kBytesInPerTurn);
    received_next_ = 0;
  }
  while (received_next_ < received_count_) {
    const uint8_t byte = received_[received_next_++];
    const uint8_t framing = mavlink_frame_char_buffer(&incoming_, &parser_, byte, nullptr, nullptr);
    if (framing == MAVLINK_FRAMING_OK) return &incoming_;
  }
  return nullptr;
}

bool Link::send_bytes(Identity from, uint32_t id, uint8_t crc_extra, const uint8_t* payload,
                      uint8_t length) {
  while (length > 1 && payload[length - 1] == 0) --length;
  if (queued_ + kHeaderLength + length + kChecksumLength > kQueueSize) return false;
  const uint8_t header[kHeaderLength] = {
      MAVLINK_STX,
      length,
      0,
      0,
      sequence_++,
      from.system,
      from.component,
      static_cast<uint8_t>(id & 0xff),
      static_cast<uint8_t>(id >> 8 & 0xff),
      static_cast<uint8_t>(id >> 16),
  };
  uint16_t checksum = crc_calculate(header + 1, kHeaderLength - 1);
  crc_accumulate_buffer(&checksum, reinterpret_cast<const char*>(payload), length);
  crc_accumulate(crc_extra, &checksum);
  for (const uint8_t byte : header) push(byte);
  for (uint8_t i = 0; i < length; ++i) push(payload[i]);
  push(static_cast<uint8_t>(checksum & 0xff));
  push(static_cast<uint8_t>(checksum >> 8));
  return true;
}

void Link::push(uint8_t byte) {
  queue_[(first_ + queued_) % kQueueSize] = byte;
  ++queued_;
}

uint8_t Link::flush(SerialPort& port, uint8_t budget) {
  while (queued_ > 0 && budget > 0) {
    const uint16_t to_end = kQueueSize - first_;
    const uint16_t run = queued_ < to_end ? queued_ : to_end;
    const uint8_t offered = run < budget ? static_cast<uint8_t>(run) : budget;
    const uint8_t taken = port.write(queue_ + first_, offered);
    first_ = (first_ + taken) % kQueueSize;
    queued_ -= taken;
    budget = static_cast<uint8_t>(budget - taken);
    if (taken < offered) break;
  }
  return budget;
}

}  // namespace echowing
