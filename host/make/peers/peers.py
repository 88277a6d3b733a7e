#!/usr/bin/env python3
"""Trains recurrent networks on exported features: the peers that our own model is measured against.

    lipstream features FEATURES -o EXPORT
    python3 peers.py EXPORT -o PREDICTIONS --net gru128 --seed 1 [--audio EXPORT ...]
    lipstream evaluate FEATURES --predictions gru128@80=PREDICTIONS

A network hears the 39 numbers of every frame (MFCC_E_D_A, causally normalised) and says the mouth of the frame that lies
`--look-ahead` before it. As delta-deltas look four frames ahead themselves, it waits four frames less than that. The loss is that of
our own training without its coupled HMM: standardised errors weighted by each parameter's deviation, and the cross-entropy of phones (weight 0.05),
in clips with sound only too. The running mean of the parameters with the least error on validation clips speaks.
Needs numpy and jax.
"""
import argparse
import json
import os
import sys
import time

import numpy as np

NETS = {"gru64": (64, False), "gru128": (128, False), "gru256": (256, False), "bigru128": (128, True)}
DELTA_FRAMES = 4  # Delta-deltas look so far ahead.
BATCH = 20
PHONE_WEIGHT = 0.05
RATE, WARM_UP, CUT, KEEP = 0.003, 60, 0.5, 0.98
DECAY = 0.003  # Part of its length that a weight loses in a step at the highest rate.
CROP = 160  # Frames of a piece in half of the batches, which starts where it has heard nothing.
INPUT_DROPOUT = 0.0  # Share of the numbers of every frame that are not heard.


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("export", help="folder that `lipstream features FEATURES -o EXPORT` has written")
    parser.add_argument("-o", "--output", required=True, help="folder for ID.npy of every validation and test clip")
    parser.add_argument("--audio", action="append", default=[], help="export of clips with sound only, whose phones are learnt too")
    parser.add_argument("--net", choices=sorted(NETS), default="gru128")
    parser.add_argument("--look-ahead", type=int, default=8, help="frames of 10 ms; a bidirectional network hears the whole clip")
    parser.add_argument("--passes", type=int, default=70)
    parser.add_argument("--noise", type=float, default=0.15, help="deviation of the noise on standardised statics, a frame and a clip each")
    parser.add_argument("--seed", type=int, default=1)
    return parser.parse_args()


def frame_phones(clip, names):
    """Index of the phone of each frame, -1 where none is known: labels, else pronunciations spread evenly over timed words."""
    out = np.full(clip["frames"], -1, np.int32)
    spans = [(p["phone"], p["start"], p["end"]) for p in clip["phones"]]
    if not spans and clip["words"] and all(w["time"] for w in clip["words"]):
        out[:] = names.setdefault("sil", len(names))
        for word in clip["words"]:
            start, end = word["time"]
            said = word["pronunciations"][0]
            step = (end - start) / len(said)
            spans += [(phone, start + i * step, start + (i + 1) * step) for i, phone in enumerate(said)]
    for phone, start, end in spans:
        out[round(start * 100) : round(end * 100)] = names.setdefault(phone, len(names))
    return out


def load(folder, names):
    """Clips by split: (id, sound [T, 39], mouth [T, D] or None, phones [T])."""
    with open(os.path.join(folder, "index.json"), encoding="utf-8") as file:
        index = json.load(file)
    clips = {"train": [], "val": [], "test": []}
    for clip in index["clips"]:
        read = lambda kind: np.load(os.path.join(folder, clip[kind])).astype(np.float32) if clip[kind] else None
        clips[clip["split"]].append((clip["id"], read("audio"), read("visual"), frame_phones(clip, names)))
    return clips


