// Microseconds since boot, from timer 1.
#ifndef CLOCK_H
#define CLOCK_H

#include <stdbool.h>
#include <stdint.h>

#define MS 1000ULL

typedef uint64_t micros_t;

void clock_start(void);
micros_t clock_now(void);

// Whether the clock has moved on since the last call: a dead timer must not be mistaken for a quiet host.
bool clock_alive(void);

#endif
