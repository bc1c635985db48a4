#!/bin/bash
# wardrobe.sh - examples/wardrobe on a made body (a tube with arms' names, in two shapes) and a made garment: OBJ, GLB and
#               PNG are written and hold what was asked for; poses by name, by joint and by numbers agree; what is refused
# prints  "wardrobe: N passed, N failed"; WARDROBE=path tests a program already built. Without Debian's python3-numpy only
#         that it builds, and refusals
cd "$(dirname "$0")" || exit 2
dir=$(mktemp -d) || exit 2
trap 'rm -rf "$dir"' EXIT
passed=0 failed=0
ok() { if "${@:2}" > "$dir/log" 2>&1; then passed=$((passed + 1)); echo "ok   $1"; else failed=$((failed + 1)); echo "FAIL $1"; tail -n 20 "$dir/log"; fi; }
finish() { echo "wardrobe: $passed passed, $failed failed"; exit $((failed > 0)); }
cc=${CC:-gcc} cxx=${CXX:-g++} python=/usr/bin/python3 examples=$PWD/../examples
export PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=$examples/train
W="-std=c99 -O1 -Wall -Wextra -Wpedantic -Wconversion -Wsign-conversion -Wshadow -Wdouble-promotion -Wundef -Werror"
gltf= objects=
if echo '#include <tiny_gltf.h>' | $cxx -x c++ -E - > /dev/null 2>&1; then gltf=-DEX_TINYGLTF; fi
wardrobe=${WARDROBE:-$dir/wardrobe}
if [[ -z ${WARDROBE:-} ]]; then
   for f in wardrobe common/glb common/mesh common/picture common/pool common/scene common/tensors common/tool; do
      ok "$f.c builds without a warning" $cc $W -D_POSIX_C_SOURCE=200809L $gltf -c "$examples/$f.c" -o "$dir/${f##*/}.o"
      objects+=" $dir/${f##*/}.o"
   done
   if [[ -n $gltf ]]; then
      ok "scene_gltf.cc builds" $cxx -std=c++11 -O1 $gltf -c "$examples/common/scene_gltf.cc" -o "$dir/scene_gltf.o"
      ok "wardrobe links" $cxx $objects "$dir/scene_gltf.o" -ltinygltf -lpthread -lm -o "$wardrobe"
   else ok "wardrobe links" $cc $objects -lpthread -lm -o "$wardrobe"
   fi
fi
refused() # refused WORD ARGUMENTS..: exit code 1 and one line with that word
{
   local word=$1 code
   shift
   "$wardrobe" "$@" > "$dir/out" 2> "$dir/said"
   code=$?
   cat "$dir/said"
   [[ $code -eq 1 && $(wc -l < "$dir/said") -eq 1 ]] && grep -qF -- "$word" "$dir/said"
}
ok "refused: no body" refused "--body is needed" --pose walk
ok "refused: a body that is not there" refused "no-such-file" --body "$dir/no-such-file.safetensors"
if ! $python -c "import numpy" 2> /dev/null; then
   echo "skip what needs a body: python3-numpy is not installed"
   finish
fi
cat > "$dir/make.py" << 'PY'
import json, sys
import numpy as np
import safetensors_io as st
out = sys.argv[1]
names = ["Hips", "Spine", "LeftArm", "LeftForeArm"]
joints = np.array([[0, 0, 0], [0, 0.4, 0], [0, 0.8, 0], [0.3, 1.0, 0]], np.float32)
def tube(rings, sides, radius, low, high, closed):
    y, a = np.meshgrid(np.linspace(low, high, rings), np.arange(sides) * 2 * np.pi / sides, indexing="ij")
    way = np.stack([np.cos(a), 0 * a, -np.sin(a)], -1).reshape(-1, 3)
    p = radius * way + y.reshape(-1, 1) * [0, 1, 0]
    i, j = (x.ravel() for x in np.meshgrid(np.arange(rings - 1), np.arange(sides), indexing="ij"))
    q = lambda r, s: r * sides + s % sides
    f = np.concatenate([np.stack([q(i, j), q(i, j + 1), q(i + 1, j)], 1), np.stack([q(i, j + 1), q(i + 1, j + 1), q(i + 1, j)], 1)])
    if closed:
        s, n = np.arange(sides), len(p)
        f = np.concatenate([f, np.stack([q(0, s + 1), q(0, s), n + 0 * s], 1), np.stack([q(rings - 1, s), q(rings - 1, s + 1), n + 1 + 0 * s], 1)])
        p, way = np.concatenate([p, [[0, low, 0], [0, high, 0]]]), np.concatenate([way, [[0, 0, 0]] * 2])
    w = np.maximum(0, 1 - np.abs(p[:, 1:2] - [[0.1, 0.5, 0.9, 3]]) / 0.4)
    w /= w.sum(1, keepdims=True)
    dirs = np.zeros((len(p), 3, 2))
    dirs[:, 1, 0], dirs[:, :, 1] = 0.1 * p[:, 1], 0.2 * p * [1, 0, 1]
    return {"template": p, "faces": f.astype(np.int32), "shapedirs": dirs, "weights": w}, way
def write(name, t, **more):
    st.save(f"{out}/{name}.safetensors", {k: v if v.dtype == np.int32 else v.astype(np.float32) for k, v in dict(t, **more).items()},
            {"joint_names": json.dumps(names)})
