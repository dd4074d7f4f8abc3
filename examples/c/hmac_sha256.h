/* HMAC-SHA256 (FIPS 180-4, RFC 2104), for messages of a stream with authentication. Use a library where you have one. */
#ifndef HMAC_SHA256_H
#define HMAC_SHA256_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

enum { SHA256_BLOCK = 64, SHA256_BYTES = 32 };

/* State of a hash: eight words, the block that is not full, and the number of bytes so far. */
typedef struct {
    uint32_t word[8];
    unsigned char block[SHA256_BLOCK];
    uint64_t count;
} sha256_state;

static uint32_t sha256_rotate(uint32_t x, int bits)
{
    return x >> bits | x << (32 - bits);
}

static void sha256_add_block(sha256_state *s, const unsigned char *block)
{
    static const uint32_t k[64] = {
        0x428a2f98, 0x71374491, 0xb5c0fbcf, 0xe9b5dba5, 0x3956c25b, 0x59f111f1, 0x923f82a4, 0xab1c5ed5, 0xd807aa98, 0x12835b01,
        0x243185be, 0x550c7dc3, 0x72be5d74, 0x80deb1fe, 0x9bdc06a7, 0xc19bf174, 0xe49b69c1, 0xefbe4786, 0x0fc19dc6, 0x240ca1cc,
        0x2de92c6f, 0x4a7484aa, 0x5cb0a9dc, 0x76f988da, 0x983e5152, 0xa831c66d, 0xb00327c8, 0xbf597fc7, 0xc6e00bf3, 0xd5a79147,
        0x06ca6351, 0x14292967, 0x27b70a85, 0x2e1b2138, 0x4d2c6dfc, 0x53380d13, 0x650a7354, 0x766a0abb, 0x81c2c92e, 0x92722c85,
        0xa2bfe8a1, 0xa81a664b, 0xc24b8b70, 0xc76c51a3, 0xd192e819, 0xd6990624, 0xf40e3585, 0x106aa070, 0x19a4c116, 0x1e376c08,
        0x2748774c, 0x34b0bcb5, 0x391c0cb3, 0x4ed8aa4a, 0x5b9cca4f, 0x682e6ff3, 0x748f82ee, 0x78a5636f, 0x84c87814, 0x8cc70208,
        0x90befffa, 0xa4506ceb, 0xbef9a3f7, 0xc67178f2};
    uint32_t w[64], v[8];
    for (int i = 0; i < 16; i++)
        w[i] = (uint32_t)block[4 * i] << 24 | (uint32_t)block[4 * i + 1] << 16 | (uint32_t)block[4 * i + 2] << 8 |
               block[4 * i + 3];
    for (int i = 16; i < 64; i++) {
        const uint32_t a = w[i - 15], b = w[i - 2];
        w[i] = w[i - 16] + w[i - 7] + (sha256_rotate(a, 7) ^ sha256_rotate(a, 18) ^ a >> 3) +
               (sha256_rotate(b, 17) ^ sha256_rotate(b, 19) ^ b >> 10);
    }
    memcpy(v, s->word, sizeof v);
    for (int i = 0; i < 64; i++) {
        const uint32_t e = sha256_rotate(v[4], 6) ^ sha256_rotate(v[4], 11) ^ sha256_rotate(v[4], 25);
        const uint32_t a = sha256_rotate(v[0], 2) ^ sha256_rotate(v[0], 13) ^ sha256_rotate(v[0], 22);
        const uint32_t first = v[7] + e + ((v[4] & v[5]) ^ (~v[4] & v[6])) + k[i] + w[i];
        const uint32_t second = a + ((v[0] & v[1]) ^ (v[0] & v[2]) ^ (v[1] & v[2]));
        memmove(v + 1, v, 7 * sizeof *v);
        v[4] += first;
        v[0] = first + second;
    }
    for (int i = 0; i < 8; i++) s->word[i] += v[i];
}

static void sha256_begin(sha256_state *s)
{
    static const uint32_t start[8] = {0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a,
                                      0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19};
    memcpy(s->word, start, sizeof start);
    s->count = 0;
}

static void sha256_add(sha256_state *s, const void *data, size_t size)
{
    for (size_t i = 0; i < size; i++) {
        s->block[s->count++ % SHA256_BLOCK] = ((const unsigned char *)data)[i];
        if (s->count % SHA256_BLOCK == 0) sha256_add_block(s, s->block);
    }
}

static void sha256_end(sha256_state *s, unsigned char hash[SHA256_BYTES])
{
    const uint64_t bits = 8 * s->count;
    unsigned char length[8];
    for (int i = 0; i < 8; i++) length[i] = (unsigned char)(bits >> (56 - 8 * i));
    sha256_add(s, "\x80", 1);
    while (s->count % SHA256_BLOCK != SHA256_BLOCK - 8) sha256_add(s, "", 1);
    sha256_add(s, length, sizeof length);
    for (int i = 0; i < SHA256_BYTES; i++) hash[i] = (unsigned char)(s->word[i / 4] >> (24 - 8 * (i % 4)));
}

/* Compute HMAC-SHA256 with a key of 32 bytes, of a message in three parts. */
static void hmac_sha256(const unsigned char key[SHA256_BYTES], const void *const parts[3], const size_t sizes[3],
                        unsigned char code[SHA256_BYTES])
{
    unsigned char pad[SHA256_BLOCK] = {0};
    sha256_state s;
    memcpy(pad, key, SHA256_BYTES);
    for (int i = 0; i < SHA256_BLOCK; i++) pad[i] ^= 0x36;
    sha256_begin(&s);
    sha256_add(&s, pad, sizeof pad);
    for (int i = 0; i < 3; i++) sha256_add(&s, parts[i], sizes[i]);
    sha256_end(&s, code);
    for (int i = 0; i < SHA256_BLOCK; i++) pad[i] ^= 0x36 ^ 0x5c;
    sha256_begin(&s);
    sha256_add(&s, pad, sizeof pad);
    sha256_add(&s, code, SHA256_BYTES);
    sha256_end(&s, code);
}

#endif
