#include "uart.h"

#include <avr/interrupt.h>
#include <avr/io.h>

// Sizes are 256, so that an index of 8 bits wraps by itself.
static char received[256], waiting[256];
static volatile uint8_t received_head, received_tail, waiting_head, waiting_tail;

ISR(USART_RX_vect) {
    bool broken = UCSR0A & (_BV(FE0) | _BV(DOR0));
    char byte = UDR0;
    if ((uint8_t)(received_head + 1) == received_tail) return;  // full: the checksum will tell
    received[received_head++] = broken ? '\xFF' : byte;
}

ISR(USART_UDRE_vect) {
    if (waiting_head == waiting_tail)
        UCSR0B &= ~_BV(UDRIE0);
    else
        UDR0 = waiting[waiting_tail++];
}

void uart_start(void) {
    UBRR0 = 16;  // 117647 baud, as every Arduino that calls it 115200; 2.1 % off, within the 8N1 limit
    UCSR0A = _BV(U2X0);
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
}

bool uart_take(char *byte) {
    if (received_head == received_tail) return false;
    *byte = received[received_tail++];
    return true;
}

bool uart_send(const char *bytes, uint8_t length) {
    uint8_t room = waiting_tail - waiting_head - 1;
    if (length > room) return false;
    uint8_t head = waiting_head;
    while (length--) waiting[head++] = *bytes++;
    waiting_head = head;
    UCSR0B |= _BV(UDRIE0);
    return true;
}
