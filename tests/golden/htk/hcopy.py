#!/usr/bin/env python3
"""Sound to HTK's MFCC_E_D_A, as HTK's HCopy writes it with the settings in hcopy.conf.

    python3 hcopy.py SOUND.wav OUT.htk        writes the features of a sound
    python3 hcopy.py --compare FOLDER...      the largest difference from every *.htk that lies beside a *.wav

HTK may not be passed on, so a test that needs its output could not run on a fresh clone. This program takes HTK's place
there. It is written from the definition in The HTK Book (chapter 5, "Speech Input/Output"), not from the Rust code that it
judges, and shares nothing with it: a mistake in one is not a mistake in the other. README.md beside it says how far
it is from files that the real HCopy has written.

Only numpy is needed. All arithmetic is in doubles; HTK's own is partly in floats, which is what the difference comes from.
"""
import struct
import sys
import wave
from pathlib import Path

import numpy as np

SAMPLE_RATE = 16000
WINDOW = 400  # WINDOWSIZE: 25 ms
HOP = 160  # TARGETRATE: 10 ms
FFT = 512  # the next power of two
CHANNELS = 26  # NUMCHANS
CEPSTRA = 12  # NUMCEPS
LIFTER = 22  # CEPLIFTER
PREEMPHASIS = 0.97  # PREEMCOEF
DELTA_WINDOW = 2  # DELTAWINDOW and ACCWINDOW, HTK's default

# The last two bytes of the header: the basic kind MFCC with the qualifiers _E, _D and _A.
KIND = 6 | 0o100 | 0o400 | 0o1000


def read_wav(path):
    """Samples as doubles at the scale of 16-bit integers, which is the scale HTK computes at."""
    with wave.open(str(path), "rb") as sound:
        if (sound.getframerate(), sound.getsampwidth(), sound.getnchannels()) != (SAMPLE_RATE, 2, 1):
            raise SystemExit(f"{path}: 16-bit mono samples at {SAMPLE_RATE} Hz are needed")
        return np.frombuffer(sound.readframes(sound.getnframes()), dtype="<i2").astype(float)


def windows(samples):
    """Every whole window; what is left at the end is not analysed."""
    count = (len(samples) - WINDOW) // HOP + 1
    if count < 1:
        raise SystemExit(f"{len(samples)} samples are less than one window")
    return np.stack([samples[HOP * t : HOP * t + WINDOW] for t in range(count)])


def log_energy(frames):
    """RAWENERGY: the logarithm of the sum of squares before pre-emphasis and window. HTK's logarithm of nothing is -1e10."""
    energy = (frames**2).sum(axis=1)
    return np.where(energy > 0, np.log(np.maximum(energy, 1e-300)), -1e10)


def preemphasise(frames):
    """s'[i] = s[i] - k s[i-1] within the window. A window's first sample has no predecessor in it and stands for its own."""
    previous = np.concatenate([frames[:, :1], frames[:, :-1]], axis=1)
    return frames - PREEMPHASIS * previous


def hamming():
    """USEHAMMING: 0.54 - 0.46 cos(2 pi i / (N - 1)), i = 0..N-1."""
    return 0.54 - 0.46 * np.cos(2 * np.pi * np.arange(WINDOW) / (WINDOW - 1))


def mel(hertz):
    return 1127 * np.log(1 + hertz / 700)


