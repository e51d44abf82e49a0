#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "rig.h"

using namespace echowing;
using rig::Rig;

namespace {

constexpr Microseconds ms(uint32_t count) { return count * 1000; }

constexpr uint8_t kUs = 191;

mavlink_param_request_list_t list_request(uint8_t system, uint8_t component) {
  mavlink_param_request_list_t message = {};
  message.target_system = system;
  message.target_component = component;
  return message;
}

mavlink_param_request_read_t read_request(const char* name, int16_t index) {
  mavlink_param_request_read_t message = {};
  message.target_system = 1;
  message.target_component = kUs;
  message.param_index = index;
  memcpy(message.param_id, name, strlen(name));
  return message;
}

void feed(Rig& rig, const std::vector<uint8_t>& bytes, int port = 0) {
  rig.serial[port].in.insert(rig.serial[port].in.end(), bytes.begin(), bytes.end());
}

}  // namespace

TEST_CASE("a heartbeat a second on both ports, as an onboard controller and no autopilot") {
  Rig rig;
  rig.run(ms(10000));
  for (const int port : {0, 1}) {
    CHECK(rig.heartbeats(port).size() == 10);
    CHECK(rig.heartbeats(port).back().type == MAV_TYPE_ONBOARD_CONTROLLER);
    CHECK(rig.heartbeats(port).back().autopilot == MAV_AUTOPILOT_INVALID);
    CHECK(rig.heartbeats(port).back().system_status == MAV_STATE_ACTIVE);
  }
}

TEST_CASE("the list holds every parameter once, in order, paced between the reports") {
  for (const uint8_t component : {kUs, uint8_t{0}}) {
    Rig rig;
    rig.run(ms(1000));
    rig.forget();
    rig.hear(0, list_request(1, component));
    rig.run(ms(2000));
    const auto values = rig.values();
    REQUIRE(values.size() == int{kParameterCount});
    for (uint8_t i = 0; i < kParameterCount; ++i) {
      CHECK(values[i].index == i);
      CHECK(values[i].count == int{kParameterCount});
      CHECK(values[i].type == MAV_PARAM_TYPE_REAL32);
      CHECK(Parameters::find(values[i].name.c_str()) == i);
      CHECK(values[i].value == rig.core.parameters().at(i));
    }
    CHECK(rig.ranges().size() == 40);
    CHECK(rig.values(1).empty());  // the other port did not ask
  }
}

TEST_CASE("requests for others are not ours") {
  Rig rig;
  rig.hear(0, list_request(2, kUs));
  rig.hear(0, list_request(1, 1));
  rig.run(ms(1000));
  CHECK(rig.values().empty());
}

TEST_CASE("a parameter is read by name and by index, an unknown one not at all") {
  Rig rig;
  rig.hear(0, read_request("AVG_WINDOW", -1));
  rig.run(ms(200));
  rig.hear(0, read_request("", 0));
  rig.run(ms(200));
  rig.hear(0, read_request("NO_SUCH", -1));
  rig.hear(0, read_request("", kParameterCount));
  rig.hear(0, read_request("", -2));
  rig.run(ms(500));
  REQUIRE(rig.values().size() == 2);
  CHECK(rig.values()[0].name == "AVG_WINDOW");
  CHECK(rig.values()[0].value == 450);
  CHECK(rig.values()[1].name == "SYS_ID");
}

TEST_CASE("several reads at once are all answered") {
  Rig rig;
  rig.run(ms(500));
  for (int16_t index = 0; index < 6; ++index) {
    rig.hear(0, read_request("", static_cast<int16_t>(5 - index)));
  }
  rig.run(ms(500));
  CHECK(rig.values().size() == 6);
}

TEST_CASE("a set is confirmed; one out of range is refused with the value in force") {
  Rig rig;
  rig.set_parameter("SCAN_DWELL", 400);
  rig.run(ms(100));
  rig.set_parameter("SCAN_DWELL", 4);
  rig.run(ms(100));
  rig.set_parameter("SCAN_DWELL", std::nanf(""));
  rig.run(ms(100));
  const auto values = rig.values();
  REQUIRE(values.size() == 3);
  for (const auto& value : values) CHECK(value.value == 400);
  CHECK(rig.parameter(Parameter::kDwell) == 400);
}

