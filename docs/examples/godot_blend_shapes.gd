## Godot 4: moves the blend shapes of a face by a file of weights, in time with its sound.
##
##     lipstream cues speech.wav --set arkit --rate 60 -o speech.json
##
## Put the script on any node, name file, face and sound in the inspector, and play the sound.
## Any set does whose names the face's blend shapes have: arkit, oculus, vrm. Names without a
## blend shape are left out, and said.
extends Node

@export_file("*.json") var weights_file: String
@export var face: MeshInstance3D
@export var sound: AudioStreamPlayer

## Moments of the rows in seconds, and the weights of each.
var _times: PackedFloat64Array = []
var _weights: Array[PackedFloat32Array] = []
## The blend shape of each column; -1 where the face has none.
var _shapes: PackedInt32Array = []


func _ready() -> void:
	set_process(false)
	var said: Variant = JSON.parse_string(FileAccess.get_file_as_string(weights_file))
	if not (said is Dictionary and said.has_all(["names", "frames"])):
		push_error("%s is no file of `lipstream cues --set`" % weights_file)
		return
	var missing: PackedStringArray = []
	for shape_name: String in said["names"]:
		var shape := face.find_blend_shape_by_name(shape_name)
		_shapes.append(shape)
		if shape < 0:
			missing.append(shape_name)
	if missing.size() > 0:
		print("without a blend shape: ", ", ".join(missing))
	for frame: Dictionary in said["frames"]:
		_times.append(frame["time"])
		_weights.append(PackedFloat32Array(frame["weights"]))
	set_process(_times.size() > 0)


func _process(_delta: float) -> void:
	if not sound.playing:
		return
	# What is heard now: the position is told once for every piece that is mixed, and what is
	# mixed is heard later.
	var now := sound.get_playback_position() + AudioServer.get_time_since_last_mix()
	now -= AudioServer.get_output_latency()
	# The row at or after this moment, and the one before it.
	var after := mini(_times.bsearch(now), _times.size() - 1)
	var before := maxi(after - 1, 0)
	var step := _times[after] - _times[before]
	var part := 1.0 if step <= 0.0 else clampf((now - _times[before]) / step, 0.0, 1.0)
	for column in _shapes.size():
		if _shapes[column] >= 0:
			var weight := lerpf(_weights[before][column], _weights[after][column], part)
			face.set_blend_shape_value(_shapes[column], weight)
