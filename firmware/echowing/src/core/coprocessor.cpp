#include "coprocessor.h"

#include <math.h>

#include "scan.h"

namespace echowing {
namespace {

// Longest message that may go out before the range: 66 bytes of STATUSTEXT at 115200 baud, and
// a turn.
constexpr Microseconds kClearWire = milliseconds(8);
// Time for the acknowledgement to leave.
constexpr Microseconds kRebootDelay = milliseconds(200);

// What hobby servos stand.
constexpr float kShortestPulse_us = 800.0f;
constexpr float kLongestPulse_us = 2200.0f;

template <typename Message>
Command command_from(const Message& message) {
  return {message.target_system,
          message.target_component,
          message.command,
          {message.param1, message.param2}};
}

bool is_pulse(float pulse_us) {
  return pulse_us >= kShortestPulse_us && pulse_us <= kLongestPulse_us;
}

// Message ids and addresses come as floats; -1 for what cannot be one.
int32_t whole_number(float value) {
  return value >= 0.0f && value <= 65535.0f ? static_cast<int32_t>(value) : -1;
}

}  // namespace

Coprocessor::Coprocessor(const Ports& ports, uint32_t seed, Microseconds now, uint32_t uptime_ms)
    : ports_(ports),
      loaded_(store_.load(ports_.memory, parameters_)),
      uptime_(now, uptime_ms),
      sonar_(parameters_, seed, now),
      tracker_(parameters_, now),
      autopilot_connection_(ports.autopilot),
      usb_connection_(ports.usb),
      pointed_(tracker_.aim()),
      pointing_(pointing(parameters_, pointed_)) {
  renew_identity();
  notify(Notice::kStarted);
  if (loaded_ == ParameterStore::Loaded::kCorrupt) notify(Notice::kParametersCorrupt);
}

bool Coprocessor::set_parameter(uint8_t index, float value) {
  const bool taken = parameters_.set(index, value);
  pointing_stale_ = true;
  renew_identity();
  return taken;
}

// A turn does one of its costly things, a reading with its report first of all: so it stays short
// on AVR, and what waits has its turn within two milliseconds.
void Coprocessor::step(Microseconds now) {
  uptime_.advance(now);
  autopilot_.step(now);
  range(now);
  examine(now);
  point(now);
  const Telemetry telemetry = observe(now);
  const bool told = tell_reading(now, telemetry);
  const bool handled = !told && !new_reading_ && listen(now);
  if (!told && !new_reading_ && !handled && !renew_pointing()) tell_other(now, telemetry);
  if (!autopilot_connection_.flush()) usb_connection_.flush();
  keep(now);
}

// The autopilot goes first.
bool Coprocessor::listen(Microseconds now) {
  return receive(now, autopilot_connection_, kAutopilotPort) ||
         receive(now, usb_connection_, kUsbPort);
}

bool Coprocessor::receive(Microseconds now, Connection& connection, Port port) {
  const mavlink_message_t* message = connection.receive();
  if (message == nullptr) return false;
  const bool our_own = message->sysid == identity_.system && message->compid == identity_.component;
  if (our_own) self_test_.on_own_message(port);
  if (port == kAutopilotPort) autopilot_.on_message(now, *message);
  handle(now, connection, *message);
  renew_identity();
  return true;
}

void Coprocessor::handle(Microseconds now, Connection& connection,
                         const mavlink_message_t& message) {
  switch (message.msgid) {
    case MAVLINK_MSG_ID_PARAM_REQUEST_READ: return on_parameter_read(connection, message);
    case MAVLINK_MSG_ID_PARAM_REQUEST_LIST: return on_parameter_list(connection, message);
    case MAVLINK_MSG_ID_PARAM_SET: return on_parameter_set(now, connection, message);
    case MAVLINK_MSG_ID_COMMAND_LONG: {
      mavlink_command_long_t command;
      mavlink_msg_command_long_decode(&message, &command);
      return on_command(now, connection, message, command_from(command));
    }
    case MAVLINK_MSG_ID_COMMAND_INT: {
      mavlink_command_int_t command;
      mavlink_msg_command_int_decode(&message, &command);
      return on_command(now, connection, message, command_from(command));
    }
    default: return;
  }
}

void Coprocessor::on_parameter_read(Connection& connection, const mavlink_message_t& message) {
  mavlink_param_request_read_t asked;
  mavlink_msg_param_request_read_decode(&message, &asked);
  if (!is_for_us(asked.target_system, asked.target_component, false)) return;
  const int16_t index =
      asked.param_index == -1 ? Parameters::find(asked.param_id) : asked.param_index;
  if (index < 0 || index >= kParameterCount) return;
  connection.tell_parameter(static_cast<uint8_t>(index));
}

void Coprocessor::on_parameter_list(Connection& connection, const mavlink_message_t& message) {
  mavlink_param_request_list_t asked;
  mavlink_msg_param_request_list_decode(&message, &asked);
  if (is_for_us(asked.target_system, asked.target_component, true)) connection.list_parameters();
}

void Coprocessor::on_parameter_set(Microseconds now, Connection& connection,
                                   const mavlink_message_t& message) {
  mavlink_param_set_t asked;
  mavlink_msg_param_set_decode(&message, &asked);
  if (!is_for_us(asked.target_system, asked.target_component, false)) return;
  const int16_t index = Parameters::find(asked.param_id);
  if (index < 0) return;
  const uint8_t row = static_cast<uint8_t>(index);
  const bool changes = parameters_.at(row) != asked.param_value;
  if (parameters_.set(row, asked.param_value) && changes) store_.touch(now);
  pointing_stale_ = true;
  // The value in force, which is the old one if the new one was refused.
  connection.tell_parameter(row);
}

void Coprocessor::on_command(Microseconds now, Connection& connection,
                             const mavlink_message_t& message, const Command& command) {
  if (!is_for_us(command.target_system, command.target_component, false)) return;
  const uint8_t result = execute(now, connection, command);
  connection.acknowledge(identity_, message, command.id, result);
}

uint8_t Coprocessor::execute(Microseconds now, Connection& connection, const Command& command) {
  const float* value = command.parameters;
  switch (command.id) {
    case kCommandRequestMessage: {
      const int32_t id = whole_number(value[0]);
      if (id < 0) return MAV_RESULT_DENIED;
      return connection.request_message(static_cast<uint32_t>(id));
    }
    case kCommandSetInterval: {
      const int32_t id = whole_number(value[0]);
      if (id < 0) return MAV_RESULT_DENIED;
      return connection.set_interval(static_cast<uint32_t>(id), value[1]);
    }
    case kCommandCapabilities: return connection.request_message(MAVLINK_MSG_ID_AUTOPILOT_VERSION);
    default: return execute_on_bench(now, command);
  }
}

uint8_t Coprocessor::execute_on_bench(Microseconds now, const Command& command) {
  const float* value = command.parameters;
  switch (command.id) {
    case kCommandSetServo:
    case kCommandGimbalAngles:
    case kCommandScan:
    case kCommandReboot:
    case kCommandStorage:
    case kCommandSonarAddress:
    case kCommandSelfTest: break;
    default: return MAV_RESULT_UNSUPPORTED;
  }
  // In flight the gimbal belongs to the leader.
  if (autopilot_.maybe_flying()) return MAV_RESULT_TEMPORARILY_REJECTED;
  switch (command.id) {
    case kCommandSetServo: return hold_servo(value[0], value[1]);
    case kCommandGimbalAngles: return hold_angles(value[0], value[1]);
    case kCommandScan: return scan_override(value[0]);
    case kCommandReboot: return reboot(now, value[0]);
    case kCommandStorage: return restore_defaults(now, value[0]);
    case kCommandSonarAddress: return change_sonar_address(value[0]);
    default: return start_self_test(now);
  }
}

uint8_t Coprocessor::hold(Aim aim) {
  tracker_.hold_at(aim);
  override_ = Override::kHold;
  return MAV_RESULT_ACCEPTED;
}

uint8_t Coprocessor::hold_servo(float servo, float pulse_us) {
  const bool pan = servo == 1.0f;
  if ((!pan && servo != 2.0f) || !is_pulse(pulse_us)) return MAV_RESULT_DENIED;
  Aim aim = tracker_.aim();
  (pan ? aim.pan_us : aim.tilt_us) = static_cast<uint16_t>(lroundf(pulse_us));
  return hold(aim);
}

uint8_t Coprocessor::hold_angles(float pitch_deg, float yaw_deg) {
  const Aim centre = scan_centre(parameters_);
  const float pan_us =
      static_cast<float>(centre.pan_us) + yaw_deg * parameters_.get(Parameter::kPanScale);
  const float tilt_us =
      static_cast<float>(centre.tilt_us) + pitch_deg * parameters_.get(Parameter::kTiltScale);
  if (!is_pulse(pan_us) || !is_pulse(tilt_us)) return MAV_RESULT_DENIED;
  return hold({static_cast<uint16_t>(lroundf(pan_us)), static_cast<uint16_t>(lroundf(tilt_us))});
}

uint8_t Coprocessor::scan_override(float choice) {
  if (choice == 0.0f) {
    override_ = Override::kNone;
  } else if (choice == 1.0f) {
    override_ = Override::kScan;
  } else if (choice == 2.0f) {
    override_ = Override::kCentre;
  } else {
    return MAV_RESULT_DENIED;
  }
  return MAV_RESULT_ACCEPTED;
}

uint8_t Coprocessor::reboot(Microseconds now, float choice) {
  if (choice != 1.0f && choice != 3.0f) return MAV_RESULT_DENIED;
  into_bootloader_ = choice == 3.0f;
  rebooting_ = true;
  reboot_delay_.start(now, kRebootDelay);
  return MAV_RESULT_ACCEPTED;
}

uint8_t Coprocessor::restore_defaults(Microseconds now, float choice) {
  if (choice != 2.0f) return MAV_RESULT_DENIED;
  parameters_.reset();
  pointing_stale_ = true;
  store_.touch(now);
  notify(Notice::kParametersReset);
  return MAV_RESULT_ACCEPTED;
}

uint8_t Coprocessor::change_sonar_address(float address) {
  const int32_t wanted = whole_number(address);
  if (wanted < 0 || wanted > 127) return MAV_RESULT_DENIED;
  asked_address_ = static_cast<uint8_t>(wanted);
  return sonar_.change_address(asked_address_) ? MAV_RESULT_ACCEPTED : MAV_RESULT_DENIED;
}

uint8_t Coprocessor::start_self_test(Microseconds now) {
  if (self_test_.running()) return MAV_RESULT_TEMPORARILY_REJECTED;
  self_test_.start(now);
  return MAV_RESULT_ACCEPTED;
}

void Coprocessor::examine(Microseconds now) {
  if (autopilot_.armed()) self_test_.abort();
  if (new_reading_) self_test_.on_reading();
  // The memory is asked at the end, and a byte that still burns would make that wait.
  if (ports_.memory.busy()) return;
  if (self_test_.step(now)) tell_test_results();
}

void Coprocessor::tell_test_results() {
  const bool memory = store_.sound(ports_.memory);
  const bool link = self_test_.looped(kAutopilotPort);
  const bool usb = self_test_.looped(kUsbPort);
  notify(self_test_.sonar_heard() ? Notice::kTestSonarGood : Notice::kTestSonarBad);
  notify(memory ? Notice::kTestMemoryGood : Notice::kTestMemoryBad);
  notify(link ? Notice::kTestLinkLooped : Notice::kTestLinkOpen);
  notify(usb ? Notice::kTestUsbLooped : Notice::kTestUsbOpen);
  notify(Notice::kTestEnded);
}

void Coprocessor::range(Microseconds now) {
  const SonarEvent event = sonar_.step(now, ports_.bus);
  new_reading_ = event == SonarEvent::kReading;
  if (event == SonarEvent::kFault) notify(Notice::kSonarFault);
  if (event == SonarEvent::kRecovered) notify(Notice::kSonarBack);
  if (sonar_.take_address_changed()) adopt_new_address(now);
  if (!new_reading_) return;
  heard_sonar_ = true;
  autopilot_connection_.on_reading();
  usb_connection_.on_reading();
  reading_ms_ = uptime_.ms();
  freshness_.start(now, kStale);
}

void Coprocessor::adopt_new_address(Microseconds now) {
  parameters_.set(static_cast<uint8_t>(Parameter::kSonarAddress), asked_address_);
  store_.touch(now);
  notify(Notice::kAddressChanged);
}

void Coprocessor::point(Microseconds now) {
  // Taking off ends what the bench had ordered.
  if (autopilot_.armed()) override_ = Override::kNone;
  if (self_test_.running()) tracker_.hold_at(self_test_.aim(parameters_));
  tracker_.step(now, gimbal_mode());
  if (new_reading_) tracker_.on_reading(sonar_.reading());
  const Aim aim = tracker_.aim();
  ports_.servos.write(aim);
  const bool moved = aim.pan_us != pointed_.pan_us || aim.tilt_us != pointed_.tilt_us;
  pointing_stale_ = pointing_stale_ || moved;
  pointed_ = aim;
}

bool Coprocessor::renew_pointing() {
  if (!pointing_stale_) return false;
  pointing_stale_ = false;
  pointing_ = pointing(parameters_, pointed_);
  return true;
}

GimbalMode Coprocessor::gimbal_mode() const {
  if (self_test_.running()) return GimbalMode::kHold;
  switch (override_) {
    case Override::kScan: return GimbalMode::kScan;
    case Override::kCentre: return GimbalMode::kCentre;
    case Override::kHold: return GimbalMode::kHold;
    default: break;
  }
  const bool on_the_ground = autopilot_.heard() && !autopilot_.armed();
  return on_the_ground ? GimbalMode::kCentre : GimbalMode::kScan;
}

Telemetry Coprocessor::observe(Microseconds now) {
  return {
      tracker_,
      pointing_,
      reading_ms_,
      identity_,
      uptime_.ms(),
      sonar_.faulty(),
      freshness_.running(now),
      sonar_.reading_within(now, kClearWire),
      sonar_.reading().range_cm,
      tracker_.aim(),
      static_cast<uint8_t>(state()),
  };
}

bool Coprocessor::tell_reading(Microseconds now, const Telemetry& telemetry) {
  return autopilot_connection_.send_reading(now, parameters_, telemetry) ||
         usb_connection_.send_reading(now, parameters_, telemetry);
}

void Coprocessor::tell_other(Microseconds now, const Telemetry& telemetry) {
  const char* git_hash = ports_.board.git_hash();
  if (autopilot_connection_.send_other(now, parameters_, telemetry, git_hash)) return;
  usb_connection_.send_other(now, parameters_, telemetry, git_hash);
}

void Coprocessor::keep(Microseconds now) {
  const bool may_store = !autopilot_.maybe_flying();
  if (store_.step(now, may_store, ports_.memory, parameters_)) notify(Notice::kParametersStored);
  if (!rebooting_ || reboot_delay_.running(now)) return;
  rebooting_ = false;
  ports_.board.reboot(into_bootloader_);
}

void Coprocessor::notify(Notice notice) {
  autopilot_connection_.notify(notice);
  usb_connection_.notify(notice);
}

DeviceState Coprocessor::state() const {
  if (sonar_.faulty()) return DeviceState::kSonarFault;
  if (!heard_sonar_) return DeviceState::kStarting;
  return tracker_.tracking() ? DeviceState::kTracking : DeviceState::kSearching;
}

LedState Coprocessor::led_state() const {
  switch (state()) {
    case DeviceState::kSonarFault: return LedState::kSonarFault;
    case DeviceState::kStarting: return LedState::kStarting;
    default: break;
  }
  if (!autopilot_.heard()) return LedState::kNoAutopilot;
  return tracker_.tracking() ? LedState::kTracking : LedState::kSearching;
}

void Coprocessor::renew_identity() {
  const uint8_t before = static_cast<uint8_t>(parameters_.whole(Parameter::kSystemId));
  identity_.system = autopilot_.system_id(before);
  identity_.component = static_cast<uint8_t>(parameters_.whole(Parameter::kComponentId));
}

bool Coprocessor::is_for_us(uint8_t system, uint8_t component, bool broadcast_too) const {
  const bool our_system = system == identity_.system;
  if (broadcast_too && component == MAV_COMP_ID_ALL) return our_system || system == 0;
  return our_system && component == identity_.component;
}

}  // namespace echowing
