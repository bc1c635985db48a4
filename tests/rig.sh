#!/bin/bash
# rig.sh - examples/rig on the mesh, the model and the poses of a golden file: the GLB it writes is played by a small
#          reader written here (numpy) and must show the golden vertices; its layout, sizes and names; Khronos' validator
#          where node and npm can install it; what is refused
# prints  "rig: N passed, N failed"; RIG=path tests a program already built. Without python3-numpy only building and refusals;
#         GLTF_VALIDATOR=folder: where gltf-validator is installed (else npm puts it into a temporary folder)
cd "$(dirname "$0")" || exit 2
dir=$(mktemp -d) || exit 2
trap 'rm -rf "$dir"' EXIT
passed=0 failed=0
ok() { if "${@:2}" > "$dir/log" 2>&1; then passed=$((passed + 1)); echo "ok   $1"; else failed=$((failed + 1)); echo "FAIL $1"; tail -n 20 "$dir/log"; fi; }
finish() { echo "rig: $passed passed, $failed failed"; exit $((failed > 0)); }
cc=${CC:-gcc} cxx=${CXX:-g++} python=/usr/bin/python3
golden=$PWD/data/golden/neuralblendshapes_small.safetensors examples=$PWD/../examples
export PYTHONDONTWRITEBYTECODE=1 OMP_NUM_THREADS=1 PYTHONPATH=$dir:$examples/train
W="-std=c99 -O1 -Wall -Wextra -Wpedantic -Wconversion -Wsign-conversion -Wshadow -Wdouble-promotion -Wundef -Werror"
gltf= objects=
if echo '#include <tiny_gltf.h>' | $cxx -x c++ -E - > /dev/null 2>&1; then gltf=-DEX_TINYGLTF; fi
rig=${RIG:-$dir/rig}
if [[ -z ${RIG:-} ]]; then
   for f in rig common/glb common/mesh common/picture common/pool common/retarget common/scene common/tensors common/tool; do
      ok "$f.c builds without a warning" $cc $W -D_POSIX_C_SOURCE=200809L $gltf -c "$examples/$f.c" -o "$dir/${f##*/}.o"
      objects+=" $dir/${f##*/}.o"
   done
   if [[ -n $gltf ]]; then
      ok "scene_gltf.cc builds" $cxx -std=c++11 -O1 $gltf -c "$examples/common/scene_gltf.cc" -o "$dir/scene_gltf.o"
      ok "rig links" $cxx $objects "$dir/scene_gltf.o" -ltinygltf -lpthread -lm -o "$rig"
   else ok "rig links" $cc $objects -lpthread -lm -o "$rig"
   fi
fi
printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n' > "$dir/one.obj"
printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n' > "$dir/bad.obj"
# refuse PATTERN ARGUMENTS...: one line that says it, and no file
refuse()
{
   rm -f "$dir/none.glb"
   "$rig" "${@:2}" > "$dir/said" 2>&1
   local rc=$?
   cat "$dir/said"
   ((rc == 1)) && [[ $(wc -l < "$dir/said") == 1 ]] && grep -qE -- "$1" "$dir/said" && [[ ! -e $dir/none.glb ]]
}
out=(--out "$dir/none.glb")
ok "refused: no mesh" refuse "needs --mesh and --out" --model "$golden"
ok "refused: no model, and says where one comes from" refuse "needs --model.*convert_nbs" --mesh "$dir/one.obj" "${out[@]}"
ok "refused: a face beyond the vertices" refuse "bad.obj: line 4" --model "$golden" --mesh "$dir/bad.obj" "${out[@]}"
ok "refused: no such model" refuse "none.safetensors" --model "$dir/none.safetensors" --mesh "$dir/one.obj" "${out[@]}"
ok "refused: a model of another kind" refuse "a mlp, expected neuralblendshapes" --model "${golden%/*}/mlp_small.safetensors" --mesh "$dir/one.obj" "${out[@]}"
ok "refused: an unknown word" refuse "unknown argument" --mode x
ok "refused: five influences" refuse "--influences 5" --influences 5
ok "refused: a name that is no GLB" refuse "ending in .glb" --model "$golden" --mesh "$dir/one.obj" --out "$dir/none.obj"
if [[ ! -f $golden ]] || ! $python -c "import numpy" 2> /dev/null; then
   echo "skip what is written: python3-numpy or the golden file is not there"
   finish
fi

cat > "$dir/player.py" << 'PY'
# a glTF player for one skinned, morphed mesh: reads GLB, samples keys, poses in float64
import json
import numpy as np


