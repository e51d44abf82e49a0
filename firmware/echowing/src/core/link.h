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
  // At most this many bytes are taken, and handed on, in a turn: a flood cannot starve the scan,
  // and turns stay short on AVR, where a byte costs up to 30 us in and 10 us out. At 115200 baud
  // 11.5 of them pass in a millisecond, and the usual turn is shorter than half of one. What goes
  // out is a budget for both ports: what the first one cannot take yet is the second one's.
  static constexpr uint8_t kBytesInPerTurn = 8;
  static constexpr uint8_t kBytesOutPerTurn = 24;

  // The next whole message with a good checksum, valid until the next call; null when this turn's
  // bytes hold none. Call once a turn: what comes after a message is left for the next.
  const mavlink_message_t* receive(SerialPort& port);

  // Queues a message; false, and nothing queued, when it does not fit. Trailing zeros are cut as
  // MAVLink 2 wants.
  template <typename Payload>
  bool send(Identity from, const Payload& payload) {
    using Format = WireFormat<Payload>;
    return send_bytes(from, Format::kId, Format::kCrcExtra,
                      reinterpret_cast<const uint8_t*>(&payload), Format::kLength);
  }

  // Hands up to `budget` queued bytes to the port, as far as it takes them; returns what is left of
  // the budget. Once a turn.
  uint8_t flush(SerialPort& port, uint8_t budget);
  bool idle() const { return queued_ == 0; }

 private:
  static constexpr uint16_t kQueueSize = 256;  // power of two: indices wrap by masking
  static constexpr uint8_t kHeaderLength = 10;
  static constexpr uint8_t kChecksumLength = 2;

  bool send_bytes(Identity from, uint32_t id, uint8_t crc_extra, const uint8_t* payload,
                  uint8_t length);
  void push(uint8_t byte);

  mavlink_message_t incoming_ = {};
  mavlink_status_t parser_ = {};
  uint8_t received_[kBytesInPerTurn];
  uint8_t received_count_ = 0;
  uint8_t received_next_ = 0;
  uint8_t sequence_ = 0;
  uint8_t queue_[kQueueSize];
  uint16_t first_ = 0;
  uint16_t queued_ = 0;
};

}  // namespace echowing
