#!/bin/bash
# calibrate.sh - examples/calibrate on the bundled demo: the file it writes loads, holds the old tensors and metadata byte for
#                byte and ranges that contain what was seen; written twice it is the same; what is refused
# prints  "calibrate: N passed, N failed"
cd "$(dirname "$0")" || exit 2
dir=$(mktemp -d) || exit 2
trap 'rm -rf "$dir"' EXIT
passed=0 failed=0
ok() { if "${@:2}" > "$dir/log" 2>&1; then passed=$((passed + 1)); echo "ok   $1"; else failed=$((failed + 1)); echo "FAIL $1"; tail -n 20 "$dir/log"; fi; }
finish() { echo "calibrate: $passed passed, $failed failed"; exit $((failed > 0)); }
cc=${CC:-gcc} examples=$PWD/../examples
W="-std=c99 -O2 -Wall -Wextra -Wpedantic -Wconversion -Wsign-conversion -Wshadow -Wdouble-promotion -Wundef -Werror"
python=$(command -v python3) # its own library is enough
for f in calibrate refine common/glb common/picture common/pool common/ranges common/scene common/tensors common/tool; do
   ok "$f.c builds without a warning" $cc $W -D_POSIX_C_SOURCE=200809L -c "$examples/$f.c" -o "$dir/${f##*/}.o"
done
common="$dir/glb.o $dir/picture.o $dir/pool.o $dir/scene.o $dir/tensors.o $dir/tool.o"
ok "calibrate links" $cc "$dir/calibrate.o" "$dir/ranges.o" $common -lpthread -lm -o "$dir/calibrate"
ok "refine links" $cc "$dir/refine.o" $common -lpthread -lm -o "$dir/refine"
refused() # refused WORD ARGUMENTS..: exit code 1 and one line with that word
{
   local word=$1 code
   shift
   "$dir/calibrate" "$@" > "$dir/out" 2> "$dir/said"
   code=$?
   cat "$dir/said"
   [[ $code -eq 1 && $(wc -l < "$dir/said") -eq 1 ]] && grep -qF -- "$word" "$dir/said"
}
demo=$examples/demo model=$examples/models/humanoid.safetensors
ok "refused: nowhere to write" refused "needs --out"
ok "refused: a motion without a character" refused "needs --character" --motion "$demo/clip.glb" --out "$dir/x"
ok "refused: an unknown word" refused "--modle" --modle x --out "$dir/x"
ok "refused: a model that is not there" refused "no-such-file" --model "$dir/no-such-file" --out "$dir/x"
ok "refused: no frames" refused "--frames 0" --frames 0 --out "$dir/x"
ok "refused: ends of another kind" refused "expected clipped or seen" --ends best --out "$dir/x"
ok "refused: a folder that is not there" refused "cannot be written" --model "$model" --character "$demo/humanoid.safetensors" \
   --motion "$demo/truth.safetensors" --frames 1 --out "$dir/no-such-folder/x"
ok "nothing is written when something is refused" test ! -e "$dir/x"
ok "the demo, ends as seen" "$dir/calibrate" --model "$model" --character "$demo/humanoid.safetensors" --motion "$demo/truth.safetensors" \
   --frames 6 --threads 2 --ends seen --out "$dir/seen.safetensors"
ok "the demo, clipped, on one thread" "$dir/calibrate" --model "$model" --character "$demo/humanoid.safetensors" --motion "$demo/truth.safetensors" \
   --frames 6 --threads 1 --out "$dir/clipped.safetensors"
cp "$dir/clipped.safetensors" "$dir/twice.safetensors"
ok "over itself" "$dir/calibrate" --model "$dir/twice.safetensors" --character "$demo/humanoid.safetensors" --motion "$demo/truth.safetensors" \
   --frames 6 --threads 2 --out "$dir/twice.safetensors"
