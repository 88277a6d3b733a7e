"""Plots a conversion: how far the mouth is open over time, and which viseme is heard, as an SVG picture that every browser shows.

    lipstream convert speech.wav -o mouth.json           # viseme weights, 100 frames a second
    lipstream cues speech.wav --set facs -o jaw.csv      # how far the mouth is open, in the last column
    python3 plot_conversion.py mouth.json jaw.csv plot.svg

Needs numpy and nothing else. In a notebook call `load` and hand its arrays to the plotting library of your choice.
"""
import json
import sys

import numpy as np

WIDTH, HEIGHT, ROW = 1000, 120, 16


def load(conversion, table):
    """Times (s) and weights [frames, 13] with their names, and times and openings (0 to 1)."""
    with open(conversion, encoding="utf-8") as file:
        said = json.load(file)
    weights = np.array(said["viseme_weights"], dtype=np.float32)
    times = said["first_frame_s"] + np.arange(len(weights)) / said["rate_hz"]
    rows = np.genfromtxt(table, delimiter=",", names=True)
    return times, weights, said["viseme_names"], rows["time"], rows["open"]


def runs(values):
    """Where each run of equal values begins and ends."""
    borders = np.flatnonzero(np.diff(values)) + 1
    return zip(np.r_[0, borders], np.r_[borders, len(values)])


def plot(times, weights, names, open_times, opening):
    """The picture's text: the opening as a line, below it a row for each viseme with bars where it is the likeliest."""
    end = max(times[-1], open_times[-1])
    across = lambda seconds: 60 + (WIDTH - 80) * seconds / end
    points = " ".join(f"{across(t):.1f},{HEIGHT - 10 - (HEIGHT - 20) * o:.1f}" for t, o in zip(open_times, opening))
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{HEIGHT + ROW * len(names) + 30}" font-family="sans-serif" font-size="11">',
        f'<text x="4" y="{HEIGHT / 2}">open</text>',
        f'<polyline fill="none" stroke="#c0392b" points="{points}"/>',
    ]
    for k, name in enumerate(names):
        out.append(f'<text x="4" y="{HEIGHT + ROW * k + 12}">{name}</text>')
    likeliest = weights.argmax(axis=1)
    step = times[1] - times[0] if len(times) > 1 else 0.01
    for first, last in runs(likeliest):
        left, right = across(times[first]), across(times[last - 1] + step)
        top = HEIGHT + ROW * likeliest[first] + 2
        out.append(f'<rect x="{left:.1f}" y="{top}" width="{right - left:.1f}" height="{ROW - 4}" fill="#2c3e50"/>')
    for second in range(int(end) + 1):
        out.append(f'<text x="{across(second):.1f}" y="{HEIGHT + ROW * len(names) + 20}">{second} s</text>')
    return "\n".join(out + ["</svg>"])


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit("usage: plot_conversion.py mouth.json jaw.csv plot.svg")
    conversion, table, picture = sys.argv[1:]
    with open(picture, "w", encoding="utf-8") as file:
        file.write(plot(*load(conversion, table)))
