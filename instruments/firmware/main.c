// The rig controller: start, the main loop, and the host's commands. docs/rig-protocol.md says what they do.
#include <avr/eeprom.h>
#include <avr/interrupt.h>
#include <avr/pgmspace.h>
#include <avr/wdt.h>
#include <stdlib.h>
#include <string.h>

#include "alarm.h"
#include "board.h"
#include "clock.h"
#include "door.h"
#include "lamp.h"
#include "line.h"
#include "uart.h"

#define STRING_(x) #x
#define STRING(x) STRING_(x)

static uint8_t reset_flags __attribute__((section(".noinit")));
static uint32_t EEMEM boots_kept;
static uint32_t boots;
static bool greeted;

// Before main, before memory is set up: everything off, and the watchdog too (it may still run after a reset by it).
void before_all(void) __attribute__((naked, used, section(".init3")));
void before_all(void) {
    lamp_outputs_off();
    reset_flags = MCUSR;
    MCUSR = 0;
    wdt_disable();
}

static void say_about(void) {
    line_say("protocol=" STRING(PROTOCOL) " firmware=" FIRMWARE " boot=");
    line_number(boots);
    // Power-up sets other flags as well; optiboot leaves the reset line's beside the watchdog's, by which it starts us.
    line_text(reset_flags & _BV(PORF)    ? PSTR(" reset=POWER")
              : reset_flags & _BV(EXTRF) ? PSTR(" reset=EXTERNAL")
              : reset_flags & _BV(BORF)  ? PSTR(" reset=BROWNOUT")
              : reset_flags & _BV(WDRF)  ? PSTR(" reset=WATCHDOG")
                                         : PSTR(" reset=UNKNOWN"));
}

// --- commands -----------------------------------------------------------------------------------

typedef enum { DONE, ERR_GARBLED, ERR_HELLO, ERR_VERSION, ERR_COMMAND, ERR_ARGUMENT, ERR_RANGE, ERR_FAULT } result;

static const char error_names[][9] PROGMEM = {"",        "GARBLED",  "HELLO", "VERSION",
                                              "COMMAND", "ARGUMENT", "RANGE", "FAULT"};

#define MOST_WORDS 6
static char *words[MOST_WORDS + 1];
static uint8_t n_words;

static void split(char *text) {
    n_words = 0;
    for (char *word = strtok_r(text, " ", &text); word && n_words <= MOST_WORDS; word = strtok_r(NULL, " ", &text))
        words[n_words++] = word;
}

static result number(const char *word, uint32_t lowest, uint32_t highest, uint32_t *value) {
    uint8_t length = strlen(word);
    if (strspn_P(word, PSTR("0123456789")) != length) return ERR_ARGUMENT;
    if (length > 9) return ERR_RANGE;
    *value = strtoul(word, NULL, 10);
    return *value < lowest || *value > highest ? ERR_RANGE : DONE;
}

static void begin(result outcome, uint16_t id, micros_t now) {
    line_begin();
    line_text(outcome == DONE ? PSTR("OK ") : PSTR("ERR "));
    line_number(id);
    line_say(" ");
    line_number(now);
    line_say(" ");
    line_text(error_names[outcome]);
}

static result hello(uint16_t id, micros_t now) {
    if (n_words != 3) return ERR_ARGUMENT;
    if (strcmp_P(words[2], PSTR(STRING(PROTOCOL)))) return ERR_VERSION;
    lamp_ready(now);
    door_stop();
    alarm_forget_all();
    greeted = true;
    begin(DONE, id, now);
    say_about();
    line_say(" max_on_ms=");
    line_number(MAX_ON_MS);
    return DONE;
}

static result limits(uint16_t id, micros_t now) {
    uint32_t max_on, settle, threshold;
    result outcome;
    if (n_words != 5) return ERR_ARGUMENT;
    if ((outcome = number(words[2], 1, MAX_ON_MS, &max_on))) return outcome;
    if ((outcome = number(words[3], 50, 60000, &settle))) return outcome;
    if ((outcome = number(words[4], 0, 1000, &threshold))) return outcome;
    lamp_limits(max_on, settle, threshold, now);
    begin(DONE, id, now);
    line_say("max_on_ms=");
    line_number(max_on);
    line_say(" settle_ms=");
    line_number(settle);
    line_say(" threshold=");
    line_number(threshold);
    return DONE;
}

static result lamp(uint16_t id, micros_t now) {
    uint32_t keep;
    result outcome;
    if (n_words == 3 && strcmp_P(words[2], PSTR("OFF")) == 0) {
        lamp_off(now);
    } else if (n_words == 4 && strcmp_P(words[2], PSTR("ON")) == 0) {
        if ((outcome = number(words[3], 1, LONGEST_KEEP_MS, &keep))) return outcome;
        if (lamp_faulty()) return ERR_FAULT;
        lamp_on(keep, now);
    } else {
        return ERR_ARGUMENT;
    }
    begin(DONE, id, now);
    line_say("lamp=");
    lamp_say_state();
    line_say(" since=");
    lamp_say_since();
    return DONE;
}