class Player:
    def __init__(self, path):
        raw = open(path, "rb").read()
        size = int.from_bytes(raw[12:16], "little")
        assert raw[:4] == b"glTF" and int.from_bytes(raw[8:12], "little") == len(raw) and raw[16:20] == b"JSON" and size % 4 == 0
        self.json, self.bin = json.loads(raw[20:20 + size]), raw[28 + size:]
        assert raw[24 + size:28 + size] == b"BIN\0" and len(self.bin) == self.json["buffers"][0]["byteLength"] and len(self.bin) % 4 == 0
        self.mesh = self.json["meshes"][0]
        self.primitive = self.mesh["primitives"][0]

    def read(self, view, offset, count, width, kind):
        v, dtype = self.json["bufferViews"][view], np.dtype({5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}[kind])
        start, stride = v.get("byteOffset", 0) + offset, v.get("byteStride", dtype.itemsize * width)
        assert start % dtype.itemsize == 0 and offset + (count - 1) * stride + dtype.itemsize * width <= v["byteLength"]
        return np.ndarray((count, width), dtype, self.bin, start, (stride, dtype.itemsize)).copy()

    def accessor(self, index):
        a = self.json["accessors"][index]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}[a["type"]]
        x = np.zeros((a["count"], width), np.float32)
        if "bufferView" in a:
            x = self.read(a["bufferView"], a.get("byteOffset", 0), a["count"], width, a["componentType"])
        if "sparse" in a:
            s = a["sparse"]
            at = self.read(s["indices"]["bufferView"], s["indices"]["byteOffset"], s["count"], 1, s["indices"]["componentType"])[:, 0].astype(int)
            assert (np.diff(at) > 0).all() and at[-1] < len(x)
            x[at] = self.read(s["values"]["bufferView"], s["values"]["byteOffset"], s["count"], width, a["componentType"])
        if "min" in a:
            assert np.array_equal(x.min(0), np.float32(a["min"])) and np.array_equal(x.max(0), np.float32(a["max"])), index
        return x

    def pose(self, frame=None):
        """vertices (V,3); frame None: as the file rests"""
        nodes, skin = self.json["nodes"], self.json["skins"][0]
        move, turn = [np.array(n.get("translation", [0, 0, 0]), float) for n in nodes], [np.array([0, 0, 0, 1.0]) for _ in nodes]
        weights = np.array(self.mesh.get("weights", []), float)
        for c in self.json["animations"][0]["channels"] if frame is not None else ():
            key = self.accessor(self.json["animations"][0]["samplers"][c["sampler"]]["output"]).astype(float)
            node, path = c["target"]["node"], c["target"]["path"]
            if path == "rotation":
                turn[node] = key[frame]
            elif path == "translation":
                move[node] = key[frame]
            else:
                weights = key.reshape(-1, len(weights))[frame]
        x = self.accessor(self.primitive["attributes"]["POSITION"]).astype(float)
        for target, weight in zip(self.primitive.get("targets", []), weights):
            x = x + weight * self.accessor(target["POSITION"])
        world = [None] * len(nodes)

        def place(i, up):
            a, b, c, d = turn[i]
            m = np.eye(4)
            m[:3, :3] = [[1 - 2 * (b * b + c * c), 2 * (a * b - d * c), 2 * (a * c + d * b)], [2 * (a * b + d * c), 1 - 2 * (a * a + c * c), 2 * (b * c - d * a)],
                         [2 * (a * c - d * b), 2 * (b * c + d * a), 1 - 2 * (a * a + b * b)]]
            m[:3, 3] = move[i]
            world[i] = up @ m
            for k in nodes[i].get("children", []):
                place(k, world[i])
        for root in self.json["scenes"][0]["nodes"]:
            place(root, np.eye(4))
        bind = self.accessor(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1).astype(float)
        palette = np.array([world[n] for n in skin["joints"]]) @ bind
        out, k, total = np.zeros_like(x), 0, 0
        while f"JOINTS_{k}" in self.primitive["attributes"]:
            joint, w = (self.accessor(self.primitive["attributes"][f"{name}_{k}"]) for name in ("JOINTS", "WEIGHTS"))
            assert (joint[w == 0] == 0).all() and (w >= 0).all()
            m = np.einsum("vk,vkij->vij", w.astype(float), palette[joint])
            out += np.einsum("vij,vj->vi", m[:, :3, :3], x) + m[:, :3, 3]
            total, k = total + w.sum(1, dtype=float), k + 1
        assert np.abs(total - 1).max() < 2e-7 and k > 0
        return out
