#!/bin/bash
# convert_nbs.sh - examples/train/convert_nbs.py on checkpoint folders of our making, laid out as the authors' code writes
#                  them: every number arrives under its name, the converted model gives in deformnet.h what the
#                  checkpoint gives in PyTorch (a forward pass written here from the specification), and every kind of
#                  wrong folder is refused in one line, without running anything
# prints  "convert_nbs: N passed, N failed"; where Debian's python3-torch is not installed only that it is skipped
cd "$(dirname "$0")" || exit 2
dir=$(mktemp -d) || exit 2
trap 'rm -rf "$dir"' EXIT
passed=0 failed=0
ok() { if "${@:2}" > "$dir/log" 2>&1; then passed=$((passed + 1)); echo "ok   $1"; else failed=$((failed + 1)); echo "FAIL $1"; tail -n 20 "$dir/log"; fi; }
finish() { echo "convert_nbs: $passed passed, $failed failed"; exit $((failed > 0)); }
train=$PWD/../examples/train golden=$PWD/data/golden
export PYTHONDONTWRITEBYTECODE=1 OMP_NUM_THREADS=1 PYTHONPATH=$train
python=/usr/bin/python3
ok "convert_nbs.py is Python" $python -c "import ast, sys; ast.parse(open(sys.argv[1]).read())" "$train/convert_nbs.py"
if ! $python -c "import torch, numpy" 2> /dev/null; then
   echo "skip the conversion: python3-torch and python3-numpy are not installed"
   finish
fi

cat > "$dir/forward.py" << 'PY'
# Neural Blend Shapes in PyTorch, float64, from section 5 of the specification; w: tensors by the authors' keys
import numpy as np
import torch
leaky = lambda x: torch.nn.functional.leaky_relu(x, 0.2)


def edges(faces):
    number, ring, used = {}, [], []
    for f in faces.tolist():
        e = []
        for a, b in ((0, 1), (1, 2), (2, 0)):
            key = (min(f[a], f[b]), max(f[a], f[b]))
            if key not in number:
                number[key] = len(number)
                ring.append([-1] * 4)
                used.append(0)
            e.append(number[key])
        for k in range(3):
            ring[e[k]][used[e[k]]], ring[e[k]][used[e[k]] + 1] = e[(k + 1) % 3], e[(k + 2) % 3]
            used[e[k]] += 2
    return torch.tensor(sorted(number, key=number.get)), torch.tensor(ring)


def conv(x, ring, weight, bias):
    rows = torch.cat([x, torch.zeros(1, x.shape[1], dtype=x.dtype)])[ring]
    a, b, c, d = rows.unbind(1)
    image = torch.stack([x, a + c, b + d, (a - c).abs(), (b - d).abs()], 2)
    return torch.nn.functional.conv2d(image.permute(1, 0, 2)[None], weight, bias)[0, :, :, 0].T


def branch(w, x, ring, pooled=False):
    layers = len(w) // 2
    for n in range(layers):
        x = conv(x, ring, w[f"{n}.conv.weight"], w[f"{n}.conv.bias"])
        if n < layers - 1:
            x = leaky(x)
            if pooled:
                k = x.shape[1] // 5
                x = torch.cat([x[:, :k].max(0, keepdim=True)[0].expand(len(x), k), x[:, k:]], 1)
    return x


def rotations(r):
    t = r.norm(dim=-1, keepdim=True)
    k = torch.where(t > 0, r / t.clamp(min=1e-300), r)
    c, s = torch.cos(t)[..., None], torch.sin(t)[..., None]
    x, y, z = k.unbind(-1)
    o = torch.zeros_like(x)
    cross = torch.stack([o, -z, y, z, o, -x, -y, x, o], -1).reshape(*r.shape, 3)
    return c * torch.eye(3, dtype=r.dtype) + (1 - c) * k[..., :, None] * k[..., None, :] + s * cross