TEST_CASE("a change is stored after two seconds, only on the ground, and lives on") {
  Rig rig;
  rig.autopilot(1, true);
  rig.run(ms(500));
  rig.set_parameter("SCAN_DWELL", 400);
  rig.run(ms(10000));
  CHECK(rig.memory.writes == 0);
  CHECK(rig.parameter(Parameter::kDwell) == 400);
  rig.autopilot(1, false);
  rig.run(ms(500));
  CHECK(rig.memory.flushes == 1);
  CHECK(rig.said("stored"));

  Rig later(0, rig.memory);
  CHECK(later.parameter(Parameter::kDwell) == 400);
  later.run(ms(500));
  CHECK_FALSE(later.said("corrupt"));
}

TEST_CASE("the first pulses are the stored ones") {
  Rig rig;
  rig.set_parameter("PAN_MIDDLE", 1420);
  rig.run(ms(3000));
  const Rig later(0, rig.memory);
  CHECK(later.core.aim().pan_us == 1420);
}

TEST_CASE("nothing is stored when the autopilot falls silent in flight") {
  Rig rig;
  rig.autopilot(1, true);
  rig.run(ms(500));
  rig.set_parameter("SCAN_DWELL", 400);
  rig.silence_autopilot();
  rig.run(ms(20000));
  CHECK(rig.memory.writes == 0);
  CHECK(rig.command(246, 1) == MAV_RESULT_TEMPORARILY_REJECTED);
}

TEST_CASE("setting what is set already does not wear the memory") {
  Rig rig;
  rig.set_parameter("SCAN_DWELL", 300);
  rig.run(ms(5000));
  CHECK(rig.memory.writes == 0);
}

TEST_CASE("corrupt memory is told and defaults hold") {
  rig::FakeMemory broken;
  memset(broken.slots, 0x5a, sizeof(broken.slots));
  Rig rig(0, broken);
  rig.run(ms(500));
  CHECK(rig.said("corrupt"));
  CHECK(rig.parameter(Parameter::kDwell) == 300);
}

TEST_CASE("defaults come back by command") {
  Rig rig;
  rig.set_parameter("SCAN_DWELL", 400);
  rig.run(ms(3000));
  CHECK(rig.command(245, 1) == MAV_RESULT_DENIED);
  CHECK(rig.command(245, 2) == MAV_RESULT_ACCEPTED);
  CHECK(rig.parameter(Parameter::kDwell) == 300);
  CHECK(rig.parameter(Parameter::kSystemId) == 0);  // it learns anew
  rig.run(ms(3000));
  CHECK(Rig(0, rig.memory).parameter(Parameter::kDwell) == 300);
}

TEST_CASE("defaults keep the address of a sonar that has been given another") {
  Rig rig;
  rig.run(ms(500));
  CHECK(rig.command(31011, 0x35) == MAV_RESULT_ACCEPTED);
  rig.run(ms(3000));
  CHECK(rig.command(245, 2) == MAV_RESULT_ACCEPTED);
  rig.forget();
  rig.run(ms(3000));
  CHECK(rig.parameter(Parameter::kSonarAddress) == 0x35);
  CHECK(rig.ranges().back().report.current_distance == 300);
  CHECK(Rig(0, rig.memory).parameter(Parameter::kSonarAddress) == 0x35);
}

TEST_CASE("a memory that fails is said, and not that the parameters are stored") {
  Rig rig;
  rig.memory.stuck_at = 40;
  rig.set_parameter("SCAN_DWELL", 400);
  rig.run(ms(5000));
  CHECK(rig.said("parameters NOT stored"));
  CHECK_FALSE(rig.said("parameters stored"));
}

TEST_CASE("the start notice says why it started") {
  struct Row {
    ResetCause cause;
    const char* text;
  };
  const Row rows[] = {{ResetCause::kUnknown, "Echowing: started"},
                      {ResetCause::kPowerOn, "Echowing: started, power on"},
                      {ResetCause::kBrownOut, "Echowing: started, supply was too low"},
                      {ResetCause::kPin, "Echowing: started, reset pin"},
                      {ResetCause::kWatchdog, "Echowing: started, watchdog"},
                      {ResetCause::kOrdered, "Echowing: started, by command"}};
  for (const Row& row : rows) {
    Rig rig(0, rig::FakeMemory(), 0, 1, row.cause);
    rig.run(ms(100));
    REQUIRE(rig.texts().size() == 1);
    CHECK(rig.texts()[0] == row.text);
  }
}

