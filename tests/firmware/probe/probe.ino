// Does one thing a letter, so that tests can see whether the emulated board is a board.
#include <Wire.h>
#include <avr/interrupt.h>
#include <avr/sleep.h>
#include <avr/wdt.h>

static const uint8_t kSonar = 0x70;

static void set_pulses(uint16_t pan_us, uint16_t tilt_us) {
  OCR1A = 2 * pan_us - 1;
  OCR1B = 2 * tilt_us - 1;
}

// 50 Hz on D11 and D12: Timer1, fast PWM up to ICR1, half-microsecond ticks.
static void start_pulses() {
  ICR1 = 39999;
  set_pulses(1380, 1400);
  TCCR1A = _BV(COM1A1) | _BV(COM1B1) | _BV(WGM11);
  TCCR1B = _BV(WGM13) | _BV(WGM12) | _BV(CS11);
  pinMode(11, OUTPUT);
  pinMode(12, OUTPUT);
  pinMode(LED_BUILTIN, OUTPUT);
}

static void read_sonar() {
  const uint8_t count = Wire.requestFrom(kSonar, (uint8_t)2);
  Serial1.print(count);
  while (Wire.available()) {
    Serial1.print(' ');
    Serial1.print(Wire.read());
  }
  Serial1.println();
}

static void write_sonar(uint8_t command) {
  Wire.beginTransmission(kSonar);
  Wire.write(command);
  Serial1.println(Wire.endTransmission());
}

// Open drain: low by driving, high by letting go.
static void line(uint8_t pin, bool high) {
  pinMode(pin, high ? INPUT : OUTPUT);
  if (!high) digitalWrite(pin, LOW);
  delayMicroseconds(5);
}

static void free_bus() {
  Wire.end();
  for (uint8_t i = 0; i < 9; ++i) {
    line(SCL, false);
    line(SCL, true);
  }
  line(SDA, false);
  line(SDA, true);
  Serial1.println(digitalRead(SDA));
  Wire.begin();
  Wire.setWireTimeout(3000, true);
}

static void use_stack() {
  volatile uint8_t block[1000];
  for (uint16_t i = 0; i < sizeof(block); ++i) block[i] = i;
  Serial1.println(block[999]);
}

static void burn(uint16_t address, uint8_t value) {
  while (EECR & _BV(EEPE)) wdt_reset();
  EEAR = address;
  EEDR = value;
  cli();
  EECR |= _BV(EEMPE);
  EECR |= _BV(EEPE);
  sei();
}

// A millisecond with interrupts off.
static void be_deaf() {
  cli();
  delayMicroseconds(1000);
  sei();
}

// Asleep with interrupts off, an AVR never wakes.
static void die() {
  cli();
  set_sleep_mode(SLEEP_MODE_IDLE);
  sleep_enable();
  sleep_cpu();
}

// Until the watchdog bites.
static void hang() {
  for (;;) {
  }
}

static void obey(char letter) {
  switch (letter) {
    case 'p': return set_pulses(1330, 1500);
    case 'r': return read_sonar();
    case 't': return write_sonar(81);
    case 'f': return free_bus();
    case 's': return use_stack();
    case 'e': return burn(7, 0x5a);
    case 'l': return digitalWrite(LED_BUILTIN, !digitalRead(LED_BUILTIN));
    case 'd': return delay(5);
    case 'w': return hang();
    case 'o': return be_deaf();
    case 'z': return die();
    case '?': Serial1.println(EECR & _BV(EEPE) ? F("busy") : F("ready")); return;
  }
  Serial1.write(letter);
}

void setup() {
  Serial.begin(57600);
  Serial1.begin(115200);
  Wire.begin();
  Wire.setWireTimeout(3000, true);
  start_pulses();
  Serial1.println(F("boot"));
  wdt_enable(WDTO_120MS);
}

void loop() {
  wdt_reset();
  if (Serial1.available()) obey(Serial1.read());
  if (Serial.available()) Serial.write(Serial.read());
}