def filterbank():
    """The weights of the channels, [bins, channels].

    The channels are triangles, equally wide and half overlapping on the mel scale, from 0 Hz to half the sample rate. A bin
    between the peaks of two neighbours belongs to both, in shares that sum to 1; below the first peak and above the last one
    the other share is lost. The bins at 0 Hz and at half the sample rate belong to no channel.
    """
    peaks = mel(SAMPLE_RATE / 2) * np.arange(CHANNELS + 2) / (CHANNELS + 1)
    weights = np.zeros((FFT // 2 + 1, CHANNELS))
    for channel in range(CHANNELS):
        below, peak, above = peaks[channel : channel + 3]
        for bin_ in range(1, FFT // 2):
            m = mel(bin_ * SAMPLE_RATE / FFT)
            rising = (m - below) / (peak - below)
            falling = (above - m) / (above - peak)
            weights[bin_, channel] = max(0.0, min(rising, falling))
    return weights


def cepstra(log_channels):
    """c1..c12: the cosine transform with the factor sqrt(2/N), then the lifter 1 + L/2 sin(pi n/L)."""
    n = np.arange(1, CEPSTRA + 1)
    j = np.arange(1, CHANNELS + 1)
    cosines = np.sqrt(2 / CHANNELS) * np.cos(np.pi * np.outer(j - 0.5, n) / CHANNELS)
    return log_channels @ cosines * (1 + LIFTER / 2 * np.sin(np.pi * n / LIFTER))


def slopes(values):
    """The regression over two frames on each side; beyond the ends the first and the last frame are repeated."""
    count = len(values)
    padded = np.concatenate([values[:1]] * DELTA_WINDOW + [values] + [values[-1:]] * DELTA_WINDOW)
    total = np.zeros_like(values)
    for k in range(1, DELTA_WINDOW + 1):
        later = padded[DELTA_WINDOW + k : DELTA_WINDOW + k + count]
        earlier = padded[DELTA_WINDOW - k : DELTA_WINDOW - k + count]
        total += k * (later - earlier)
    return total / (2 * sum(k * k for k in range(1, DELTA_WINDOW + 1)))


def features(samples):
    """[frames, 39]: c1..c12 and E, the slopes of these thirteen, the slopes of those."""
    frames = windows(samples)
    # USEPOWER is off by default: the channels add up magnitudes, not their squares.
    magnitudes = np.abs(np.fft.rfft(preemphasise(frames) * hamming(), FFT, axis=1))
    # HTK floors a channel's sum at 1 before the logarithm.
    channels = np.log(np.maximum(magnitudes @ filterbank(), 1.0))
    statics = np.column_stack([cepstra(channels), log_energy(frames)])
    deltas = slopes(statics)
    return np.concatenate([statics, deltas, slopes(deltas)], axis=1)


def write_htk(path, values):
    """Frames, their period in 100 ns, bytes of a frame, kind; then the numbers. Everything has its high byte first."""
    header = struct.pack(">iihh", len(values), HOP * 10_000_000 // SAMPLE_RATE, 4 * values.shape[1], KIND)
    Path(path).write_bytes(header + values.astype(">f4").tobytes())


def read_htk(path):
    data = Path(path).read_bytes()
    count, period, size, kind = struct.unpack(">iihh", data[:12])
    if (period, size, kind) != (100_000, 156, KIND) or len(data) != 12 + count * size:
        raise SystemExit(f"{path}: not an uncompressed MFCC_E_D_A file at 10 ms")
    return np.frombuffer(data[12:], dtype=">f4").reshape(count, size // 4).astype(float)


def compare(folder):
    """Prints the largest difference between this program's features and those in each file of the folder."""
    pairs = [(path.with_suffix(".wav"), path) for path in sorted(Path(folder).glob("*.htk"))]
    if not pairs:
        raise SystemExit(f"{folder}: no *.htk")
    for sound, golden in pairs:
        ours, theirs = features(read_wav(sound)).astype(np.float32), read_htk(golden)
        if ours.shape != theirs.shape:
            raise SystemExit(f"{golden}: {theirs.shape} numbers, not {ours.shape}")
        print(f"{golden.name}: {len(ours)} frames, largest difference {np.abs(ours - theirs).max():.2e}")


def main(arguments):
    if arguments[:1] == ["--compare"] and len(arguments) > 1:
        for folder in arguments[1:]:
            compare(folder)
    elif len(arguments) == 2 and not arguments[0].startswith("-"):
        write_htk(arguments[1], features(read_wav(arguments[0])))
    else:
        raise SystemExit(__doc__)


if __name__ == "__main__":
    main(sys.argv[1:])
