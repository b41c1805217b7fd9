#include "framing.h"

#define CRC 2u
#define CRC_START 0xFFFFu

static uint16_t crc16(uint16_t crc, uint8_t byte)
{
    crc = (uint16_t)(crc ^ ((uint16_t)byte << 8));
    for (int bit = 0; bit < 8; bit++) {
        crc = (uint16_t)((crc & 0x8000u) ? ((uint32_t)crc << 1) ^ 0x1021u : (uint32_t)crc << 1);
    }
    return crc;
}

static void store(framing_reader *reader, uint8_t byte)
{
    if (reader->length < FRAMING_MAX) {
        reader->frame[reader->length++] = byte;
    } else {
        reader->overlong = true;
    }
}

static framing_event close_frame(framing_reader *reader)
{
    const uint8_t *frame = reader->frame;
    uint16_t crc = CRC_START;
    reader->closed = true;
    if (!reader->started) {
        return FRAMING_OPEN;
    }
    if (reader->code_left != 0 || reader->overlong || reader->length <= CRC) {
        return FRAMING_BAD;
    }
    reader->length = (uint8_t)(reader->length - CRC);
    for (size_t i = 0; i < reader->length; i++) {
        crc = crc16(crc, frame[i]);
    }
    frame += reader->length;
    return crc == (uint16_t)(frame[0] | (unsigned)frame[1] << 8) ? FRAMING_GOOD : FRAMING_BAD;
}

framing_event framing_push(framing_reader *reader, uint8_t byte)
{
    if (reader->closed) {
        reader->length = reader->code = reader->code_left = 0;
        reader->started = reader->overlong = reader->closed = false;
    }
    if (byte == 0) {
        return close_frame(reader);
    }
    if (reader->code_left == 0) {
        if (reader->started && reader->code < 255) {
            store(reader, 0); /* the 00 that the previous block stood for */
        }
        reader->started = true;
        reader->code = byte;
        reader->code_left = (uint8_t)(byte - 1u);
    } else {
        reader->code_left--;
        store(reader, byte);
    }
    return FRAMING_OPEN;
}

size_t framing_seal(const uint8_t *payload, size_t length, uint8_t *out)
{
    size_t block = 0; /* where the code of the open block goes */
    uint16_t crc = CRC_START;
    for (size_t i = 0; i < length; i++) {
        crc = crc16(crc, payload[i]);
    }
    for (size_t i = 0; i < length + CRC; i++) {
        if (i < length) {
            out[i + 1] = payload[i];
        } else {
            out[i + 1] = (uint8_t)(i == length ? crc & 0xFFu : crc >> 8);
        }
        if (out[i + 1] == 0) {
            out[block] = (uint8_t)(i + 1 - block);
            block = i + 1;
        }
    }
    out[block] = (uint8_t)(length + CRC + 1 - block);
    out[length + CRC + 1] = 0;
    return length + CRC + 2;
}
