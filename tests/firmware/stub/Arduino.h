// What the sketch uses of Arduino, for a compiler that has none.
#include <cstddef>
#include <cstdint>
struct SerialPort {
  void begin(long) {}
  int available() { return 0; }
  int read() { return 0; }
  void write(const uint8_t *, size_t) {}
};
static SerialPort Serial;
const int INPUT_PULLUP = 2, RISING = 3, A0 = 14;
inline void pinMode(int, int) {}
inline int digitalRead(int) { return 0; }
inline int analogRead(int) { return 0; }
inline int digitalPinToInterrupt(int pin) { return pin; }
inline void attachInterrupt(int, void (*)(), int) {}
inline void noInterrupts() {}
inline void interrupts() {}
inline unsigned long micros() { return 0; }
