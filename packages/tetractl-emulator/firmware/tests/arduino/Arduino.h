/* What field_driver.ino calls of Arduino; a test plays the board. */
#ifndef ARDUINO_H
#define ARDUINO_H

#include <stddef.h>
#include <stdint.h>

#define HIGH 1
#define LOW 0
#define OUTPUT 1
#define constrain(value, low, high) ((value) < (low) ? (low) : (value) > (high) ? (high) : (value))

uint32_t millis(void);
void delayMicroseconds(unsigned int us);
void pinMode(uint8_t pin, uint8_t mode);
void digitalWrite(uint8_t pin, uint8_t level);
void analogWrite(uint8_t pin, int duty);
void analogWriteFreq(uint32_t hz);
int analogRead(uint8_t pin);

struct SerialStub {
    void begin(unsigned long baud);
    int available();
    int read();
    size_t write(const uint8_t *data, size_t size);
};
extern SerialStub Serial;

struct Rp2040Stub {
    void wdt_begin(uint32_t ms);
    void wdt_reset();
};
extern Rp2040Stub rp2040;

#endif
