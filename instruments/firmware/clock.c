#include "clock.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/atomic.h>

#include "board.h"

// 16 MHz / 8: half a microsecond a tick, 32.768 ms a turn of the 16-bit timer; 32 bits of turns last four years.
static volatile uint32_t overflows = FIRST_OVERFLOW;

ISR(TIMER1_OVF_vect) { overflows++; }

void clock_start(void) {
    TCCR1A = 0;
    TCCR1B = _BV(CS11);
    TIMSK1 |= _BV(TOIE1);
}

micros_t clock_now(void) {
    uint32_t turns;
    uint16_t ticks;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        turns = overflows;
        ticks = TCNT1;
        // The timer may have turned over with its interrupt still waiting.
        if ((TIFR1 & _BV(TOV1)) && ticks < 0x8000) turns++;
    }
    return ((micros_t)turns << 15) | (ticks >> 1);
}

bool clock_alive(void) {
    static uint32_t seen = 0xFFFFFFFF;
    uint32_t turns;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { turns = overflows; }
    if (turns == seen) return false;
    seen = turns;
    return true;
}