body, _ = tube(21, 16, 0.1, 0, 1, True)
write("body", body, joint_template=joints, joint_shapedirs=np.concatenate([joints[..., None] * [[[0], [0.1], [0]]], 0 * joints[..., None]], -1),
      parents=np.array([-1, 0, 1, 2], np.int32))
write("bare", body)
coat, way = tube(17, 16, 0.107, 0.2, 0.9, False)
write("coat", coat, looseness_dirs=way)
PY
ok "a body and a garment are made" $python "$dir/make.py" "$dir"
body="$dir/body.safetensors" coat="$dir/coat.safetensors"
run() { "$wardrobe" --body "$body" --garment "$coat" "$@" --threads 1; }
cat > "$dir/look.py" << 'PY'
# the three kinds of files: OBJ as arrays by object, PNG's size, GLB's counts
import json, struct, sys
import numpy as np
def obj(path):
    parts = []
    for line in open(path):
        k, *v = line.split()
        if k == "o": parts.append([])
        if k == "v": parts[-1].append([float(x) for x in v])
    return [np.array(p) for p in parts]
def png(path):
    b = open(path, "rb").read()
    assert b[:8] == b"\x89PNG\r\n\x1a\n" and b[-8:-4] == b"IEND"
    return struct.unpack(">II", b[16:24])
def glb(path):
    b = open(path, "rb").read()
    assert b[:4] == b"glTF" and struct.unpack_from("<I", b, 8)[0] == len(b)
    return json.loads(b[20:20 + struct.unpack_from("<I", b, 12)[0]])
PY
look() { PYTHONPATH=$dir:$PYTHONPATH $python -c "from look import *; d = '$dir/'; $1"; }
ok "an OBJ at rest" run --out "$dir/rest.obj"
ok "holds the made meshes" look "import safetensors_io as st; b, c = obj(d + 'rest.obj'); assert abs(b - st.load(d + 'body.safetensors')[0]['template']).max() < 2e-6 and abs(c - st.load(d + 'coat.safetensors')[0]['template']).max() < 2e-6"
ok "looser, in another shape" "$wardrobe" --body "$body" --garment "$coat:0.03:0" --shape 1,-0.5 --out "$dir/loose.obj"
ok "is as much looser and taller" look "
b, c = obj(d + 'loose.obj'); b0, c0 = obj(d + 'rest.obj')
assert abs(b[:, 1].max() - 1.1) < 1e-5 and abs(np.hypot(b[:-2, 0], b[:-2, 2]) - 0.09).max() < 1e-5
assert abs(np.hypot(c[:, 0], c[:, 2]) - (0.9 * 0.107 + 0.03)).max() < 1e-5"
ok "a pose by joint" run --pose "Spine=0,0,40;LeftArm=0,0,30" --out "$dir/joint.obj"
ok "the same by numbers" run --pose 0,0,0,0,0,0.698131700798,0,0,0.523598775598,0,0,0 --out "$dir/numbers.obj"
ok "give the same" look "assert all(abs(x - y).max() < 2e-5 for x, y in zip(obj(d + 'joint.obj'), obj(d + 'numbers.obj'))) and abs(obj(d + 'joint.obj')[0] - obj(d + 'rest.obj')[0]).max() > 0.1"
ok "the garment is pushed out of the bent body" bash -c "'$wardrobe' --body '$body' --garment '$coat' --pose 'Spine=0,0,70;LeftArm=0,0,60' --out '$dir/bent.obj' | tee '$dir/said' && grep '^  coat.*vertices moved out' '$dir/said' | grep -vq ' 0 of '"
ok "a picture of two shapes in three poses, and a GLB" run --shape 0 --shape 1,1 --pose rest --pose tpose --pose "Spine=0,30,0" --picture "$dir/all.png" --out "$dir/all.glb"
ok "are as large as that needs" look "
w, h = png(d + 'all.png'); w1, h1 = (0, 0)
g = glb(d + 'all.glb'); m = g['meshes'][0]['primitives'][0]
assert w > 900 and h > 800, (w, h)
assert len(m['targets']) == 2 and g['accessors'][m['attributes']['POSITION']]['count'] == 21 * 16 + 2 + 17 * 16 and len(g['animations']) == 1"
ok "refused: a garment as the body" refused "no parents" --body "$coat"
ok "refused: a body without joints and parents" refused "no parents" --body "$dir/bare.safetensors" --garment "$coat"
ok "refused: more coefficients than there are" refused "the body has 2" --body "$body" --shape 1,2,3
ok "refused: an unknown pose" refused "not a pose by name" --body "$body" --pose cartwheel
ok "refused: an unknown joint" refused "no joint \"Tail\"" --body "$body" --pose "Tail=1,2,3"
ok "refused: two angles" refused "three angles" --body "$body" --pose "Spine=1,2"
ok "refused: a margin below 0" refused "--margin" --body "$body" --margin -1
ok "refused: looseness that is no number" refused "FILE:looseness" --body "$body" --garment "$coat:wide"
ok "refused: a picture where nothing can be" refused "all.png" --body "$body" --picture "$dir/none/all.png"
ok "refused: an ending that is unknown" refused ".obj or .glb" --body "$body" --out "$dir/a.fbx"
finish
