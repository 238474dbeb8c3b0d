#include "door.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/pgmspace.h>
#include <util/atomic.h>

#include "alarm.h"
#include "board.h"
#include "line.h"

#define ARRIVES_WITHIN (3000 * MS)
#define HOLD (200 * MS)    // a servo that pushes for ever hums, and shakes the camera
#define DEBOUNCE (5 * MS)
#define FRAME_TICKS 40000  // 20 ms from pulse to pulse, in timer ticks of half a microsecond

typedef enum { PLACE_BETWEEN, PLACE_OPEN, PLACE_CLOSED, PLACE_BOTH } place_name;

static const char place_names[][8] PROGMEM = {"BETWEEN", "OPEN", "CLOSED", "BOTH"};
static const char drive_names[][6] PROGMEM = {"IDLE", "OPEN", "CLOSE", "STUCK"};

static place_name place, seen;
static micros_t place_at, seen_at;
static drive_name drive;
static micros_t pushes_until;
static bool pushes;

// The timer itself sets and clears the pin, so that no interrupt makes a pulse longer.
static volatile uint16_t pulse_ticks;  // 0: no more pulses
static volatile bool rising;

#define SET_ON_MATCH (_BV(COM1A1) | _BV(COM1A0))
#define CLEAR_ON_MATCH _BV(COM1A1)

ISR(TIMER1_COMPA_vect) {
    static uint16_t ticks;
    if (rising) {
        if (pulse_ticks) ticks = pulse_ticks;  // else: told to stop too late, and the last pulse is as the others
        TCCR1A = CLEAR_ON_MATCH;
        OCR1A += ticks;
    } else if (pulse_ticks) {
        TCCR1A = SET_ON_MATCH;
        OCR1A += FRAME_TICKS - ticks;
    } else {
        TCCR1A = 0;
        TIMSK1 &= ~_BV(OCIE1A);
        return;
    }
    rising = !rising;
}

static void push(uint16_t pulse_us) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        pulse_ticks = 2 * pulse_us;
        if (!(TIMSK1 & _BV(OCIE1A))) {
            rising = true;
            OCR1A = TCNT1 + 200;
            TCCR1A = SET_ON_MATCH;
            TIFR1 = _BV(OCF1A);
            TIMSK1 |= _BV(OCIE1A);
        }
    }
    pushes = true;
}

static void let_go(void) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { pulse_ticks = 0; }
    pushes = false;
}

static place_name look(void) {
    bool open = !(PIND & _BV(OPEN_BIT)), closed = !(PIND & _BV(CLOSED_BIT));
    return open ? (closed ? PLACE_BOTH : PLACE_OPEN) : (closed ? PLACE_CLOSED : PLACE_BETWEEN);
}

void door_start(void) {
    PORTD |= _BV(OPEN_BIT) | _BV(CLOSED_BIT);  // pull-ups
    for (volatile uint8_t i = 0; i < 100; i++)
        ;  // until they have pulled
    place = seen = look();
}

static void arrive(micros_t now) {
    if ((drive == DRIVE_OPEN && place == PLACE_OPEN) || (drive == DRIVE_CLOSE && place == PLACE_CLOSED)) {
        drive = DRIVE_IDLE;
        pushes_until = now + HOLD;
    }
}

void door_watch(micros_t now) {
    place_name sees = look();
    if (sees != seen) {
        seen = sees;
        seen_at = now;
    }
    if (seen != place && now - seen_at >= DEBOUNCE) {
        place = seen;
        place_at = seen_at;
        line_begin();
        line_say("EV ");
        line_number(place_at);
        line_say(" DOOR state=");
        door_say_place();
        line_send();
    }
    arrive(now);
    if (pushes && now >= pushes_until) {
        let_go();
        if (drive != DRIVE_IDLE) {
            alarm_raise(ALARM_DOORSTUCK, drive == DRIVE_OPEN ? PSTR(" to=OPEN") : PSTR(" to=CLOSE"), now);
            drive = DRIVE_STUCK;
        }
    }
}

void door_drive(drive_name to, micros_t now) {
    drive = to;
    pushes_until = now + ARRIVES_WITHIN;
    push(to == DRIVE_OPEN ? SERVO_OPEN_US : SERVO_CLOSED_US);
    arrive(now);
}

void door_stop(void) {
    drive = DRIVE_IDLE;
    let_go();
}

void door_say_place(void) { line_text(place_names[place]); }

void door_say_drive(void) { line_text(drive_names[drive]); }

void door_say_status(void) {
    line_say("door=");
    door_say_place();
    line_say(" door_us=");
    line_number(place_at);
    line_say(" drive=");
    door_say_drive();
}
