/* The sketch on a board that this test plays, an Uno or one with an RP2040: what the pins do for a
 * frame, after silence, and after a reset by the chip's own watchdog. */
#include "Arduino.h"

#include "../field_driver/field_driver.ino"

#include <stdio.h>
#include <string.h>

static uint32_t clock_ms;
static uint8_t waiting[64], written[64], level[40];
static size_t first, last, answered;
static int duty[40], pulses, kicks, failures;
SerialStub Serial;

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

#if defined(ARDUINO_ARCH_RP2040)
static RP2040::resetReason_t reason = RP2040::PWRON_RESET;
RP2040 rp2040;
void RP2040::wdt_begin(uint32_t) {}
void RP2040::wdt_reset() { kicks++; }
RP2040::resetReason_t RP2040::getResetReason() { return reason; }

static void bite() { reason = RP2040::WDT_RESET; }
#else
struct Reset {};
uint8_t TCCR1B, WDTCSR;
void wdt_enable(uint8_t time)
{
    WDTCSR = 0;
    if (time == WDTO_15MS) {
        throw Reset();
    }
}
void wdt_reset() { kicks++; }

static void bite()
{
    if ((WDTCSR & _BV(WDIE)) == 0) {
        return; /* a reset without an interrupt before it */
    }
    try {
        WDT_vect();
    } catch (const Reset &) {
    }
}
#endif

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

/* Regression: after a reset by the chip's own watchdog the driver took up the next frame. */
static void test_reset_by_the_watchdog()
{
    first = 0; /* the same frame again */
    run(100);
    expect(duty[SPEED[0]] > 0, "current before the watchdog bites");
    bite();
#if !defined(ARDUINO_ARCH_RP2040)
    expect(duty[SPEED[0]] == 0 && duty[SPEED[1]] == 0, "no current while the reset is awaited");
#endif
    setup();
    answered = 0;
    first = 0;
    run(100);
    expect(duty[SPEED[0]] == 0 && duty[SPEED[1]] == 0, "no current after a reset by the watchdog");
    expect(answered == FIELD_REPLY_SIZE, "a reply after a reset by the watchdog");
    expect(written[3] == FIELD_STATUS_EMERGENCY_STOPPED, "latched by a reset by the watchdog");
}

int main()
{
    /* sequence 1, run and poll, x 1.5 A, y -0.75 A */
    const uint8_t command[] = {0x53, 1, FIELD_FLAG_RUN | FIELD_FLAG_POLL, 0xDC, 0x05, 0x12, 0xFD};

    setup();
    run(5);
    expect(duty[SPEED[0]] == 0 && duty[SPEED[1]] == 0, "no current at power-up");
    last = framing_seal(command, sizeof command, waiting);
    run(100);
#if defined(ELECTRODES)
    expect(duty[SPEED[0]] == 31 && duty[SPEED[1]] == 15, "1.5 V and 0.75 V of 12 V");
#else
    expect(duty[SPEED[0]] == 127 && duty[SPEED[1]] == 63, "6 V and 3 V of 12 V");
#endif
    expect(level[DIRECTION[0]] == LOW && level[DIRECTION[1]] == HIGH, "directions");
    expect(answered == FIELD_REPLY_SIZE, "a reply");
    run(300);
    expect(duty[SPEED[0]] == 0 && duty[SPEED[1]] == 0, "0 after silence");
    expect(pulses > 400 && pulses == kicks, "a pulse and a kick each millisecond");
    test_reset_by_the_watchdog();
    printf("field_driver: %d failures\n", failures);
    return failures != 0;
}
