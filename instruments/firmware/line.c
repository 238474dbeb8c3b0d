#include "line.h"

#include <string.h>
#include <util/crc16.h>

#include "uart.h"

static char out[LINE_ROOM];
static uint8_t out_length;

void line_begin(void) { out_length = 0; }

static void put(char character) {
    if (out_length < LINE_ROOM - 6) out[out_length++] = character;
}

void line_text(const char *flash_text) {
    char character;
    while ((character = pgm_read_byte(flash_text++))) put(character);
}

void line_number(uint64_t number) {
    char digits[20];
    uint8_t length = 0;
    // 64-bit division is slow here; few numbers need it.
    while (number > 0xFFFFFFFF) {
        digits[length++] = '0' + number % 10;
        number /= 10;
    }
    uint32_t rest = number;
    do {
        digits[length++] = '0' + rest % 10;
        rest /= 10;
    } while (rest);
    while (length) put(digits[--length]);
}

static uint16_t crc(const char *text, uint8_t length) {
    uint16_t sum = 0xFFFF;
    while (length--) sum = _crc_xmodem_update(sum, *text++);
    return sum;
}

static char hex(uint8_t nibble) { return nibble < 10 ? '0' + nibble : 'A' + nibble - 10; }

static void hex4(char *to, uint16_t value) {
    for (int8_t shift = 12; shift >= 0; shift -= 4) *to++ = hex((value >> shift) & 15);
}

bool line_send(void) {
    uint16_t sum = crc(out, out_length);
    out[out_length++] = '*';
    hex4(out + out_length, sum);
    out_length += 4;
    out[out_length++] = '\n';
    return uart_send(out, out_length);
}

uint8_t line_copy(char *to) {
    memcpy(to, out, out_length);
    return out_length;
}

bool line_send_copy(const char *from, uint8_t length) { return uart_send(from, length); }

static bool checks(char *line, uint8_t length) {
    char digits[4];
    if (length < 6 || line[length - 5] != '*') return false;
    for (uint8_t i = 0; i < length - 5; i++)
        if (line[i] < 0x20 || line[i] > 0x7E || line[i] == '*') return false;
    hex4(digits, crc(line, length - 5));
    return memcmp(digits, line + length - 4, 4) == 0;
}

line_state line_read(char *text) {
    static char in[LINE_IN];
    static uint8_t length;
    static bool too_long;
    char byte;
    while (uart_take(&byte)) {
        if (byte == '\r') continue;
        if (byte != '\n') {
            if (length < LINE_IN - 1)
                in[length++] = byte;
            else
                too_long = true;
            continue;
        }
        if (length == 0) continue;
        bool good = !too_long && checks(in, length);
        if (good) {
            memcpy(text, in, length - 5);
            text[length - 5] = 0;
        }
        length = 0;
        too_long = false;
        return good ? LINE_TEXT : LINE_GARBLED;
    }
    return LINE_NONE;
}
