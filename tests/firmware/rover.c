/* A robot for tests: drives circles in real time and speaks `trigpoint` on a descriptor.
 * rover DESCRIPTOR BOOT odometry|ticks
 * Each correction is a line on standard output: number, establishes, x, y, heading, xx, and the
 * number of the answers that it gives. It ends when its standard input does. */
#define _POSIX_C_SOURCE 200809L
#define TRIGPOINT_IMPLEMENTATION
#include "trigpoint_serial.h"

#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

static int port;

static uint64_t now_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000000u + (uint64_t)now.tv_nsec;
}

static void write_port(void *user, const uint8_t *data, size_t size) {
    (void)user;
    if (write(port, data, size) < 0) return; /* a line that nobody reads loses it */
}

static enum trigpoint_result correct(void *user, const trigpoint_correction *told) {
    (void)user;
    printf("%lu %d %.9f %.9f %.9f %.9g\n", (unsigned long)told->number, told->establishes,
           told->map_from_base.x, told->map_from_base.y, told->map_from_base.heading,
           (double)told->covariance[0]);
    fflush(stdout);
    return TRIGPOINT_ACCEPTED;
}

int main(int count, char **words) {
    if (count != 4) return 2;
    static trigpoint self;
    static const trigpoint_wheels wheels = {0.0001f, 0.0001f, 0.3f, 16};
    trigpoint_config config = {write_port, correct, NULL, "r1", "rover.c", 0};
    port = atoi(words[1]);
    config.boot = (uint32_t)strtoul(words[2], NULL, 10);
    int is_ticks = strcmp(words[3], "ticks") == 0;
    uint64_t begin_ns = now_ns(), due_ns = begin_ns;
    trigpoint_begin(&self, &config);
    for (;;) {
        uint8_t data[512];
        struct pollfd waits[2] = {{port, POLLIN, 0}, {0, POLLIN, 0}};
        poll(waits, 2, 2);
        if (waits[1].revents) return 0;
        ssize_t size = waits[0].revents & POLLIN ? read(port, data, sizeof data) : 0;
        for (ssize_t i = 0; i < size; i++) trigpoint_receive(&self, data[i], now_ns());
        trigpoint_poll(&self, now_ns());
        if (now_ns() < due_ns) continue;
        /* 0.4 m/s, 0.3 rad/s: the wheels go 0.4 -+ 0.045 m/s. */
        double t = (double)(due_ns - begin_ns) / 1e9, heading = 0.3 * t;
        if (is_ticks) {
            long left = (long)(0.355 * t / 0.0001), right = (long)(0.445 * t / 0.0001);
            trigpoint_ticks(&self, due_ns, (uint16_t)left, (uint16_t)right, &wheels);
        } else {
            double radius = 0.4 / 0.3;
            trigpoint_pose pose = {radius * sin(heading), radius * (1 - cos(heading)), heading};
            trigpoint_odometry(&self, due_ns, pose, 0.4f, 0.3f);
        }
        due_ns += 20000000u;
    }
}
