#!/bin/bash
# refine.sh - examples/refine and the models that ship: each loads, binds the bundled character and brings it nearer to its
#             truth, by bounds a little above what was measured when it was made; numbers of threads; what is refused
# prints  "refine: N passed, N failed"; REFINE=path tests a program already built
cd "$(dirname "$0")" || exit 2
dir=$(mktemp -d) || exit 2
trap 'rm -rf "$dir"' EXIT
passed=0 failed=0
ok() { if "${@:2}" > "$dir/log" 2>&1; then passed=$((passed + 1)); echo "ok   $1"; else failed=$((failed + 1)); echo "FAIL $1"; tail -n 20 "$dir/log"; fi; }
cc=${CC:-gcc} cxx=${CXX:-g++} examples=$PWD/../examples
W="-std=c99 -O1 -Wall -Wextra -Wpedantic -Wconversion -Wsign-conversion -Wshadow -Wdouble-promotion -Wundef -Werror"
gltf= objects=
if echo '#include <tiny_gltf.h>' | $cxx -x c++ -E - > /dev/null 2>&1; then gltf=-DEX_TINYGLTF; fi
refine=${REFINE:-$dir/refine}
if [[ -z ${REFINE:-} ]]; then
   for f in refine common/glb common/mesh common/picture common/pool common/scene common/tensors common/tool; do
      ok "$f.c builds without a warning" $cc $W -D_POSIX_C_SOURCE=200809L $gltf -c "$examples/$f.c" -o "$dir/${f##*/}.o"
      objects+=" $dir/${f##*/}.o"
   done
   if [[ -n $gltf ]]; then
      ok "scene_gltf.cc builds" $cxx -std=c++11 -O1 $gltf -c "$examples/common/scene_gltf.cc" -o "$dir/scene_gltf.o"
      ok "refine links" $cxx $objects "$dir/scene_gltf.o" -ltinygltf -lpthread -lm -o "$refine"
   else ok "refine links" $cc $objects -lpthread -lm -o "$refine"
   fi
fi
number() { sed -n "s/^ *\"$2\": \([-+.e0-9]*\),*$/\1/p" "$dir/$1.json"; } # number MODEL KEY
below() # below MODEL MEAN P99 REST WORSE: shares of skinning's errors, of resting vertices kept, and frames
{
   awk -v lm="$(number "$1" lbs_mean_cm)" -v lp="$(number "$1" lbs_p99_cm)" -v rm="$(number "$1" refined_mean_cm)" \
      -v rp="$(number "$1" refined_p99_cm)" -v kept="$(number "$1" resting_kept)" -v worse="$(number "$1" worse_frames)" \
      -v frames="$(number "$1" frames)" -v fallback="$(number "$1" fallback_nodes)" "BEGIN {
      printf \"mean %.3f, 99 %% %.3f, rest %.3f, worse %d of %d, fallback %d\\n\", rm / lm, rp / lp, kept, worse, frames, fallback
      exit !(frames == 72 && fallback == \"0\" && lm > 0 && rm > 0 && rm < $2 * lm && rp < $3 * lp && kept > $4 && worse != \"\" && worse <= $5) }"
}
demo() # demo MODEL OPTIONS...: the bundled character and its truth
{
   "$refine" --model "$examples/models/$1.safetensors" --character "$examples/demo/humanoid.safetensors" \
      --truth "$examples/demo/truth.safetensors" --json "$dir/$1.json" "${@:2}"
}
ok "humanoid on the bundled character" demo humanoid
ok "its errors" below humanoid 0.58 0.45 0.85 4
ok "humanoid_lite, which does not see finger joints" demo humanoid_lite
grep -q "(40 not in the model)" "$dir/log"
ok "refine says so" test $? -eq 0
ok "its errors" below humanoid_lite 0.47 0.40 0.91 0
two=$(grep -E 'cm"|kept|worse' "$dir/humanoid_lite.json")
ok "on three threads" demo humanoid_lite --threads 3
ok "the same figures" test "$two" = "$(grep -E 'cm"|kept|worse' "$dir/humanoid_lite.json")"

refused() # refused WORD ARGUMENTS..: exit code 1 and one line with that word
{
   local word=$1 code
   shift
   "$refine" "$@" > "$dir/out" 2> "$dir/said"
   code=$?
   cat "$dir/said"
   [[ $code -eq 1 && $(wc -l < "$dir/said") -eq 1 ]] && grep -qF -- "$word" "$dir/said"
}
ok "refused: a model that is not there" refused "no-such-model" --model "$dir/no-such-model.safetensors"
ok "refused: no model" refused "demo/humanoid.safetensors" --model "$examples/demo/humanoid.safetensors"
ok "refused: no threads" refused "--threads 0" --threads 0
ok "refused: frames from the end to the beginning" refused "--frames 5:2" --frames 5:2
ok "refused: an argument it does not know" refused "--fast" --fast
ok "refused: another ending" refused "--out" --out frames.obj
echo "refine: $passed passed, $failed failed"
((failed == 0))
