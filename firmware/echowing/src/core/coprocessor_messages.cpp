// What the co-processor does with the messages it gets: parameters and commands.
#include "coprocessor.h"
#include "flash_table.h"

namespace echowing {
namespace {

// Time for the acknowledgement to leave.
constexpr Milliseconds kRestartDelay = 200;

struct CommandRow {
  uint16_t number;
  bool in_flight;
  uint8_t (Coprocessor::*handler)(const Coprocessor::Order& order);
};

const CommandRow kCommands[] ECHOWING_FLASH = {
#define ECHOWING_COMMAND(handler, number, in_flight, text) \
  {number, in_flight, &Coprocessor::handler},
#include "command_table.h"
#undef ECHOWING_COMMAND
};

template <typename Message>
Command command_from(const Message& message) {
  return {message.target_system, message.target_component, message.command, message.param1,
          message.param2};
}

// Message ids and addresses come as floats; -1 for what cannot be one.
int32_t whole_number(float value) {
  return value >= 0.0f && value <= 65535.0f ? static_cast<int32_t>(value) : -1;
}

uint8_t accepted_if(bool good) { return good ? MAV_RESULT_ACCEPTED : MAV_RESULT_DENIED; }

}  // namespace

bool Coprocessor::receive(const Instant& now, Connection& connection, Port port) {
  const mavlink_message_t* message = connection.receive();
  if (message == nullptr) return false;
  const bool our_own = message->sysid == identity_.system && message->compid == identity_.component;
  if (our_own) self_test_.on_own_message(port);
  if (port == kAutopilotPort) hear_autopilot(now, *message);
  dispatch(now, connection, *message);
  return true;
}

void Coprocessor::hear_autopilot(const Instant& now, const mavlink_message_t& message) {
  autopilot_.on_message(now, message);
  const bool ours = autopilot_.own() != 0 && message.sysid == autopilot_.own() &&
                    message.compid == MAV_COMP_ID_AUTOPILOT1;
  if (ours && message.msgid == MAVLINK_MSG_ID_ATTITUDE) look_.on_attitude(now, message);
}

void Coprocessor::dispatch(const Instant& now, Connection& connection,
                           const mavlink_message_t& message) {
  switch (message.msgid) {
    case MAVLINK_MSG_ID_PARAM_REQUEST_READ: return on_parameter_read(connection, message);
    case MAVLINK_MSG_ID_PARAM_REQUEST_LIST: return on_parameter_list(connection, message);
    case MAVLINK_MSG_ID_PARAM_SET: return on_parameter_set(now, connection, message);
    case MAVLINK_MSG_ID_GIMBAL_DEVICE_SET_ATTITUDE: return on_look_order(now, message);
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

bool Coprocessor::is_for_us(uint8_t system, uint8_t component, bool broadcast_too) const {
  const bool our_system = system == identity_.system;
  if (broadcast_too && component == MAV_COMP_ID_ALL) return our_system || system == 0;
  return our_system && component == identity_.component;
}

void Coprocessor::on_parameter_read(Connection& connection, const mavlink_message_t& message) {
  mavlink_param_request_read_t asked;
  mavlink_msg_param_request_read_decode(&message, &asked);
  if (!is_for_us(asked.target_system, asked.target_component, false)) return;
  const int16_t index =
      asked.param_index == -1 ? Parameters::find(asked.param_id) : asked.param_index;
  if (index < 0 || index >= kParameterCount) return;
  connection.report_parameter(static_cast<uint8_t>(index));
}

void Coprocessor::on_parameter_list(Connection& connection, const mavlink_message_t& message) {
  mavlink_param_request_list_t asked;
  mavlink_msg_param_request_list_decode(&message, &asked);
  if (is_for_us(asked.target_system, asked.target_component, true)) connection.list_parameters();
}

void Coprocessor::on_parameter_set(const Instant& now, Connection& connection,
                                   const mavlink_message_t& message) {
  mavlink_param_set_t asked;
  mavlink_msg_param_set_decode(&message, &asked);
  if (!is_for_us(asked.target_system, asked.target_component, false)) return;
  const int16_t index = Parameters::find(asked.param_id);
  if (index < 0) return;
  const uint8_t row = static_cast<uint8_t>(index);
  // The answer is the value in force: the old one, if the new one is refused.
  connection.report_parameter(row);
  if (parameters_.at(row) == asked.param_value) return;
  if (autopilot_.maybe_flying() && !parameter_info(row).in_flight) {
    return connection.notify(Notice::kNotInFlight);
  }
  if (set_parameter(row, asked.param_value)) store_.touch(now);
}

void Coprocessor::on_look_order(const Instant& now, const mavlink_message_t& message) {
  mavlink_gimbal_device_set_attitude_t order;
  mavlink_msg_gimbal_device_set_attitude_decode(&message, &order);
  if (!is_for_us(order.target_system, order.target_component, false)) return;
  look_.on_order(now, message);
}

void Coprocessor::on_command(const Instant& now, Connection& connection,
                             const mavlink_message_t& message, const Command& command) {
  if (!is_for_us(command.target_system, command.target_component, false)) return;
  const Identity from = identity_;  // who was asked answers, whatever the command changes
  const uint8_t result = execute(command.number, {now, connection, command.first, command.second});
  connection.acknowledge(from, message, command.number, result);
}

uint8_t Coprocessor::execute(uint16_t number, const Order& order) {
  for (const CommandRow& each : kCommands) {
    const CommandRow row = from_flash(each);
    if (row.number != number) continue;
    if (autopilot_.maybe_flying() && !row.in_flight) return MAV_RESULT_TEMPORARILY_REJECTED;
    return (this->*row.handler)(order);
  }
  return MAV_RESULT_UNSUPPORTED;
}

uint8_t Coprocessor::set_servo(const Order& order) {
  return accepted_if(orders_.hold_servo(tracker_.aim(), order.first, order.second));
}

uint8_t Coprocessor::set_gimbal_angles(const Order& order) {
  return accepted_if(orders_.hold_angles(parameters_, order.first, order.second));
}

uint8_t Coprocessor::set_scan(const Order& order) {
  return accepted_if(orders_.choose(order.first));
}

uint8_t Coprocessor::set_message_interval(const Order& order) {
  const int32_t id = whole_number(order.first);
  if (id < 0) return MAV_RESULT_DENIED;
  return order.connection.set_interval(static_cast<uint32_t>(id), order.second);
}

uint8_t Coprocessor::request_message(const Order& order) {
  const int32_t id = whole_number(order.first);
  if (id < 0) return MAV_RESULT_DENIED;
  return order.connection.request_message(static_cast<uint32_t>(id));
}

uint8_t Coprocessor::report_capabilities(const Order& order) {
  return order.connection.request_message(MAVLINK_MSG_ID_AUTOPILOT_VERSION);
}

uint8_t Coprocessor::restart(const Order& order) {
  if (order.first != 1.0f && order.first != 3.0f) return MAV_RESULT_DENIED;
  into_bootloader_ = order.first == 3.0f;
  restarting_ = true;
  restart_delay_.start(order.now, kRestartDelay);
  return MAV_RESULT_ACCEPTED;
}

// The sonar keeps its address in a memory of its own: forgetting it would lose the sonar.
uint8_t Coprocessor::restore_defaults(const Order& order) {
  if (order.first != 2.0f) return MAV_RESULT_DENIED;
  const float address = parameters_.get(Parameter::kSonarAddress);
  parameters_.reset();
  parameters_.set(static_cast<uint8_t>(Parameter::kSonarAddress), address);
  pointing_.find(pointed_);
  renew_identity();
  store_.touch(order.now);
  notify(Notice::kParametersReset);
  return MAV_RESULT_ACCEPTED;
}

uint8_t Coprocessor::change_sonar_address(const Order& order) {
  const int32_t wanted = whole_number(order.first);
  if (wanted < 0 || wanted > 127) return MAV_RESULT_DENIED;
  asked_address_ = static_cast<uint8_t>(wanted);
  return accepted_if(sonar_.change_address(asked_address_));
}

uint8_t Coprocessor::start_self_test(const Order& order) {
  if (self_test_.running()) return MAV_RESULT_TEMPORARILY_REJECTED;
  self_test_.start(order.now);
  return MAV_RESULT_ACCEPTED;
}

}  // namespace echowing
