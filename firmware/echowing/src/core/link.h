// One MAVLink connection over one serial port: its own parser, its own queue, its own sequence.
#pragma once

#include <stdint.h>

#include "mavlink_headers.h"
#include "ports.h"
#include "wire_format.h"

namespace echowing {

// Who we are on the wire.
struct Identity {
  uint8_t system;
  uint8_t component;
};

class Link {
 public:
  // Takes at most this many bytes a turn, so that a flood cannot starve the scan; at 115200 baud
  // eleven arrive in a millisecond.
  static constexpr uint8_t kBytesPerTurn = 32;

  // Takes what has arrived, once a turn; then `next` until it gives null.
  void receive(SerialPort& port);
  // A whole message with a good checksum, valid until the next call.
  const mavlink_message_t* next();

  // Queues a message; false, and nothing queued, when it does not fit. Trailing zeros are cut as
  // MAVLink 2 wants.
  template <typename Payload>
  bool send(Identity from, const Payload& payload) {
    using Format = WireFormat<Payload>;
    return send_bytes(from, Format::kId, Format::kCrcExtra,
                      reinterpret_cast<const uint8_t*>(&payload), Format::kLength);
  }

  // Hands queued bytes to the port as far as it takes them.
  void flush(SerialPort& port);
  bool idle() const { return queued_ == 0; }

 private:
  static constexpr uint16_t kQueueSize = 256;  // power of two: indices wrap by masking
  static constexpr uint8_t kHeaderLength = 10;
  static constexpr uint8_t kChecksumLength = 2;

  bool send_bytes(Identity from, uint8_t id, uint8_t crc_extra, const uint8_t* payload,
                  uint8_t length);
  void push(uint8_t byte);

  mavlink_message_t incoming_ = {};
  mavlink_status_t parser_ = {};
  uint8_t received_[kBytesPerTurn];
  uint8_t received_count_ = 0;
  uint8_t received_next_ = 0;
  uint8_t sequence_ = 0;
  uint8_t queue_[kQueueSize];
  uint16_t first_ = 0;
  uint16_t queued_ = 0;
};

}  // namespace echowing
