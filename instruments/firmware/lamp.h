// The lamp, its two relays, and the photodiode that tells whether it shines.
#ifndef LAMP_H
#define LAMP_H

#include "clock.h"

// All outputs off; the first thing that a boot does.
void lamp_outputs_off(void);

void lamp_start(void);
void lamp_watch(micros_t now);

// As after HELLO: off, main relay closed, default limits, no fault.
void lamp_ready(micros_t now);
void lamp_limits(uint32_t max_on_ms, uint32_t settle_ms, uint16_t threshold, micros_t now);

bool lamp_faulty(void);  // may not be switched on
void lamp_on(uint16_t keep_ms, micros_t now);
void lamp_off(micros_t now);
void lamp_keep(uint16_t keep_ms, micros_t now);

// Whether there is light now that the fault STUCK is about.
bool lamp_shines_wrongly(void);

// Parts of replies, into the line that is being written.
void lamp_say_state(void);  // ON or OFF
void lamp_say_since(void);
void lamp_say_why(void);
void lamp_say_status(micros_t now);

#endif