def main():
    args = arguments()
    import jax
    import jax.numpy as jnp

    size, both_ways = NETS[args.net]
    wait = 0 if both_ways else args.look_ahead - DELTA_FRAMES
    if wait < 0:
        sys.exit(f"peers.py: delta-deltas look {DELTA_FRAMES} frames ahead: give --look-ahead {DELTA_FRAMES} or more")
    names = {}
    clips = load(args.export, names)
    seen = [c for c in clips["train"] if c[2] is not None]
    heard = [c for folder in args.audio for c in load(folder, names)["train"]]
    if not seen or not clips["val"]:
        sys.exit(f"peers.py: {args.export} has no clip with video to train on, or none to validate on")
    sound = np.concatenate([c[1] for c in seen])
    mouth = np.concatenate([c[2] for c in seen])
    centre, spread = sound.mean(0), sound.std(0) + 1e-6
    deviation = mouth.std(0) + 1e-6
    weights = jnp.asarray(deviation / deviation.sum())
    outputs, phones = mouth.shape[1], len(names)
    rng = np.random.default_rng(args.seed)

    def cell_parameters(inputs):
        uniform = lambda *shape: rng.uniform(-1, 1, shape).astype(np.float32) / np.sqrt(size)
        return {"in": uniform(inputs, 3 * size), "again": uniform(size, 3 * size), "bias": uniform(3 * size), "bias_again": uniform(3 * size)}

    width = size * (2 if both_ways else 1)
    parameters = {
        "forth": cell_parameters(39),
        "mouth": rng.normal(0, 0.02, (width, outputs)).astype(np.float32),
        "mouth_bias": np.zeros(outputs, np.float32),
        "phone": rng.normal(0, 0.02, (width, phones)).astype(np.float32),
        "phone_bias": np.zeros(phones, np.float32),
    }
    if both_ways:
        parameters["back"] = cell_parameters(39)
    parameters = jax.tree.map(jnp.asarray, parameters)

    def run(p, x, valid, backwards):
        """Memory after every frame, [T, batch, size]; padding leaves it as it is."""
        drive = x @ p["in"] + p["bias"]

        def step(h, now):
            d, ok = now
            again = h @ p["again"] + p["bias_again"]
            r, z = jax.nn.sigmoid(d[:, :size] + again[:, :size]), jax.nn.sigmoid(d[:, size : 2 * size] + again[:, size : 2 * size])
            n = jnp.tanh(d[:, 2 * size :] + r * again[:, 2 * size :])
            h = jnp.where(ok[:, None], (1 - z) * n + z * h, h)
            return h, h

        return jax.lax.scan(step, jnp.zeros((x.shape[1], size)), (drive, valid), reverse=backwards)[1]

    def say(p, x, valid, keep):
        """Standardised mouth and phone logits of each frame, from x [T + wait, batch, 39]."""
        h = run(p["forth"], x, valid, False)
        if both_ways:
            h = jnp.concatenate([h, run(p["back"], x, valid, True)], 2)
        h = h[wait:]
        return (h * keep) @ p["mouth"] + p["mouth_bias"], h @ p["phone"] + p["phone_bias"]

    def loss(p, batch, keep):
        x, valid, y, in_video, phone = batch
        said, logits = say(p, x, valid, keep)
        error = (((said - y) ** 2 * weights).sum(2) * in_video).sum() / jnp.maximum(in_video.sum(), 1)
        known = phone >= 0
        chosen = jnp.take_along_axis(jax.nn.log_softmax(logits), jnp.maximum(phone, 0)[:, :, None], 2)[:, :, 0]
        return error - PHONE_WEIGHT * (chosen * known).sum() / jnp.maximum(known.sum(), 1)

    def batch_of(chosen, length, noisy):
        n = len(chosen)
        x = np.zeros((length + wait, n, 39), np.float32)
        valid = np.zeros((length + wait, n), bool)
        y = np.zeros((length, n, outputs), np.float32)
        in_video = np.zeros((length, n), np.float32)
        phone = np.full((length, n), -1, np.int32)
        for i, (_, audio, visual, labels) in enumerate(chosen):
            frames = min(len(audio), length)
            part = (audio[:frames] - centre) / spread
            if noisy:
                part[:, :13] += rng.normal(0, args.noise, (frames, 13)) + rng.normal(0, args.noise, 13)
                part *= (rng.random(part.shape) > INPUT_DROPOUT) / (1 - INPUT_DROPOUT)
            x[:frames, i] = part
            x[frames : frames + wait, i] = part[-1]
            valid[: frames + wait, i] = True
            if visual is not None:
                both = min(frames, len(visual))
                y[:both, i] = visual[:both] / deviation
                in_video[:both, i] = 1
            phone[: min(frames, len(labels)), i] = labels[:frames]
        return x, valid, y, in_video, phone

    def crop(clip):
        name, audio, visual, labels = clip
        first = int(rng.integers(0, max(len(audio) - CROP, 0) + 1))
        part = slice(first, first + CROP)
        return name, audio[part], None if visual is None else visual[part], labels[part]

    longest = max(len(c[1]) for split in clips.values() for c in split)
    heard_a_batch = round(BATCH * len(heard) / len(seen))
    steps_a_pass = max(len(seen) // BATCH, 1)
    steps = args.passes * steps_a_pass

    @jax.jit
    def update(p, m, v, mean, batch, keep, t):
        value, g = jax.value_and_grad(loss)(p, batch, keep)
        norm = jnp.sqrt(sum((leaf**2).sum() for leaf in jax.tree.leaves(g)))
        g = jax.tree.map(lambda leaf: leaf * jnp.minimum(1, CUT / (norm + 1e-12)), g)
        m = jax.tree.map(lambda a, b: 0.9 * a + 0.1 * b, m, g)
        v = jax.tree.map(lambda a, b: 0.99 * a + 0.01 * b * b, v, g)
        rate = RATE * jnp.minimum(t / WARM_UP, 0.5 * (1 + jnp.cos(jnp.pi * t / steps)))
        at = lambda moment, beta: moment / (1 - beta**t)
        p = jax.tree.map(lambda a, b, c: a - rate * at(b, 0.9) / (jnp.sqrt(at(c, 0.99)) + 1e-8) - DECAY * rate / RATE * a * (a.ndim > 1), p, m, v)
        keeping = jnp.minimum(KEEP, t / (t + 10))
        mean = jax.tree.map(lambda a, b: keeping * a + (1 - keeping) * b, mean, p)
        return p, m, v, mean, value

    speak = jax.jit(lambda p, x, valid: say(p, x, valid, 1.0)[0])

    def predict(p, chosen):
        out = []
        for first in range(0, len(chosen), BATCH):
            part = chosen[first : first + BATCH]
            x, valid, *_ = batch_of(part + [part[-1]] * (BATCH - len(part)), longest, False)
            said = np.asarray(speak(p, x, valid)) * deviation
            out += [said[: len(c[1]), i] for i, c in enumerate(part)]
        return out

    def amse(p):
        said = predict(p, clips["val"])
        errors = [((s[: len(c[2])] - c[2][: len(s)]) ** 2).sum(1) for s, c in zip(said, clips["val"])]
        return float(np.concatenate(errors).mean())

    zeros = jax.tree.map(jnp.zeros_like, parameters)
    m, v, mean = zeros, zeros, parameters
    best, kept, t, begun = np.inf, parameters, 0, time.time()
    for number in range(1, args.passes + 1):
        order = rng.permutation(len(seen))
        total = 0.0
        for step in range(steps_a_pass):
            chosen = [seen[i] for i in order[step * BATCH : (step + 1) * BATCH]]
            chosen += [heard[i] for i in rng.integers(0, len(heard), heard_a_batch)] if heard else []
            t += 1
            length = longest
            if rng.random() < 0.5:
                chosen, length = [crop(clip) for clip in chosen], CROP
            keep = jnp.asarray((rng.random((1, len(chosen), width)) > 0.2) / 0.8, jnp.float32)
            parameters, m, v, mean, value = update(parameters, m, v, mean, batch_of(chosen, length, True), keep, float(t))
            total += float(value)
        judged = amse(mean)
        if judged < best:
            best, kept = judged, mean
        if number % 10 == 0 or number == args.passes:
            print(f"pass {number}/{args.passes}: loss {total / steps_a_pass:.4f}; validation AMSE {judged:.0f}, least {best:.0f}; {time.time() - begun:.0f} s", flush=True)
    os.makedirs(args.output, exist_ok=True)
    judges = clips["val"] + clips["test"]
    for (name, *_), said in zip(judges, predict(kept, judges)):
        np.save(os.path.join(args.output, f"{name}.npy"), said.astype(np.float32))
    count = sum(leaf.size for leaf in jax.tree.leaves(kept)) - kept["phone"].size - phones
    print(f"{args.output}: {len(judges)} clips; {count} parameters ({count / 1024:.0f} KiB at 8 bits)")


if __name__ == "__main__":
    main()
