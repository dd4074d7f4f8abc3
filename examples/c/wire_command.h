/* The command of a stream, read from a message in JSON or MessagePack: docs/wire.md, "Streams". Other fields are skipped. */
#ifndef WIRE_COMMAND_H
#define WIRE_COMMAND_H

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "wire_state.h"

enum { WIRE_MOST_DEPTH = 32 };

/* The fields of a command that a driver needs. `torque_count` is 0 in an error record. */
typedef struct {
    double sequence, time;
    int torque_count;
    double torque[WIRE_MOST_JOINTS]; /* N·m, by motor */
} wire_command;

/* A message that is read: the next byte, and the end. `next` is NULL after an error. */
typedef struct {
    const unsigned char *next, *end;
} wire_reader;

/* ---- MessagePack -------------------------------------------------------------------------------------------------------- */

/* A value: its kind, and its number, the number of its bytes, or of its items. */
typedef struct {
    enum { WIRE_NUMBER, WIRE_BYTES, WIRE_TEXT, WIRE_LIST, WIRE_MAP, WIRE_OTHER } kind;
    double number;
    uint32_t size;
    const unsigned char *bytes;
} wire_value;

static uint64_t wire_take(wire_reader *r, int size)
{
    uint64_t value = 0;
    if (r->next == NULL || r->end - r->next < size) {
        r->next = NULL;
        return 0;
    }
    for (int i = 0; i < size; i++) value = value << 8 | *r->next++;
    return value;
}

static double wire_take_float(wire_reader *r, int size)
{
    const uint64_t bits = wire_take(r, size);
    double value;
    if (size == 4) {
        const uint32_t narrow = (uint32_t)bits;
        float number;
        memcpy(&number, &narrow, sizeof number);
        return (double)number;
    }
    memcpy(&value, &bits, sizeof value);
    return value;
}

static double wire_take_signed(wire_reader *r, int size)
{
    const uint64_t bits = wire_take(r, size), sign = (uint64_t)1 << (8 * size - 1);
    return bits & sign ? -(double)((~bits & (sign - 1)) + 1) : (double)bits;
}

static wire_value wire_bytes(wire_reader *r, int kind, uint32_t size)
{
    const wire_value value = {.kind = kind, .size = size, .bytes = r->next};
    if (r->next != NULL && (size_t)(r->end - r->next) >= size)
        r->next += size;
    else
        r->next = NULL;
    return value;
}

/* Read a value; the items of a list or a map follow it. */
static wire_value wire_next(wire_reader *r)
{
    const int type = (int)wire_take(r, 1);
    if (r->next == NULL) return (wire_value){.kind = WIRE_OTHER};
    if (type < 0x80) return (wire_value){.kind = WIRE_NUMBER, .number = type};
    if (type < 0x90) return (wire_value){.kind = WIRE_MAP, .size = (uint32_t)type & 15};
    if (type < 0xa0) return (wire_value){.kind = WIRE_LIST, .size = (uint32_t)type & 15};
    if (type < 0xc0) return wire_bytes(r, WIRE_TEXT, (uint32_t)type & 31);
    if (type >= 0xe0) return (wire_value){.kind = WIRE_NUMBER, .number = type - 256};
    if (type >= 0xc4 && type <= 0xc6) return wire_bytes(r, WIRE_BYTES, (uint32_t)wire_take(r, 1 << (type - 0xc4)));
    if (type == 0xca || type == 0xcb)
        return (wire_value){.kind = WIRE_NUMBER, .number = wire_take_float(r, type == 0xca ? 4 : 8)};
    if (type >= 0xcc && type <= 0xcf)
        return (wire_value){.kind = WIRE_NUMBER, .number = (double)wire_take(r, 1 << (type - 0xcc))};
    if (type >= 0xd0 && type <= 0xd3)
        return (wire_value){.kind = WIRE_NUMBER, .number = wire_take_signed(r, 1 << (type - 0xd0))};
    if (type >= 0xd9 && type <= 0xdb) return wire_bytes(r, WIRE_TEXT, (uint32_t)wire_take(r, 1 << (type - 0xd9)));
    if (type == 0xdc || type == 0xdd)
        return (wire_value){.kind = WIRE_LIST, .size = (uint32_t)wire_take(r, type == 0xdc ? 2 : 4)};
    if (type == 0xde || type == 0xdf)
        return (wire_value){.kind = WIRE_MAP, .size = (uint32_t)wire_take(r, type == 0xde ? 2 : 4)};
    if (type == 0xc1 || (type >= 0xc7 && type <= 0xd8)) r->next = NULL; /* extensions: the wire has none */
    return (wire_value){.kind = WIRE_OTHER};                            /* null, false or true */
}

