#include "board.h"

#include "m3pi_core.h"

#include <setjmp.h>
#include <stdio.h>
#include <string.h>

#define DRIVE_MS 1300u /* time at which the radio receives a command to drive [ms] */
#define POLL_MS 1700u  /* time at which the radio receives a poll [ms] */
#define END_MS 2000u   /* time at which a run ends [ms] */
#define LATE_MS 3u     /* maximum time until the program reacts [ms] */

static const uint8_t drive_frame[] = {9, 0x51, 7, 1, 3, 0x40, 0xC0, 0x7F, 0x7F, 1, 1, 2, 0x7D, 0};
static const uint8_t battery_reply[] = {0x34, 0x12};
static const uint8_t forward_bytes[] = {0xC1, 64, 0xC6, 64}, still_bytes[] = {0xC1, 0, 0xC5, 0};

static struct {
    const uint8_t *waiting[2]; /* at each port */
    size_t left[2];
    uint8_t poll[16], answer[M3PI_REPLY_SIZE], command[4];
    size_t answered, commanded;
    uint32_t now_ms, held_ms, started_ms, stopped_ms; /* held_ms: time in reset of the 3pi */
    uint32_t watchdog_ms, fed_ms, unfed_max_ms;
    bool base_held, base_was_held, driving;
} board;
static int failures;
static jmp_buf program_end; /* leaves the program, whose loop has no end */
bool board_was_reset_by_watchdog;

void board_check(bool ok, const char *what)
{
    if (!ok) {
        printf("%s is wrong\n", what);
        failures++;
    }
}

uint32_t board_now_ms(void) { return board.now_ms; }

static void receive(int port, const uint8_t *bytes, size_t size)
{
    board.waiting[port] = bytes;
    board.left[port] = size;
}

static void advance_one_ms(void)
{
    board.now_ms++;
    board.held_ms += board.base_held;
    if (board.now_ms == DRIVE_MS) {
        receive(BOARD_RADIO, drive_frame, sizeof drive_frame);
    } else if (board.now_ms == POLL_MS) {
        const uint8_t body[] = {0x51, 8, M3PI_FLAG_POLL, 0};
        receive(BOARD_RADIO, board.poll, framing_seal(body, sizeof body, board.poll));
    } else if (board.now_ms == END_MS) {
        longjmp(program_end, 1);
    }
}

void board_pass(uint32_t ms)
{
    while (ms-- > 0) {
        advance_one_ms();
    }
}

bool board_has(int port) { return board.left[port] > 0; }

int board_read(int port)
{
    if (!board_has(port)) {
        return -1;
    }
    board.left[port]--;
    return *board.waiting[port]++;
}

static void receive_at_base(uint8_t byte)
{
    board_check(!board.base_held && board.base_was_held, "command to a 3pi in reset");
    if (board.commanded == 0 && byte == 0xB1) {
        receive(BOARD_BASE, battery_reply, sizeof battery_reply);
        return;
    }
    board.command[board.commanded++] = byte;
    if (board.commanded == sizeof board.command) {
        const bool drives = board.command[1] != 0;
        const uint8_t *expected = drives ? forward_bytes : still_bytes;
        board_check(memcmp(board.command, expected, sizeof still_bytes) == 0, "command");
        board.started_ms = drives && !board.driving ? board.now_ms : board.started_ms;
        board.stopped_ms = !drives && board.driving ? board.now_ms : board.stopped_ms;
        board.driving = drives;
        board.commanded = 0;
    }
}

void board_write(int port, uint8_t byte)
{
    if (port == BOARD_BASE) {
        receive_at_base(byte);
    } else if (board.answered < sizeof board.answer) {
        board.answer[board.answered++] = byte;
    }
}

void board_hold_base(bool held)
{
    board.base_held = held;
    board.base_was_held = board.base_was_held || held;
}

void board_start_watchdog(uint32_t ms)
{
    board.watchdog_ms = ms;
    board.fed_ms = board.now_ms;
}

void board_feed_watchdog(void)
{
    const uint32_t unfed_ms = board.now_ms - board.fed_ms;
    board.unfed_max_ms = unfed_ms > board.unfed_max_ms ? unfed_ms : board.unfed_max_ms;
    board.fed_ms = board.now_ms;
}

static bool is_soon_after(uint32_t ms, uint32_t cause_ms)
{
    return ms >= cause_ms && ms <= cause_ms + LATE_MS;
}

static void check_board(void)
{
    board_check(board.held_ms >= 9 && board.held_ms <= 12 && !board.base_held, "reset of the 3pi");
    board_check(board.watchdog_ms == M3PI_WATCHDOG_MS, "time of the chip's watchdog");
    board_check(
        board.unfed_max_ms <= LATE_MS && is_soon_after(END_MS, board.fed_ms),
        "feeding of the watchdog");
    board_check(board.answered == M3PI_REPLY_SIZE && board.answer[1] == 0x52, "reply to a poll");
    if (board_was_reset_by_watchdog) {
        /* regression: the robot obeyed the next frame */
        board_check(board.started_ms == 0, "start after a reset by the watchdog");
        board_check(board.answer[4] == M3PI_STATUS_EMERGENCY_STOPPED, "status after such a reset");
    } else {
        board_check(is_soon_after(board.started_ms, DRIVE_MS), "start");
        board_check(is_soon_after(board.stopped_ms, DRIVE_MS + M3PI_WATCHDOG_MS), "stop");
    }
}

static void run_until_end(int (*program)(void))
{
    if (setjmp(program_end) == 0) {
        (void)program();
    }
}

int board_play(int (*program)(void), void (*reset_chip)(void), void (*check_chip)(void))
{
    for (int run = 0; run < 2; run++) {
        memset(&board, 0, sizeof board);
        board_was_reset_by_watchdog = run == 1;
        reset_chip();
        run_until_end(program);
        check_board();
        check_chip();
    }
    printf(failures > 0 ? "failed\n" : "passed\n");
    return failures > 0;
}