def forward(w, parents, positions, faces, axis_angle):
    w = {b: {k: v.double() for k, v in t.items()} for b, t in w.items()}
    v, pose, s = torch.tensor(positions).double(), torch.tensor(axis_angle).double(), len(parents)
    pairs, ring = edges(faces)
    to_vertex = torch.zeros(len(v), len(pairs), dtype=v.dtype)
    for k in (0, 1):
        to_vertex[pairs[:, k], torch.arange(len(pairs))] = 1
    degree = to_vertex.sum(1, keepdim=True)
    to_vertex = to_vertex / degree.clamp(min=1)
    x = (v[pairs[:, 0]] + v[pairs[:, 1]]) / 2
    att = torch.softmax(branch(w["att"], x, ring, True), 1)
    weights = to_vertex @ att
    weights[degree[:, 0] == 0, 0] = 1
    total = att.sum(0)
    h = ((att.T @ branch(w["geo"], x, ring)) / torch.where(total < 1e-10, torch.ones_like(total), total)[:, None]).reshape(-1)
    layers = len(w["gen"]) // 3
    for n in range(layers):
        h = (w["gen"][f"{n}.0.weight"] * w["gen"][f"{n}.0.mask"]) @ h + w["gen"][f"{n}.0.bias"]
        h = leaky(h) if n < layers - 1 else h
    offsets = h.reshape(s, 3)
    shapes = (to_vertex @ branch(w["dec"], torch.cat([branch(w["geo2"], x, ring), att], 1), ring)).reshape(len(v), -1, 3)
    local = rotations(pose)
    coefficients = []
    for j in range(s - 1):
        y = (local[:, j + 1] - torch.eye(3, dtype=v.dtype)).reshape(len(pose), 9)
        for n in range(3):
            y = y @ w["coff"][f"coff_branch.{j}.layers.{n}.0.weight"].T + w["coff"][f"coff_branch.{j}.layers.{n}.0.bias"]
            y = leaky(y) if n < 2 else y
        coefficients.append(y)
    coefficients = torch.stack(coefficients, 1)
    bar = torch.tensor([0.02 if j in (20, 21) else 0.05 for j in range(1, s)])
    near = torch.stack([(weights[:, j] > bar[j - 1]) | (weights[:, parents[j]] > bar[j - 1]) for j in range(1, s)], 1).double()
    gap = float(min((weights[:, k] - bar[j - 1]).abs().min() for j in range(1, s) for k in (j, parents[j])))
    moved = torch.einsum("fji,vj,vic->fvc", coefficients, near, shapes)
    rest = offsets.clone()
    for j in range(1, s):
        rest[j] += rest[parents[j]]
    turn, place = [], []
    for j, p in enumerate(parents):
        turn.append(local[:, j] if j == 0 else turn[p] @ local[:, j])
        place.append(offsets[0].expand(len(pose), 3) if j == 0 else place[p] + turn[p] @ offsets[j])
    posed = sum(weights[:, j, None] * ((v + moved - rest[j]) @ turn[j].transpose(1, 2) + place[j][:, None]) for j in range(s))
    return {"skin_weights": weights, "joint_offsets": offsets, "blend_shapes": shapes, "mask": near, "coefficients": coefficients,
            "displacement": moved, "posed": posed}, gap
PY

cat > "$dir/make.py" << 'PY'
# make.py FOLDER SEED JOINTS: a checkpoint folder; modules nested and named as in the authors' code, saved by torch.save
import os, sys
import torch
from torch import nn
folder, seed, joints = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
torch.manual_seed(seed)
parents = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21][:joints]
steps = [[0] * joints for _ in parents]
for j in range(1, joints):
    for k in range(j):
        steps[j][k] = steps[k][j] = steps[parents[j]][k] + 1


class Conv(nn.Module):
    def __init__(self, a, b):
        super().__init__()
        self.conv = nn.Conv2d(a, b, (1, 5))


class Skeleton(nn.Module):
    def __init__(self, a, b):
        super().__init__()
        near = torch.tensor(steps) <= 2
        self.bias = nn.Parameter(torch.randn(joints * b) * 0.1)
        self.weight = nn.Parameter(torch.randn(joints * b, joints * a) * (1.5 / (5 * a) ** 0.5))
        self.mask = nn.Parameter(near.float().repeat_interleave(b, 0).repeat_interleave(a, 1), requires_grad=False)


