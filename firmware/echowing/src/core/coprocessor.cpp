#include "coprocessor.h"

#include "scan.h"

namespace echowing {
namespace {

// Longest message that may go out before the range: 66 bytes of STATUSTEXT at 115200 baud, and
// a turn.
constexpr Microseconds kClearWire = milliseconds(8);
// Until our vehicle's system id is known, we send with an id that no vehicle has: vehicles are
// numbered from 1 up, ground stations from 255 down.
constexpr uint8_t kUnknownSystem = 250;

Notice start_notice(ResetCause cause) {
  return static_cast<Notice>(static_cast<uint8_t>(Notice::kStarted) + static_cast<uint8_t>(cause));
}
static_assert(static_cast<uint8_t>(Notice::kStartedByOrder) -
                      static_cast<uint8_t>(Notice::kStarted) ==
                  static_cast<uint8_t>(ResetCause::kOrdered),
              "a notice for each cause");

}  // namespace

Coprocessor::Coprocessor(const Ports& ports, uint32_t seed, Microseconds now, Milliseconds uptime)
    : ports_(ports),
      loaded_(store_.load(ports_.memory, parameters_)),
      uptime_(now, uptime),
      autopilot_({now, uptime}),
      sonar_(parameters_, seed, {now, uptime}),
      tracker_(parameters_, {now, uptime}),
      look_(parameters_, tracker_.aim(), {now, uptime}),
      autopilot_connection_(ports.autopilot, true),
      usb_connection_(ports.usb, false),
      pointed_(tracker_.aim()),
      pointing_(pointing(parameters_, pointed_)) {
  renew_identity();
  notify(start_notice(ports_.board.reset_cause()));
  if (loaded_ == ParameterStore::Loaded::kCorrupt) notify(Notice::kParametersCorrupt);
}

bool Coprocessor::set_parameter(uint8_t index, float value) {
  const bool taken = parameters_.set(index, value);
  pointing_.find(pointed_);
  renew_identity();
  return taken;
}

void Coprocessor::step(Microseconds us) {
  uptime_.advance(us);
  const Instant now = {us, uptime_.ms()};
  sense(now);
  decide(now);
  act(now);
  tell(now);
}

void Coprocessor::sense(const Instant& now) {
  autopilot_.step(now);
  poll_sonar(now);
}

void Coprocessor::decide(const Instant& now) {
  if (autopilot_.armed()) cancel_bench_orders();
  if (autopilot_.take_learned()) adopt_system_id(now);
  if (autopilot_.take_conflict(now)) {
    notify(autopilot_.own() == 0 ? Notice::kSeveralVehicles : Notice::kOnlyOtherVehicles);
  }
  if (autopilot_.own() != 0 && look_.take_request(now)) autopilot_connection_.ask_for_attitude();
  run_self_test(now);
  aim_gimbal(now);
}

void Coprocessor::act(const Instant& now) {
  ports_.servos.write(tracker_.aim());
  store_parameters(now);
  restart_if_ordered(now);
}

// A turn does one of its costly things: so it stays short on AVR, and what waits has its turn
// within two milliseconds. A reading's report goes first of all, in the turn after it.
void Coprocessor::tell(const Instant& now) {
  const Telemetry telemetry = observe(now);
  const bool busy = new_reading_ || sonar_.timed_out() || report_reading(now, telemetry) ||
                    sonar_.pinged() || look_.work(now, tracker_) || handle_message(now) ||
                    pointing_.step(parameters_);
  if (!busy) send_other(now, telemetry);
  usb_connection_.flush(autopilot_connection_.flush(Link::kBytesOutPerTurn));
}

void Coprocessor::poll_sonar(const Instant& now) {
  const SonarEvent event = sonar_.step(now, ports_.bus);
  new_reading_ = event == SonarEvent::kReading;
  if (event == SonarEvent::kFault) notify(Notice::kSonarFault);
  if (event == SonarEvent::kRecovered) notify(Notice::kSonarBack);
  if (sonar_.pinged()) look_.on_ping(now);
  if (sonar_.take_address_changed()) adopt_sonar_address(now);
  if (!new_reading_) return;
  heard_sonar_ = true;
  look_.on_reading(now, tracker_);
  autopilot_connection_.on_reading();
  usb_connection_.on_reading();
  reading_ms_ = now.ms;
  freshness_.start(now, kStale);
}

void Coprocessor::adopt_sonar_address(const Instant& now) {
  parameters_.set(static_cast<uint8_t>(Parameter::kSonarAddress), asked_address_);
  store_.touch(now);
  notify(Notice::kAddressChanged);
}

void Coprocessor::adopt_system_id(const Instant& now) {
  parameters_.set(static_cast<uint8_t>(Parameter::kSystemId), autopilot_.own());
  renew_identity();
  store_.touch(now);
  notify(Notice::kSystemLearned);
}

// Taking off ends whatever the bench has ordered: nothing of it may act in flight.
void Coprocessor::cancel_bench_orders() {
  orders_.cancel();
  self_test_.abort();
  sonar_.cancel_address_change();
  autopilot_connection_.restore_intervals();
  usb_connection_.restore_intervals();
  restarting_ = false;
}

void Coprocessor::run_self_test(const Instant& now) {
  if (new_reading_) self_test_.on_reading();
  // The memory is asked at the end: not while a byte still burns, nor after a reading.
  if (ports_.memory.busy() || new_reading_) return;
  if (self_test_.step(now)) report_self_test();
}

void Coprocessor::report_self_test() {
  const bool memory = store_.sound(ports_.memory);
  const bool link = self_test_.looped(kAutopilotPort);
  const bool usb = self_test_.looped(kUsbPort);
  notify(self_test_.sonar_heard() ? Notice::kTestSonarGood : Notice::kTestSonarBad);
  notify(memory ? Notice::kTestMemoryGood : Notice::kTestMemoryBad);
  notify(link ? Notice::kTestLinkLooped : Notice::kTestLinkOpen);
  notify(usb ? Notice::kTestUsbLooped : Notice::kTestUsbOpen);
  notify(Notice::kTestEnded);
}

void Coprocessor::aim_gimbal(const Instant& now) {
  tracker_.hold_at(self_test_.running() ? self_test_.aim(parameters_) : orders_.aim());
  tracker_.step(now, gimbal_mode(now), look_.deviation_rad());
  if (new_reading_) tracker_.on_reading(now, sonar_.reading());
  note_pointing(now);
}

void Coprocessor::note_pointing(const Instant& now) {
  const Aim aim = tracker_.aim();
  const bool moved = aim.pan_us != pointed_.pan_us || aim.tilt_us != pointed_.tilt_us;
  if (!moved) return;
  pointing_.find(aim);
  pointed_ = aim;
  look_.on_aim(now, aim);
}

GimbalMode Coprocessor::gimbal_mode(const Instant& now) {
  if (self_test_.running()) return GimbalMode::kHold;
  const bool on_the_ground = autopilot_.heard() && !autopilot_.armed();
  if (look_.active(now)) {
    return orders_.mode(on_the_ground ? GimbalMode::kLook : GimbalMode::kLookRound);
  }
  return orders_.mode(on_the_ground ? GimbalMode::kCentre : GimbalMode::kScan);
}

void Coprocessor::store_parameters(const Instant& now) {
  // A turn with a reading has enough to do.
  const bool may_store = !autopilot_.maybe_flying() && !new_reading_;
  switch (store_.step(now, may_store, ports_.memory, parameters_)) {
    case StoreEvent::kStored: return notify(Notice::kParametersStored);
    case StoreEvent::kFailed: return notify(Notice::kParametersNotStored);
    default: return;
  }
}

void Coprocessor::restart_if_ordered(const Instant& now) {
  if (!restarting_ || restart_delay_.running(now)) return;
  restarting_ = false;
  ports_.board.reboot(into_bootloader_);
}

Telemetry Coprocessor::observe(const Instant& now) {
  return {
      tracker_,
      pointing_.found(),
      look_.axis(),
      reading_ms_,
      identity_,
      now.ms,
      sonar_.faulty(),
      freshness_.running(now),
      sonar_.reading_within(now.us, kClearWire),
      sonar_.reading().range_cm,
      tracker_.aim(),
      static_cast<uint8_t>(state()),
  };
}

bool Coprocessor::report_reading(const Instant& now, const Telemetry& telemetry) {
  return autopilot_connection_.send_reading(now, parameters_, telemetry) ||
         usb_connection_.send_reading(now, parameters_, telemetry);
}

// The autopilot goes first.
bool Coprocessor::handle_message(const Instant& now) {
  return receive(now, autopilot_connection_, kAutopilotPort) ||
         receive(now, usb_connection_, kUsbPort);
}

void Coprocessor::send_other(const Instant& now, const Telemetry& telemetry) {
  const char* git_hash = ports_.board.git_hash();
  if (autopilot_connection_.send_other(now, parameters_, telemetry, git_hash)) return;
  usb_connection_.send_other(now, parameters_, telemetry, git_hash);
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
  autopilot_.set_own(static_cast<uint8_t>(parameters_.whole(Parameter::kSystemId)));
  identity_.system = autopilot_.own() != 0 ? autopilot_.own() : kUnknownSystem;
  identity_.component = static_cast<uint8_t>(parameters_.whole(Parameter::kComponentId));
}

}  // namespace echowing
