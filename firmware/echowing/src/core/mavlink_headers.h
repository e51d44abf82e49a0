// The only include of mavgen's headers (generated from firmware/dialect/echowing.xml by the build).
#pragma once

// The wired link is unsigned; without these the SHA-256 code is linked in. Signed frames are
// still understood, their signature unread.
#define MAVLINK_NO_SIGN_PACKET
#define MAVLINK_NO_SIGNATURE_CHECK
// The channel arrays of the generated helpers are never used, but need a size.
#define MAVLINK_COMM_NUM_BUFFERS 1

#include "generated_mavlink.h"
