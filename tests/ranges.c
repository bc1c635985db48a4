/*  ranges.c - the ranges that examples/calibrate writes: what was seen, the ends chosen, the file they are added to
    build     cc -g -fsanitize=address,undefined ranges.c -o ranges -lm
    run       ./ranges [part of a test's name] */
#define _POSIX_C_SOURCE 200809L
#define DEFORMNET_IMPLEMENTATION
#include "../deformnet.h"
#include "../examples/common/tensors.c"
#include "../examples/common/tool.c"
#include "../examples/common/ranges.c"
#include "test.h"
#include "tiny.h"
#include <math.h>

/* the range of one channel that has seen these numbers, in taps of up to 97 */
static void range_of(const float *x, size_t count, int clip, float ends[2], ex_ranges_report *report)
{
   ex_ranges *r = ex_ranges_create();
   dn_probe p = ex_ranges_probe(r);
   const char *name = NULL;
   const float *range;
   size_t i, width = 0;
   for (i = 0; i < count; i += 97) p.tap(p.user, "local.0", x + i, i, count - i < 97 ? count - i : 97, 1, 1);
   CHECK(ex_ranges_choose(r, clip));
   range = ex_ranges_at(r, 0, &name, &width);
   CHECK(range && width == 1 && strcmp(name, "local.0.range") == 0 && !ex_ranges_at(r, 1, &name, &width));
   if (range) ends[0] = range[0], ends[1] = range[1];
   *report = ex_ranges_describe(r);
   ex_ranges_free(r);
}
/* what int8 costs on average with these ends: rounding spreads evenly over a step, and what lies outside is clipped. Number i
   came weight[i] times */
static double error_of(const float *x, const double *weight, size_t count, double least, double most)
{
   double step = (most - least) / 254, sum = 0, all = 0;
   size_t i;
   for (i = 0; i < count; i++) {
      double d = (double)x[i] < least ? least - (double)x[i] : (double)x[i] > most ? (double)x[i] - most : 0;
      sum += weight[i] * (d * d + step * step / 12);
      all += weight[i];
   }
   return sum / all;
}
static float normal(uint64_t *seed)
{
   float sum = 0;
   int k;
   for (k = 0; k < 12; k++) sum += test_uniform(seed, -0.5f, 0.5f);
   return sum;
}

/* without clipping the ends are the least and the most, to the bit, whatever the order and size of what comes */
TEST(ends_as_seen)
{
   static float x[3000];
   uint64_t seed = 5;
   size_t kind, i, kinds = 0;
   for (kind = 0; kind < 40; kind++, kinds++) {
      float scale = ldexpf(1, (int)(test_random(&seed) % 60) - 30), offset = kind % 3 ? 0 : test_uniform(&seed, -50, 50) * scale, least, most, ends[2] = {0, 0};
      ex_ranges_report report;
      for (i = 0; i < 3000; i++) x[i] = offset + scale * normal(&seed) * (kind % 2 ? 1 : (float)(i + 1)); /* growing: bins are merged */
      least = most = x[0];
      for (i = 1; i < 3000; i++) least = fminf(least, x[i]), most = fmaxf(most, x[i]);
      range_of(x, 3000, 0, ends, &report);
      CHECK_MSG(memcmp(&ends[0], &least, 4) == 0 && memcmp(&ends[1], &most, 4) == 0, "kind %lu: %g %g, seen %g %g", (unsigned long)kind,
                (double)ends[0], (double)ends[1], (double)least, (double)most);
      CHECK(report.numbers == 3000 && report.outside == 0 && report.clipped == 0 && report.channels == 1);
   }
   AT_LEAST(kinds, 40, "channels");
}
/* clipped ends give a squared error that no pair of ends from a fine grid beats by more than the bins' coarseness; it is never
   above the unclipped one; the ends lie within what was seen. A million numbers, and in some kinds one or two far away */