PY
cat > "$dir/make.py" << 'PY'
# make.py GOLDEN FOLDER: the torus and the poses of the golden file as OBJ and axis_angle; and the torus cut along a seam of
# texture coordinates, twice as large, and somewhere else
import sys
import numpy as np
import safetensors_io as st
tensors, _ = st.load(sys.argv[1])
p, f, pose = (tensors[f"golden.torus.in.{k}"] for k in ("positions", "faces", "axis_angle"))
f = f.astype(int)
used = np.unique(f)
assert np.array_equal(used, np.arange(len(p)))
with open(f"{sys.argv[2]}/torus.obj", "w") as o:
    o.writelines("v %.9g %.9g %.9g\n" % tuple(r) for r in p)
    o.writelines("f %d %d %d\n" % tuple(r) for r in f + 1)
with open(f"{sys.argv[2]}/seams.obj", "w") as o:  # two texture coordinates and two normals a vertex, by the triangle's number
    o.writelines("v %.9g %.9g %.9g\n" % tuple(r) for r in p)
    o.write("vt 0 0\nvt 0.5 1\nvn 0 0 3\nvn 1 0 0\n")
    o.writelines("f %d/%d/%d %d/%d/%d %d/%d/%d\n" % tuple(x for v in r for x in (v + 1, k % 2 + 1, k % 2 + 1)) for k, r in enumerate(f))
st.save(f"{sys.argv[2]}/poses.safetensors", {"axis_angle": np.ascontiguousarray(pose), "translation": np.array([[0, 0, 0], [0.5, -1, 2]], np.float32)}, {"fps": "25"})
PY
ok "mesh and poses" $python "$dir/make.py" "$golden" "$dir"
ok "a rig without a motion" "$rig" --model "$golden" --mesh "$dir/torus.obj" --out "$dir/still.glb" --threads 1
ok "with one, all influences, the coefficients as they are" "$rig" --model "$golden" --mesh "$dir/torus.obj" --out "$dir/signed.glb" --motion "$dir/poses.safetensors" --influences all --weights signed --threads 2
ok "with one, weights from 0 to 1" "$rig" --model "$golden" --mesh "$dir/torus.obj" --out "$dir/unsigned.glb" --motion "$dir/poses.safetensors" --influences all --threads 1
ok "four influences, seams, names" "$rig" --model "$golden" --mesh "$dir/seams.obj" --out "$dir/four.glb" --motion "$dir/poses.safetensors" --joints a,b,c,d,e,f,g,h,i --threads 2 --picture "$dir/four.png"
ok "the picture is a PNG" cmp -s -n 8 "$dir/four.png" <(printf '\211PNG\r\n\032\n')
ok "refused: too few names" refuse "2 names, the model has 9 joints" --model "$golden" --mesh "$dir/torus.obj" "${out[@]}" --joints a,b
ok "played, they show the golden vertices" $python - "$golden" "$dir" << 'PY'
import sys
import numpy as np
import safetensors_io as st
from player import Player
tensors, _ = st.load(sys.argv[1])
t = lambda k: tensors[f"golden.torus.{k}"]
p, move, dir = t("in.positions"), np.array([[0, 0, 0], [0.5, -1, 2]]), sys.argv[2]
checked = 0
for name in ("signed", "unsigned", "four"):
    g = Player(f"{dir}/{name}.glb")
    x = g.accessor(g.primitive["attributes"]["POSITION"])
    row = np.array([np.flatnonzero((p == r).all(1))[0] for r in x])  # vertices of the file by their place
    for frame in (0, 1):
        want = t("out.posed")[frame][row] + move[frame]
        error = np.abs(g.pose(frame) - want)
        print(name, frame, error.max(), "of", np.abs(want - x).max())
        if name == "four":  # what five dropped influences cost: bounded by their share
            w = np.sort(t("out.skin_weights"), 1)[:, :-4].sum(1)[row]
            assert np.linalg.norm(error, axis=1).max() < 4 * w.max() * np.abs(want - x).max() + 1e-5
        else:
            assert (error < 1e-5 + 1e-4 * np.abs(want)).all()
        checked += 1
    offsets = np.array([n.get("translation", [0, 0, 0]) for n in g.json["nodes"][1:]], np.float32)
    assert np.abs(offsets - t("out.joint_offsets")).max() < 1e-5 + 1e-4 * np.abs(offsets).max()