TEST_CASE("unknown commands are answered as unsupported, those for others not at all") {
  Rig rig;
  rig.run(ms(500));
  CHECK(rig.command(400, 1) == MAV_RESULT_UNSUPPORTED);  // arming is not our business
  rig.forget();
  mavlink_command_long_t message = {};
  message.command = 512;
  message.target_system = 1;
  message.target_component = 1;
  rig.hear(0, message);
  message.target_component = 0;
  rig.hear(0, message);
  message.target_system = 2;
  message.target_component = kUs;
  rig.hear(0, message);
  rig.run(ms(100));
  CHECK(rig.acks().empty());
}

TEST_CASE("COMMAND_INT does what COMMAND_LONG does") {
  Rig rig;
  mavlink_command_int_t message = {};
  message.target_system = 1;
  message.target_component = kUs;
  message.command = 183;
  message.param1 = 1;
  message.param2 = 1600;
  rig.hear(0, message);
  rig.run(ms(20));
  REQUIRE(rig.acks().size() == 1);
  CHECK(rig.acks()[0].result == MAV_RESULT_ACCEPTED);
  CHECK(rig.servos.last.pan_us == 1600);
}

TEST_CASE("an acknowledgement goes to who asked, on the port it came by, at once") {
  Rig rig;
  rig.run(ms(530));  // between two readings, whose messages go first
  rig.forget();
  mavlink_command_long_t message = {};
  message.target_system = 1;
  message.target_component = kUs;
  message.command = 512;
  message.param1 = 148;
  rig.hear(1, message, 245, 7);
  rig.run(ms(10));
  CHECK(rig.acks(0).empty());
  REQUIRE(rig.acks(1).size() == 1);
  for (const auto& each : rig.sent(1)) {
    if (each.message.msgid != MAVLINK_MSG_ID_COMMAND_ACK) continue;
    mavlink_command_ack_t ack;
    mavlink_msg_command_ack_decode(&each.message, &ack);
    CHECK(ack.target_system == 245);
    CHECK(ack.target_component == 7);
  }
}

TEST_CASE("version and git hash are told on request, the old way too") {
  for (const uint16_t id : {512, 520}) {
    Rig rig;
    rig.run(ms(500));
    rig.forget();
    CHECK(rig.command(id, id == 512 ? 148.0f : 1.0f) == MAV_RESULT_ACCEPTED);
    rig.run(ms(200));
    int versions = 0;
    for (const auto& each : rig.sent()) {
      if (each.message.msgid != MAVLINK_MSG_ID_AUTOPILOT_VERSION) continue;
      ++versions;
      mavlink_autopilot_version_t version;
      mavlink_msg_autopilot_version_decode(&each.message, &version);
      CHECK(memcmp(version.flight_custom_version, "0123abcd", 8) == 0);
      const uint32_t number = version.flight_sw_version;
      CHECK(number == 0x000100ff);
      CHECK((version.capabilities & MAV_PROTOCOL_CAPABILITY_COMMAND_INT) != 0);
    }
    CHECK(versions == 1);
  }
}

TEST_CASE("messages that are not ours to send are unsupported") {
  Rig rig;
  CHECK(rig.command(512, 33) == MAV_RESULT_UNSUPPORTED);
  CHECK(rig.command(512, std::nanf("")) == MAV_RESULT_DENIED);
  CHECK(rig.command(512, 1e20f) == MAV_RESULT_DENIED);
}

TEST_CASE("reboot comes after its acknowledgement, into the bootloader on demand") {
  for (const bool bootloader : {false, true}) {
    Rig rig;
    rig.run(ms(100));
    CHECK(rig.command(246, bootloader ? 3.0f : 1.0f) == MAV_RESULT_ACCEPTED);
    CHECK(rig.board.reboots == 0);
    rig.run(ms(300));
    CHECK(rig.board.reboots == 1);
    CHECK(rig.board.bootloader == bootloader);
  }
  Rig rig;
  CHECK(rig.command(246, 0) == MAV_RESULT_DENIED);
}

TEST_CASE("self test: servos sweep, then sonar, memory and ports are told") {
  Rig rig;
  rig.autopilot(1, false);
  rig.run(ms(500));
  rig.forget();
  CHECK(rig.command(31012) == MAV_RESULT_ACCEPTED);
  CHECK(rig.command(31012) == MAV_RESULT_TEMPORARILY_REJECTED);
  uint16_t least_pan = 2000, most_pan = 0, least_tilt = 2000, most_tilt = 0;
  for (int i = 0; i < 3000; ++i) {
    rig.run(1000);
    least_pan = std::min(least_pan, rig.servos.last.pan_us);
    most_pan = std::max(most_pan, rig.servos.last.pan_us);
    least_tilt = std::min(least_tilt, rig.servos.last.tilt_us);
    most_tilt = std::max(most_tilt, rig.servos.last.tilt_us);
  }
  CHECK(least_pan == 1330);
  CHECK(most_pan == 1400);
  CHECK(least_tilt == 1300);
  CHECK(most_tilt == 1500);
  CHECK(rig.servos.last.pan_us == 1380);
  for (const int port : {0, 1}) {
    CHECK(rig.said("test: sonar good", port));
    CHECK(rig.said("test: memory good", port));
    CHECK(rig.said("autopilot port has no loop plug", port));
    CHECK(rig.said("USB port has no loop plug", port));
    CHECK(rig.said("test: ended", port));
  }
}

