"""Spine: an animation of mouth shapes for a skeleton, from the cues of a sound.

    lipstream cues speech.wav -o speech.json
    python3 spine_mouth.py skeleton.json speech.json talking.json [SLOT [PREFIX [ANIMATION]]]

skeleton.json is Spine's export in JSON (version 3.8 or later). The pictures of the mouth are attachments of SLOT ("mouth") and are called PREFIX ("mouth-") and the letter of the
shape: mouth-A to mouth-H and mouth-X. A skeleton without G, H or X gets B, C and A in their place, as `cues --extendedShapes` does. The animation ("speech") is added to what the
skeleton has, and talking.json is what Spine imports or a game loads.
"""
import json
import sys

# What stands for a shape that need not be drawn.
INSTEAD = {"G": "B", "H": "C", "X": "A"}


def pictures(skeleton, slot):
    """Names of all attachments of a slot, in whichever skin; skins are a list of objects since version 3.8."""
    return {name for skin in skeleton.get("skins", []) for name in skin.get("attachments", {}).get(slot, {})}


def timeline(cues, has, prefix):
    """Keys of the attachment: a key holds until the next one, and a key at 0 has no time."""
    keys = []
    for cue in cues:
        shape = cue["value"]
        if prefix + shape not in has and shape in INSTEAD:
            shape = INSTEAD[shape]
        if prefix + shape not in has:
            sys.exit(f"the slot has no attachment {prefix}{shape}; it has {', '.join(sorted(has)) or 'none'}")
        if keys and keys[-1]["name"] == prefix + shape:
            continue
        keys.append({"time": round(cue["start"], 4), "name": prefix + shape})
    if keys and keys[0]["time"] == 0:
        del keys[0]["time"]
    return keys


def animate(skeleton, cues, slot="mouth", prefix="mouth-", animation="speech"):
    """Adds the animation to the skeleton."""
    if slot not in [one["name"] for one in skeleton.get("slots", [])]:
        sys.exit(f"the skeleton has no slot {slot}")
    animations = skeleton.setdefault("animations", {})
    if animation in animations:
        sys.exit(f"the skeleton has an animation {animation} already: name another one")
    animations[animation] = {"slots": {slot: {"attachment": timeline(cues, pictures(skeleton, slot), prefix)}}}


if __name__ == "__main__":
    if not 4 <= len(sys.argv) <= 7:
        sys.exit("usage: spine_mouth.py skeleton.json speech.json talking.json [SLOT [PREFIX [ANIMATION]]]")
    with open(sys.argv[1], encoding="utf-8") as file:
        rig = json.load(file)
    with open(sys.argv[2], encoding="utf-8") as file:
        spoken = json.load(file)["mouthCues"]
    animate(rig, spoken, *sys.argv[4:])
    with open(sys.argv[3], "w", encoding="utf-8") as file:
        json.dump(rig, file, indent=1)
