/* Prints what the m3pi's core does with random packets: good, old, damaged, cut off, foreign, and
 * noise, with and without silence between them. Every processor has to print the same. */
#include "m3pi_core.h"

#include <stdio.h>

#define PACKETS 10000
#define ROBOTS 4u

static uint32_t state = 98;

static uint32_t below(uint32_t limit)
{
    state = state * 1664525u + 1013904223u;
    return (state >> 16) % limit;
}

static size_t make(uint8_t *packet, uint8_t sequence)
{
    uint8_t body[4 + 2 * ROBOTS] = {below(20) ? 0x51 : 0x52, sequence};
    const uint8_t flags[] = {0, 1, 1, 1, 1, 4, 5, 8}, robots = (uint8_t)below(ROBOTS + 1);
    size_t size = 4;

    body[2] = below(200) ? flags[below(8)] : M3PI_FLAG_EMERGENCY_STOP;
    body[3] = robots;
    for (uint8_t i = 0; i < 2 * robots; i++) {
        body[size++] = (uint8_t)below(256);
    }
    size = framing_seal(body, size, packet);
    if (below(10) == 0) {
        packet[below((uint32_t)size)] ^= (uint8_t)(1u << below(8));
    }
    return below(20) ? size : below((uint32_t)size);
}

int main(void)
{
    static m3pi_core core;
    uint8_t packet[32], reply[M3PI_REPLY_SIZE], sequence = 0;
    uint32_t now = UINT32_MAX - 100000u; /* the clock wraps round on the way */

    m3pi_init(&core, 0);
    for (int n = 0; n < PACKETS; n++) {
        int8_t left, right;
        size_t size;

        now += below(12) ? below(60) : below(600);
        sequence = (uint8_t)(sequence + (below(6) ? 1u : below(256)));
        size = make(packet, sequence);
        printf("%d %lu:", n, (unsigned long)now);
        for (size_t i = 0; i < size; i++) {
            const m3pi_event event = m3pi_push(&core, packet[i], now);
            if (event != M3PI_NOTHING) {
                printf(" %d", event);
            }
        }
        m3pi_wheels(&core, now, &left, &right);
        printf(" | %d %d | %d |", left, right, m3pi_status(&core, now));
        size = m3pi_take_reply(&core, now, reply);
        for (size_t i = 0; i < size; i++) {
            printf(" %02x", reply[i]);
        }
        printf("\n");
        if (m3pi_status(&core, now) & M3PI_STATUS_EMERGENCY_STOPPED && below(10) == 0) {
            m3pi_init(&core, (uint8_t)below(ROBOTS)); /* switched off and on */
            m3pi_set_battery(&core, (uint16_t)below(6000));
        }
    }
    return 0;
}
