#include "board.h"

#include "m3pi_core.h"

#include <setjmp.h>
#include <stdio.h>
#include <string.h>

#define DRIVE_MS 1300u
#define POLL_MS 1700u
#define END_MS 2000u
#define LATE_MS 3u /* maximum time until the program reacts */

static const uint8_t drive[] = {9, 0x51, 7, 1, 3, 0x40, 0xC0, 0x7F, 0x7F, 1, 1, 2, 0x7D, 0};
static const uint8_t battery[] = {0x34, 0x12};
static const uint8_t forward[] = {0xC1, 64, 0xC6, 64}, still[] = {0xC1, 0, 0xC5, 0};

static struct {
    const uint8_t *waiting[2]; /* at each port */
    size_t left[2];
    uint8_t poll[16], answer[M3PI_REPLY_SIZE], command[4];
    size_t answered, commanded;
    uint32_t now, held, started, stopped, watchdog, fed, hungry;
    bool base_held, base_was_held, driving;
} board;
static int failures;
static jmp_buf outside; /* of the program, whose loop has no end */
bool board_was_reset_by_watchdog;

void board_check(bool ok, const char *what)
{
    if (!ok) {
        printf("%s is wrong\n", what);
        failures++;
    }
}

uint32_t board_now_ms(void) { return board.now; }

static void receive(int port, const uint8_t *bytes, size_t size)
{
    board.waiting[port] = bytes;
    board.left[port] = size;
}

static void pass_one(void)
{
    board.now++;
    board.held += board.base_held;
    if (board.now == DRIVE_MS) {
        receive(BOARD_RADIO, drive, sizeof drive);
    } else if (board.now == POLL_MS) {
        const uint8_t body[] = {0x51, 8, M3PI_FLAG_POLL, 0};
        receive(BOARD_RADIO, board.poll, framing_seal(body, sizeof body, board.poll));
    } else if (board.now == END_MS) {
        longjmp(outside, 1);
    }
}

void board_pass(uint32_t ms)
{
    while (ms-- > 0) {
        pass_one();
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

static void base_received(uint8_t byte)
{
    board_check(!board.base_held && board.base_was_held, "command to a 3pi in reset");
    if (board.commanded == 0 && byte == 0xB1) {
        receive(BOARD_BASE, battery, sizeof battery);
        return;
    }
    board.command[board.commanded++] = byte;
    if (board.commanded == sizeof board.command) {
        const bool drives = board.command[1] != 0;
        board_check(memcmp(board.command, drives ? forward : still, sizeof still) == 0, "command");
        board.started = drives && !board.driving ? board.now : board.started;
        board.stopped = !drives && board.driving ? board.now : board.stopped;
        board.driving = drives;
        board.commanded = 0;
    }
}

void board_write(int port, uint8_t byte)
{
    if (port == BOARD_BASE) {
        base_received(byte);
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
    board.watchdog = ms;
    board.fed = board.now;
}

void board_feed_watchdog(void)
{
    const uint32_t hungry = board.now - board.fed;
    board.hungry = hungry > board.hungry ? hungry : board.hungry;
    board.fed = board.now;
}

static bool is_soon_after(uint32_t ms, uint32_t cause_ms)
{
    return ms >= cause_ms && ms <= cause_ms + LATE_MS;
}

static void check_board(void)
{
    board_check(board.held >= 9 && board.held <= 12 && !board.base_held, "reset of the 3pi");
    board_check(board.watchdog == M3PI_WATCHDOG_MS, "time of the chip's watchdog");
    board_check(board.hungry <= LATE_MS && is_soon_after(END_MS, board.fed), "feeding of the watchdog");
    board_check(board.answered == M3PI_REPLY_SIZE && board.answer[1] == 0x52, "reply to a poll");
    if (board_was_reset_by_watchdog) {
        /* regression: the robot obeyed the next frame */
        board_check(board.started == 0, "start after a reset by the watchdog");
        board_check(board.answer[4] == M3PI_STATUS_EMERGENCY_STOPPED, "status after such a reset");
    } else {
        board_check(is_soon_after(board.started, DRIVE_MS), "start");
        board_check(is_soon_after(board.stopped, DRIVE_MS + M3PI_WATCHDOG_MS), "stop");
    }
}

static void run_to_the_end(int (*program)(void))
{
    if (setjmp(outside) == 0) {
        (void)program();
    }
}

int board_play(int (*program)(void), void (*reset_chip)(void), void (*check_chip)(void))
{
    for (int run = 0; run < 2; run++) {
        memset(&board, 0, sizeof board);
        board_was_reset_by_watchdog = run == 1;
        reset_chip();
        run_to_the_end(program);
        check_board();
        check_chip();
    }
    printf(failures > 0 ? "failed\n" : "passed\n");
    return failures > 0;
}
