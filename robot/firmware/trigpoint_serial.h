/* The firmware's side of the serial protocol `trigpoint`, version 1 (docs/reference/serial.md), in C99.
 *
 * One header, no allocation, no dependencies but <stdint.h>, <string.h> and <math.h>. About 2.5 kB of
 * state with the defaults. In one source file:
 *
 *     #define TRIGPOINT_IMPLEMENTATION
 *     #include "trigpoint_serial.h"
 *
 * It reads no clock and no port: hand it every byte with the time at which it came, and it calls
 * `write` with the frames to send. It is not reentrant: call it from one context (the main loop).
 * Times are nanoseconds of your own clock, which never jumps while `boot` stays the same.
 *
 * Where `double` has 4 bytes (AVR), positions are good to 8 micrometres within 100 m; the wire holds
 * 8 bytes all the same.
 */
#ifndef TRIGPOINT_SERIAL_H
#define TRIGPOINT_SERIAL_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define TRIGPOINT_VERSION 1
#define TRIGPOINT_MAXIMUM_TEXT 64
#define TRIGPOINT_MAXIMUM_FRAME 250

/* Readings that are kept to look a correction's moment up in; the page asks for three seconds. At
 * more readings a second than this allows, not every one is kept. */
#ifndef TRIGPOINT_HISTORY
#define TRIGPOINT_HISTORY 64
#endif
#define TRIGPOINT_HISTORY_NS 3000000000ull

/* Numbers of corrections whose answers are remembered. */
#ifndef TRIGPOINT_REMEMBERED
#define TRIGPOINT_REMEMBERED 32
#endif

enum trigpoint_result {
    TRIGPOINT_ACCEPTED = 0,
    TRIGPOINT_TOO_OLD = 1,
    TRIGPOINT_JUMP = 2,
    TRIGPOINT_INVALID = 3,
    TRIGPOINT_BUSY = 4
};

/* A pose in the plane: metres, radians. */
typedef struct {
    double x, y, heading;
} trigpoint_pose;

/* What the bridge tells. `covariance`: xx, xy, xh, yy, yh, hh in the map's axes. */
typedef struct {
    uint32_t number;
    int establishes; /* stop and plan anew before acting on it */
    uint64_t stamp_ns;
    uint8_t map[16];
    uint64_t sequence;
    trigpoint_pose map_from_base; /* at stamp_ns */
    float covariance[6];
    trigpoint_pose map_from_odom; /* what follows for your odometry frame from now on */
} trigpoint_correction;

typedef struct {
    float left_metres, right_metres; /* a count */
    float track;                     /* metres */
    uint8_t bits;                    /* 16 or 32 */
} trigpoint_wheels;

typedef struct {
    /* Send these bytes now. */
    void (*write)(void *user, const uint8_t *data, size_t size);
    /* A correction to apply; return what to answer. NULL: every one is accepted. */
    enum trigpoint_result (*correct)(void *user, const trigpoint_correction *correction);
    void *user;
    const char *name;    /* the robot's in site.toml, or "" */
    const char *program; /* for people: "rover 1.4" */
    uint32_t boot;       /* another number at each start: random, or counted in flash */
} trigpoint_config;

typedef struct {
    uint64_t stamp_ns;
    trigpoint_pose pose;
} trigpoint_reading;

typedef struct {
    trigpoint_config config;
    uint8_t held[TRIGPOINT_MAXIMUM_FRAME + 1];
    uint16_t held_size;
    uint8_t is_overlong, is_synchronised, knows_bridge, is_placed;
    uint16_t sequence;
    uint32_t bridge_boot;
    uint32_t received, rejected;
    uint64_t heartbeat_due_ns, bridge_heard_ns;
    trigpoint_reading history[TRIGPOINT_HISTORY];
    uint16_t history_begin, history_size;
    uint64_t newest_ns;
    trigpoint_pose newest;
    uint32_t numbers[TRIGPOINT_REMEMBERED];
    uint8_t results[TRIGPOINT_REMEMBERED];
    uint8_t remembered, oldest;
    trigpoint_pose map_from_odom;
    /* Of trigpoint_ticks: the pose that it adds up. */
    uint32_t left, right;
    uint8_t has_counts;
    trigpoint_pose counted;
} trigpoint;

