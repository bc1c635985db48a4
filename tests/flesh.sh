#!/bin/bash
# flesh.sh - the truth solver on a tube of our making: at rest, moved as a whole, bent, twisted; options and refusals
# prints  "flesh: N passed, N failed"; the tube and the checks are two small programs written below
cd "$(dirname "$0")" || exit 2
dir=$(mktemp -d) || exit 2
trap 'rm -rf "$dir"' EXIT
cc=${CC:-gcc}
common=$PWD/../examples/common train=$PWD/../examples/train
passed=0 failed=0
check() { if "${@:2}"; then passed=$((passed + 1)); echo "ok   $1"; else failed=$((failed + 1)); echo "FAIL $1"; fi; }
finish() { echo "flesh: $passed passed, $failed failed"; exit $((failed > 0)); }

cat > "$dir/tube.h" <<'C'
/* a closed tube along x, 0.9 m long and 12 cm thick, four joints; frames: 0 rest, 1 turned and moved, 2 bent by 90
   degrees at joints 1 and 2, 3 twisted by 150 degrees along the limb, 4 bent back on itself until it touches */
#include "scene.h"
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
enum { RINGS = 46, SIDES = 20, V = RINGS * SIDES + 2, T = 2 * RINGS * SIDES, S = 4, F = 5 };
static const float at[S] = {0.05f, 0.30f, 0.60f, 0.85f};
static void turn(double *m, int axis, double angle, const double *about) /* m = m * rotation about a point */
{
   double r[12] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};
   int a = (axis + 1) % 3, b = (axis + 2) % 3, i;
   r[5 * a] = r[5 * b] = cos(angle); /* rows of four: the diagonal is every fifth */
   r[4 * a + b] = -sin(angle);
   r[4 * b + a] = sin(angle);
   for (i = 0; i < 3; i++) r[4 * i + 3] = about[i] - r[4 * i] * about[0] - r[4 * i + 1] * about[1] - r[4 * i + 2] * about[2];
   ex__multiply(m, r, m);
}
C
cat > "$dir/make.c" <<'C'
#include "tube.h"
static float position[V][3], weight[V][2], rest[S][3], palette[F][S][12];
static int32_t joint[V][2], triangle[T][3], parent[S];
int main(int argc, char **argv)
{
   char error[EX_ERROR];
   size_t v3[2] = {V, 3}, t3[2] = {T, 3}, v2[2] = {V, 2}, s3[2] = {S, 3}, fs[4] = {F, S, 3, 4}, id[6];
   int i, k, j, f, t = 0;
   ex_writer *w;
   for (i = 0; i < V; i++) {
      int r = i / SIDES;
      double x = 0.9 * r / (RINGS - 1), a = 6.283185307179586 * (i % SIDES) / SIDES, s;
      if (i >= V - 2) { x = i == V - 2 ? 0 : 0.9; s = 0; } else s = 0.06;
      position[i][0] = (float)x; position[i][1] = (float)(s * cos(a)); position[i][2] = (float)(s * sin(a));
      for (j = 0; j < S - 1 && at[j + 1] < x; j++) {} /* the blend is 10 cm long, around each joint */
      k = j + 1 < S && at[j + 1] - x < 0.05 ? j + 1 : j > 0 && x - at[j] < 0.05 ? j - 1 : j;
      s = k == j ? 1 : 0.5 + fabs(x - at[k > j ? k : j]) / 0.1;
      joint[i][0] = j; joint[i][1] = k; weight[i][0] = (float)s; weight[i][1] = (float)(1 - s);
   }
   for (i = 0; i < RINGS - 1; i++) for (k = 0; k < SIDES; k++) {
      int a = i * SIDES + k, b = i * SIDES + (k + 1) % SIDES;
      triangle[t][0] = a; triangle[t][1] = b; triangle[t++][2] = a + SIDES;
      triangle[t][0] = b; triangle[t][1] = b + SIDES; triangle[t++][2] = a + SIDES;
   }
   for (k = 0; k < SIDES; k++) {
      int b = (k + 1) % SIDES, e = (RINGS - 1) * SIDES;
      triangle[t][0] = V - 2; triangle[t][1] = b; triangle[t++][2] = k;
      triangle[t][0] = V - 1; triangle[t][1] = e + k; triangle[t++][2] = e + b;
   }
   for (j = 0; j < S; j++) { rest[j][0] = at[j]; parent[j] = j - 1; }
   for (f = 0; f < F; f++) {
      double m[12] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}, o[3] = {0, 0, 0};
      for (j = 0; j < S; j++) {
         o[0] = at[j];
         if (f == 1 && j == 0) { turn(m, 1, 0.7, o); turn(m, 0, -1.1, o); m[3] += 2; m[7] -= 1; }
         if (f == 2 && (j == 1 || j == 2)) turn(m, 2, 1.5707963, o);
         if (f == 3 && j == 3) turn(m, 0, 2.6, o);
         if (f == 4 && (j == 1 || j == 2)) turn(m, 2, j == 1 ? 1.2 : 2.0, o);
         for (k = 0; k < 12; k++) palette[f][j][k] = (float)m[k];
      }
   }
   (void)argc;
   w = ex_writer_open(argv[1], error);
   if (!w) return 1;
   ex_writer_meta(w, "joint_names", "root,upper,lower,tip");
   id[0] = ex_writer_tensor(w, "positions", EX_F32, 2, v3);
   id[1] = ex_writer_tensor(w, "triangles", EX_I32, 2, t3);
   id[2] = ex_writer_tensor(w, "skin_joints", EX_I32, 2, v2);
   id[3] = ex_writer_tensor(w, "skin_weights", EX_F32, 2, v2);
   id[4] = ex_writer_tensor(w, "joint_rest", EX_F32, 2, s3);
   id[5] = ex_writer_tensor(w, "parents", EX_I32, 1, s3);
   ex_writer_put(w, id[0], 0, position, 3 * V);
   ex_writer_put(w, id[1], 0, triangle, 3 * T);
   ex_writer_put(w, id[2], 0, joint, 2 * V);
   ex_writer_put(w, id[3], 0, weight, 2 * V);
   ex_writer_put(w, id[4], 0, rest, 3 * S);
   ex_writer_put(w, id[5], 0, parent, S);
   if (!ex_writer_close(w, error)) return 1;
   w = ex_writer_open(argv[2], error);
   if (!w) return 1;
   id[0] = ex_writer_tensor(w, "palettes", EX_F32, 4, fs);
   ex_writer_put(w, id[0], 0, palette, F * S * 12);
   return !ex_writer_close(w, error);
}
C
cat > "$dir/judge.c" <<'C'
#include "tube.h"
static double thinnest(const float *x, double *flat) /* least mean radius of a ring; least distance from a ring's centre */
{
   double least = 1e9;
   int r, k, c;
   *flat = 1e9;
   for (r = 0; r < RINGS; r++) {
      double m[3] = {0, 0, 0}, s = 0;
      for (k = 0; k < SIDES; k++) for (c = 0; c < 3; c++) m[c] += x[3 * (r * SIDES + k) + c] / SIDES;
      for (k = 0; k < SIDES; k++) { double d = 0; for (c = 0; c < 3; c++) d += pow(x[3 * (r * SIDES + k) + c] - m[c], 2); s += sqrt(d) / SIDES; *flat = fmin(*flat, sqrt(d)); }
      least = s < least ? s : least;
   }
   return least;
}
static double apart(const float *a, const float *b) { double d = 0; int i; for (i = 0; i < 3 * V; i++) d = fmax(d, fabs((double)a[i] - b[i])); return d; }
int main(int argc, char **argv)
{
   static float lbs[F][3 * V];
   char error[EX_ERROR];
   ex_scene *s = ex_scene_load(argv[1], error);
   ex_tensors *t = s ? ex_tensors_open(argv[2], error) : NULL;
   const float *x, *change;
   const int32_t *settled, *before, *after;
   double a, b, c, d;
   int f, bad = 0;
   (void)argc;
   if (!t) { puts(error); return 1; }
   x = (const float *)ex_tensors_find(t, "vertices")->data;
   change = (const float *)ex_tensors_find(t, "volume_change")->data;
   settled = (const int32_t *)ex_tensors_find(t, "settled")->data;
   before = (const int32_t *)ex_tensors_find(t, "crossings_before")->data;
   after = (const int32_t *)ex_tensors_find(t, "crossings_after")->data;
   for (f = 0; f < F; f++) ex_skin(s, (const float *)ex_tensors_find(t, "palettes")->data + f * S * 12, lbs[f]);
#define SAY(ok, ...) do { if (!(ok)) bad = 1; printf("%s ", (ok) ? "ok  " : "FAIL"); printf(__VA_ARGS__); putchar('\n'); } while (0)
   SAY(apart(x, lbs[0]) < 3e-4, "rest stays: largest move %.3f mm", 1e3 * apart(x, lbs[0]));
   SAY(apart(x + 3 * V, lbs[1]) < 3e-4, "moved as a whole, nothing else moves: %.3f mm", 1e3 * apart(x + 3 * V, lbs[1]));
   a = thinnest(x + 6 * V, &c);
   b = thinnest(lbs[2], &d);
   SAY(c > 0.048 && d < 0.043, "bent: nearest to the axis %.1f mm, skinned %.1f of 60", 1e3 * c, 1e3 * d);
   a = thinnest(x + 9 * V, &c);
   b = thinnest(lbs[3], &d);
   SAY(a > 0.053 && b < 0.025, "twisted: thinnest radius %.1f mm, skinned %.1f of 60", 1e3 * a, 1e3 * b);
   SAY(before[4] >= 40 && after[4] < 0.75 * before[4], "folded: crossing vertices %d, skinned %d", after[4], before[4]);
   for (f = 0; f < 4; f++) SAY(settled[f] == 1 && fabs(change[f]) < 0.02, "frame %d settled, flesh %+.2f %%", f, 100 * (double)change[f]);
   return bad;
}
C
flags="-std=gnu99 -O2 -I$common"
build() { $cc $flags "$dir/make.c" "$common/scene.c" "$common/tensors.c" -lm -o "$dir/make" && $cc $flags "$dir/judge.c" "$common/scene.c" "$common/tensors.c" -lm -o "$dir/judge"; }
check "test programs build" build
cd "$train" || exit 2
check "flesh builds without a warning" $cc -std=gnu99 -O3 -march=native -ffast-math -pthread -Wall -Wextra -Werror flesh*.c "$common/scene.c" "$common/tensors.c" -lm -o "$dir/flesh"
cd "$dir" || exit 2
./make tube.safetensors motion.safetensors || finish
same() { cmp -s "$1" "$2"; }
rows() { # the file without its header and without the seconds: vertices and figures
   ./flesh --character tube.safetensors --motion motion.safetensors --threads "$1" --out "$2" "${@:3}" > log 2>&1 || { cat log; return 1; }
}
check "solves five poses" rows 1 one.safetensors
check "reports" grep -q "settled poses: volume change at most .*crossing vertices .*largest edge stretch" log
./judge tube.safetensors one.safetensors | tee verdict
passed=$((passed + $(grep -c '^ok' verdict))) failed=$((failed + $(grep -c '^FAIL' verdict)))
(($(grep -c . verdict) == 9)) || { echo "FAIL judge stopped early"; failed=$((failed + 1)); }
check "solves on three threads" rows 3 two.safetensors
size=$((5 * 922 * 12)) # vertices [5,922,3] come first in the file
head=$((8 + $(od -An -tu4 -N4 one.safetensors)))
for n in one two; do tail -c +$((head + 1)) $n.safetensors | head -c $size > $n.rows; done
check "the same bits on one and on three threads ($size bytes)" same one.rows two.rows
check "at least 50,000 bytes compared" test "$(stat -c %s one.rows)" -ge 50000
check "a part of the motion" rows 1 part.safetensors --from 2 --to 5 --step 2
tail -c +$((8 + $(od -An -tu4 -N4 part.safetensors) + 1)) part.safetensors | head -c $((size / 5)) > part.rows
tail -c +$((size / 5 * 2 + 1)) one.rows | head -c $((size / 5)) > third.rows
check "a pose does not depend on the poses before it" same part.rows third.rows
refused() { ! ./flesh "${@:2}" > log 2>&1 && grep -q -- "$1" log && (($(grep -c . log) == 1)); }
check "refuses: no such character" refused "none.safetensors: cannot be opened" --character none.safetensors --motion motion.safetensors --out x.safetensors
check "refuses: a character as a motion" refused "no tensor palettes" --character tube.safetensors --motion tube.safetensors --out x.safetensors
check "refuses: frames beyond the motion" refused "none from 9" --character tube.safetensors --motion motion.safetensors --from 9 --out x.safetensors
check "refuses: a word for a number" refused "expected a number" --cell thick --character tube.safetensors --motion motion.safetensors --out x.safetensors
check "refuses: a number out of range" refused "from 0.0001 to 1" --cell 0 --character tube.safetensors --motion motion.safetensors --out x.safetensors
check "a refused run leaves no file" test ! -e x.safetensors
finish
