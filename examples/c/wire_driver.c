/* A driver of a stream without a library: states and commands of docs/wire.md in JSON or MessagePack, with authentication.
 *
 *     wire_driver state   json|msgpack KEY JOINTS  < numbers of a state   > attachment and payload
 *     wire_driver command json|msgpack KEY         < attachment, payload  > sequence, time and torques, as text
 *
 * KEY is the `key` of the reply that opened the stream. A program with Zenoh puts payload and attachment to
 * graspforce/1/streams/<id>/state, and gets those of commands from graspforce/1/streams/<id>/command. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "hmac_sha256.h"
#include "wire_command.h"
#include "wire_state.h"

enum { COUNTER = 8, CODE = 16, ATTACHMENT = COUNTER + CODE };

static unsigned char input[WIRE_MOST_BYTES + 1];
static wire_message message;

/* Compute the attachment of a message: the counter, and the code of direction, counter and payload. */
static void sign(const unsigned char key[SHA256_BYTES], char direction, uint64_t counter, const void *payload, size_t size,
                 unsigned char attachment[ATTACHMENT])
{
    unsigned char code[SHA256_BYTES];
    const void *const parts[3] = {&direction, attachment, payload};
    const size_t sizes[3] = {1, COUNTER, size};
    for (int i = 0; i < COUNTER; i++) attachment[i] = (unsigned char)(counter >> 8 * i);
    hmac_sha256(key, parts, sizes, code);
    memcpy(attachment + COUNTER, code, CODE);
}

/* Return whether the attachment of a command is that of its payload, with a counter above the last one. */
static int is_genuine(const unsigned char key[SHA256_BYTES], const unsigned char attachment[ATTACHMENT], const void *payload,
                      size_t size, uint64_t last)
{
    unsigned char expected[ATTACHMENT], difference = 0;
    uint64_t counter = 0;
    for (int i = 0; i < COUNTER; i++) counter |= (uint64_t)attachment[i] << 8 * i;
    sign(key, 'C', counter, payload, size, expected);
    for (int i = 0; i < ATTACHMENT; i++) difference |= expected[i] ^ attachment[i]; /* in constant time */
    return difference == 0 && counter > last;
}

static int read_key(const char *text, unsigned char key[SHA256_BYTES])
{
    if (strlen(text) != 2 * SHA256_BYTES) return 0;
    for (int i = 0; i < SHA256_BYTES; i++) {
        unsigned byte;
        if (sscanf(text + 2 * i, "%2x", &byte) != 1) return 0;
        key[i] = (unsigned char)byte;
    }
    return 1;
}

/* Read doubles from standard input. */
static int read_numbers(double *x, int count)
{
    return fread(x, sizeof *x, (size_t)count, stdin) == (size_t)count;
}

static int send_state(wire_encoding encoding, const unsigned char key[SHA256_BYTES], int joints)
{
    static wire_state s;
    unsigned char attachment[ATTACHMENT];
    if (joints < 1 || joints > WIRE_MOST_JOINTS) return 2;
    s.sequence = 1, s.joint_count = joints;
    if (!read_numbers(&s.time, 1) || !read_numbers(s.posture, joints) || !read_numbers(s.velocity, joints) ||
        !read_numbers(s.position, 3) || !read_numbers(s.rotation, 9) || !read_numbers(s.twist, 6) ||
        !read_numbers(s.desired_position, 3) || !read_numbers(s.desired_rotation, 9) || !read_numbers(s.desired_twist, 6) ||
        !read_numbers(s.desired_acceleration, 6))
        return 2;
    wire_encode_state(&s, encoding, &message);
    if (message.size > sizeof message.bytes) return 2;
    sign(key, 'S', s.sequence, message.bytes, message.size, attachment);
    return fwrite(attachment, 1, ATTACHMENT, stdout) != ATTACHMENT ||
           fwrite(message.bytes, 1, message.size, stdout) != message.size;
}

static int receive_command(wire_encoding encoding, const unsigned char key[SHA256_BYTES])
{
    wire_command c;
    const size_t size = fread(input, 1, WIRE_MOST_BYTES, stdin);
    if (size < ATTACHMENT || !is_genuine(key, input, input + ATTACHMENT, size - ATTACHMENT, 0)) {
        printf("not genuine\n");
        return 1;
    }
    if (!wire_read_command(input + ATTACHMENT, size - ATTACHMENT, encoding, &c)) {
        printf("no command\n");
        return 1;
    }
    printf("%.0f %.17g", c.sequence, c.time);
    for (int i = 0; i < c.torque_count; i++) printf(" %.17g", c.torque[i]);
    printf("\n");
    return 0;
}

int main(int argc, char **argv)
{
    unsigned char key[SHA256_BYTES];
    if (argc < 4 || !read_key(argv[3], key)) {
        fprintf(stderr, "usage: wire_driver state json|msgpack KEY JOINTS, or wire_driver command json|msgpack KEY\n");
        return 2;
    }
    const wire_encoding encoding = strcmp(argv[2], "msgpack") == 0 ? WIRE_MSGPACK : WIRE_JSON;
    if (strcmp(argv[1], "state") == 0) return send_state(encoding, key, argc > 4 ? atoi(argv[4]) : 0);
    return receive_command(encoding, key);
}
