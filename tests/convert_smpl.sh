#!/bin/bash
# convert_smpl.sh - examples/train/convert_smpl.py on body models of our making, laid out as SMPL's are: a pickle with
#                   chumpy and scipy objects (whose modules are made up here: neither need be installed), a clean one, an
#                   npz; the converted body gives in deformnet.h what the original gives in numpy; pickles that call
#                   something are refused and call nothing; every kind of wrong file is refused in one line
# prints  "convert_smpl: N passed, N failed"; where Debian's python3-numpy is not installed only that it is skipped
cd "$(dirname "$0")" || exit 2
dir=$(mktemp -d) || exit 2
trap 'rm -rf "$dir"' EXIT
passed=0 failed=0
ok() { if "${@:2}" > "$dir/log" 2>&1; then passed=$((passed + 1)); echo "ok   $1"; else failed=$((failed + 1)); echo "FAIL $1"; tail -n 20 "$dir/log"; fi; }
finish() { echo "convert_smpl: $passed passed, $failed failed"; exit $((failed > 0)); }
train=$PWD/../examples/train
export PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=$train
python=/usr/bin/python3
cc=${CC:-gcc}
ok "convert_smpl.py is Python" $python -c "import ast, sys; ast.parse(open(sys.argv[1]).read())" "$train/convert_smpl.py"
if ! $python -c "import numpy" 2> /dev/null; then
   echo "skip the conversion: python3-numpy is not installed"
   finish
fi

cat > "$dir/make.py" << 'PY'
# made bodies of 40 vertices, 24 joints, and everything that can be wrong with one
import copyreg, pickle, struct, sys, types, zipfile
import numpy as np
out = sys.argv[1]
rng = np.random.default_rng(7)
V, S, B = 40, 24, 12
tree = np.array([[2**32 - 1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21], range(S)], np.int64)
J = np.where(rng.random((S, V)) < 0.2, rng.random((S, V)), 0)
J[:, 0] += 0.1
J /= J.sum(1, keepdims=True)
W = np.where(rng.random((V, S)) < 0.1, rng.random((V, S)), 0)
W[:, 3] += 0.2
W /= W.sum(1, keepdims=True)
body = {"v_template": rng.normal(size=(V, 3)), "f": np.stack([np.arange(V), (np.arange(V) + 1) % V, (np.arange(V) + 7) % V], 1).astype(np.uint32),
        "shapedirs": rng.normal(size=(V, 3, B)) * 0.1, "posedirs": rng.normal(size=(V, 3, 9 * (S - 1))) * 0.01, "weights": W,
        "J_regressor": J, "kintree_table": tree, "bs_style": "lbs", "bs_type": "lrotmin"}

def module(name, **things):
    m = types.ModuleType(name)
    m.__dict__.update(things)
    for k, v in things.items():
        if isinstance(v, type):
            v.__module__, v.__qualname__ = name, k
    sys.modules[name] = m
class Ch:
    def __init__(self, x): self.__dict__.update(x=x, _dirty_vars={"x"}, _itr=None, _cache={})
class Select:
    def __init__(self, a, idxs, preferred_shape): self.__dict__.update(a=a, idxs=idxs, preferred_shape=preferred_shape, _dirty_vars=set())
class csc_matrix:
    def __init__(self, d):
        at = np.nonzero(d.T)
        self.__dict__.update(_shape=d.shape, indices=at[1].astype(np.int32), data=d.T[at], maxprint=50,
                             indptr=np.concatenate([[0], np.cumsum((d != 0).sum(0))]).astype(np.int32))
class csr_matrix:
    def __init__(self, d):
        at = np.nonzero(d)
        self.__dict__.update(_shape=d.shape, indices=at[1].astype(np.int32), data=d[at], indptr=np.concatenate([[0], np.cumsum((d != 0).sum(1))]).astype(np.int32))
class coo_matrix:
    def __init__(self, d):
        at = np.nonzero(d)
        self.__dict__.update(_shape=d.shape, row=at[0], col=at[1], data=d[at])
