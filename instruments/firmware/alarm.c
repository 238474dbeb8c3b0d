#include "alarm.h"

#include <avr/pgmspace.h>
#include <string.h>

#include "board.h"
#include "lamp.h"
#include "line.h"

#define REPEAT (1000 * MS)

static const char names[ALARMS][12] PROGMEM = {"WATCHDOG", "MAXON", "LAMPFAULT", "DOORSTUCK"};

static struct {
    bool standing;
    const char *detail;
    micros_t at, said;
} alarms[ALARMS];

static void say(alarm_name alarm) {
    line_begin();
    line_say("EV ");
    line_number(alarms[alarm].at);
    line_say(" ");
    line_text(names[alarm]);
    line_text(alarms[alarm].detail);
    line_send();  // without room it comes a second later
}

void alarm_raise(alarm_name alarm, const char *detail, micros_t now) {
    alarms[alarm].standing = true;
    alarms[alarm].detail = detail;
    alarms[alarm].at = alarms[alarm].said = now;
    say(alarm);
}

void alarm_watch(micros_t now) {
    bool sound = lamp_shines_wrongly();
    for (uint8_t i = 0; i < ALARMS; i++) {
        if (!alarms[i].standing) continue;
        sound = true;
        if (now - alarms[i].said >= REPEAT) {
            alarms[i].said = now;
            say(i);
        }
    }
    if (sound)
        PORTD |= _BV(ALARM_BIT);
    else
        PORTD &= ~_BV(ALARM_BIT);
}

void alarm_forget_all(void) { memset(alarms, 0, sizeof alarms); }

bool alarm_acknowledge(const char *name) {
    for (uint8_t i = 0; i < ALARMS; i++)
        if (strcmp_P(name, names[i]) == 0) {
            alarms[i].standing = false;
            return true;
        }
    return false;
}

void alarm_list(void) {
    bool any = false;
    for (uint8_t i = 0; i < ALARMS; i++) {
        if (!alarms[i].standing) continue;
        if (any) line_say(",");
        line_text(names[i]);
        any = true;
    }
    if (!any) line_say("-");
}