/* Begin; says HELLO. */
void trigpoint_begin(trigpoint *self, const trigpoint_config *config);
/* One byte that came at `now_ns`. */
void trigpoint_receive(trigpoint *self, uint8_t byte, uint64_t now_ns);
/* Call it often: sends the heartbeat once a second. */
void trigpoint_poll(trigpoint *self, uint64_t now_ns);
/* One reading of the odometry, 20 to 100 a second: odom_from_base, m/s forward, rad/s. */
void trigpoint_odometry(trigpoint *self, uint64_t stamp_ns, trigpoint_pose odom_from_base,
                        float linear, float angular);
/* Or one reading of both wheels' counters; adds up the pose for corrections. */
void trigpoint_ticks(trigpoint *self, uint64_t stamp_ns, uint32_t left, uint32_t right,
                     const trigpoint_wheels *wheels);
/* Your clock jumped: what is remembered by it is void. */
void trigpoint_clock_jumped(trigpoint *self);
/* Where the robot is now; 0 before the first correction. */
int trigpoint_map_from_base(const trigpoint *self, trigpoint_pose *map_from_base);
/* Whether the bridge was heard within three seconds: else no corrections will come. */
int trigpoint_is_heard(const trigpoint *self, uint64_t now_ns);

#ifdef __cplusplus
}
#endif
#endif /* TRIGPOINT_SERIAL_H */

#if defined(TRIGPOINT_IMPLEMENTATION) && !defined(TRIGPOINT_IMPLEMENTED)
#define TRIGPOINT_IMPLEMENTED

#include <math.h>
#include <string.h>

enum { TP_HELLO = 1, TP_ODOMETRY, TP_PING, TP_PONG, TP_CORRECTION, TP_ACKNOWLEDGE, TP_HEARTBEAT,
       TP_TICKS };

/* -- numbers, little-endian whatever the machine is -- */

static void tp_put(uint8_t *to, uint64_t value, int size) {
    for (int i = 0; i < size; i++) to[i] = (uint8_t)(value >> (8 * i));
}

static uint64_t tp_get(const uint8_t *from, int size) {
    uint64_t value = 0;
    for (int i = size - 1; i >= 0; i--) value = (value << 8) | from[i];
    return value;
}

static void tp_put_f32(uint8_t *to, float value) {
    uint32_t bits;
    memcpy(&bits, &value, 4);
    tp_put(to, bits, 4);
}

static float tp_get_f32(const uint8_t *from) {
    uint32_t bits = (uint32_t)tp_get(from, 4);
    float value;
    memcpy(&value, &bits, 4);
    return value;
}

/* An IEEE 754 double by its bits, also where the compiler's double has 4 bytes. */
static void tp_put_f64(uint8_t *to, double value) {
    uint64_t bits = 0;
    if (sizeof(double) == 8) {
        memcpy(&bits, &value, sizeof value);
    } else {
        float single = (float)value;
        uint32_t half;
        memcpy(&half, &single, 4);
        uint64_t sign = half >> 31, power = (half >> 23) & 0xFF, fraction = half & 0x7FFFFF;
        if (power == 0xFF) power = 0x7FF;
        else if (power) power += 1023 - 127;
        else fraction = 0; /* below 1e-38: zero */
        bits = (sign << 63) | (power << 52) | (fraction << 29);
    }
    tp_put(to, bits, 8);
}

