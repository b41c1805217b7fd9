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

#if defined(ARDUINO_ARCH_RP2040)
struct RP2040 {
    enum resetReason_t { PWRON_RESET, WDT_RESET };
    void wdt_begin(uint32_t ms);
    void wdt_reset();
    resetReason_t getResetReason();
};
extern RP2040 rp2040;
#else
#define A0 14
#define A1 15
#define WDIE 6
#define _BV(bit) (1 << (bit))
#define ISR(vector) extern "C" void vector()
extern uint8_t TCCR1B, WDTCSR;
#endif

#endif