assert checked == 6
PY
ok "weights lie between 0 and 1, or are the coefficients" $python - "$golden" "$dir" << 'PY'
import sys
import numpy as np
import safetensors_io as st
from player import Player
tensors, _ = st.load(sys.argv[1])
a = tensors["golden.torus.out.coefficients"]
for name in ("signed", "unsigned"):
    g = Player(f"{sys.argv[2]}/{name}.glb")
    names = g.mesh["extras"]["targetNames"]
    keys = g.accessor(g.json["animations"][0]["samplers"][-1]["output"]).reshape(2, -1)
    assert len(names) == len(set(names)) == len(g.mesh["weights"]) == len(g.primitive["targets"]) == keys.shape[1] > 8
    if name == "signed":
        for n, key in zip(names, keys.T):
            joint, shape = n.rsplit(".", 1)
            assert np.abs(key - a[:, int(joint[5:]) - 1, int(shape)]).max() < 1e-5, n
        assert (keys < 0).any() and (keys > 0).any()
        moved = tensors["golden.torus.out.mask"].any(0).sum() * a.shape[2]
        assert len(names) == moved, (len(names), moved)
    else:
        assert keys.min() >= 0 and keys.max() <= 1 and min(g.mesh["weights"]) >= 0 and any(n.endswith("-") for n in names)
        assert (np.maximum(keys.max(0), g.mesh["weights"]) > 0.999999).all()
PY
ok "layout: seams, normals, texture coordinates, times, joints, sparse targets" $python - "$golden" "$dir" << 'PY'
import os, sys
import numpy as np
import safetensors_io as st
from player import Player
tensors, meta = st.load(sys.argv[1])
dir = sys.argv[2]
g = Player(f"{dir}/four.glb")
at = g.primitive["attributes"]
x, n, uv = (g.accessor(at[k]) for k in ("POSITION", "NORMAL", "TEXCOORD_0"))
f = g.accessor(g.primitive["indices"]).reshape(-1, 3)
p, faces = tensors["golden.torus.in.positions"], tensors["golden.torus.in.faces"].astype(int)
assert np.array_equal(x[f], p[faces]) and len(x) > 1.5 * len(p)
assert np.array_equal(np.unique(n, axis=0), [[0, 0, 1], [1, 0, 0]]) and np.array_equal(np.unique(uv, axis=0), [[0, 1], [0.5, 0]])
assert "JOINTS_1" not in at and [m["name"] for m in g.json["nodes"][1:]] == list("abcdefghi")
assert {n.split(".")[0] for n in g.mesh["extras"]["targetNames"]} <= set("bcdefghi")
parents = {c: i for i, m in enumerate(g.json["nodes"]) for c in m.get("children", [])}
assert [parents.get(i, 0) - 1 for i in range(1, 10)] == [int(v) for v in meta["deformnet.parents"].split(",")]
assert np.allclose(g.accessor(g.json["animations"][0]["samplers"][0]["input"])[:, 0], [0, 0.04])
still = Player(f"{dir}/still.glb")
assert "animations" not in still.json and "TEXCOORD_0" not in still.primitive["attributes"]
normals = still.accessor(still.primitive["attributes"]["NORMAL"])
assert np.abs(np.linalg.norm(normals, axis=1) - 1).max() < 1e-5
mask = tensors["golden.torus.out.mask"]
row = np.array([np.flatnonzero((p == r).all(1))[0] for r in still.accessor(1)])
sparse = 0
for name, target in zip(still.mesh["extras"]["targetNames"], still.primitive["targets"]):
    joint, shape = int(name.split(".")[0][5:]), int(name.split(".")[1])
    want = tensors["golden.torus.out.blend_shapes"][row, shape] * mask[row, joint - 1][:, None]
    got = still.accessor(target["POSITION"])
    assert (np.abs(got - want) < 1e-5 + 1e-4 * np.abs(want)).all(), name
    a = still.json["accessors"][target["POSITION"]]
    share = mask[:, joint - 1].mean()
    assert ("sparse" in a) == (share * (1 + 2 / 24) < 1) or abs(share - 0.92) < 0.05, (name, share)
    sparse += "sparse" in a