static double tp_get_f64(const uint8_t *from) {
    uint64_t bits = tp_get(from, 8);
    if (sizeof(double) == 8) {
        double value;
        memcpy(&value, &bits, sizeof value);
        return value;
    }
    int power = (int)((bits >> 52) & 0x7FF);
    uint32_t sign = (uint32_t)(bits >> 63) << 31, fraction = (uint32_t)(bits >> 29) & 0x7FFFFF;
    uint32_t half = sign;
    if (power == 0x7FF) half |= 0x7F800000u | fraction;
    else if (power > 1023 + 127) half |= 0x7F800000u; /* too large: infinite, which is refused */
    else if (power > 1023 - 127) half |= (uint32_t)(power - 1023 + 127) << 23 | fraction;
    float value;
    memcpy(&value, &half, 4);
    return value;
}

/* -- frames -- */

static uint16_t tp_crc(const uint8_t *data, size_t size) {
    uint16_t crc = 0xFFFF;
    for (size_t i = 0; i < size; i++) {
        crc ^= (uint16_t)((uint16_t)data[i] << 8);
        for (int bit = 0; bit < 8; bit++)
            crc = (uint16_t)(crc & 0x8000 ? (crc << 1) ^ 0x1021 : crc << 1);
    }
    return crc;
}

/* `frame` begins with 4 bytes of room: one for COBS, three for the head. */
static void tp_send(trigpoint *self, uint8_t *frame, uint8_t kind, size_t payload) {
    size_t size = 3 + payload;
    frame[1] = kind;
    tp_put(frame + 2, self->sequence++, 2);
    tp_put(frame + 1 + size, tp_crc(frame + 1, size), 2);
    size += 2;
    size_t last = 0; /* COBS in place: every 0 gives way to the distance to the next one */
    for (size_t i = 1; i <= size; i++) {
        if (frame[i] == 0) {
            frame[last] = (uint8_t)(i - last);
            last = i;
        }
    }
    frame[last] = (uint8_t)(size + 1 - last);
    frame[size + 1] = 0;
    self->config.write(self->config.user, frame, size + 2);
}

static size_t tp_text(uint8_t *to, const char *text) {
    size_t size = text ? strlen(text) : 0;
    if (size > TRIGPOINT_MAXIMUM_TEXT) {
        size = TRIGPOINT_MAXIMUM_TEXT;
        while (size && ((uint8_t)text[size] & 0xC0) == 0x80) size--; /* between characters */
    }
    to[0] = (uint8_t)size;
    if (size) memcpy(to + 1, text, size);
    return size + 1;
}

static void tp_hello(trigpoint *self) {
    uint8_t frame[4 + 6 + 2 * (TRIGPOINT_MAXIMUM_TEXT + 1) + 3];
    size_t size = 6;
    tp_put(frame + 4, TRIGPOINT_VERSION, 2);
    tp_put(frame + 6, self->config.boot, 4);
    size += tp_text(frame + 4 + size, self->config.name);
    size += tp_text(frame + 4 + size, self->config.program);
    tp_send(self, frame, TP_HELLO, size);
}

static void tp_acknowledge(trigpoint *self, uint32_t number, uint8_t result) {
    uint8_t frame[4 + 6 + 3];
    tp_put(frame + 4, number, 4);
    frame[8] = result;
    frame[9] = 0; /* no text */
    tp_send(self, frame, TP_ACKNOWLEDGE, 6);
}

/* -- geometry -- */

static double tp_turned(double angle) {
    const double turn = 6.283185307179586;
    angle = fmod(angle, turn);
    if (angle > turn / 2) angle -= turn;
    if (angle < -turn / 2) angle += turn;
    return angle;
}

static trigpoint_pose tp_after(trigpoint_pose first, trigpoint_pose second) {
    double c = cos(first.heading), s = sin(first.heading);
    trigpoint_pose found = {first.x + c * second.x - s * second.y,
                            first.y + s * second.x + c * second.y,
                            tp_turned(first.heading + second.heading)};
    return found;
}

static trigpoint_pose tp_inverse(trigpoint_pose pose) {
    double c = cos(pose.heading), s = sin(pose.heading);
    trigpoint_pose found = {-c * pose.x - s * pose.y, s * pose.x - c * pose.y, -pose.heading};
    return found;
}