TEST_CASE("self test finds a dead sonar, broken memory and a looped port") {
  rig::FakeMemory broken;
  memset(broken.slots, 0x5a, sizeof(broken.slots));
  Rig rig(0, broken);
  rig.sonar.plugged = false;
  CHECK(rig.command(31012, 0, 0, 1) == MAV_RESULT_ACCEPTED);
  for (int i = 0; i < 3000; ++i) {
    mavlink_heartbeat_t own = {};
    own.type = MAV_TYPE_ONBOARD_CONTROLLER;
    own.autopilot = MAV_AUTOPILOT_INVALID;
    if (i % 1000 == 0) rig.hear(0, own, 1, kUs);
    rig.run(1000);
  }
  CHECK(rig.said("sonar gives no reading"));
  CHECK(rig.said("memory corrupt"));
  CHECK(rig.said("autopilot port looped"));
  CHECK(rig.said("USB port has no loop plug"));
}

TEST_CASE("taking off ends a self test") {
  Rig rig;
  rig.sonar.listen = [](Microseconds) { return 765; };
  rig.autopilot(1, false);
  rig.run(ms(100));
  rig.command(31012);
  rig.autopilot(1, true);
  rig.run(ms(4000));
  CHECK_FALSE(rig.said("test: ended"));
}

TEST_CASE("garbage before and between frames does not cost the frames") {
  Rig rig;
  std::srand(7);
  for (int i = 0; i < 50; ++i) {
    std::vector<uint8_t> noise(static_cast<size_t>(std::rand() % 40));
    for (uint8_t& byte : noise) byte = static_cast<uint8_t>(std::rand() % 250);  // no start marks
    feed(rig, noise);
    rig.set_parameter("SCAN_DWELL", static_cast<float>(300 + i));
    rig.run(ms(50));
    CHECK(rig.parameter(Parameter::kDwell) == 300 + i);
  }
}

TEST_CASE("a megabyte of random bytes: reports go on, nothing changes") {
  Rig rig;
  const Parameters untouched = rig.core.parameters();
  rig.run(ms(1000));
  rig.forget();
  std::srand(3);
  size_t reports = 0;
  for (int block = 0; block < 10000; ++block) {
    std::vector<uint8_t> noise(105);
    for (uint8_t& byte : noise) byte = static_cast<uint8_t>(std::rand());
    feed(rig, noise);
    rig.run(ms(15), 500);  // a turn of the slowest board under such a flood
    reports += rig.ranges().size();
    rig.forget();
  }
  CHECK(reports == 3000);
  for (uint8_t i = 0; i < kParameterCount; ++i) {
    CHECK(rig.core.parameters().at(i) == untouched.at(i));
  }
  // The noise may have begun a frame of up to 280 bytes: what falls into it is lost, not more.
  for (int i = 0; i < 10; ++i) rig.set_parameter("SCAN_DWELL", 444);
  rig.run(ms(100));
  CHECK(rig.parameter(Parameter::kDwell) == 444);
}

TEST_CASE("a flood does not starve the scan: the backlog is worked off turn by turn") {
  Rig rig;
  rig.run(ms(1000));
  rig.forget();
  feed(rig, std::vector<uint8_t>(100000, 0xfd));
  rig.run(ms(1000));
  CHECK(rig.ranges().size() == 20);
  CHECK(rig.serial[0].in.size() > 60000);
}