assert sparse > 0, "none is sparse"
print(sparse, "of", len(still.primitive["targets"]), "sparse,", os.path.getsize(f"{dir}/still.glb"), "bytes")
PY
ok "--fit sees the same for a mesh of another size and place" $python - "$golden" "$dir" "$rig" << 'PY'
import subprocess, sys
import numpy as np
import safetensors_io as st
from player import Player
golden, dir, rig = sys.argv[1:4]
out = []
for name, scale, lift in (("one", 1, 0), ("two", 2, 5)):
    with open(f"{dir}/torus.obj") as o, open(f"{dir}/{name}.obj", "w") as f:
        for line in o:
            if line.startswith("v "):
                p = [float(v) * scale for v in line.split()[1:]]
                line = "v %.9g %.9g %.9g\n" % (p[0], p[1] + lift, p[2])
            f.write(line)
    subprocess.run([rig, "--model", golden, "--mesh", f"{dir}/{name}.obj", "--out", f"{dir}/{name}.glb", "--fit", "--motion", f"{dir}/poses.safetensors",
                    "--influences", "all", "--threads", "1"], check=True, stdout=subprocess.DEVNULL)
    out.append(Player(f"{dir}/{name}.glb"))
for frame in (None, 0):  # frame 1 travels, in the file's own unit
    a, b = out[0].pose(frame), out[1].pose(frame)
    error = np.abs((b - [0, 5, 0]) / 2 - a)
    print(frame, error.max(), "of", np.abs(a).max())
    assert (error < 2e-4 * (1 + np.abs(a))).all()
PY
ok "the same file for any number of threads" bash -c '"$1" --model "$2" --mesh "$3/torus.obj" --out "$3/again.glb" --motion "$3/poses.safetensors" --influences all --threads 3 && cmp "$3/again.glb" "$3/unsigned.glb"' - "$rig" "$golden" "$dir"
if [[ -n $gltf ]]; then
   ok "a GLB in, its own skin ignored" "$rig" --model "$golden" --mesh "$dir/signed.glb" --out "$dir/from.glb" --threads 1
   ok "gives the same rig" $python - "$dir" << 'PY'
import sys
import numpy as np
from player import Player
a, b = Player(f"{sys.argv[1]}/still.glb"), Player(f"{sys.argv[1]}/from.glb")
assert np.array_equal(a.pose(), b.pose())
PY
   ok "a GLB's animation, by joint names" "$rig" --model "$golden" --mesh "$dir/torus.obj" --out "$dir/clip.glb" --motion "$dir/signed.glb" --influences all --threads 1
   ok "moves it as it moved there" $python - "$dir" << 'PY'
import sys
import numpy as np
from player import Player
a, b = Player(f"{sys.argv[1]}/signed.glb"), Player(f"{sys.argv[1]}/clip.glb")
for frame in (0, 1):
    x, y = a.pose(frame), b.pose(frame)
    print(np.abs(x - y).max())
    assert np.abs(x - y).max() < 1e-4 * np.abs(x).max()
PY
fi

# Khronos' validator: no errors, and nothing lesser either
validator=${GLTF_VALIDATOR:-}
if [[ -z $validator ]] && command -v node > /dev/null && command -v npm > /dev/null; then
   (cd "$dir" && timeout 120 npm install --prefix "$dir/npm" --ignore-scripts --no-audit --no-fund gltf-validator@2.0.0-dev.3.10) > "$dir/npm.log" 2>&1 && validator=$dir/npm/node_modules/gltf-validator
fi
if [[ -z $validator ]]; then echo "skip gltf-validator: node, npm or its package cannot be had here"
else
   cat > "$dir/validate.js" << 'JS'
const fs = require("fs"), validator = require(process.argv[2]);
const seen = async (file) => (await validator.validateBytes(new Uint8Array(fs.readFileSync(file)))).issues;
(async () => {
   let bad = 0;
   for (const file of process.argv.slice(3)) {
      const r = await seen(file);
      // texture coordinates are kept for the user's material, and the plain one that is written does not use them
      const unused = r.messages.filter((m) => m.code == "UNUSED_OBJECT" && m.pointer.endsWith("/TEXCOORD_0")).length;
      console.log(file, r.numErrors, "errors", r.numWarnings, "warnings", r.numInfos, "infos", r.numHints, "hints", JSON.stringify(r.messages.slice(0, 5)));
      bad += r.numErrors + r.numWarnings + r.numInfos + r.numHints - unused;
   }
   process.exit(bad ? 1 : 0);
})();
JS
   files=()
   for name in still signed unsigned four two clip; do if [[ -e $dir/$name.glb ]]; then files+=("$dir/$name.glb"); fi; done
   ok "gltf-validator finds nothing in ${#files[@]} files" node "$dir/validate.js" "$validator" "${files[@]}"
   head -c 400 "$dir/still.glb" > "$dir/cut.glb"
   ok "and does find something in a cut one" bash -c '! node "$@"' - "$dir/validate.js" "$validator" "$dir/cut.glb"
fi
finish
