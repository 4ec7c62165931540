/* A PID controller that balances the wheeled pendulum, as a process of its own on a serial CAN bus.
 *
 *     balance TERMINAL [P I D N LIMIT]
 *
 * It reads the messages of WheeledPendulum.dbc in the slcan protocol: pitch from Sensors1, its
 * reference from References1, both with AUTOSAR E2E profile 11; and answers each pitch with
 * Actuators1. Without a good pitch for 20 ms it sends zero volts. Gains are those of
 *
 *     C.-C. Peng, N.-J. Cheng, M.-C. Tsai, Electronics 12 (2023) 4569.
 */

#define _DEFAULT_SOURCE
#define _POSIX_C_SOURCE 200809L

#include <fcntl.h>
#include <poll.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <unistd.h>

enum { ACTUATORS = 0x101, SENSORS = 0x111, REFERENCES = 0x121 };
enum { SECOND_SIGNAL = 5, FIRST_SIGNAL = 2 }; /* first byte of each in the payload */
enum { SILENCE_MS = 20 };

static const double step_of_bus = 1e-4, period = 1e-3;

/* CRC-8 SAE J1850 as profile 11 starts and ends it: with zero; over the data identifier, then over
 * all bytes behind the checksum. */
static uint8_t checksum(const uint8_t *payload, uint16_t data_id)
{
    const uint8_t id[2] = {(uint8_t)data_id, (uint8_t)(data_id >> 8)};
    uint8_t crc = 0;
    for (int i = 0; i < 9; i++) {
        crc ^= i < 2 ? id[i] : payload[i - 1];
        for (int bit = 0; bit < 8; bit++)
            crc = (uint8_t)(crc & 0x80 ? crc << 1 ^ 0x1D : crc << 1);
    }
    return crc;
}

static double signal_at(const uint8_t *p)
{
    const uint32_t raw = p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16;
    return step_of_bus * (double)(raw & 0x800000 ? (int32_t)raw - 0x1000000 : (int32_t)raw);
}

typedef struct {
    double P, I, D, N, limit;
    double integral, smooth;
} Pid;

static double control(Pid *pid, double error)
{
    const double slope = pid->N * (error - pid->smooth);
    double volts = pid->P * error + pid->I * pid->integral + pid->D * slope;
    const bool above = volts > pid->limit, below = volts < -pid->limit;
    if (above || below)
        volts = above ? pid->limit : -pid->limit;
    else
        pid->integral += period * error;
    pid->smooth += period * slope;
    return volts;
}

static bool command(int terminal, double volts)
{
    static uint8_t counter;
    uint8_t payload[8] = {0, counter};
    const double steps = volts / step_of_bus;
    const int32_t raw = (int32_t)(steps < 0 ? steps - 0.5 : steps + 0.5);
    for (int i = 0; i < 3; i++)
        payload[FIRST_SIGNAL + i] = (uint8_t)((uint32_t)raw >> 8 * i);
    payload[0] = checksum(payload, ACTUATORS);
    counter = (uint8_t)((counter + 1) % 15);
    char line[32];
    int n = snprintf(line, sizeof line, "t%03X8", ACTUATORS);
    for (int i = 0; i < 8; i++)
        n += snprintf(line + n, sizeof line - (size_t)n, "%02X", payload[i]);
    line[n++] = '\r';
    return write(terminal, line, (size_t)n) == n;
}

static int digit(char c)
{
    return c >= '0' && c <= '9' ? c - '0' : c >= 'A' && c <= 'F' ? c - 'A' + 10 : -1;
}

/* The payload of a line if it is one of ours, fresh and intact. */
static bool take(const char *line, size_t length, unsigned wanted, int *last, uint8_t *payload)
{
    if (length < 21 || line[0] != 't' || line[4] != '8')
        return false;
    unsigned id = 0;
    for (int i = 1; i < 4; i++)
        id = id << 4 | (unsigned)digit(line[i]);
    if (id != wanted)
        return false;
    for (int i = 0; i < 8; i++) {
        const int high = digit(line[5 + 2 * i]), low = digit(line[6 + 2 * i]);
        if (high < 0 || low < 0)
            return false;
        payload[i] = (uint8_t)(high << 4 | low);
    }
    const int count = payload[1] & 15;
    if (payload[0] != checksum(payload, (uint16_t)id) || count == *last)
        return false;
    *last = count;
    return true;
}

int main(int n, char **words)
{
    if (n < 2) {
        fprintf(stderr, "usage: %s TERMINAL [P I D N LIMIT]\n", words[0]);
        return 2;
    }
    const int terminal = open(words[1], O_RDWR | O_NOCTTY);
    struct termios raw;
    if (terminal < 0 || tcgetattr(terminal, &raw) != 0) {
        perror(words[1]);
        return 2;
    }
    raw.c_iflag = raw.c_oflag = raw.c_lflag = 0;
    raw.c_cflag = (raw.c_cflag & ~(tcflag_t)(CSIZE | PARENB)) | CS8 | CREAD | CLOCAL;
    raw.c_cc[VMIN] = 1, raw.c_cc[VTIME] = 0;
    tcsetattr(terminal, TCSANOW, &raw);
    if (write(terminal, "O\r", 2) != 2)
        return 2;

    Pid pid = {.P = -168, .I = -800, .D = -8.8, .N = 100, .limit = 800};
    double *settings[] = {&pid.P, &pid.I, &pid.D, &pid.N, &pid.limit};
    for (int i = 2; i < n && i < 7; i++)
        *settings[i - 2] = atof(words[i]);

    char line[64], block[4096];
    size_t length = 0;
    int last_pitch = -1, last_reference = -1;
    double reference = 0;
    for (;;) {
        struct pollfd ready = {.fd = terminal, .events = POLLIN};
        const int events = poll(&ready, 1, SILENCE_MS);
        if (events < 0)
            return 1;
        if (events == 0) {
            pid.integral = pid.smooth = 0;
            if (!command(terminal, 0.0))
                return 1;
            continue;
        }
        const ssize_t got = read(terminal, block, sizeof block);
        if (got <= 0)
            return 0;
        for (ssize_t i = 0; i < got; i++) {
            if (block[i] != '\r') {
                if (length < sizeof line)
                    line[length++] = block[i];
                continue;
            }
            uint8_t payload[8];
            if (take(line, length, REFERENCES, &last_reference, payload))
                reference = signal_at(payload + SECOND_SIGNAL);
            else if (take(line, length, SENSORS, &last_pitch, payload)
                     && !command(terminal, control(&pid, reference - signal_at(payload + SECOND_SIGNAL))))
                return 1;
            length = 0;
        }
    }
}
