/* The firmware on a simulated ATmega328P, wired to a simulated lamp, photodiode, door and end switches.
 *
 *     firmware_board rig.elf HANG_ADDRESS
 *
 * The UART is on a pseudo-terminal. Standard input takes commands, standard output tells what happens; both as in
 * simulated_board.py, so that one set of tests runs on either. HANG_ADDRESS is that of an endless loop in the firmware.
 *
 * Time: the processor is run in steps of 50 us and held back to the wall clock. Simulated time never runs faster; where
 * the machine is too slow for 16 MHz it runs slower, and what is lost is not made up for. So the host is never late
 * in the firmware's eyes because of the simulation, and a lamp-off time measured by the wall clock is never too short.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <pty.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include <simavr/avr_adc.h>
#include <simavr/avr_ioport.h>
#include <simavr/avr_timer.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>

#define HZ 16000000ULL
#define STEP_US 50
#define BYTE_US 87 /* 10 bits at 115200 baud */
#define TRAVEL_US 280000.0
#define LIGHT_AFTER_US 40000
#define PULSE_GONE_US 40000
#define LONGEST_PULSE_US 3000

static avr_t *avr;
static int master = -1, slave = -1;
static avr_irq_t *uart_in, *adc_in, *open_in, *closed_in;

static bool lamp, main_relay, alarm_on;
static bool relay_stuck, main_stuck, lamp_dead, door_stuck;
static bool powered;
static uint64_t powered_us = -LIGHT_AFTER_US;
static double door; /* 0 closed, 1 open */
static uint64_t pulse_up, pulse_us, pulse_seen;
static int motor; /* what the last pulses said: 1 open, -1 closed, 0 nothing */
static int garble_out, lose_out, garble_in, lose_in;

static uint64_t now_us(void) { return avr->cycle * 1000000ULL / HZ; }

