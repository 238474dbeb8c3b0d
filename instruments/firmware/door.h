// The trapdoor: a servo that pushes, and an end switch at either end.
#ifndef DOOR_H
#define DOOR_H

#include "clock.h"

typedef enum { DRIVE_IDLE, DRIVE_OPEN, DRIVE_CLOSE, DRIVE_STUCK } drive_name;

void door_start(void);
void door_watch(micros_t now);
void door_drive(drive_name to, micros_t now);  // DRIVE_OPEN or DRIVE_CLOSE
void door_stop(void);
void door_say_place(void);
void door_say_drive(void);
void door_say_status(void);

#endif
