/* Runs tests/twist_vectors.txt, read from standard input or a file, against twist_core: on this
 * computer, and built for a Cortex-M0+ under an emulator. */
#include "twist_core.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define LINE 1024

static size_t unescape(const char *text, char *out)
{
    size_t size = 0;
    while (*text != '\0' && *text != '\n') {
        if (text[0] != '\\') {
            out[size++] = *text++;
        } else if (text[1] == 'x') {
            const char digits[3] = {text[2], text[3], '\0'};
            out[size++] = (char)strtol(digits, NULL, 16);
            text += 4;
        } else {
            out[size++] = text[1] == 'n' ? '\n' : '\r';
            text += 2;
        }
    }
    return size;
}

int main(int argc, char **argv)
{
    static twist_core core;
    static char line[LINE], text[LINE], reply[TWIST_REPLY_MAX];
    int number = 0, checks = 0, failures = 0;
    FILE *file = argc > 1 ? fopen(argv[1], "r") : stdin;

    if (file == NULL) {
        printf("cannot read %s\n", argv[1]);
        return 2;
    }
    while (fgets(line, sizeof line, file) != NULL) {
        char *at = strchr(line, ' ');
        bool ok = true;
        number++;
        if (line[0] == '#' || at == NULL) {
            continue;
        }
        *at++ = '\0';
        const uint32_t first = (uint32_t)strtoul(at, &at, 10);
        at += *at == ' ';
        if (strcmp(line, "init") == 0 || strcmp(line, "boot") == 0) {
            twist_init(&core, (uint8_t)first, (uint16_t)strtoul(at, NULL, 10));
            if (line[0] == 'i') {
                (void)twist_status(&core, TWIST_FORGET_MS);
            }
        } else if (strcmp(line, "battery") == 0) {
            twist_set_battery(&core, (uint16_t)first);
        } else if (strcmp(line, "push") == 0) {
            const size_t size = unescape(at, text);
            for (size_t i = 0; i < size; i++) {
                (void)twist_push(&core, (uint8_t)text[i], first);
            }
        } else if (strcmp(line, "wheels") == 0) {
            int32_t left, right;
            twist_wheels(&core, first, &left, &right);
            const long wished = strtol(at, &at, 10);
            ok = left == wished && right == strtol(at, NULL, 10);
        } else if (strcmp(line, "status") == 0) {
            ok = twist_status(&core, first) == strtoul(at, NULL, 10);
        } else if (strcmp(line, "reply") == 0) {
            const size_t size = unescape(at, text);
            ok = twist_take_reply(&core, first, reply) == size && memcmp(reply, text, size) == 0;
        } else {
            ok = false;
        }
        checks += line[0] == 'w' || line[0] == 's' || line[0] == 'r';
        if (!ok) {
            printf("line %d: %s is wrong\n", number, line);
            failures++;
        }
    }
    printf("%d checks, %d failures\n", checks, failures);
    return failures > 0 || checks == 0;
}