TEST(clipped_ends_are_the_best)
{
   enum { OFTEN = 4000, TIMES = 250, COUNT = OFTEN + 2 };
   static float x[COUNT];
   static double weight[COUNT];
   uint64_t seed = 9;
   size_t kind, i, k, a, b, pairs = 0, clipped = 0;
   for (kind = 0; kind < 16; kind++) {
      float least, most, ends[2] = {0, 0};
      double best = 1e300, got, unclipped;
      ex_ranges *r = ex_ranges_create();
      dn_probe p = ex_ranges_probe(r);
      const char *name = NULL;
      const float *range;
      size_t width = 0;
      for (i = 0; i < COUNT; i++) {
         float v = normal(&seed);
         x[i] = kind % 4 == 0 ? v : kind % 4 == 1 ? v * v * v + 3 : kind % 4 == 2 ? fabsf(v) : 0.01f * v - 7;
         weight[i] = i < OFTEN ? TIMES : 1;
      }
      if (kind >= 8) x[OFTEN] += kind < 12 ? 40.0f : 5.0f, x[OFTEN + 1] -= kind % 2 ? 60.0f : 0.0f;
      least = most = x[0];
      for (i = 1; i < COUNT; i++) least = fminf(least, x[i]), most = fmaxf(most, x[i]);
      for (k = 0; k < TIMES; k++) p.tap(p.user, "local.0", x, 0, k ? OFTEN : COUNT, 1, 1);
      CHECK(ex_ranges_choose(r, 1));
      range = ex_ranges_at(r, 0, &name, &width);
      CHECK(range != NULL);
      if (range) memcpy(ends, range, sizeof ends);
      CHECK(ends[0] >= least && ends[1] <= most && ends[0] < ends[1]);
      got = error_of(x, weight, COUNT, (double)ends[0], (double)ends[1]);
      unclipped = error_of(x, weight, COUNT, (double)least, (double)most);
      for (a = 0; a < 60; a++)
         for (b = 0; b < 60; b++, pairs++) {
            double low = (double)least + ((double)most - (double)least) * (double)a / 61, high = (double)most - ((double)most - (double)least) * (double)b / 61;
            if (high > low && (a * 7 + b) % 5 == kind % 5) best = fmin(best, error_of(x, weight, COUNT, low, high));
         }
      CHECK_MSG(got <= 1.01 * best, "kind %lu: error %g, best %g, unclipped %g", (unsigned long)kind, got, best, unclipped);
      CHECK_MSG(got <= 1.001 * unclipped, "kind %lu: error %g, unclipped %g", (unsigned long)kind, got, unclipped);
      clipped += got < 0.5 * unclipped;
      ex_ranges_free(r);
   }
   AT_LEAST(pairs, 30000, "pairs of ends");
   AT_LEAST(clipped, 4, "channels at less than half of the unclipped error");
}
/* a channel that never changes, one that holds nothing finite, one number of both signs */
TEST(odd_channels)
{
   float ends[2] = {0, 0}, x[3];
   ex_ranges_report report;
   static const float constants[] = {0, 1, -3.5f, 1e-30f, 1e30f, 7e-8f};
   size_t k;
   for (k = 0; k < sizeof constants / sizeof *constants; k++) {
      x[0] = x[1] = x[2] = constants[k];
      range_of(x, 3, (int)(k % 2), ends, &report);
      CHECK_MSG(ends[0] < constants[k] && ends[1] > constants[k] && test_finite(ends[0]) && test_finite(ends[1]), "constant %g: %g %g",
                (double)constants[k], (double)ends[0], (double)ends[1]);
   }
   x[0] = (float)INFINITY, x[1] = (float)NAN, x[2] = -(float)INFINITY;
   range_of(x, 3, 1, ends, &report);
   CHECK(report.numbers == 0 && ends[0] < ends[1]);
   x[0] = -1e-3f, x[1] = (float)NAN, x[2] = 1e-3f;
   range_of(x, 3, 0, ends, &report);
   CHECK(report.numbers == 2 && ends[0] == -1e-3f && ends[1] == 1e-3f);
}

