/* Converts a WAV (16 kHz, mono, 16 bits) with a model's tables: float rows of mouth parameters, a hundred a second, as raw numbers on standard output.
 *
 *     cc convert.c -I.. liblipstream_c.a -lpthread -ldl -lm -o convert
 *     ./convert models/grid-s1.tables data/hello.wav > mouth.f32
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "lipstream.h"

/* A whole file, or the end of the program. */
static unsigned char *whole(const char *path, size_t *bytes) {
    FILE *file = fopen(path, "rb");
    long length = -1;
    if (file != NULL && fseek(file, 0, SEEK_END) == 0) {
        length = ftell(file);
        rewind(file);
    }
    unsigned char *data = length < 0 ? NULL : malloc((size_t)length + 1);
    if (data == NULL || fread(data, 1, (size_t)length, file) != (size_t)length) {
        fprintf(stderr, "convert: cannot read %s\n", path);
        exit(1);
    }
    fclose(file);
    *bytes = (size_t)length;
    return data;
}

static unsigned long u32_at(const unsigned char *at) {
    return at[0] | (unsigned long)at[1] << 8 | (unsigned long)at[2] << 16 | (unsigned long)at[3] << 24;
}

/* The samples of a WAV, whose chunks follow each other at even places. */
static const unsigned char *samples_of(const unsigned char *wav, size_t bytes, size_t *n_samples) {
    static const unsigned char wanted[] = {1, 0, 1, 0, 0x80, 0x3e, 0, 0}; /* PCM, one channel, 16,000 Hz */
    int is_wanted = 0;
    if (bytes < 12 || memcmp(wav, "RIFF", 4) != 0 || memcmp(wav + 8, "WAVE", 4) != 0) {
        return NULL;
    }
    for (size_t at = 12; at + 8 <= bytes;) {
        size_t length = u32_at(wav + at + 4);
        const unsigned char *body = wav + at + 8;
        if (length > bytes - at - 8) {
            length = bytes - at - 8;
        }
        if (memcmp(wav + at, "fmt ", 4) == 0 && length >= 16) {
            is_wanted = memcmp(body, wanted, sizeof wanted) == 0 && body[14] == 16;
        } else if (memcmp(wav + at, "data", 4) == 0 && is_wanted) {
            *n_samples = length / 2;
            return body;
        }
        at += 8 + length + length % 2;
    }
    return NULL;
}

/* One row of real numbers. */
static void put(const LipstreamStream *stream, const LipstreamFrame *frame) {
    for (size_t i = 0; i < frame->n_values; i++) {
        float value = (float)frame->values[i] * lipstream_scale(stream, i);
        fwrite(&value, sizeof value, 1, stdout);
    }
}

int main(int count, char **words) {
    if (count != 3) {
        fprintf(stderr, "convert: write MODEL.tables SPEECH.wav\n");
        return 2;
    }
    size_t tables_bytes, wav_bytes, left = 0;
    unsigned char *tables = whole(words[1], &tables_bytes);
    unsigned char *wav = whole(words[2], &wav_bytes);
    const unsigned char *sound = samples_of(wav, wav_bytes, &left);
    if (sound == NULL) {
        fprintf(stderr, "convert: %s is no WAV of 16 kHz, mono, 16 bits\n", words[2]);
        return 1;
    }

    void *memory = malloc(lipstream_stream_bytes());
    LipstreamStream *stream;
    char why[200];
    if (lipstream_open(memory, lipstream_stream_bytes(), tables, tables_bytes, LipstreamStudio, &stream, why, sizeof why) != LipstreamOk) {
        fprintf(stderr, "convert: %s: %s\n", words[1], why);
        return 1;
    }
    LipstreamFrame frame;
    while (left > 0) {
        int16_t piece[160];
        size_t length = left < 160 ? left : 160;
        for (size_t i = 0; i < length; i++) {
            piece[i] = (int16_t)(sound[2 * i] | sound[2 * i + 1] << 8);
        }
        bool has_frame;
        size_t taken = lipstream_push(stream, piece, length, &frame, &has_frame);
        if (has_frame) {
            put(stream, &frame);
        }
        sound += 2 * taken;
        left -= taken;
    }
    while (lipstream_finish(stream, &frame)) {
        put(stream, &frame);
    }
    free(memory);
    free(wav);
    free(tables);
    return 0;
}