for name in ("chumpy", "scipy", "scipy.sparse"): module(name)
module("chumpy.ch", Ch=Ch)
module("chumpy.reordering", Select=Select)
module("scipy.sparse.csc", csc_matrix=csc_matrix)
module("scipy.sparse", csr_matrix=csr_matrix)
module("scipy.sparse.coo", coo_matrix=coo_matrix)

dump = lambda name, x, protocol=2: open(f"{out}/{name}", "wb").write(pickle.dumps(x, protocol))
turned = np.concatenate([body["shapedirs"].reshape(V * 3, B)[::-1].ravel(), np.ones(5)])
order = np.arange(V * 3 * B).reshape(V * 3, B)[::-1].ravel()
old = dict(body, v_template=Ch(body["v_template"]), shapedirs=Select(Ch(turned), order, (V, 3, B)), posedirs=Ch(np.asfortranarray(body["posedirs"])),
           J_regressor=csc_matrix(J), weights=Ch(W), J_regressor_prior=csc_matrix(J), vert_sym_idxs=np.arange(V), pose_training_info={"a": [1, 2]})
dump("old.pkl", old)
dump("old0.pkl", old, 0)
dump("clean.pkl", dict(body, J_regressor=csr_matrix(J)), 4)
dump("coo.pkl", dict(body, J_regressor=coo_matrix(J), f=body["f"].astype(">i4"), v_template=body["v_template"].astype(">f8")), 3)
np.savez(f"{out}/body.npz", **{k: v for k, v in body.items() if not isinstance(v, str)}, dynamic=np.array([{"x": 1}], object))
np.savez_compressed(f"{out}/object.npz", **dict({k: v for k, v in body.items() if not isinstance(v, str)}, J_regressor=np.array(csc_matrix(J), object)))
np.savez(f"{out}/truth.npz", **{k: v for k, v in body.items() if not isinstance(v, str)})

# wrong ones
for k in ("v_template", "f", "shapedirs", "weights", "J_regressor", "kintree_table"):
    dump(f"bad_missing_{k}.pkl", {n: v for n, v in body.items() if n != k})