static result ping(uint16_t id, micros_t now) {
    uint32_t keep;
    result outcome;
    if (n_words != 3) return ERR_ARGUMENT;
    if ((outcome = number(words[2], 0, LONGEST_KEEP_MS, &keep))) return outcome;
    if (keep) lamp_keep(keep, now);
    begin(DONE, id, now);
    line_say("lamp=");
    lamp_say_state();
    line_say(" why=");
    lamp_say_why();
    line_say(" alarms=");
    alarm_list();
    return DONE;
}

static result door(uint16_t id, micros_t now) {
    if (n_words != 3) return ERR_ARGUMENT;
    if (strcmp_P(words[2], PSTR("OPEN")) == 0)
        door_drive(DRIVE_OPEN, now);
    else if (strcmp_P(words[2], PSTR("CLOSE")) == 0)
        door_drive(DRIVE_CLOSE, now);
    else if (strcmp_P(words[2], PSTR("STOP")) == 0)
        door_stop();
    else
        return ERR_ARGUMENT;
    begin(DONE, id, now);
    line_say("door=");
    door_say_place();
    line_say(" drive=");
    door_say_drive();
    return DONE;
}

static result status(uint16_t id, micros_t now) {
    if (n_words != 2) return ERR_ARGUMENT;
    begin(DONE, id, now);
    lamp_say_status(now);
    line_say(" ");
    door_say_status();
    line_say(" alarms=");
    alarm_list();
    return DONE;
}

static result acknowledge(uint16_t id, micros_t now) {
    if (n_words != 3 || !alarm_acknowledge(words[2])) return ERR_ARGUMENT;
    begin(DONE, id, now);
    line_say("alarms=");
    alarm_list();
    return DONE;
}

static const struct {
    char name[8];
    result (*act)(uint16_t id, micros_t now);
} commands[] PROGMEM = {
    {"LIMITS", limits}, {"LAMP", lamp}, {"PING", ping}, {"DOOR", door}, {"STATUS", status}, {"ACK", acknowledge},
};

static result carry_out(uint16_t id, micros_t now) {
    if (n_words > MOST_WORDS) return ERR_ARGUMENT;
    for (uint8_t i = 0; i < sizeof commands / sizeof *commands; i++)
        if (strcmp_P(words[1], commands[i].name) == 0) {
            result (*act)(uint16_t, micros_t) = (result(*)(uint16_t, micros_t))pgm_read_word(&commands[i].act);
            return act(id, now);
        }
    return ERR_COMMAND;
}

static void obey(char *text) {
    static uint16_t last_id;  // 0: nothing to repeat
    static char last_reply[LINE_ROOM];
    static uint8_t last_length;
    micros_t now = clock_now();
    uint32_t id;
    split(text);
    if (n_words < 2 || number(words[0], 1, 65535, &id)) {
        begin(ERR_GARBLED, 0, now);
        line_send();
        return;
    }
    result outcome;
    if (strcmp_P(words[1], PSTR("HELLO")) == 0) {
        if ((outcome = hello(id, now)))
            begin(outcome, id, now);
        else
            last_id = 0;
        line_send();
    } else if (!greeted) {
        begin(ERR_HELLO, id, now);
        line_send();
    } else if (id == last_id) {
        line_send_copy(last_reply, last_length);
    } else {
        if ((outcome = carry_out(id, now))) begin(outcome, id, now);
        line_send();
        last_length = line_copy(last_reply);
        last_id = id;
    }
}

// --- start and loop -----------------------------------------------------------------------------

static void count_boot(void) {
    boots = eeprom_read_dword(&boots_kept) + 1;  // a blank EEPROM is all ones: the first boot is 0, and made 1
    if (boots == 0) boots = 1;
    eeprom_update_dword(&boots_kept, boots);
}

int main(void) {
    wdt_enable(WDTO_250MS);
    clock_start();
    lamp_start();
    door_start();
    uart_start();
    count_boot();
    sei();
    uart_send("\n", 1);  // the reset may have cut a line short
    line_begin();
    line_say("EV 0 BOOT ");
    say_about();
    line_send();
    for (;;) {
        if (clock_alive()) wdt_reset();
        micros_t now = clock_now();
        lamp_watch(now);
        door_watch(now);
        alarm_watch(now);
        char text[LINE_IN];
        switch (line_read(text)) {
            case LINE_TEXT:
                obey(text);
                break;
            case LINE_GARBLED:
                begin(ERR_GARBLED, 0, now);
                line_send();
                break;
            case LINE_NONE:
                break;
        }
    }
}