/* -- the last readings -- */

static trigpoint_reading *tp_reading(trigpoint *self, uint16_t i) {
    return &self->history[(self->history_begin + i) % TRIGPOINT_HISTORY];
}

static void tp_remember(trigpoint *self, uint64_t stamp_ns, trigpoint_pose pose) {
    const uint64_t spacing = TRIGPOINT_HISTORY_NS / (TRIGPOINT_HISTORY - 2);
    self->newest = pose;
    self->newest_ns = stamp_ns;
    /* The last one gives way to a newer one until it is far enough from the one before it. */
    if (self->history_size > 1) {
        trigpoint_reading *last = tp_reading(self, (uint16_t)(self->history_size - 1));
        trigpoint_reading *before = tp_reading(self, (uint16_t)(self->history_size - 2));
        if (last->stamp_ns - before->stamp_ns < spacing) self->history_size--;
    }
    if (self->history_size == TRIGPOINT_HISTORY) {
        self->history_begin = (uint16_t)((self->history_begin + 1) % TRIGPOINT_HISTORY);
        self->history_size--;
    }
    trigpoint_reading *added = tp_reading(self, self->history_size++);
    added->stamp_ns = stamp_ns;
    added->pose = pose;
}

/* odom_from_base at a moment, between the readings about it; 0 outside of them. */
static int tp_look_up(trigpoint *self, uint64_t stamp_ns, trigpoint_pose *pose) {
    for (uint16_t i = self->history_size; i > 0; i--) {
        trigpoint_reading *earlier = tp_reading(self, (uint16_t)(i - 1));
        if (earlier->stamp_ns > stamp_ns) continue;
        if (earlier->stamp_ns == stamp_ns) {
            *pose = earlier->pose;
            return 1;
        }
        if (i == self->history_size) return 0;
        trigpoint_reading *later = tp_reading(self, i);
        double part = (double)(stamp_ns - earlier->stamp_ns) /
                      (double)(later->stamp_ns - earlier->stamp_ns);
        double turn = tp_turned(later->pose.heading - earlier->pose.heading);
        pose->x = earlier->pose.x + part * (later->pose.x - earlier->pose.x);
        pose->y = earlier->pose.y + part * (later->pose.y - earlier->pose.y);
        pose->heading = tp_turned(earlier->pose.heading + part * turn);
        return 1;
    }
    return 0;
}

/* -- what comes -- */

static int tp_is_sound(double value) { return value - value == 0 && fabs(value) < 1e5; }

static enum trigpoint_result tp_apply(trigpoint *self, const uint8_t *p) {
    trigpoint_correction correction;
    trigpoint_pose odom_from_base;
    double q[4], length = 0;
    correction.number = (uint32_t)tp_get(p, 4);
    correction.establishes = p[4] & 1;
    correction.stamp_ns = tp_get(p + 5, 8);
    memcpy(correction.map, p + 13, 16);
    correction.sequence = tp_get(p + 29, 8);
    correction.map_from_base.x = tp_get_f64(p + 37);
    correction.map_from_base.y = tp_get_f64(p + 45);
    for (int i = 0; i < 4; i++) q[i] = tp_get_f64(p + 61 + 8 * i), length += q[i] * q[i];
    for (int i = 0; i < 6; i++) correction.covariance[i] = tp_get_f32(p + 93 + 4 * i);
    if (!tp_is_sound(correction.map_from_base.x) || !tp_is_sound(correction.map_from_base.y) ||
        !(fabs(length - 1) < 2e-3) || fabs(q[0]) > 1e-3 || fabs(q[1]) > 1e-3)
        return TRIGPOINT_INVALID;
    correction.map_from_base.heading = tp_turned(2 * atan2(q[2], q[3]));
    if (!tp_look_up(self, correction.stamp_ns, &odom_from_base)) return TRIGPOINT_TOO_OLD;
    correction.map_from_odom = tp_after(correction.map_from_base, tp_inverse(odom_from_base));
    if (self->config.correct) {
        enum trigpoint_result result = self->config.correct(self->config.user, &correction);
        if (result != TRIGPOINT_ACCEPTED) return result;
    }
    self->map_from_odom = correction.map_from_odom;
    self->is_placed = 1;
    return TRIGPOINT_ACCEPTED;
}

