// The serial line, with a ring of bytes each way.
#ifndef UART_H
#define UART_H

#include <stdbool.h>
#include <stdint.h>

void uart_start(void);

// Take the next byte that has come in; false if there is none.
bool uart_take(char *byte);

// Send `length` bytes, all or, if there is no room, none.
bool uart_send(const char *bytes, uint8_t length);

#endif
