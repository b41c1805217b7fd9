/* The sketch on a board that this test plays: what the pins do for a frame, and after silence. */
#include "Arduino.h"

#define ARDUINO_ARCH_RP2040
#include "../field_driver/field_driver.ino"

#include <stdio.h>
#include <string.h>

static uint32_t clock_ms;
static uint8_t waiting[64], written[64], level[40];
static size_t first, last, answered;
static int duty[40], pulses, bites, failures;
SerialStub Serial;
Rp2040Stub rp2040;

uint32_t millis(void) { return clock_ms; }
void delayMicroseconds(unsigned int) {}
void pinMode(uint8_t, uint8_t) {}
void digitalWrite(uint8_t pin, uint8_t to) { pulses += pin == RELAY && to == HIGH; level[pin] = to; }
void analogWrite(uint8_t pin, int to) { duty[pin] = to; }
void analogWriteFreq(uint32_t) {}
int analogRead(uint8_t) { return 512; }
void SerialStub::begin(unsigned long) {}
int SerialStub::available() { return (int)(last - first); }
int SerialStub::read() { return waiting[first++]; }
size_t SerialStub::write(const uint8_t *data, size_t size) { memcpy(written, data, size); return answered = size; }
void Rp2040Stub::wdt_begin(uint32_t) {}
void Rp2040Stub::wdt_reset() { bites++; }

static void expect(bool holds, const char *what)
{
    if (!holds) {
        printf("FAILED: %s\n", what);
        failures++;
    }
}

static void run(uint32_t ms)
{
    for (const uint32_t end = clock_ms + ms; clock_ms < end; clock_ms++) {
        loop();
    }
}

int main()
{
    /* sequence 1, run and poll, x 1.5 A, y -0.75 A */
    const uint8_t command[] = {0x53, 1, FIELD_FLAG_RUN | FIELD_FLAG_POLL, 0xDC, 0x05, 0x12, 0xFD};

    setup();
    run(5);
    expect(duty[2] == 0 && duty[3] == 0, "no current at power-up");
    last = framing_seal(command, sizeof command, waiting);
    run(100);
#if defined(ELECTRODES)
    expect(duty[2] == 31 && duty[3] == 15, "1.5 V and 0.75 V of 12 V");
#else
    expect(duty[2] == 127 && duty[3] == 63, "6 V and 3 V of 12 V");
#endif
    expect(level[6] == LOW && level[7] == HIGH, "directions");
    expect(answered == FIELD_REPLY_SIZE, "a reply");
    run(300);
    expect(duty[2] == 0 && duty[3] == 0, "0 after silence");
    expect(pulses > 400 && pulses == bites, "a pulse and a kick each millisecond");
    printf("field_driver: %d failures\n", failures);
    return failures != 0;
}
