/* The current driver of two coils, or the voltage driver of two pairs of electrodes, on an Arduino
 * Uno or an RP2040 board (Arduino IDE, with Earle Philhower's core for RP2040). NOT TRIED ON
 * HARDWARE. Copy field_core.c, .h, framing.c and .h into this folder.
 *
 * Each axis has an H-bridge with two inputs, speed (PWM) and direction; its enable input needs a
 * resistor to ground. RELAY gets a pulse each millisecond: it holds the power stage on by a relay
 * that drops without pulses (a retriggerable monostable, or a charge pump at its gate), for a PWM
 * output holds its last value when a program hangs.
 *
 * Coils: OHMS and SUPPLY_MV say which duty makes which current, before they warm up; with a current
 * sensor at SENSE_PIN, SENSE_MV_A is not 0 and the rest is regulated. Electrodes: define ELECTRODES;
 * a set point of 1 mA in a frame is then 1 mV between a pair.
 *
 * On an Uno a capacitor of 10 uF from RESET to ground keeps a program that opens the port from
 * restarting it, which would end an emergency stop.
 *
 * After a reset by the chip's own watchdog the driver begins emergency-stopped, until it is switched
 * off and on.
 */
#include "field_core.h"

#define RELAY 4
#define SUPPLY_MV 12000L
#define OHMS 4L         /* of a coil pair; without meaning for electrodes */
#define SENSE_MV_A 0L   /* of a current sensor whose zero is half of the ADC's range; 0: none */
#define CURRENT_MAX_MA 2000
#define SLEW_MA_S 100000UL

#if defined(ARDUINO_ARCH_RP2040)
static const uint8_t SPEED[2] = {2, 3}, DIRECTION[2] = {6, 7}, SENSE_PIN[2] = {26, 27};
#define ADC_MV 3300L
#else
#include <avr/wdt.h>
static const uint8_t SPEED[2] = {9, 10}, DIRECTION[2] = {7, 8}, SENSE_PIN[2] = {A0, A1};
#define ADC_MV 5000L
#endif

#define DUTY_MAX 255L
static field_core core;
static uint32_t last_ms;

static void start_hardware(void)
{
#if defined(ARDUINO_ARCH_RP2040)
    analogWriteFreq(20000);
    rp2040.wdt_begin(FIELD_WATCHDOG_MS);
#else
    TCCR1B = (TCCR1B & 0xF8) | 1; /* 31 kHz on pins 9 and 10 */
    wdt_enable(WDTO_250MS);
    WDTCSR |= _BV(WDIE); /* first the interrupt, then the reset */
#endif
}

#if defined(ARDUINO_ARCH_RP2040)
static bool was_bitten(void) { return rp2040.getResetReason() == RP2040::WDT_RESET; }
#else
/* An Uno's bootloader clears the register that tells why the chip was reset. So the watchdog's
 * interrupt, which comes before its reset, leaves a mark in memory that a reset keeps and a power-up
 * fills at random. A program that hangs with interrupts off is reset without the mark. */
#define BITTEN 0x5AC39617UL /* any number that a power-up is unlikely to make */
static volatile uint32_t mark __attribute__((section(".noinit")));

ISR(WDT_vect)
{
    analogWrite(SPEED[0], 0);
    analogWrite(SPEED[1], 0);
    mark = BITTEN;
    wdt_enable(WDTO_15MS);
    for (;;) { /* until the reset */
    }
}

static bool was_bitten(void) { return mark == BITTEN; }
#endif

static void alive(void)
{
#if defined(ARDUINO_ARCH_RP2040)
    rp2040.wdt_reset();
#else
    wdt_reset();
#endif
    digitalWrite(RELAY, HIGH);
    delayMicroseconds(20);
    digitalWrite(RELAY, LOW);
}

#if !defined(ELECTRODES)
static int32_t trim_uv[2]; /* what regulation adds to the voltage */
#endif

/* Returns the current [mA], as measured or else as set. */
static int16_t drive(uint8_t axis, int32_t wished_ua)
{
    int32_t measured_ma = wished_ua / 1000;
#if defined(ELECTRODES)
    int32_t uv = wished_ua;
#else
    int32_t uv = wished_ua * OHMS; /* 2 A at 4 ohms: 8e6 */
    if (SENSE_MV_A != 0) {
        const int32_t seen_mv = analogRead(SENSE_PIN[axis]) * ADC_MV / 1023 - ADC_MV / 2;
        measured_ma = seen_mv * 1000 / (SENSE_MV_A + !SENSE_MV_A);
        trim_uv[axis] += (wished_ua / 1000 - measured_ma) * 20;
        trim_uv[axis] = constrain(trim_uv[axis], -SUPPLY_MV * 250, SUPPLY_MV * 250);
        if (wished_ua == 0) {
            trim_uv[axis] = 0;
        }
        uv += trim_uv[axis];
    }
#endif
    const int32_t duty = constrain(uv / 1000 * DUTY_MAX / SUPPLY_MV, -DUTY_MAX, DUTY_MAX);
    digitalWrite(DIRECTION[axis], duty < 0 ? HIGH : LOW);
    analogWrite(SPEED[axis], (int)(duty < 0 ? -duty : duty));
    return (int16_t)measured_ma;
}

void setup()
{
    const field_limits limits = {CURRENT_MAX_MA, SLEW_MA_S, FIELD_WATCHDOG_MS, 700};
    for (uint8_t axis = 0; axis < 2; axis++) {
        pinMode(SPEED[axis], OUTPUT);
        pinMode(DIRECTION[axis], OUTPUT);
    }
    pinMode(RELAY, OUTPUT);
    Serial.begin(115200);
    start_hardware();
    last_ms = millis();
    field_init(&core, &limits, last_ms);
    if (was_bitten()) {
        field_emergency_stop(&core);
    }
}

void loop()
{
    const uint32_t now_ms = millis();
    uint8_t reply[FIELD_REPLY_SIZE];
    int32_t x_ua, y_ua;

    while (Serial.available() > 0) {
        field_push(&core, (uint8_t)Serial.read(), now_ms);
    }
    if (now_ms != last_ms) {
        last_ms = now_ms;
        field_currents(&core, now_ms, &x_ua, &y_ua);
        const int16_t x_ma = drive(0, x_ua), y_ma = drive(1, y_ua);
        field_measured(&core, x_ma, y_ma, SUPPLY_MV, FIELD_TEMPERATURE_UNKNOWN);
        alive();
    }
    const size_t size = field_take_reply(&core, now_ms, reply);
    if (size > 0) {
        Serial.write(reply, size);
    }
}
