// LPC1768 in the m3pi's socket, Mbed OS 6. NOT TRIED ON HARDWARE: no robot was at hand. All that
// decides anything is in m3pi_core.c and m3pi_shell.c, which host tests run; here is only wiring.
//
// XBee on p28 (tx), p27 (rx), transparent mode at RADIO_BAUD; 3pi with the serial-slave program
// on p9 (tx), p10 (rx), its reset on p23. Build once per robot with -DROBOT_INDEX=0, 1, ...

#include "m3pi_shell.h"
#include "mbed.h"

#ifndef ROBOT_INDEX
#error "define ROBOT_INDEX: the robot's place in the spec, from 0"
#endif
#ifndef RADIO_BAUD
#define RADIO_BAUD 57600
#endif

static BufferedSerial radio(p28, p27, RADIO_BAUD);
static BufferedSerial base(p9, p10, 115200);
static DigitalOut base_reset(p23, 1);
static Timer timer;

static int read_one(BufferedSerial &port)
{
    uint8_t byte;
    return port.readable() && port.read(&byte, 1) == 1 ? byte : -1;
}

static int radio_read(void *) { return read_one(radio); }
static int base_read(void *) { return read_one(base); }
static void radio_write(void *, const uint8_t *data, size_t length) { radio.write(data, length); }
static void base_write(void *, const uint8_t *data, size_t length) { base.write(data, length); }

static uint32_t now_ms()
{
    using namespace std::chrono;
    return static_cast<uint32_t>(duration_cast<milliseconds>(timer.elapsed_time()).count());
}

int main()
{
    static m3pi_shell shell;
    const m3pi_hal hal = {nullptr, radio_read, radio_write, base_read, base_write};

    // Also after the chip's own watchdog has bitten: the 3pi would drive on by itself.
    base_reset = 0;
    thread_sleep_for(10);
    base_reset = 1;
    thread_sleep_for(200);

    timer.start();
    m3pi_shell_start(&shell, &hal, ROBOT_INDEX, now_ms());
    Watchdog::get_instance().start(M3PI_WATCHDOG_MS);
    for (;;) {
        m3pi_shell_step(&shell, now_ms());
        Watchdog::get_instance().kick();
        thread_sleep_for(1);
    }
}