class Mlp(nn.Module):
    def __init__(self, widths):
        super().__init__()
        self.layers = nn.ModuleList(nn.Sequential(nn.Linear(a, b), nn.LeakyReLU(0.2)) if b != widths[-1] else nn.Sequential(nn.Linear(a, b))
                                    for a, b in zip(widths, widths[1:]))


class Shapes(nn.Module):
    def __init__(self):
        super().__init__()
        self.coff_branch = nn.ModuleList(Mlp([9, 11, 12, 5]) for _ in range(joints - 1))
        self.register_buffer("mask", torch.ones(7, joints - 1))


def convs(*widths):
    return nn.ModuleList(Conv(a, b) for a, b in zip(widths, widths[1:]))


modules = {"att": convs(3, 10, 15, 12, joints), "geo": convs(3, 8, 12, 16, 20), "geo2": convs(3, 9, 12, 14, 18),
           "dec": convs(18 + joints, 13, 15), "coff": Shapes(),
           "gen": nn.ModuleList(nn.Sequential(Skeleton(a, b), nn.LeakyReLU(0.2)) if b != 3 else nn.Sequential(Skeleton(a, b))
                                for a, b in zip((20, 8, 6, 5), (8, 6, 5, 3)))}
with torch.no_grad():  # sharper attention, so that the masks differ from joint to joint
    modules["att"][3].conv.weight *= 25
    modules["att"][3].conv.bias *= 10
for name, module in modules.items():
    os.makedirs(f"{folder}/{name}/model")
    torch.save(module.state_dict(), f"{folder}/{name}/model/latest.pt", _use_new_zipfile_serialization=name != "geo2")  # both of torch's formats
with open(f"{folder}/args.txt", "w") as f:
    f.write("--save_path=./results/ --pool_ratio 0.2 --pool_method=max --base=64")
PY

cat > "$dir/case.py" << 'PY'
# case.py FOLDER MODEL CASE: the checkpoint's forward pass on a bent, open sheet with a lone vertex; and every number's place
import sys
import numpy as np
import torch
import safetensors_io as st
from forward import forward
folder, model, case = sys.argv[1:4]
names = ("att", "geo", "gen", "geo2", "dec", "coff")
w = {b: torch.load(f"{folder}/{b}/model/latest.pt", weights_only=True) for b in names}
w["coff"].pop("mask", None)
tensors, meta = st.load(model)
exact = all(v.dtype == np.float32 for v in tensors.values())
seen = 0
for b in names:
    for key, value in w[b].items():
        if key.endswith(".mask"):
            continue
        value = value * w[b][key[:-6] + "mask"] if b == "gen" and key.endswith("weight") else value
        name = key.replace("coff_branch.", "").replace(".layers.", ".").replace(".conv.", ".")
        name = f"{b}.{name}" if b in ("att", "geo", "geo2", "dec") else f"{b}." + ".".join(p for k, p in enumerate(name.split(".")) if k != len(name.split(".")) - 2)
        got, want = tensors[name].astype(np.float32), value.numpy()
        assert np.array_equal(got, want if exact else want.astype(np.float16).astype(np.float32)), name
        seen += 1
assert seen == len(tensors), (seen, len(tensors))
if not exact:
    w = {b: {k: v.half().float() for k, v in t.items()} for b, t in w.items()}