static void wire_skip(wire_reader *r, int depth)
{
    const wire_value value = wire_next(r);
    if (depth == 0) r->next = NULL;
    const uint32_t items = value.kind == WIRE_MAP ? 2 * value.size : value.kind == WIRE_LIST ? value.size : 0;
    for (uint32_t i = 0; i < items && r->next != NULL; i++) wire_skip(r, depth - 1);
}

/* Read an array of numbers, binary or a list. Return their number, 0 if there are too many. */
static int wire_msgpack_array(wire_reader *r, double *x)
{
    const wire_value array = wire_next(r);
    const uint32_t count = array.kind == WIRE_BYTES ? array.size / 8 : array.size;
    if (r->next == NULL || count > WIRE_MOST_JOINTS || (array.kind != WIRE_BYTES && array.kind != WIRE_LIST)) return 0;
    for (uint32_t i = 0; i < count; i++) {
        uint64_t bits = 0;
        for (uint32_t b = 0; array.kind == WIRE_BYTES && b < 8; b++) bits |= (uint64_t)array.bytes[8 * i + b] << 8 * b;
        if (array.kind == WIRE_BYTES)
            memcpy(x + i, &bits, sizeof bits);
        else
            x[i] = wire_next(r).number;
    }
    return r->next == NULL ? 0 : (int)count;
}

static int wire_read_msgpack(wire_reader *r, wire_command *c)
{
    const wire_value record = wire_next(r);
    if (record.kind != WIRE_MAP) return 0;
    for (uint32_t i = 0; i < record.size && r->next != NULL; i++) {
        const wire_value name = wire_next(r);
        if (r->next == NULL || name.kind != WIRE_TEXT) return 0;
        if (name.size == 8 && memcmp(name.bytes, "sequence", 8) == 0)
            c->sequence = wire_next(r).number;
        else if (name.size == 4 && memcmp(name.bytes, "time", 4) == 0)
            c->time = wire_next(r).number;
        else if (name.size == 6 && memcmp(name.bytes, "torque", 6) == 0)
            c->torque_count = wire_msgpack_array(r, c->torque);
        else
            wire_skip(r, WIRE_MOST_DEPTH);
    }
    return r->next != NULL;
}

/* ---- JSON --------------------------------------------------------------------------------------------------------------- */

/* Return the place after a text, a list, a record or another value that begins here; `end` if there is none. */
static const char *wire_json_skip(const char *at, const char *end)
{
    int depth = 0, is_text = 0;
    for (; at < end; at++) {
        if (is_text && *at == '\\') {
            at++;
        } else if (*at == '"') {
            is_text = !is_text;
            if (!is_text && depth == 0) return at + 1;
        } else if (!is_text && (*at == '{' || *at == '[')) {
            depth++;
        } else if (!is_text && (*at == '}' || *at == ']')) {
            if (depth == 0) return at;
            if (--depth == 0) return at + 1;
        } else if (!is_text && depth == 0 && *at == ',') {
            return at;
        }
    }
    return end;
}

/* Return the value of a field of the outermost record; NULL if there is none. The server writes no spaces. */
static const char *wire_json_field(const char *at, const char *end, const char *name)
{
    const size_t length = strlen(name);
    if (at >= end || *at != '{') return NULL;
    for (at++; at < end && *at == '"'; at++) {
        const char *const after = wire_json_skip(at, end);
        if (end - after < 2 || *after != ':') return NULL;
        if ((size_t)(after - at) == length + 2 && memcmp(at + 1, name, length) == 0) return after + 1;
        at = wire_json_skip(after + 1, end);
        if (at >= end || *at != ',') return NULL;
    }
    return NULL;
}

static int wire_read_json(const char *text, const char *end, wire_command *c)
{
    const char *const sequence = wire_json_field(text, end, "sequence"), *const time = wire_json_field(text, end, "time");
    const char *torque = wire_json_field(text, end, "torque");
    c->sequence = sequence == NULL ? 0.0 : strtod(sequence, NULL);
    c->time = time == NULL ? 0.0 : strtod(time, NULL);
    if (torque == NULL || *torque != '[') return text < end && *text == '{';
    while (*torque != ']' && c->torque_count < WIRE_MOST_JOINTS) {
        char *after;
        c->torque[c->torque_count++] = strtod(torque + 1, &after);
        if (after == torque + 1 || (*after != ',' && *after != ']')) return 0;
        torque = after;
    }
    return 1;
}

/* Read a command of `size` bytes, after which there is a zero byte. Return 0 if it is none. */
static int wire_read_command(const unsigned char *bytes, size_t size, wire_encoding encoding, wire_command *c)
{
    wire_reader r = {bytes, bytes + size};
    memset(c, 0, sizeof *c);
    return encoding == WIRE_JSON ? wire_read_json((const char *)bytes, (const char *)bytes + size, c)
                                 : wire_read_msgpack(&r, c);
}

#endif
