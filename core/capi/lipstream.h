/* Speech in, mouth parameters out: lipstream's core for C and C++ (docs/c.md). Made by `cargo xtask header`; do not edit. */

#ifndef LIPSTREAM_H
#define LIPSTREAM_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/*
 Samples a second of the sound that a stream takes.
 */
#define LIPSTREAM_SAMPLE_RATE 16000

/*
 Most parameters of a frame.
 */
#define LIPSTREAM_MAX_PARAMETERS 96

/*
 Visemes of a model that has visemes; docs/visemes.md names them in their order.
 */
#define LIPSTREAM_VISEMES 13

/*
 What came of opening a stream.
 */
typedef enum LipstreamStatus {
  /*
   All is well.
   */
  LipstreamOk = 0,
  /*
   The memory is null, too small or not aligned.
   */
  LipstreamBadMemory = 1,
  /*
   The tables are null, damaged, or of another version or front end.
   */
  LipstreamBadTables = 2,
  /*
   No such profile.
   */
  LipstreamBadProfile = 3,
} LipstreamStatus;

/*
 How far a stream looks ahead; docs/design.md section 5.
 */
typedef enum LipstreamProfile {
  /*
   42.5 ms.
   */
  LipstreamLive = 0,
  /*
   72.5 ms.
   */
  LipstreamStandard = 1,
  /*
   All that the model can use: 92.5 ms for the shipped one.
   */
  LipstreamStudio = 2,
} LipstreamProfile;

/*
 One stream of sound through a model, in the caller's memory. It points into itself: its memory must not be moved or copied.
 */
typedef struct LipstreamStream LipstreamStream;

/*
 The mouth at one time, a hundred a second.
 */
typedef struct LipstreamFrame {
  /*
   Frame of the sound that the parameters belong to.
   */
  uint32_t frame;
  /*
   Sample at the centre of that frame's window, modulo 2^32.
   */
  uint32_t sample;
  /*
   Parameters that follow, as many as the model has.
   */
  uint16_t n_values;
  /*
   Viseme weights that follow: 13, or 0 where the model has no visemes.
   */
  uint16_t n_visemes;
  /*
   Parameters; lipstream_scale says what one unit of each is.
   */
  int16_t values[LIPSTREAM_MAX_PARAMETERS];
  /*
   Occupancy of each viseme, 255 is 1.
   */
  uint8_t visemes[LIPSTREAM_VISEMES];
} LipstreamFrame;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

/*
 Bytes that a stream takes.
 */
size_t lipstream_stream_bytes(void);

/*
 What the address of a stream's memory must be a multiple of; a power of two, 8 at most.
 */
size_t lipstream_stream_alignment(void);

/*
 Makes a stream in `memory`, of `memory_bytes` bytes, over the tables that `lipstream export` wrote. `profile` is a LipstreamProfile. On success `*stream` is
 the stream; otherwise it is null, and `why`, if it is not null, holds a sentence of at most `why_bytes` bytes with its zero.

 # Safety

 `memory` and `tables` are null or have so many bytes; the tables must stay where they are, unchanged, and the memory must not be moved or used
 otherwise, as long as the stream is used. `stream` may be written; `why` is null or has `why_bytes` bytes.
 */
enum LipstreamStatus lipstream_open(void *memory,
                                    size_t memory_bytes,
                                    const uint8_t *tables,
                                    size_t tables_bytes,
                                    uint32_t profile,
                                    struct LipstreamStream **stream,
                                    char *why,
                                    size_t why_bytes);

/*
 Takes samples, mono, 16 kHz, cut anywhere, up to the end of the next window; gives how many. Where they brought a frame, it is in `*frame` and
 `*has_frame` is true. Call it until all are taken. Samples after lipstream_finish begin a new stream.

 # Safety

 `stream` came from [`lipstream_open`] and nobody else uses it now; `samples` has `n_samples` samples; `frame` and `has_frame` may be written, or are null.
 */
size_t lipstream_push(struct LipstreamStream *stream,
                      const int16_t *samples,
                      size_t n_samples,
                      struct LipstreamFrame *frame,
                      bool *has_frame);

/*
 The frames that are still owed when the sound has ended, one a call into `*frame`; false when all are out.

 # Safety

 As for [`lipstream_push`].
 */
bool lipstream_finish(struct LipstreamStream *stream,
                      struct LipstreamFrame *frame);

/*
 Forgets everything; the next frame is frame 0.

 # Safety

 As for [`lipstream_push`].
 */
void lipstream_reset(struct LipstreamStream *stream);

/*
 Samples from the centre of a frame's window to the last sample that it waits for.

 # Safety

 As for [`lipstream_push`].
 */
size_t lipstream_delay_samples(struct LipstreamStream *stream);

/*
 Number that tells models apart: what `Hello` on the wire has, and `lipstream render` asks for.

 # Safety

 `stream` came from [`lipstream_open`].
 */
uint32_t lipstream_model_id(const struct LipstreamStream *stream);

/*
 Parameters of a frame.

 # Safety

 `stream` came from [`lipstream_open`].
 */
size_t lipstream_parameters(const struct LipstreamStream *stream);

/*
 What one unit of a parameter is in real units; 0 where there is no such parameter.

 # Safety

 `stream` came from [`lipstream_open`].
 */
float lipstream_scale(const struct LipstreamStream *stream, size_t parameter);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* LIPSTREAM_H */