ok "the same file, from other threads too" cmp "$dir/clipped.safetensors" "$dir/twice.safetensors"
cat > "$dir/check.py" << 'PY'
import json, struct, sys
def read(path):
    raw = open(path, "rb").read()
    size, = struct.unpack("<Q", raw[:8])
    head, data = json.loads(raw[8:8 + size]), raw[8 + size:]
    meta = head.pop("__metadata__", {})
    return meta, {k: (v["dtype"], v["shape"], data[v["data_offsets"][0]:v["data_offsets"][1]]) for k, v in head.items()}, data
meta, old, data = read(sys.argv[1])
old = {k: v for k, v in old.items() if not k.endswith(".range")}
files = [read(p) for p in sys.argv[2:]]
compared = ranges = 0
for m, tensors, bytes_ in files:
    assert m == meta, "metadata"
    for k, v in old.items():
        assert tensors[k] == v, k
        compared += 1
    new = {k for k in tensors if k not in old}
    widths = {k[:-len(".lin.weight")]: v[1][0] for k, v in old.items() if k.endswith(".lin.weight") and not k.startswith("pool")}
    for k in widths:
        widths[k] += old[k + ".self.weight"][1][0] if k + ".self.weight" in old else 0
    widths.update({k[:-len(".weight")]: v[1][0] for k, v in old.items() if k.startswith(("pre.", "post.")) and k.endswith(".weight") and ".bn." not in k})
    del widths["pre.0"]
    widths["pool"], widths["unpool"] = widths["pre.1"], widths["global.1"]
    assert new == {k + ".range" for k in widths}, (sorted(new), sorted(widths))
    for k, w in widths.items():
        dtype, shape, raw = tensors[k + ".range"]
        assert dtype == "F32" and shape == [2, w] and len(raw) == 8 * w, (k, dtype, shape)
        x = struct.unpack(f"<{2 * w}f", raw)
        assert all(a < b and b - a < 1e4 for a, b in zip(x[:w], x[w:])), k
        if k.startswith("pre") or k.startswith("post"):
            assert all(-1.01 <= a and b <= 1.01 for a, b in zip(x[:w], x[w:])), k  # tanh
        ranges += 1
seen, clipped = (f[1] for f in files)
inside = tighter = 0
for k in seen:
    if k.endswith(".range"):
        n = seen[k][1][1]
        s, c = (struct.unpack(f"<{2 * n}f", t[k][2]) for t in (seen, clipped))
        for i in range(n):
            assert s[i] <= c[i] < c[n + i] <= s[n + i], (k, i)
            tighter += c[i] > s[i] or c[n + i] < s[n + i]
            inside += 1
assert compared >= 60 and ranges == 20 and inside >= 1000 and 0 < tighter <= inside, (compared, ranges, inside, tighter)
print(compared, "tensors,", ranges, "ranges,", inside, "channels")
PY
if [[ -n $python ]]; then ok "old tensors untouched, ranges as they should be" "$python" "$dir/check.py" "$model" "$dir/seen.safetensors" "$dir/clipped.safetensors"
else echo "skip what the file holds: no python3"
fi
for f in seen clipped; do
   ok "float32 is the same with ranges in the file ($f)" bash -c "cd '$dir' && for m in '$model' $f.safetensors; do ./refine --model \$m --character '$demo/humanoid.safetensors' \
      --truth '$demo/truth.safetensors' --frames 10:13 --out \$(basename \$m .safetensors)-frames.safetensors; done && cmp humanoid-frames.safetensors $f-frames.safetensors"
done
mean() { sed -n 's/^ *"refined_mean_cm": \([-+.e0-9]*\),*$/\1/p' "$1"; }
for p in f32 int8; do
   ok "the demo in $p" "$dir/refine" --model "$dir/clipped.safetensors" --character "$demo/humanoid.safetensors" --truth "$demo/truth.safetensors" \
      --precision $p --json "$dir/$p.json"
done
ok "int8's error is at most 3 % above float32's" awk -v a="$(mean "$dir/f32.json")" -v b="$(mean "$dir/int8.json")" \
   'BEGIN { print a, b; exit !(a > 0.1 && b > 0.1 && b <= 1.03 * a) }'
finish
