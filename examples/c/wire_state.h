/* The state of a stream as a message, in JSON or MessagePack: docs/wire.md, "Streams". */
#ifndef WIRE_STATE_H
#define WIRE_STATE_H

#include <stdint.h>
#include <stdio.h>
#include <string.h>

enum { WIRE_MOST_JOINTS = 64, WIRE_MOST_BYTES = 1 << 16 };
typedef enum { WIRE_JSON, WIRE_MSGPACK } wire_encoding;

/* An exact state: measured joints and object, and the desired motion of the object. SI units; rotations by rows. */
typedef struct {
    uint32_t sequence;
    double time;
    int joint_count;
    double posture[WIRE_MOST_JOINTS], velocity[WIRE_MOST_JOINTS];
    double position[3], rotation[9], twist[6];
    double desired_position[3], desired_rotation[9], desired_twist[6], desired_acceleration[6];
} wire_state;

/* A message under construction. */
typedef struct {
    wire_encoding encoding;
    size_t size;
    unsigned char bytes[WIRE_MOST_BYTES];
} wire_message;

static void wire_put(wire_message *m, const void *bytes, size_t size)
{
    if (m->size + size <= sizeof m->bytes) memcpy(m->bytes + m->size, bytes, size);
    m->size += size; /* larger than the message if it does not fit */
}

static void wire_put_byte(wire_message *m, int byte)
{
    const unsigned char value = (unsigned char)byte;
    wire_put(m, &value, 1);
}

/* Put a number as eight bytes: little-endian in arrays, big-endian in MessagePack itself. */
static void wire_put_float64(wire_message *m, double value, int is_little)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    for (int i = 0; i < 8; i++) wire_put_byte(m, (int)(bits >> (is_little ? 8 * i : 56 - 8 * i) & 0xff));
}

static void wire_put_number(wire_message *m, double value)
{
    char text[32];
    if (m->encoding == WIRE_JSON) {
        wire_put(m, text, (size_t)snprintf(text, sizeof text, "%.17g", value));
        return;
    }
    wire_put_byte(m, 0xcb);
    wire_put_float64(m, value, 0);
}

static void wire_put_integer(wire_message *m, uint32_t value)
{
    char text[16];
    if (m->encoding == WIRE_JSON) {
        wire_put(m, text, (size_t)snprintf(text, sizeof text, "%u", (unsigned)value));
        return;
    }
    const int size = value < 128 ? 0 : value < 256 ? 1 : value < 65536 ? 2 : 4;
    if (size > 0) wire_put_byte(m, size == 1 ? 0xcc : size == 2 ? 0xcd : 0xce);
    for (int i = size > 0 ? size - 1 : 0; i >= 0; i--) wire_put_byte(m, (int)(value >> 8 * i & 0xff));
}

/* Begin the field of a record: `first` of so many. In MessagePack the first field has the size of the record before it. */
static void wire_put_field(wire_message *m, const char *name, int fields, int is_first)
{
    if (m->encoding == WIRE_JSON) {
        wire_put(m, is_first ? "{\"" : ",\"", 2);
        wire_put(m, name, strlen(name));
        wire_put(m, "\":", 2);
        return;
    }
    if (is_first) wire_put_byte(m, 0x80 | fields);
    wire_put_byte(m, 0xa0 | (int)strlen(name));
    wire_put(m, name, strlen(name));
}

static void wire_end_record(wire_message *m)
{
    if (m->encoding == WIRE_JSON) wire_put(m, "}", 1);
}

/* Put an array of rows, or of numbers if `rows` is 1: lists in JSON, binary in MessagePack. */
static void wire_put_array(wire_message *m, const double *x, int rows, int columns)
{
    if (m->encoding == WIRE_MSGPACK) {
        const int size = 8 * rows * columns;
        if (size < 256) {
            wire_put_byte(m, 0xc4);
        } else {
            wire_put_byte(m, 0xc5);
            wire_put_byte(m, size >> 8);
        }
        wire_put_byte(m, size & 0xff);
        for (int i = 0; i < rows * columns; i++) wire_put_float64(m, x[i], 1);
        return;
    }
    if (rows > 1) wire_put(m, "[", 1);
    for (int r = 0; r < rows; r++) {
        wire_put(m, r > 0 ? ",[" : "[", r > 0 ? 2 : 1);
        for (int c = 0; c < columns; c++) {
            if (c > 0) wire_put(m, ",", 1);
            wire_put_number(m, x[r * columns + c]);
        }
        wire_put(m, "]", 1);
    }
    if (rows > 1) wire_put(m, "]", 1);
}

/* Encode a state. Its size is larger than WIRE_MOST_BYTES if it does not fit. */
static void wire_encode_state(const wire_state *s, wire_encoding encoding, wire_message *m)
{
    m->encoding = encoding, m->size = 0;
    wire_put_field(m, "sequence", 4, 1);
    wire_put_integer(m, s->sequence);
    wire_put_field(m, "time", 4, 0);
    wire_put_number(m, s->time);
    wire_put_field(m, "state", 4, 0);
    wire_put_field(m, "posture", 3, 1);
    wire_put_array(m, s->posture, 1, s->joint_count);
    wire_put_field(m, "velocity", 3, 0);
    wire_put_array(m, s->velocity, 1, s->joint_count);
    wire_put_field(m, "object", 3, 0);
    wire_put_field(m, "position", 3, 1);
    wire_put_array(m, s->position, 1, 3);
    wire_put_field(m, "rotation", 3, 0);
    wire_put_array(m, s->rotation, 3, 3);
    wire_put_field(m, "twist", 3, 0);
    wire_put_array(m, s->twist, 1, 6);
    wire_end_record(m);
    wire_end_record(m);
    wire_put_field(m, "desired", 4, 0);
    wire_put_field(m, "position", 4, 1);
    wire_put_array(m, s->desired_position, 1, 3);
    wire_put_field(m, "rotation", 4, 0);
    wire_put_array(m, s->desired_rotation, 3, 3);
    wire_put_field(m, "twist", 4, 0);
    wire_put_array(m, s->desired_twist, 1, 6);
    wire_put_field(m, "acceleration", 4, 0);
    wire_put_array(m, s->desired_acceleration, 1, 6);
    wire_end_record(m);
    wire_end_record(m);
}

#endif