static double mono_s(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

static void say(const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    vprintf(format, arguments);
    va_end(arguments);
    putchar('\n');
    fflush(stdout);
}

static void pin(const char *name, int value) {
    say("pin %s %d %.6f %llu", name, value, mono_s(), (unsigned long long)now_us());
}

/* --- the line ---------------------------------------------------------------------------------- */

static void plug(void) {
    char name[128];
    struct termios raw;
    if (master >= 0) return;
    if (openpty(&master, &slave, name, NULL, NULL)) exit(1);
    tcgetattr(slave, &raw);
    cfmakeraw(&raw);
    tcsetattr(slave, TCSANOW, &raw);
    fcntl(master, F_SETFL, O_NONBLOCK);
    say("port %s", name);
}

static void unplug(void) {
    if (master >= 0) close(master), close(slave);
    master = slave = -1;
}

static void on_uart(struct avr_irq_t *irq, uint32_t value, void *unused) {
    static char line[512];
    static int length;
    (void)irq, (void)unused;
    if (length < (int)sizeof line) line[length++] = value;
    if (value != '\n') return;
    bool reply = line[0] != 'E' || line[1] != 'V';
    if (reply && lose_out) {
        lose_out--;
    } else {
        if (reply && garble_out) garble_out--, line[2] ^= 4;
        if (master >= 0 && write(master, line, length) < 0 && errno != EAGAIN) say("note write: %s", strerror(errno));
    }
    length = 0;
}

static char held[4096];
static int n_held, next_held;

static void read_host(void) {
    static char line[1024];
    static int length;
    char byte;
    if (next_held == n_held) next_held = n_held = 0;
    while (master >= 0 && n_held < (int)(sizeof held - sizeof line) && read(master, &byte, 1) == 1) {
        if (length < (int)sizeof line) line[length++] = byte;
        if (byte != '\n') continue;
        if (lose_in) {
            lose_in--;
        } else {
            if (garble_in) garble_in--, line[2] ^= 4;
            memcpy(held + n_held, line, length);
            n_held += length;
        }
        length = 0;
    }
}

/* simavr's UART takes a little longer for a byte than a real one, and drops what its own queue of 64 cannot hold. */
static bool uart_full;

static void on_xon(struct avr_irq_t *irq, uint32_t value, void *unused) {
    (void)irq, (void)value, (void)unused;
    uart_full = false;
}

static void on_xoff(struct avr_irq_t *irq, uint32_t value, void *unused) {
    (void)irq, (void)value, (void)unused;
    uart_full = true;
}

static void feed_uart(void) {
    static uint64_t due;
    if (next_held == n_held || now_us() < due || uart_full) return;
    due = now_us() + BYTE_US;
    avr_raise_irq(uart_in, (uint8_t)held[next_held++]);
}

/* --- what the pins are wired to ----------------------------------------------------------------- */

static void on_lamp(struct avr_irq_t *irq, uint32_t value, void *unused) {
    (void)irq, (void)unused;
    if (lamp != !!value) lamp = value, pin("lamp", lamp);
}

static void on_main(struct avr_irq_t *irq, uint32_t value, void *unused) {
    (void)irq, (void)unused;
    if (main_relay != !!value) main_relay = value, pin("main", main_relay);
}

static void on_alarm(struct avr_irq_t *irq, uint32_t value, void *unused) {
    (void)irq, (void)unused;
    if (alarm_on != !!value) alarm_on = value, pin("alarm", alarm_on);
}

/* From the timer, not from the pin: simavr lets a write to the port, as when the lamp goes off, end a pulse that the timer
 * holds. Where its counter overflows within a pulse, the timer says again that the pulse is up; a reset ends one unsaid. */
static void on_servo(struct avr_irq_t *irq, uint32_t value, void *unused) {
    (void)irq, (void)unused;
    if (value) {
        if (!pulse_up || avr->cycle - pulse_up > LONGEST_PULSE_US * HZ / 1000000) pulse_up = avr->cycle;
    } else if (pulse_up) {
        pulse_us = (avr->cycle - pulse_up) * 1000000ULL / HZ;
        pulse_seen = now_us();
        pulse_up = 0;
    }
}

/* Switches to ground. simavr lets a write to the port raise the pins to the pull-ups again, unless it is told otherwise. */
static void press(bool open, bool closed) {
    avr_ioport_external_t pins = {.name = 'D', .mask = 1 << 2 | 1 << 3, .value = !open << 2 | !closed << 3};
    avr_ioctl(avr, AVR_IOCTL_IOPORT_SET_EXTERNAL('D'), &pins);
    avr_raise_irq(open_in, !open);
    avr_raise_irq(closed_in, !closed);
}

static void wire(void) {
    static uint64_t last;
    uint64_t now = now_us();
    bool power = (lamp || relay_stuck) && (main_relay || main_stuck) && !lamp_dead;
    if (power != powered) powered = power, powered_us = now;
    bool shines = powered == (now - powered_us >= LIGHT_AFTER_US);
    avr_raise_irq(adc_in, shines ? 3418 : 98); /* mV: 700 and 20 of 1023 */

    int to = pulse_seen && now - pulse_seen < PULSE_GONE_US ? (pulse_us > 1500 ? 1 : -1) : 0;
    if (to != motor) motor = to, pin("motor", motor);
    if (!door_stuck) door += motor * (double)(now - last) / TRAVEL_US;
    door = door < 0 ? 0 : door > 1 ? 1 : door;
    last = now;
    press(door >= 1, door <= 0);
}

/* --- commands ----------------------------------------------------------------------------------- */

static void obey(char *line, uint32_t hang_address) {
    char *argument = strchr(line, ' ');
    if (argument) *argument++ = 0;
    else argument = "";
    int n = atoi(argument);
    if (!strcmp(line, "relay")) relay_stuck = !strcmp(argument, "stuck");
    else if (!strcmp(line, "main")) main_stuck = !strcmp(argument, "stuck");
    else if (!strcmp(line, "lamp")) lamp_dead = !strcmp(argument, "dead");
    else if (!strcmp(line, "door")) door_stuck = !strcmp(argument, "stuck");
    else if (!strcmp(line, "push")) door = atof(argument);
    else if (!strcmp(line, "garble-replies")) garble_out = n;
    else if (!strcmp(line, "lose-replies")) lose_out = n;
    else if (!strcmp(line, "garble-requests")) garble_in = n;
    else if (!strcmp(line, "lose-requests")) lose_in = n;
    else if (!strcmp(line, "unplug")) unplug();
    else if (!strcmp(line, "plug")) plug();
    else if (!strcmp(line, "reset")) avr_reset(avr), avr->data[0x54] = 1 << 1; /* MCUSR: EXTRF */
    else if (!strcmp(line, "hang")) avr->pc = hang_address;
    else if (!strcmp(line, "time")) pin("time", 0);
    else if (!strcmp(line, "pulse")) say("pulse %llu", (unsigned long long)pulse_us);
    else exit(2);
    say("done %s", line);
}

static void read_commands(uint32_t hang_address) {
    static char line[256];
    static int length;
    struct pollfd ready = {.fd = 0, .events = POLLIN};
    char byte;
    while (poll(&ready, 1, 0) == 1) {
        if (read(0, &byte, 1) != 1) exit(0); /* whoever started us has gone */
        if (byte == '\n') line[length] = 0, length = 0, obey(line, hang_address);
        else if (length < (int)sizeof line - 1) line[length++] = byte;
    }
}

static avr_irq_t *watch(uint32_t where, int bit, avr_irq_notify_t notify) {
    avr_irq_t *irq = avr_io_getirq(avr, where, bit);
    if (notify) avr_irq_register_notify(irq, notify, NULL);
    return irq;
}

int main(int argc, char **argv) {
    elf_firmware_t firmware = {0};
    uint32_t flags = 0, hang_address;
    if (argc != 3 || elf_read_firmware(argv[1], &firmware)) return 2;
    hang_address = strtoul(argv[2], NULL, 16);
    avr = avr_make_mcu_by_name("atmega328p");
    avr_init(avr);
    avr->log = LOG_NONE;
    firmware.frequency = HZ;
    firmware.vcc = firmware.avcc = firmware.aref = 5000;
    avr_load_firmware(avr, &firmware);

    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    uart_in = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_uart, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUT_XON), on_xon, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUT_XOFF), on_xoff, NULL);
    adc_in = avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_ADC0);
    uint32_t port_b = AVR_IOCTL_IOPORT_GETIRQ('B'), port_d = AVR_IOCTL_IOPORT_GETIRQ('D');
    watch(port_b, 0, on_lamp);
    watch(AVR_IOCTL_TIMER_GETIRQ('1'), TIMER_IRQ_OUT_COMP, on_servo);
    watch(port_d, 6, on_alarm);
    watch(port_d, 7, on_main);
    open_in = watch(port_d, 2, NULL);
    closed_in = watch(port_d, 3, NULL);
    wire();
    plug();

    double start = mono_s();
    uint64_t steps = 0, started = now_us();
    for (;;) {
        uint64_t until = started + ++steps * STEP_US;
        while (now_us() < until) {
            int state = avr_run(avr);
            if (state == cpu_Done || state == cpu_Crashed) say("note the processor stopped"), exit(3);
        }
        feed_uart();
        wire();
        if (steps % 10) continue;
        read_host();
        read_commands(hang_address);
        double ahead = (until - started) * 1e-6 - (mono_s() - start);
        if (ahead > 0) usleep(ahead * 1e6);
        else if (ahead < -0.005) start -= ahead; /* too slow: let it go */
    }
}