TEST_CASE("signed frames are understood, their signature unread") {
  Rig rig;
  mavlink_param_set_t set = {};
  set.target_system = 1;
  set.target_component = kUs;
  memcpy(set.param_id, "SCAN_DWELL", 10);
  set.param_value = 555;
  std::vector<uint8_t> bytes = Rig::frame(set, 255, 190);
  bytes[2] |= MAVLINK_IFLAG_SIGNED;
  uint16_t crc = crc_calculate(&bytes[1], static_cast<uint16_t>(bytes.size() - 3));
  crc_accumulate(MAVLINK_MSG_ID_PARAM_SET_CRC, &crc);
  bytes[bytes.size() - 2] = static_cast<uint8_t>(crc & 0xff);
  bytes[bytes.size() - 1] = static_cast<uint8_t>(crc >> 8);
  bytes.insert(bytes.end(), 13, 0xfd);
  feed(rig, bytes);
  rig.run(ms(50));
  CHECK(rig.parameter(Parameter::kDwell) == 555);
}

TEST_CASE("MAVLink 1 frames are understood") {
  Rig rig;
  mavlink_param_set_t set = {};
  set.target_system = 1;
  set.target_component = kUs;
  memcpy(set.param_id, "SCAN_DWELL", 10);
  set.param_value = 555;
  std::vector<uint8_t> bytes = {MAVLINK_STX_MAVLINK1, sizeof(set), 0, 255, 190, 23};
  const uint8_t* payload = reinterpret_cast<const uint8_t*>(&set);
  bytes.insert(bytes.end(), payload, payload + sizeof(set));
  uint16_t crc = crc_calculate(&bytes[1], static_cast<uint16_t>(bytes.size() - 1));
  crc_accumulate(MAVLINK_MSG_ID_PARAM_SET_CRC, &crc);
  bytes.push_back(static_cast<uint8_t>(crc & 0xff));
  bytes.push_back(static_cast<uint8_t>(crc >> 8));
  feed(rig, bytes);
  rig.run(ms(50));
  CHECK(rig.parameter(Parameter::kDwell) == 555);
}

TEST_CASE("a frame with any bit flipped or any tail missing does nothing") {
  mavlink_param_set_t set = {};
  set.target_system = 1;
  set.target_component = kUs;
  memcpy(set.param_id, "SCAN_DWELL", 10);
  set.param_value = 555;
  const std::vector<uint8_t> good = Rig::frame(set, 255, 190);
  for (size_t bit = 0; bit < 8 * good.size(); ++bit) {
    CAPTURE(bit);
    // The sender's own ids, sequence and flags may differ in a frame that is still checked by CRC.
    std::vector<uint8_t> bytes = good;
    bytes[bit / 8] ^= static_cast<uint8_t>(1 << bit % 8);
    Rig rig;
    feed(rig, bytes);
    rig.run(ms(5));
    CHECK(rig.parameter(Parameter::kDwell) == 300);
  }
  for (size_t length = 0; length < good.size(); ++length) {
    Rig rig;
    feed(rig, {good.begin(), good.begin() + static_cast<std::ptrdiff_t>(length)});
    rig.run(ms(5));
    CHECK(rig.parameter(Parameter::kDwell) == 300);
  }
}

TEST_CASE("a storm of parameter sets and lists: every report still leaves in its turn") {
  Rig rig;
  rig.set_parameter("SONAR_PERIOD", 50);  // a reading for each report
  rig.run(ms(1000));
  rig.forget();
  for (int i = 0; i < 250; ++i) {
    rig.set_parameter("SCAN_DWELL", static_cast<float>(300 + i % 100));
    rig.hear(0, list_request(1, kUs));
    rig.run(ms(8));
  }
  CHECK(rig.ranges().size() == 40);
  for (const auto& range : rig.ranges()) CHECK(range.at / 1000 - range.report.time_boot_ms <= 3);
  rig.run(ms(2000));
  for (uint8_t i = 0; i < kParameterCount; ++i) {
    const auto values = rig.values();
    CHECK(std::any_of(values.begin(), values.end(), [i](const auto& v) { return v.index == i; }));
  }
}

TEST_CASE("no frame is longer than its message, whatever the compiler pads a struct with") {
  Rig rig;
  rig.hear(0, list_request(1, kUs));
  rig.command(512, 148);
  rig.command(31012);
  rig.run(ms(4000));
  REQUIRE(rig.sent().size() > 150);
  for (const auto& each : rig.sent()) {
    CHECK(each.message.len <= mavlink_max_message_length(&each.message));
    if (each.message.msgid != MAVLINK_MSG_ID_STATUSTEXT) continue;
    // Trailing zeros are cut: a severity, then the text up to its last letter.
    mavlink_statustext_t text;
    mavlink_msg_statustext_decode(&each.message, &text);
    CHECK(each.message.len == 1 + strnlen(text.text, sizeof(text.text)));
  }
}
