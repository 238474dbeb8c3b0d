#include "lamp.h"

#include <avr/pgmspace.h>

#include "alarm.h"
#include "board.h"
#include "line.h"

#define SAMPLES 20  // one a millisecond: a period of 50 Hz mains

typedef enum { WHY_BOOT, WHY_HOST, WHY_WATCHDOG, WHY_MAXON, WHY_FAULT } why_name;
typedef enum { FAULT_NONE, FAULT_STUCK, FAULT_DEAD } fault_name;

static const char why_names[][9] PROGMEM = {"BOOT", "HOST", "WATCHDOG", "MAXON", "FAULT"};

static bool on, greeted, lit;
static why_name why;
static fault_name fault;
static micros_t since, keep_until;
static micros_t agreed;  // when light and command last agreed, or changed
static micros_t max_on, settle;
static uint16_t threshold, light;

void lamp_outputs_off(void) {
    PORTB &= ~(_BV(LAMP_BIT) | _BV(SERVO_BIT));
    PORTD &= ~(_BV(MAIN_BIT) | _BV(ALARM_BIT));
    DDRB |= _BV(LAMP_BIT) | _BV(SERVO_BIT);
    DDRD |= _BV(MAIN_BIT) | _BV(ALARM_BIT);
}

static void limits_default(void) {
    max_on = 600000 * MS;
    settle = 1000 * MS;
    threshold = 300;
}

void lamp_start(void) {
    limits_default();
    ADMUX = _BV(REFS0) | LIGHT_CHANNEL;
    DIDR0 = _BV(LIGHT_CHANNEL);
    ADCSRA = _BV(ADEN) | _BV(ADSC) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0);  // 125 kHz
}

static void relay(bool closed) {
    if (closed)
        PORTB |= _BV(LAMP_BIT);
    else
        PORTB &= ~_BV(LAMP_BIT);
}

static void change(bool to, why_name reason, micros_t now) {
    relay(to);  // even if nothing changes: an upset port is put right
    if (to == on) return;
    on = to;
    why = reason;
    since = agreed = now;
}

void lamp_ready(micros_t now) {
    change(false, WHY_HOST, now);
    limits_default();
    fault = FAULT_NONE;
    agreed = now;
    greeted = true;
    PORTD |= _BV(MAIN_BIT);
}

void lamp_limits(uint32_t max_on_ms, uint32_t settle_ms, uint16_t lit_from, micros_t now) {
    max_on = max_on_ms * MS;
    settle = settle_ms * MS;
    threshold = lit_from;
    agreed = now;
}

bool lamp_faulty(void) { return fault != FAULT_NONE; }

void lamp_on(uint16_t keep_ms, micros_t now) {
    lamp_keep(keep_ms, now);
    change(true, WHY_HOST, now);
}

void lamp_off(micros_t now) { change(false, WHY_HOST, now); }

void lamp_keep(uint16_t keep_ms, micros_t now) { keep_until = now + keep_ms * MS; }

bool lamp_shines_wrongly(void) { return fault == FAULT_STUCK && lit; }

// Take one sample a millisecond; return whether `light` is new.
static bool sample(micros_t now) {
    static uint16_t samples[SAMPLES], sum;
    static uint8_t next;
    static micros_t due;
    if (now < due || (ADCSRA & _BV(ADSC))) return false;
    due = now + 1 * MS;
    sum += ADC - samples[next];
    samples[next] = ADC;
    next = next + 1 < SAMPLES ? next + 1 : 0;
    light = sum / SAMPLES;
    ADCSRA |= _BV(ADSC);
    return true;
}

static void watch_light(micros_t now) {
    if (!sample(now)) return;
    if (threshold == 0) {
        lit = false;
        return;
    }
    bool seen = light >= (lit ? threshold - threshold / 8 : threshold);
    if (seen != lit) {
        lit = seen;
        line_begin();
        line_say("EV ");
        line_number(now);
        line_text(lit ? PSTR(" LIGHT state=ON") : PSTR(" LIGHT state=OFF"));
        line_send();
    }
    if (lit == on || !greeted) {
        agreed = now;
    } else if (fault == FAULT_NONE && now - agreed >= settle) {
        fault = lit ? FAULT_STUCK : FAULT_DEAD;
        change(false, WHY_FAULT, now);
        PORTD &= ~_BV(MAIN_BIT);
        alarm_raise(ALARM_LAMPFAULT, lit ? PSTR(" verdict=STUCK") : PSTR(" verdict=DEAD"), now);
    }
}

void lamp_watch(micros_t now) {
    if (on && now - since >= max_on) {
        change(false, WHY_MAXON, now);
        alarm_raise(ALARM_MAXON, PSTR(""), now);
    } else if (on && now >= keep_until) {
        change(false, WHY_WATCHDOG, now);
        alarm_raise(ALARM_WATCHDOG, PSTR(""), now);
    }
    watch_light(now);
}

void lamp_say_state(void) { line_text(on ? PSTR("ON") : PSTR("OFF")); }

void lamp_say_since(void) { line_number(since); }

void lamp_say_why(void) { line_text(why_names[why]); }

static void say_verdict(void) {
    if (threshold == 0)
        line_say("NONE");
    else if (fault != FAULT_NONE)
        line_text(fault == FAULT_STUCK ? PSTR("STUCK") : PSTR("DEAD"));
    else
        line_text(lit == on ? PSTR("OK") : PSTR("WAIT"));
}

static void say_left(micros_t until, micros_t now) { line_number(on && until > now ? (until - now) / MS : 0); }

void lamp_say_status(micros_t now) {
    line_say("lamp=");
    lamp_say_state();
    line_say(" since=");
    lamp_say_since();
    line_say(" why=");
    lamp_say_why();
    line_say(" left_ms=");
    say_left(since + max_on, now);
    line_say(" keep_ms=");
    say_left(keep_until, now);
    line_say(" light=");
    line_number(light);
    line_say(" verdict=");
    say_verdict();
}