static void tp_correct(trigpoint *self, const uint8_t *payload) {
    uint32_t number = (uint32_t)tp_get(payload, 4);
    for (uint8_t i = 0; i < self->remembered; i++) {
        if (self->numbers[i] == number) { /* it came before: the same answer, not applied again */
            tp_acknowledge(self, number, self->results[i]);
            return;
        }
    }
    uint8_t place = self->remembered < TRIGPOINT_REMEMBERED ? self->remembered++ : self->oldest;
    self->oldest = (uint8_t)((place + 1) % TRIGPOINT_REMEMBERED);
    self->numbers[place] = number;
    self->results[place] = (uint8_t)tp_apply(self, payload);
    tp_acknowledge(self, number, self->results[place]);
}

static void tp_pong(trigpoint *self, const uint8_t *payload, uint64_t now_ns) {
    uint8_t frame[4 + 24 + 3];
    memcpy(frame + 4, payload, 4);
    tp_put(frame + 8, self->config.boot, 4);
    tp_put(frame + 12, now_ns, 8);
    tp_put(frame + 20, now_ns, 8);
    tp_send(self, frame, TP_PONG, 24);
}

static int tp_heard_hello(trigpoint *self, const uint8_t *payload, size_t size) {
    if (size < 6) return 0;
    uint32_t boot = (uint32_t)tp_get(payload + 2, 4);
    self->knows_bridge = tp_get(payload, 2) == TRIGPOINT_VERSION;
    if (boot != self->bridge_boot) {
        self->bridge_boot = boot;
        self->remembered = self->oldest = 0;
    }
    tp_hello(self);
    return 1;
}

static int tp_frame(trigpoint *self, const uint8_t *frame, size_t size, uint64_t now_ns) {
    if (size < 5 || size > TRIGPOINT_MAXIMUM_FRAME) return 0;
    if (tp_crc(frame, size - 2) != tp_get(frame + size - 2, 2)) return 0;
    const uint8_t *payload = frame + 3;
    size_t length = size - 5;
    switch (frame[0]) {
    case TP_HELLO:
        if (!tp_heard_hello(self, payload, length)) return 0;
        break;
    case TP_PING:
        if (length != 24) return 0;
        if (self->knows_bridge) tp_pong(self, payload, now_ns);
        break;
    case TP_CORRECTION:
        if (length != 117) return 0;
        if (self->knows_bridge) tp_correct(self, payload);
        break;
    case TP_HEARTBEAT:
        if (length != 16) return 0;
        break;
    default:
        return 0;
    }
    self->bridge_heard_ns = now_ns;
    return 1;
}

/* Takes COBS away in place; the size, or 0 where it is none. */
static size_t tp_unstuffed(uint8_t *data, size_t size) {
    size_t from = 0, to = 0;
    while (from < size) {
        size_t code = data[from++];
        if (code == 0 || from + code - 1 > size) return 0;
        for (size_t i = 1; i < code; i++) data[to++] = data[from++];
        if (code < 255 && from < size) data[to++] = 0;
    }
    return to;
}

void trigpoint_receive(trigpoint *self, uint8_t byte, uint64_t now_ns) {
    if (byte != 0) {
        if (self->held_size < sizeof self->held) self->held[self->held_size++] = byte;
        else self->is_overlong = 1;
        return;
    }
    size_t held = self->held_size;
    int is_overlong = self->is_overlong, was_synchronised = self->is_synchronised;
    self->held_size = self->is_overlong = 0;
    self->is_synchronised = 1;
    if (held == 0 && !is_overlong) return;
    if (!is_overlong && tp_frame(self, self->held, tp_unstuffed(self->held, held), now_ns))
        self->received++;
    else if (was_synchronised)
        self->rejected++;
}