parents = [int(p) for p in meta["deformnet.parents"].split(",")]
rows, columns = 15, 12
y, a = np.meshgrid(np.linspace(0, 1.7, rows), np.linspace(0, 5.0, columns), indexing="ij")
sheet = np.stack([0.3 * np.cos(a) + 0.1 * y, y, 0.2 * np.sin(a)], -1).reshape(-1, 3)
i, j = (q.ravel() for q in np.meshgrid(np.arange(rows - 1), np.arange(columns - 1), indexing="ij"))
q = i * columns + j
f = np.concatenate([np.stack([q, q + columns, q + 1], 1), np.stack([q + 1, q + columns, q + columns + 1], 1)])
for seed in range(20):  # until no vertex is decided by rounding
    rng = np.random.default_rng(seed)
    p = np.concatenate([sheet + rng.normal(0, 0.01, sheet.shape), [[0, 2.5, 0]]]).astype(np.float32)
    pose = rng.normal(0, 0.6, (2, len(parents), 3)).astype(np.float32)
    pose[0, 2] = 0
    out, gap = forward(w, parents, p, f, pose)
    if gap > 2e-5:
        break
mean = float(out["mask"].mean())
assert gap > 2e-5 and 0.02 < mean < 0.9, (gap, mean)  # and the masks do mask
size = {k: float(v.abs().max()) for k, v in out.items()}
print({k: round(v, 4) for k, v in size.items()}, "mask", round(mean, 3))
assert min(size.values()) > 1e-4, size
data = {"golden.in.positions": p, "golden.in.faces": f.astype(np.int32), "golden.in.axis_angle": pose}
data.update({f"golden.out.{k}": v.numpy().astype(np.float32) for k, v in out.items()})
st.save(case, data)
PY
cat > "$dir/agree.py" << 'PY'
# the forward pass above against the golden vectors, so that it is a reference and not only an opinion
import sys
import numpy as np
import torch
import safetensors_io as st
from forward import forward
tensors, meta = st.load(sys.argv[1])
get = lambda n: torch.tensor(np.array(tensors[n]))
parents = [int(p) for p in meta["deformnet.parents"].split(",")]
w = {b: {} for b in ("att", "geo", "gen", "geo2", "dec", "coff")}
for name in tensors:
    b, _, rest = name.partition(".")
    if b in ("att", "geo", "geo2", "dec"):
        w[b][rest.replace(".", ".conv.", 1)] = get(name)
    elif b == "coff":
        j, n, kind = rest.split(".")
        w[b][f"coff_branch.{j}.layers.{n}.0.{kind}"] = get(name)
    elif b == "gen":
        n, kind = rest.split(".")
        w[b][f"{n}.0.{kind}"] = get(name)
near = torch.eye(len(parents), dtype=torch.bool)
for j, p in enumerate(parents[1:], 1):
    near[j, p] = near[p, j] = True
