// A jaw that speaks, in an Arduino sketch: sound in, a servo's angle out. Needs about 45 KiB of RAM and 180 KiB of flash for the tables.
//
// `tables.h` is made of a model's tables: `xxd -i grid-s1.tables > tables.h`. The library is made for the board's processor:
// `cargo rustc -p lipstream-capi --profile firmware --target thumbv7em-none-eabihf --crate-type staticlib`.
#include "lipstream.h"
#include "tables.h"

// What a board brings: samples at 16 kHz (how many came, at most so many), and a servo.
extern "C" int read_microphone(int16_t *to, int most);
extern "C" void move_jaw(int degrees);

// How far a jaw opens for each viseme, in degrees; the order is the stream's (docs/wire.md).
static const float OPEN[LIPSTREAM_VISEMES] = {0, 30, 14, 24, 13, 13, 5, 8, 9, 0, 7, 4, 10};

alignas(8) static uint8_t memory[64 * 1024];
static LipstreamStream *stream;

void setup() {
    char why[120];
    if (lipstream_open(memory, sizeof memory, grid_s1_tables, grid_s1_tables_len, LipstreamLive, &stream, why, sizeof why) != LipstreamOk) {
        for (;;) {
            // `why` says what is wrong, to whoever looks with a debugger.
        }
    }
}

void loop() {
    int16_t samples[160];
    const int count = read_microphone(samples, 160);
    LipstreamFrame frame;
    bool has_frame;
    for (size_t at = 0; at < (size_t)count;) {
        at += lipstream_push(stream, samples + at, (size_t)count - at, &frame, &has_frame);
        if (has_frame) {
            float jaw = 0.0f;
            for (size_t viseme = 0; viseme < frame.n_visemes; viseme++) {
                jaw += OPEN[viseme] * frame.visemes[viseme] / 255.0f;
            }
            move_jaw((int)jaw);
        }
    }
}