/* -- what goes -- */

void trigpoint_begin(trigpoint *self, const trigpoint_config *config) {
    const uint8_t delimiter = 0;
    memset(self, 0, sizeof *self);
    self->config = *config;
    config->write(config->user, &delimiter, 1);
    tp_hello(self);
}

void trigpoint_poll(trigpoint *self, uint64_t now_ns) {
    uint8_t frame[4 + 16 + 3];
    if (now_ns < self->heartbeat_due_ns) return;
    self->heartbeat_due_ns = now_ns + 1000000000ull;
    tp_put(frame + 4, now_ns, 8);
    tp_put(frame + 12, self->received, 4);
    tp_put(frame + 16, self->rejected, 4);
    tp_send(self, frame, TP_HEARTBEAT, 16);
}

void trigpoint_odometry(trigpoint *self, uint64_t stamp_ns, trigpoint_pose pose, float linear,
                        float angular) {
    uint8_t frame[4 + 92 + 3];
    memset(frame, 0, sizeof frame);
    tp_put(frame + 4, self->config.boot, 4);
    tp_put(frame + 8, stamp_ns, 8);
    tp_put_f64(frame + 16, pose.x);
    tp_put_f64(frame + 24, pose.y);
    tp_put_f64(frame + 56, sin(pose.heading / 2));
    tp_put_f64(frame + 64, cos(pose.heading / 2));
    tp_put_f32(frame + 72, linear);
    tp_put_f32(frame + 92, angular);
    tp_remember(self, stamp_ns, pose);
    tp_send(self, frame, TP_ODOMETRY, 92);
}

static int32_t tp_counted(uint32_t now, uint32_t before, uint8_t bits) {
    uint32_t difference = now - before;
    return bits == 16 ? (int32_t)(int16_t)(uint16_t)difference : (int32_t)difference;
}

void trigpoint_ticks(trigpoint *self, uint64_t stamp_ns, uint32_t left, uint32_t right,
                     const trigpoint_wheels *wheels) {
    uint8_t frame[4 + 33 + 3];
    if (self->has_counts) {
        double l = (double)wheels->left_metres * tp_counted(left, self->left, wheels->bits);
        double r = (double)wheels->right_metres * tp_counted(right, self->right, wheels->bits);
        double half = (r - l) / wheels->track / 2;
        double chord = (l + r) / 2 * (fabs(half) < 1e-6 ? 1 : sin(half) / half);
        self->counted.x += chord * cos(self->counted.heading + half);
        self->counted.y += chord * sin(self->counted.heading + half);
        self->counted.heading = tp_turned(self->counted.heading + 2 * half);
    }
    self->left = left, self->right = right, self->has_counts = 1;
    tp_put(frame + 4, self->config.boot, 4);
    tp_put(frame + 8, stamp_ns, 8);
    tp_put(frame + 16, left, 4);
    tp_put(frame + 20, right, 4);
    frame[24] = wheels->bits;
    tp_put_f32(frame + 25, wheels->left_metres);
    tp_put_f32(frame + 29, wheels->right_metres);
    tp_put_f32(frame + 33, wheels->track);
    tp_remember(self, stamp_ns, self->counted);
    tp_send(self, frame, TP_TICKS, 33);
}

void trigpoint_clock_jumped(trigpoint *self) {
    self->history_size = 0;
    self->heartbeat_due_ns = 0;
}

int trigpoint_map_from_base(const trigpoint *self, trigpoint_pose *map_from_base) {
    if (!self->is_placed) return 0;
    *map_from_base = tp_after(self->map_from_odom, self->newest);
    return 1;
}

int trigpoint_is_heard(const trigpoint *self, uint64_t now_ns) {
    return self->knows_bridge && now_ns - self->bridge_heard_ns < 3000000000ull;
}

#endif /* TRIGPOINT_IMPLEMENTATION */
