"""Blender: keyframes for the shape keys of the active object from a table of weights.

    lipstream cues speech.wav --set arkit --rate 24 -o speech.csv
    blender face.blend --python blender_shape_keys.py -- speech.csv

Any set does whose names the face's shape keys have: arkit, oculus, vrm. Rows lie at their times in the scene's own rate, so that the rate of the table may be another one.
Columns without a shape key of their name are left out, and said.
"""
import csv
import sys

import bpy


def animate(face, scene, table):
    """Sets a keyframe for each weight of the table; gives the names that the face does not have."""
    keys = face.data.shape_keys
    if keys is None:
        sys.exit(f"{face.name} has no shape keys")
    rate = scene.render.fps / scene.render.fps_base
    with open(table, newline="", encoding="utf-8") as file:
        rows = csv.DictReader(file)
        names = [name for name in rows.fieldnames if name not in ("time", "open")]
        missing = [name for name in names if keys.key_blocks.get(name) is None]
        if len(missing) == len(names):
            sys.exit(f"{face.name} has none of the shape keys {', '.join(names)}")
        for row in rows:
            frame = scene.frame_start + float(row["time"]) * rate
            for name in names:
                key = keys.key_blocks.get(name)
                if key is not None:
                    key.value = float(row[name])
                    key.keyframe_insert("value", frame=frame)
    return missing


if __name__ == "__main__":
    words = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []
    if len(words) != 1:
        sys.exit("usage: blender face.blend --python blender_shape_keys.py -- speech.csv")
    left_out = animate(bpy.context.object, bpy.context.scene, words[0])
    if left_out:
        print("without a shape key:", ", ".join(left_out))
