// Two servo pulses from one hardware timer, 50 Hz; no interrupt, so nothing can shift an edge.
#pragma once

#include "../core/ports.h"

namespace echowing {

class ServoPwm : public ServoOutput {
 public:
  // Starts the pulses at `aim`.
  void begin(Aim aim);
  void write(Aim aim) override;

 private:
  Aim written_ = {};
};

}  // namespace echowing
