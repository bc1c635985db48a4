#!/bin/bash
# recipe.sh - the training set of the shipped model and the run on it, resumable: what exists is not made again
# usage   ./recipe.sh CHARACTERS MOTIONS BODY.safetensors WORK [MINUTES]
#         CHARACTERS  folder of GLB characters on the 65-joint skeleton, rest rotations identity
#         MOTIONS     folder of motion GLBs of that skeleton
#         BODY        parametric body (bodies.py says its layout)
#         WORK        folder for everything that is made, about 12 GB
#         LITE=1      a model of the lite kind instead of the large one (environment)
#         HOLD="a,b"  characters kept out, HOLD_MOTIONS="x"  motions kept out (environment)
# needs   make flesh libdeformnet.so; python3 with numpy and torch. About a second a pose: some ten hours on two cores
#         before training at full size; SCALE=4 makes a quarter of the poses, BODIES=2 as many parametric bodies instead of 14
# makes   WORK/characters: CHARACTERS, BODIES parametric bodies, warped copies of them (proportions; --rigging: joints and weights too)
#         WORK/truth: for each, poses recombined from the motions, poses drawn from ranges.json, mild poses, the rest pose
cd "$(dirname "$0")" || exit 2
[ $# -ge 4 ] || { sed -n '2,14s/^# //p' "$(basename "$0")"; exit 2; }
characters=$(realpath "$1") motions=$(realpath "$2") body=$(realpath "$3") work=$(realpath -m "$4") minutes=${5:-190}
hold=",${HOLD:-}," hold_motions=",${HOLD_MOTIONS:-}," scale=${SCALE:-1}
mkdir -p "$work"/characters "$work"/motions "$work"/truth
python=${PYTHON:-python3}
clips=()
for m in "$motions"/*.glb; do
   name=$(basename "$m" .glb)
   [[ $hold_motions == *",$name,"* ]] || clips+=("$m")
done
cp -n "$characters"/*.glb "$work"/characters/
[ -f "$work"/characters/body_1_0.glb ] || $python bodies.py --body "$body" --count "${BODIES:-14}" --seed 1 --out "$work"/characters || exit 1
seed=100
for c in "$work"/characters/*.glb; do # warped copies of those that may be trained on
   name=$(basename "$c" .glb)
   if [[ $name == *_warp_* || $hold == *",$name,"* ]]; then continue; fi
   seed=$((seed + 1))
   ls "$work"/characters/"${name}"_warp_*_0.glb > /dev/null 2>&1 && continue
   $python warp.py --character "$c" --count 1 --seed $seed --out "$work"/characters || exit 1
   $python warp.py --character "$c" --count 2 --seed $((seed + 500)) --rigging --out "$work"/characters || exit 1
done
truth() # truth CHARACTER NAME POSES... : one motion of random poses, one truth file
{
   local c=$1 name=$2 out
   shift 2
   out=$work/truth/$(basename "$c" .glb)__$name.safetensors
   [ -f "$out" ] && return
   $python poses.py "$@" --skeleton "${clips[0]}" --seed $((seed = seed + 1)) --out "$work"/motions/random.glb &&
      ./flesh --character "$c" --motion "$work"/motions/random.glb --out "$out"
}
for c in "$work"/characters/*.glb; do
   name=$(basename "$c" .glb)
   if [[ $hold == *",$name,"* ]]; then # what validation measures: kept out, character and motion
      for m in ${HOLD_MOTIONS//,/ }; do
         out=$work/truth/${name}__$m.safetensors
         [ -f "$out" ] || ./flesh --character "$c" --motion "$motions/$m.glb" --step $((5 * scale)) --out "$out" || exit 1
      done
      continue
   fi
   n=$((240 / scale)) # of each kind
   [[ $name == *_warp_* ]] && n=$((12 / scale))
   ((n < 2)) && n=2
   truth "$c" mixed --clips "${clips[@]}" --shake 8 --count $n || exit 1
   truth "$c" ranges --ranges ranges.json --symmetric 0.3 --count $n || exit 1
   truth "$c" mild --clips "${clips[@]}" --shake 4 --scale 0 0.6 --count $((n / 2)) || exit 1
   truth "$c" rest --clips "${clips[@]}" --shake 0 --scale 0 0 --count 4 || exit 1
   if [[ $name != *_warp_* ]]; then
      for m in "${clips[@]}"; do
         out=$work/truth/${name}__$(basename "$m" .glb).safetensors
         [ -f "$out" ] || ./flesh --character "$c" --motion "$m" --step $((3 * scale)) --out "$out" || exit 1
      done
   fi
done
train() # train OUT OPTIONS...
{
   $python train.py --processes 2 --characters "$work"/characters --truth "$work"/truth --hold-characters "${HOLD:-}" \
      --hold-motions "${HOLD_MOTIONS:-}" --patches 20 --nodes 320 --halo 2 --even 0.5 --out "$work/$1.safetensors" "${@:2}"
}
if [ -n "${LITE:-}" ]; then # a small network without finger joints, then a narrower one that starts from it
   lite="--optimiser soap --leave-joints Thumb,Index,Middle,Ring,Pinky"
   train humanoid_small $lite --arch multiresgnet:humanoid-small --minutes $((minutes / 2)) --rate 3e-3 --freeze 0.25 &&
      train humanoid_lite $lite --arch multiresgnet:humanoid-lite --start "$work"/humanoid_small.safetensors --minutes $((minutes / 2)) \
         --rate 2e-3 --freeze 0
else
   train humanoid --arch multiresgnet:humanoid --minutes "$minutes" --rate 1.5e-3 --freeze 0.3
fi
