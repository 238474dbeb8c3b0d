// What is wired where, and the numbers that a builder may change (make CONFIG='-DNAME=VALUE').
#ifndef BOARD_H
#define BOARD_H

#include <avr/io.h>

#define FIRMWARE "1.0.0"
#define PROTOCOL 1

// Outputs: high is on. Each needs 10 kOhm to ground: a processor in reset drives nothing.
#define LAMP_BIT PB0   // D8: the lamp's relay
#define SERVO_BIT PB1  // D9: pulses for the door's servo (OC1A)
#define ALARM_BIT PD6  // D6: buzzer and red LED
#define MAIN_BIT PD7   // D7: the relay before the lamp's

// Inputs: end switches to ground, with the processor's pull-ups.
#define OPEN_BIT PD2    // D2: pressed when the door is open
#define CLOSED_BIT PD3  // D3: pressed when it is closed
#define LIGHT_CHANNEL 0 // A0: the photodiode's amplifier, 0 to 5 V

#ifndef SERVO_OPEN_US
#define SERVO_OPEN_US 2000
#endif
#ifndef SERVO_CLOSED_US
#define SERVO_CLOSED_US 1000
#endif
#ifndef MAX_ON_MS
#define MAX_ON_MS 14400000UL  // no host can ask for more
#endif
#ifndef FIRST_OVERFLOW
#define FIRST_OVERFLOW 0  // where the clock starts, in steps of 32.768 ms: a test starts it before 2^32 us
#endif

#define LONGEST_KEEP_MS 2000

#endif