bad = lambda name, **change: dump(f"bad_{name}.pkl", dict(body, **change))
bad("template_shape", v_template=body["v_template"][:, :2])
bad("shapedirs_shape", shapedirs=body["shapedirs"][:-1])
bad("posedirs_shape", posedirs=body["posedirs"][:, :, :-9])
bad("regressor_shape", J_regressor=J.T)
bad("faces_range", f=body["f"] + 1)
bad("faces_float", f=body["f"].astype(float))
bad("nan", v_template=np.where(np.arange(3) == 1, np.nan, body["v_template"]))
bad("tree_order", kintree_table=tree[:, ::-1] * [[1], [-1]] + [[0], [23]])
bad("tree_numbers", kintree_table=tree * [[1], [0]])
bad("text", weights="eight")
bad("objects", weights=np.array([[None] * S] * V, object))
bad("strings", weights=np.full((V, S), "x"))
m = csc_matrix(J); m.indices = m.indices.copy(); m.indices[3] = 999
bad("sparse_index", J_regressor=m)
m = csc_matrix(J); m.indptr = m.indptr.copy(); m.indptr[1] = -1
bad("sparse_indptr", J_regressor=m)
m = csc_matrix(J); m._shape = (1 << 20, 1 << 20)
bad("sparse_huge", J_regressor=m)
bad("select_index", shapedirs=Select(Ch(turned[:9]), order, (V, 3, B)))
dump("bad_list.pkl", [body])
whole = open(f"{out}/old.pkl", "rb").read()
for n in (0, 1, 2, 50, len(whole) // 2, len(whole) - 1):
    open(f"{out}/bad_cut_{n}.pkl", "wb").write(whole[:n])
zipped = open(f"{out}/body.npz", "rb").read()
for n in (2, 100, len(zipped) // 2, len(zipped) - 1):
    open(f"{out}/bad_cut_{n}.npz", "wb").write(zipped[:n])
with zipfile.ZipFile(f"{out}/bad_header.npz", "w") as z:
    z.writestr("v_template.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", 60) + b"{'descr': '<f8', 'fortran_order': False, 'shape': (1 << 60,)}"[:60])

# ones that call something: each would leave a file behind
mark = f"{out}/called"
class Call:
    def __init__(self, f, *args): self.f, self.args = f, args
    def __reduce__(self): return self.f, self.args
import os, builtins, subprocess, codecs, operator
evil = lambda name, x, protocol=2: dump(f"evil_{name}.pkl", dict(body, v_template=x), protocol)
evil("system", Call(os.system, f"touch {mark}"))
evil("eval", Call(eval, f"open({mark!r}, 'w')"), 4)
evil("exec", Call(exec, f"open({mark!r}, 'w')"))
evil("open", Call(open, mark, "w"), 3)
evil("popen", Call(subprocess.Popen, ["touch", mark]), 4)
evil("getattr", Call(operator.attrgetter, "system"), 4)
evil("fromfile", Call(np.fromfile, mark), 4)
evil("memmap", Call(np.memmap, mark, "u1", "w+", 0, (10,)), 4)
open(f"{out}/evil_global.pkl", "wb").write(b"cos\nsystem\n(S'touch " + mark.encode() + b"'\ntR.")
open(f"{out}/evil_newobj.pkl", "wb").write(b"\x80\x02csubprocess\nPopen\n](U\x05touchU" + bytes([len(mark)]) + mark.encode() + b"e\x85\x81.")
open(f"{out}/evil_rebuild.pkl", "wb").write(b"ccopy_reg\n_reconstructor\n(csubprocess\nPopen\nc__builtin__\nobject\nNtR.")
open(f"{out}/evil_dotted.pkl", "wb").write(b"\x80\x04\x8c\x05numpy\x8c\x12lib.npyio.os.system\x93\x8c" + bytes([len(mark) + 6]) + b"touch " + mark.encode() + b"\x85R.")
open(f"{out}/evil_chumpy.pkl", "wb").write(b"\x80\x04\x8c\x06chumpy\x8c\x0aos.system\x93\x8c" + bytes([len(mark) + 6]) + b"touch " + mark.encode() + b"\x85R.")
open(f"{out}/evil_persistent.pkl", "wb").write(b"\x80\x02U\x01xQ.")
np.savez(f"{out}/evil_object.npz", **{k: v for k, v in body.items() if not isinstance(v, str) and k != "weights"}, weights=np.array([Call(os.system, f"touch {mark}")], object))
PY
ok "bodies are made" $python "$dir/make.py" "$dir"

cat > "$dir/expect.py" << 'PY'
# what the original says, in numpy; then what deformnet.h makes of the converted file must be the same
import sys
import numpy as np
import safetensors_io as st
path, truth, out, betas, loose = sys.argv[1], np.load(sys.argv[2]), sys.argv[3], int(sys.argv[4]), float(sys.argv[5])
got, meta = st.load(path)
for ours, theirs in (("template", "v_template"), ("faces", "f"), ("weights", "weights"), ("joint_regressor", "J_regressor"), ("posedirs", "posedirs")):
    assert got[ours].shape == truth[theirs].shape and np.abs(got[ours].astype(float) - truth[theirs]).max() <= loose, ours
assert got["shapedirs"].shape[2] == betas and np.abs(got["shapedirs"] - truth["shapedirs"][:, :, :betas]).max() <= loose
assert got["parents"].tolist() == [-1] + truth["kintree_table"][0, 1:].tolist() and got["faces"].dtype == np.int32
assert '"left_elbow"' in meta["joint_names"]
rng = np.random.default_rng(3)
beta, turns = rng.normal(size=betas), rng.normal(size=(24, 3, 3))
v = truth["v_template"] + truth["shapedirs"][:, :, :betas] @ beta
st.save(out, {"beta": beta.astype(np.float32), "turns": turns.astype(np.float32), "joints": (truth["J_regressor"] @ v).astype(np.float32),
              "posed": (v + truth["posedirs"] @ (turns[1:] - np.eye(3)).ravel()).astype(np.float32)})
PY
cat > "$dir/product.c" << 'C'
#define DEFORMNET_IMPLEMENTATION
#include "deformnet.h"
#include <math.h>
static float want[4][4096];
int main(int argc, char **argv)
{
   static const char *const names[4] = { "beta", "turns", "joints", "posed" };
   static unsigned char bytes[1 << 16], memory[1 << 16];
   static float p[4096], j[256];
   dn_tensors *t;
   dn_error e;
   dn_shape_view v;
   dn_shape *s = dn_shape_load_file(argv[1], NULL, &e);
   FILE *f = fopen(argv[2], "rb");
   size_t n = f ? fread(bytes, 1, sizeof bytes, f) : 0, i;
   double worst = 0;
   if (!s) return puts(e.info), 1;
   if (argc < 4 || dn_tensors_open(bytes, n, (void *)(((uintptr_t)memory + 63) & ~(uintptr_t)63), sizeof memory - 64, &t, &e)) return puts("expected values"), 1;
   for (i = 0; i < 4; i++) dn_tensor_floats(dn_tensors_find(t, names[i]), 0, dn_tensors_find(t, names[i])->count, want[i]);
   dn_shape_describe(s, &v);
   if (v.vertices != 40 || v.joints != 24 || !v.has_pose_offsets || !v.joint_rest || strcmp(v.joint_names[18], "left_elbow")) return puts("not that body"), 1;
   dn_shape_evaluate(s, want[0], v.coefficients, 0, p, j, NULL);
   dn_shape_pose_offsets(s, want[1], p, NULL);
   for (i = 0; i < 3 * v.vertices; i++) worst = fmax(worst, fabs((double)p[i] - (double)want[3][i]));
   for (i = 0; i < 3 * v.joints; i++) worst = fmax(worst, fabs((double)j[i] - (double)want[2][i]));
   printf("largest difference %g\n", worst);
   dn_shape_free(s);
   fclose(f);
   return !(worst <= atof(argv[3]));
}
C
ok "the product builds" $cc -std=c99 -O1 -Wall -Wextra -Werror -I.. "$dir/product.c" -o "$dir/product" -lm
same() # same FILE BETAS TOLERANCE OPTIONS...
{
   $python "$train/convert_smpl.py" "$dir/$1" "$dir/$1.safetensors" "${@:4}" && $python "$dir/expect.py" "$dir/$1.safetensors" "$dir/truth.npz" "$dir/want.safetensors" "$2" "$3" &&
      "$dir/product" "$dir/$1.safetensors" "$dir/want.safetensors" "$(awk "BEGIN { print 20 * $3 }")"
}
ok "a Python 2 pickle with chumpy and scipy objects" same old.pkl 10 1e-6
ok "the same in protocol 0" same old0.pkl 10 1e-6
ok "a clean pickle with a csr matrix, 7 coefficients" same clean.pkl 7 1e-6 --betas 7
ok "big-endian numbers and a coo matrix, more coefficients asked for than there are" same coo.pkl 12 1e-6 --betas 300
ok "an npz" same body.npz 10 1e-6
ok "an npz with a sparse matrix as an object" same object.npz 10 1e-6
ok "half precision" same old.pkl 10 2e-3 --f16

refused() # one line that names the file, nothing written, nothing called
{
   local lines
   if $python "$train/convert_smpl.py" "$1" "$dir/never.safetensors" 2> "$dir/said"; then echo "accepted"; return 1; fi
   lines=$(wc -l < "$dir/said")
   cat "$dir/said"
   [[ $lines -eq 1 && ! -e $dir/never.safetensors && ! -e $dir/called ]] && grep -q "^convert_smpl.py: .*$(basename "$1")" "$dir/said"
}
count=0
for file in "$dir"/bad_*; do count=$((count + 1)); ok "refused: $(basename "$file")" refused "$file"; done
for file in "$dir"/evil_*; do
   count=$((count + 1))
   ok "refused, nothing called: $(basename "$file")" refused "$file"
done
ok "$count files were refused" test $count -ge 45
ok "the made pickles do call when Python reads them" bash -c "$python -c \"import pickle; pickle.load(open('$dir/evil_global.pkl', 'rb'))\"; test -e '$dir/called'"
finish
