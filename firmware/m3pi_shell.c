#include "m3pi_shell.h"

#include <string.h>

#define BASE_RESET_MS 10
#define BASE_STARTS_MS 200 /* until the 3pi reads commands */
#define BYTES_A_STEP 256 /* so that a babbling radio cannot hold up the motors */

enum { M1_FORWARD = 0xC1, M2_FORWARD = 0xC5, BATTERY = 0xB1 }; /* backward is one more */

static void send(m3pi_shell *shell, m3pi_port port, const uint8_t *data, size_t length)
{
    shell->hal.write(shell->hal.context, port, data, length);
}

static void drive(m3pi_shell *shell, int8_t left, int8_t right, uint32_t now_ms)
{
    const uint8_t command[4] = {
        (uint8_t)(left < 0 ? M1_FORWARD + 1 : M1_FORWARD),
        (uint8_t)(left < 0 ? -left : left),
        (uint8_t)(right < 0 ? M2_FORWARD + 1 : M2_FORWARD),
        (uint8_t)(right < 0 ? -right : right),
    };
    send(shell, M3PI_BASE, command, sizeof command);
    shell->left = left;
    shell->right = right;
    shell->sent_ms = now_ms;
}

static void listen_to_base(m3pi_shell *shell)
{
    for (int i = 0; i < BYTES_A_STEP; i++) {
        const int byte = shell->hal.read(shell->hal.context, M3PI_BASE);
        if (byte < 0) {
            return;
        }
        if (shell->awaits_battery) {
            shell->answer[shell->answered++] = (uint8_t)byte;
            if (shell->answered == sizeof shell->answer) {
                shell->awaits_battery = false;
                m3pi_set_battery(&shell->core,
                                 (uint16_t)(shell->answer[0] | (unsigned)shell->answer[1] << 8));
            }
        }
    }
}

static void ask_battery(m3pi_shell *shell, uint32_t now_ms)
{
    const uint8_t query = BATTERY;
    if (shell->awaits_battery) {
        m3pi_set_battery(&shell->core, 0);
    }
    send(shell, M3PI_BASE, &query, 1);
    shell->awaits_battery = true;
    shell->answered = 0;
    shell->asked_ms = now_ms;
}

void m3pi_shell_start(m3pi_shell *shell, const m3pi_hal *hal, uint8_t index, uint32_t now_ms)
{
    memset(shell, 0, sizeof *shell);
    m3pi_init(&shell->core, index);
    shell->hal = *hal;
    drive(shell, 0, 0, now_ms);
    ask_battery(shell, now_ms);
}

void m3pi_shell_step(m3pi_shell *shell, uint32_t now_ms)
{
    uint8_t reply[M3PI_REPLY_SIZE];
    size_t size;
    int8_t left, right;

    for (int i = 0; i < BYTES_A_STEP; i++) {
        const int byte = shell->hal.read(shell->hal.context, M3PI_RADIO);
        if (byte < 0) {
            break;
        }
        (void)m3pi_push(&shell->core, (uint8_t)byte, now_ms);
    }
    m3pi_wheels(&shell->core, now_ms, &left, &right);
    if (left != shell->left || right != shell->right ||
        (uint32_t)(now_ms - shell->sent_ms) >= M3PI_REPEAT_MS) {
        drive(shell, left, right, now_ms);
    }
    listen_to_base(shell);
    if ((uint32_t)(now_ms - shell->asked_ms) >= M3PI_BATTERY_MS) {
        ask_battery(shell, now_ms);
    }
    size = m3pi_take_reply(&shell->core, now_ms, reply);
    if (size > 0) {
        send(shell, M3PI_RADIO, reply, size);
    }
}

void m3pi_shell_run(const m3pi_board *board, uint8_t index)
{
    static m3pi_shell shell;

    board->hold_base(true);
    board->wait_ms(BASE_RESET_MS);
    board->hold_base(false);
    board->wait_ms(BASE_STARTS_MS);
    board->open_ports(); /* only now: bytes that came earlier are too old */
    m3pi_shell_start(&shell, &board->ports, index, board->now_ms());
    if (board->was_reset_by_watchdog) {
        m3pi_emergency_stop(&shell.core);
    }
    board->start_watchdog(M3PI_WATCHDOG_MS);
    for (;;) {
        m3pi_shell_step(&shell, board->now_ms());
        board->feed_watchdog();
        board->wait_ms(1);
    }
}