near = (near.float() @ near.float() > 0).float()  # at most two steps
for name in [k for k in w["gen"] if k.endswith("weight")]:
    a, b = (n // len(parents) for n in w["gen"][name].shape)
    w["gen"][name[:-6] + "mask"] = near.repeat_interleave(a, 0).repeat_interleave(b, 1)
checked = 0
for case in ("torus", "boundary"):
    out, _ = forward(w, parents, *(np.array(tensors[f"golden.{case}.in.{k}"]) for k in ("positions", "faces", "axis_angle")))
    for name, value in out.items():
        want = get(f"golden.{case}.out.{name}").double()
        error = ((value - want).abs() / (1e-6 + 1e-6 * want.abs())).max()
        print(case, name, float(error))
        assert error < 1, (case, name, float(error))
        checked += 1
assert checked == 14
PY
export PYTHONPATH=$dir:$train
convert="$train/convert_nbs.py"
if [[ -f $golden/neuralblendshapes_small.safetensors ]]; then
   ok "the forward pass of this test agrees with the golden vectors" $python "$dir/agree.py" "$golden/neuralblendshapes_small.safetensors"
fi
ok "a checkpoint of nine joints" $python "$dir/make.py" "$dir/nine" 3 9
ok "is converted" $python "$convert" "$dir/nine" "$dir/nine.safetensors" --parents=-1,0,0,0,1,2,3,4,5 --joints a,b,c,d,e,f,g,h,i
ok "a checkpoint of SMPL's 24 joints" $python "$dir/make.py" "$dir/smpl" 4 24
ok "is converted without a word on the skeleton" $python "$convert" "$dir/smpl" "$dir/smpl.safetensors"
ok "and in half precision, with other names and another licence" $python "$convert" "$dir/smpl" "$dir/half.safetensors" --f16 --joints mixamo --licence "ours alone"
for name in nine smpl half; do
   ok "$name: every number in its place, and what PyTorch makes of a mesh" $python "$dir/case.py" "$dir/${name/half/smpl}" "$dir/$name.safetensors" "$dir/$name.case.safetensors"
done
ok "the metadata says whose, which joints, in what precision" $python - "$dir" << 'PY'
import sys
import numpy as np
import safetensors_io as st
for name, joint, licence, kind in (("smpl", "left_wrist", "Peizhuo Li", np.float32), ("half", "LeftHand", "ours alone", np.float16)):
    tensors, meta = st.load(f"{sys.argv[1]}/{name}.safetensors")
    assert meta["deformnet.arch"] == "neuralblendshapes" and meta["deformnet.version"] == "1", meta
    assert meta["deformnet.joints"].split(",")[20] == joint and licence in meta["deformnet.licence"], meta
    assert all(t.dtype == kind for t in tensors.values())
PY
program=build/plain/golden
if [[ ! -x $program || ../deformnet.h -nt $program ]]; then
   ok "golden builds" ${CC:-gcc} -std=c99 -O1 golden.c -o "$dir/golden" -lm
   program=$dir/golden
fi
for name in nine smpl half; do
   ok "$name: deformnet.h gives the same" "$program" --model "$dir/$name.safetensors" "$dir/$name.case.safetensors"
done

# refusals: a copy of the nine joints' folder, spoilt; one line must say what is wrong, and nothing may be written or run
$python - "$dir" > "$dir/refusals" 2>&1 << 'PY'
import contextlib, io, os, pickle, shutil, sys
import torch
import convert_nbs
top = sys.argv[1]
d, out = f"{top}/spoilt", f"{top}/none.safetensors"
nine = ["--parents=-1,0,0,0,1,2,3,4,5", "--joints", "a,b,c,d,e,f,g,h,i"]
path = lambda b: f"{d}/{b}/model/latest.pt"
save = lambda b, state: torch.save(state, path(b))


class Evil:
    def __reduce__(self):
        return os.system, (f"touch {top}/ran",)


def change(b, key, value):
    state = torch.load(path(b))
    state[key] = value(state[key]) if callable(value) else value
    save(b, state)


def lose(b, *keys):
    save(b, {k: v for k, v in torch.load(path(b)).items() if not k.startswith(keys)})


def bytes_of(b, edit):
    with open(path(b), "rb") as f:
        data = f.read()
    with open(path(b), "wb") as f:
        f.write(edit(data))


def arguments(line):
    with open(f"{d}/args.txt", "w") as f:
        f.write(line)


def refuse(title, pattern, spoil, options=nine):
    shutil.rmtree(d, ignore_errors=True)
    shutil.copytree(f"{top}/nine", d)
    spoil()
    said = io.StringIO()
    sys.argv = ["convert_nbs.py", d, out, *options]
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
        code = convert_nbs.main()
    line = said.getvalue().strip()
    good = code == 1 and "\n" not in line and pattern in line and not os.path.exists(out) and not os.path.exists(f"{top}/ran")
    print(("ok   refused: " if good else "FAIL refused: ") + title + ("" if good else f": code {code}, {line!r}"))


refuse("a missing file", "geo2/model/latest.pt: no such file", lambda: os.remove(path("geo2")))
refuse("a cut file", "not a file of tensors", lambda: bytes_of("gen", lambda x: x[:len(x) // 2]))
refuse("an empty file", "not a file of tensors", lambda: bytes_of("att", lambda x: b""))
refuse("a pickle that runs a program", "not a file of tensors", lambda: save("att", {"0.conv.weight": Evil()}))
refuse("a bare pickle that runs a program", "not a file of tensors", lambda: bytes_of("att", lambda x: pickle.dumps(Evil())))
refuse("something that is no dictionary", "expected a state dictionary, found Tensor", lambda: save("att", torch.zeros(3)))
refuse("a value that is no tensor", "'0.conv.bias': expected a tensor, found int", lambda: change("dec", "0.conv.bias", 5))
refuse("whole numbers", "expected floating point numbers, found int32", lambda: change("dec", "0.conv.bias", lambda t: t.int()))
refuse("a missing key", "2.conv.bias is missing", lambda: lose("geo", "2.conv.bias"))
refuse("an unexpected key", "unexpected 4.conv.weight", lambda: save("geo2", {**torch.load(path("geo2")), "4.conv.weight": torch.zeros(3)}))
refuse("a wrong shape", "1.conv.weight: expected (any,8,1,5), found (12,9,1,5)", lambda: change("geo", "1.conv.weight", torch.zeros(12, 9, 1, 5)))
refuse("a bias of another length", "0.conv.bias: expected (10), found (11)", lambda: change("att", "0.conv.bias", torch.zeros(11)))
refuse("numbers that are not finite", "not finite", lambda: change("coff", "coff_branch.3.layers.1.0.weight", lambda t: t * float("nan")))
refuse("another skeleton's mask", "0.0.mask: expected ones for joints", lambda: change("gen", "0.0.mask", torch.ones_like))
refuse("too few coefficient networks", "coff_branch.7.layers.0.0.weight is missing", lambda: lose("coff", "coff_branch.7."))
refuse("another pooling", "args.txt: --pool_ratio 0.5: expected 0.2", lambda: arguments("--pool_ratio=0.5"))
refuse("a mean instead of a maximum", "args.txt: --pool_method mean: expected max", lambda: arguments("--pool_method mean"))
refuse("the wrong number of joints", "expected weights for the 24 joints of --parents, found 9", lambda: None, [])
refuse("a parent after its child", "--parents", lambda: None, ["--parents=-1,2,1,0,1,2,3,4,5"])
refuse("too few names", "--joints: expected 9 different names, found 2", lambda: None, [nine[0], "--joints", "a,b"])
refuse("a number too large for half precision", "does not fit F16", lambda: change("geo", "0.conv.bias", lambda t: t + 1e6), [*nine, "--f16"])
refuse("no folder", "no such folder", lambda: shutil.rmtree(d))
PY
cat "$dir/refusals"
passed=$((passed + $(grep -c '^ok ' "$dir/refusals"))) failed=$((failed + $(grep -vc '^ok ' "$dir/refusals")))
ok "all 22 refusals were tried" test "$(grep -c refused "$dir/refusals")" = 22
ok "the reader without PyTorch gives the same and refuses the same" $python - "$dir" << 'PY'
import os, pickle, sys
import numpy as np
import torch
import convert_nbs
d, names = sys.argv[1], ("att", "geo", "gen", "dec", "coff") # geo2 is in the older format
for b in names:
    one, two = (convert_nbs.read(f"{d}/nine", b, reader)[1] for reader in (convert_nbs.safe, convert_nbs.restricted))
    assert one.keys() == two.keys() and len(one) and all(np.array_equal(one[k], two[k]) for k in one), b
torch.save({"t": torch.arange(12.0).reshape(3, 4).T[1:, ::2]}, f"{d}/strided.pt")
assert np.array_equal(convert_nbs.restricted(f"{d}/strided.pt")["t"], np.arange(12.0).reshape(3, 4).T[1:, ::2])
class Evil:
    def __reduce__(self):
        return os.system, (f"touch {d}/ran",)
torch.save({"x": Evil()}, f"{d}/evil.pt")
for reader in (convert_nbs.safe, convert_nbs.restricted):
    try:
        reader(f"{d}/evil.pt")
        raise SystemExit("was read")
    except pickle.UnpicklingError as e:
        assert "system" in str(e), e
torch.jit.save(torch.jit.script(torch.nn.Linear(2, 2)), f"{d}/script.pt")
try:
    convert_nbs.safe(f"{d}/script.pt")
    raise SystemExit("was read")
except ValueError as e:
    assert "TorchScript" in str(e), e
assert not os.path.exists(f"{d}/ran")
PY
finish
