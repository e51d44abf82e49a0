// Prints the frames that MAVLink's own C parser cuts out of its input, as ArduPilot calls it: whole ones and broken ones.
#include <stdio.h>

#include "echowing/mavlink.h"

int main(void) {
    mavlink_message_t under_way, message;
    mavlink_status_t status = {0}, told;
    int byte;
    while ((byte = getchar()) != EOF) {
        uint8_t framing = mavlink_frame_char_buffer(&under_way, &status, (uint8_t)byte, &message, &told);
        // A signed frame with a wrong checksum is told of twice: here only when it is over.
        if (framing == MAVLINK_FRAMING_INCOMPLETE || status.parse_state != MAVLINK_PARSE_STATE_IDLE) continue;
        printf("%d %d %d %d %d\n", under_way.magic, under_way.len, under_way.seq, (int)under_way.msgid,
               under_way.ck[0] | under_way.ck[1] << 8);
    }
    return 0;
}
