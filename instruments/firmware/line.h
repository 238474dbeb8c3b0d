// Lines: text, an asterisk, the checksum; see docs/rig-protocol.md.
#ifndef LINE_H
#define LINE_H

#include <avr/pgmspace.h>
#include <stdbool.h>
#include <stdint.h>

// Write a line piece by piece, and send it; false if there was no room, and nothing was sent.
void line_begin(void);
void line_text(const char *flash_text);  // text from PSTR()
void line_number(uint64_t number);
bool line_send(void);

#define line_say(text) line_text(PSTR(text))

// What line_begin and the pieces have made, to be sent again; `LINE_ROOM` bytes are enough for any.
#define LINE_ROOM 208
uint8_t line_copy(char *to);
bool line_send_copy(const char *from, uint8_t length);

// Read what has come in. LINE_TEXT: a whole line stands in `text`, without its checksum.
typedef enum { LINE_NONE, LINE_TEXT, LINE_GARBLED } line_state;
#define LINE_IN 61
line_state line_read(char *text);

#endif
