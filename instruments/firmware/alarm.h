// What must not be missed: said again every second until the host has acknowledged it.
#ifndef ALARM_H
#define ALARM_H

#include "clock.h"

typedef enum { ALARM_WATCHDOG, ALARM_MAXON, ALARM_LAMPFAULT, ALARM_DOORSTUCK, ALARMS } alarm_name;

// Raise it; `detail`, from PSTR(), follows its name in the event.
void alarm_raise(alarm_name alarm, const char *detail, micros_t now);
void alarm_watch(micros_t now);
void alarm_forget_all(void);
bool alarm_acknowledge(const char *name);  // false: there is no such alarm
void alarm_list(void);                     // into the line that is being written

#endif
