// A differential drive with two quadrature encoders that speaks `trigpoint` over USB (docs/reference/serial.md).
// Copy trigpoint_serial.h beside this file. Written for boards with two interrupt pins and some
// 4 kB of memory (ESP32, Teensy, SAMD, Mega 2560).

#define TRIGPOINT_IMPLEMENTATION
#define TRIGPOINT_HISTORY 32
#include "trigpoint_serial.h"

const int LEFT_A = 2, LEFT_B = 4, RIGHT_A = 3, RIGHT_B = 5;
const unsigned long PERIOD_US = 20000;  // 50 readings a second

// Wheels of 100 mm with 1000 counts a turn, 300 mm apart: put your own numbers here.
const trigpoint_wheels WHEELS = {0.000314159f, 0.000314159f, 0.3f, 32};

volatile uint32_t leftCount, rightCount;
trigpoint bridge;
uint32_t lastReading;

void countLeft() { digitalRead(LEFT_B) ? leftCount-- : leftCount++; }
void countRight() { digitalRead(RIGHT_B) ? rightCount++ : rightCount--; }

// micros() wraps after 71 minutes; the protocol's clock never does.
uint64_t now() {
  static uint32_t last;
  static uint64_t high;
  uint32_t low = micros();
  if (low < last) high += 1ull << 32;
  last = low;
  return (high + low) * 1000ull;
}

void writeSerial(void *, const uint8_t *data, size_t size) { Serial.write(data, size); }

enum trigpoint_result corrected(void *, const trigpoint_correction *correction) {
  if (correction->establishes) {
    // The robot may be metres from where it thought: stop the motors, and plan anew.
  }
  return TRIGPOINT_ACCEPTED;
}

void setup() {
  Serial.begin(115200);
  for (int pin = LEFT_A; pin <= RIGHT_B; pin++) pinMode(pin, INPUT_PULLUP);
  attachInterrupt(digitalPinToInterrupt(LEFT_A), countLeft, RISING);
  attachInterrupt(digitalPinToInterrupt(RIGHT_A), countRight, RISING);
  // A number that differs at each start: noise of an open pin and the time until here.
  uint32_t boot = micros();
  for (int i = 0; i < 32; i++) boot = boot * 31u + analogRead(A0);
  trigpoint_config config = {writeSerial, corrected, nullptr, "r1", "rover 1.0", boot};
  trigpoint_begin(&bridge, &config);
}

void loop() {
  while (Serial.available()) trigpoint_receive(&bridge, (uint8_t)Serial.read(), now());
  trigpoint_poll(&bridge, now());
  if (micros() - lastReading >= PERIOD_US) {
    lastReading += PERIOD_US;
    noInterrupts();
    uint32_t left = leftCount, right = rightCount;
    interrupts();
    trigpoint_ticks(&bridge, now(), left, right, &WHEELS);
  }
}