/* which outputs get ranges, from a real run of the smallest multiresgnet: taps kept apart here as a second opinion */
typedef struct seen { char name[64]; float least, most; size_t width; } seen;
static struct { dn_probe next; seen s[32]; size_t count; } witness;
static void witness_tap(void *user, const char *name, const float *rows, size_t first, size_t count, size_t width, size_t row_stride)
{
   size_t k, i, c;
   (void)user;
   for (k = 0; k < witness.count && strcmp(witness.s[k].name, name) != 0; k++) {}
   if (k == witness.count && k < 32) {
      snprintf(witness.s[k].name, sizeof witness.s[k].name, "%s", name);
      witness.s[k].least = witness.s[k].most = rows[0], witness.s[k].width = width;
      witness.count++;
   }
   for (i = 0; i < count; i++)
      for (c = 0; c < 1; c++) /* channel 0 */
         witness.s[k].least = fminf(witness.s[k].least, rows[i * row_stride + c]), witness.s[k].most = fmaxf(witness.s[k].most, rows[i * row_stride + c]);
   witness.next.tap(witness.next.user, name, rows, first, count, width, row_stride);
}
TEST(which_outputs)
{
   static const char *const wanted_names[] = {"pre.1.range", "local.0.range", "local.1.range", "pool.range", "global.0.range", "global.1.range",
                                              "unpool.range", "global.2.range", "post.0.range", "post.1.range"};
   size_t size, k, i, found = 0, width = 0, bytes, joined = 0;
   unsigned char *file = tiny_multires("distance", "dynamic", &size), *bigger, *again;
   dn_error err;
   dn_model *m = dn_model_load(file, size, NULL, NULL, &err), *other;
   ex_ranges *r = ex_ranges_create();
   tube t;
   dn_rig *rig;
   dn_pose pose;
   dn_probe probe;
   void *scratch;
   const char *name = NULL;
   const float *range;
   CHECK(m != NULL);
   tube_make(&t);
   rig = dn_rig_create(m, &t.desc, NULL, NULL, &err);
   CHECK(rig != NULL);
   if (!m || !rig) return;
   bytes = dn_scratch_size(rig, 1);
   scratch = test_aligned(bytes);
   memset(&pose, 0, sizeof pose);
   memset(&probe, 0, sizeof probe);
   witness.next = ex_ranges_probe(r);
   probe.tap = witness_tap;
   for (k = 0; k < 2; k++) { /* two poses: at rest everything is one palette */
      pose.palette = t.pose, pose.strength = 1;
      CHECK(dn_stage_skin(rig, &pose, scratch, bytes, NULL, &err) == DN_OK);
      dn_stage_rows(rig, scratch, NULL);
      dn_stage_network(rig, scratch, NULL, &probe);
   }
   CHECK(ex_ranges_choose(r, 0));
   for (k = 0; (range = ex_ranges_at(r, k, &name, &width)) != NULL; k++) {
      for (i = 0; i < sizeof wanted_names / sizeof *wanted_names && strcmp(wanted_names[i], name) != 0; i++) {}
      CHECK_MSG(i < sizeof wanted_names / sizeof *wanted_names, "%s is not wanted", name);
      for (i = 0; i < witness.count; i++) {
         char full[80];
         snprintf(full, sizeof full, "%s.range", witness.s[i].name);
         if (strcmp(full, name) != 0) continue;
         CHECK_MSG(width == witness.s[i].width && (range[0] == witness.s[i].least || witness.s[i].least == witness.s[i].most) &&
                   (range[width] == witness.s[i].most || witness.s[i].least == witness.s[i].most),
                   "%s: %g %g, seen %g %g", name, (double)range[0], (double)range[width], (double)witness.s[i].least, (double)witness.s[i].most);
         found++;
      }
   }
   CHECK_MSG(k == sizeof wanted_names / sizeof *wanted_names, "%lu ranges", (unsigned long)k);
   AT_LEAST(found, 10, "outputs compared");

   /* the file: the old bytes stand where they stood, the new tensors are found, the model is the same */
   bigger = ex_ranges_join(r, file, size, &joined);
   CHECK(bigger != NULL);
   if (bigger) {
      size_t room, head = 0, checked = 0, n;
      void *memory[2];
      dn_tensors *a, *b;
      other = dn_model_load(bigger, joined, NULL, NULL, &err);
      CHECK_MSG(other != NULL, "%s", err.info);
      dn_model_free(other);
      for (k = 8; k-- > 0;) head = head << 8 | file[k];
      n = size - 8 - head;
      for (k = 8, i = 0; k-- > 0;) i = i << 8 | bigger[k];
      CHECK((i + 8) % 8 == 0 && memcmp(bigger + 8 + i, file + 8 + head, n) == 0);
      CHECK(dn_tensors_size(file, size, &room, &err) == DN_OK), memory[0] = test_aligned(room);
      CHECK(dn_tensors_open(file, size, memory[0], room, &a, &err) == DN_OK);
      CHECK(dn_tensors_size(bigger, joined, &room, &err) == DN_OK), memory[1] = test_aligned(room);
      CHECK(dn_tensors_open(bigger, joined, memory[1], room, &b, &err) == DN_OK);
      CHECK(dn_tensors_count(b) == dn_tensors_count(a) + sizeof wanted_names / sizeof *wanted_names);
      for (k = 0; k < dn_tensors_count(a); k++) {
         const dn_tensor *old = dn_tensors_at(a, k), *now = dn_tensors_find(b, old->name);
         CHECK(now && now->format == old->format && now->rank == old->rank && now->count == old->count &&
               memcmp(now->data, old->data, old->count * 4) == 0);
         checked++;
      }
      for (k = 0; (range = ex_ranges_at(r, k, &name, &width)) != NULL; k++) {
         const dn_tensor *now = dn_tensors_find(b, name);
         float read[64];
         CHECK(now && now->rank == 2 && now->shape[0] == 2 && now->shape[1] == width && now->count <= 64);
         if (now && now->count <= 64) {
            dn_tensor_floats(now, 0, now->count, read);
            CHECK(memcmp(read, range, now->count * sizeof(float)) == 0);
         }
      }
      AT_LEAST(checked, 30, "tensors unchanged");
      /* once more: in place, nothing grows; and other ends are written over the old ones */
      again = ex_ranges_join(r, bigger, joined, &n);
      CHECK(again && n == joined && memcmp(again, bigger, joined) == 0);
      free(again);
      CHECK(ex_ranges_choose(r, 1));
      again = ex_ranges_join(r, bigger, joined, &n);
      CHECK(again && n == joined);
      if (again) {
         CHECK(dn_tensors_open(again, n, memory[1], room, &b, &err) == DN_OK);
         range = ex_ranges_at(r, 3, &name, &width);
         CHECK(range != NULL);
         if (range && dn_tensors_find(b, name)) {
            float read[64];
            dn_tensor_floats(dn_tensors_find(b, name), 0, 2 * width, read);
            CHECK(memcmp(read, range, 2 * width * sizeof(float)) == 0);
         }
      }
      free(again);
      /* what is no file, and what has a range of another width, is refused */
      CHECK(ex_ranges_join(r, bigger, joined - 1, &n) == NULL);
      CHECK(ex_ranges_join(r, bigger, 4, &n) == NULL);
      test_aligned_free(memory[0]);
      test_aligned_free(memory[1]);
   }
   {
      ex_ranges *wide = ex_ranges_create();
      float rows[12] = {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12};
      size_t n;
      probe = ex_ranges_probe(wide);
      probe.tap(probe.user, "pool", rows, 0, 2, 6, 6);
      CHECK(ex_ranges_choose(wide, 1));
      CHECK(bigger && ex_ranges_join(wide, bigger, joined, &n) == NULL); /* the file's pool is 4 wide */
      ex_ranges_free(wide);
   }
   free(bigger);
   test_aligned_free(scratch);
   dn_rig_free(rig);
   dn_model_free(m);
   ex_ranges_free(r);
   free(file);
}

int main(int argc, char **argv)
{
   TEST_BEGIN(argc, argv);
   RUN(ends_as_seen);
   RUN(clipped_ends_are_the_best);
   RUN(odd_channels);
   RUN(which_outputs);
   return TEST_END();
}
