/*  budget.c - the network in fewer frames or on fewer nodes: what must be exact, what must hold, and what it costs in quality
    build     cc -g budget.c -o budget -lm
    run       ./budget [part of a test's name]      in this folder: the demo is that of ../examples */
#define _POSIX_C_SOURCE 200809L
#include <stdlib.h>
static size_t allocations; /* every one that the header makes by itself */
static void *counted_malloc(size_t size)
{
   allocations++;
   return malloc(size);
}
#define DN_MALLOC(size) counted_malloc(size)
#define DN_FREE(ptr) free(ptr)
#define DEFORMNET_IMPLEMENTATION
#include "../deformnet.h"
#include "test.h"
#include "tiny.h"
#include <math.h>

/* --- two open tubes side by side around one chain of three joints, a hundredth of a metre apart: closer to each other
   than to their own next rings, and without a common edge */
enum { RINGS = 30, AROUND = 16, PAIR_V = 2 * RINGS * AROUND, PAIR_T = 4 * (RINGS - 1) * AROUND, PAIR_S = 3, PAIR_I = 2 };
typedef struct pair {
   float positions[PAIR_V * 3], weights[PAIR_V * PAIR_I], inverse_bind[PAIR_S * 12], palette[PAIR_S * 12], mask[PAIR_V];
   uint32_t joints[PAIR_V * PAIR_I], indices[PAIR_T * 3];
   int32_t parents[PAIR_S];
   dn_skin_set skin;
   dn_rig_desc desc;
} pair;
static const char *const pair_names[PAIR_S] = {"hip", "knee", "foot"};

static void pair_make(pair *p)
{
   size_t side, r, a, s, n = 0;
   memset(p, 0, sizeof *p);
   for (side = 0; side < 2; side++)
      for (r = 0; r < RINGS; r++)
         for (a = 0; a < AROUND; a++) {
            size_t v = (side * RINGS + r) * AROUND + a;
            double x = 0.04 * (double)r, angle = 6.28318530717959 * ((double)a + 0.3 * (double)side) / AROUND;
            double radius = 0.1 + 0.004 * sin(17 * x + 3 * angle), at = x / (0.04 * (RINGS - 1)) * (PAIR_S - 1);
            size_t first = at >= PAIR_S - 1 ? PAIR_S - 2 : (size_t)at;
            p->positions[3 * v] = (float)(x + 0.003 * sin(5 * angle));
            p->positions[3 * v + 1] = (float)(radius * cos(angle) + (side ? 0.109 : -0.109));
            p->positions[3 * v + 2] = (float)(radius * sin(angle));
            p->joints[PAIR_I * v] = (uint32_t)first;
            p->joints[PAIR_I * v + 1] = (uint32_t)first + 1;
            p->weights[PAIR_I * v] = (float)(1 - (at - (double)first));
            p->weights[PAIR_I * v + 1] = 1 - p->weights[PAIR_I * v];
            p->mask[v] = (float)(v % 7) / 6;
            if (r + 1 < RINGS) {
               uint32_t q = (uint32_t)v, b = (uint32_t)((side * RINGS + r) * AROUND + (a + 1) % AROUND);
               uint32_t t[6];
               t[0] = q, t[1] = q + AROUND, t[2] = b, t[3] = b, t[4] = q + AROUND, t[5] = b + AROUND;
               memcpy(p->indices + n, t, sizeof t);
               n += 6;
            }
         }
   for (s = 0; s < PAIR_S; s++) {
      float *m = p->inverse_bind + 12 * s;
      m[0] = m[5] = m[10] = 1;
      m[3] = -0.58f * (float)s;
      p->parents[s] = (int32_t)s - 1;
   }
   p->skin.influences = PAIR_I;
   p->skin.joints = p->joints, p->skin.joint_type = DN_U32;
   p->skin.weights = p->weights, p->skin.weight_type = DN_F32;
   p->desc.mesh.vertices = PAIR_V, p->desc.mesh.positions = p->positions;
   p->desc.mesh.triangles = PAIR_T, p->desc.mesh.indices = p->indices, p->desc.mesh.index_type = DN_U32;
   p->desc.mesh.skin_sets = 1, p->desc.mesh.skin = &p->skin;
   p->desc.skeleton.joints = PAIR_S, p->desc.skeleton.names = pair_names, p->desc.skeleton.parents = p->parents;
   p->desc.skeleton.inverse_bind = p->inverse_bind, p->desc.skeleton.matrix = DN_3X4_ROWS;
   p->desc.resolution = 24;
}
/* every joint bent about z by `bend` against the one before, about its rest place; then all turned about y by `turn` */
static void pair_pose(pair *p, double bend, double turn)
{
   size_t s, r, c, k;
   float above[12] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};
   float whole[12] = {0};
   whole[0] = whole[10] = (float)cos(turn), whole[2] = (float)sin(turn), whole[8] = -whole[2], whole[5] = 1;
   for (s = 0; s < PAIR_S; s++) {
      double x = 0.58 * (double)s, angle = s ? bend : 0, co = cos(angle), si = sin(angle);
      float local[12] = {0}, out[12];
      local[0] = local[5] = (float)co, local[1] = -(float)si, local[4] = (float)si, local[10] = 1;
      local[3] = (float)(x - co * x), local[7] = (float)(-si * x);
      for (r = 0; r < 3; r++)
         for (c = 0; c < 4; c++) {
            double sum = c == 3 ? (double)above[4 * r + 3] : 0;
            for (k = 0; k < 3; k++) sum += (double)above[4 * r + k] * (double)local[4 * k + c];
            out[4 * r + c] = (float)sum;
         }
      memcpy(above, out, sizeof above);
      for (r = 0; r < 3; r++)
         for (c = 0; c < 4; c++) {
            double sum = 0;
            for (k = 0; k < 3; k++) sum += (double)whole[4 * r + k] * (double)out[4 * k + c];
            p->palette[12 * s + 4 * r + c] = (float)sum;
         }
   }
}
static dn_model *tiny_model(int root)
{
   size_t size;
   unsigned char *file = root ? tiny_mlp(&size) : tiny_multires("geodesic", "dynamic", &size);
   dn_error e;
   dn_model *m = dn_model_load(file, size, NULL, NULL, &e);
   CHECK_MSG(m != NULL, "%s", m ? "" : e.info);
   free(file);
   return m;
}
static dn_rig *pair_bind(const dn_model *m, const pair *p)
{
   dn_error e;
   dn_rig *r = dn_rig_create(m, &p->desc, NULL, NULL, &e);
   CHECK_MSG(r != NULL, "%s", r ? "" : e.info);
   return r;
}
static dn_pose pose_of(const float *palette)
{
   dn_pose p;
   memset(&p, 0, sizeof p);
   p.palette = palette;
   p.strength = 1;
   return p;
}

/* --- one frame's outputs, by dn_deform and by dn_carry */
typedef struct shown {
   float positions[PAIR_V * 3], normals[PAIR_V * 3], displacement[PAIR_V * 3], rest_delta[PAIR_V * 3];
   dn_output out;
   dn_result code;
} shown;
static void shown_aim(shown *s)
{
   memset(s, 0, sizeof *s);
   s->out.positions = s->positions, s->out.normals = s->normals;
   s->out.displacement = s->displacement, s->out.rest_delta = s->rest_delta;
}
static void deform(const dn_rig *rig, const dn_pose *pose, shown *s)
{
   size_t bytes = dn_scratch_size(rig, 1);
   void *scratch = test_aligned(bytes);
   memset(scratch, 0x5a, bytes);
   shown_aim(s);
   s->code = dn_deform(rig, pose, &s->out, scratch, bytes, NULL, NULL);
   test_aligned_free(scratch);
}
static dn_result evaluate(const dn_rig *rig, const dn_pose *pose, float *correction, const dn_parallel *par)
{
   size_t bytes = dn_scratch_size(rig, par ? par->workers : 1);
   void *scratch = test_aligned(bytes);
   dn_result r;
   memset(scratch, 0xa5, bytes);
   r = dn_evaluate(rig, pose, correction, scratch, bytes, par, NULL);
   test_aligned_free(scratch);
   return r;
}
static void carry(const dn_rig *rig, const dn_pose *pose, const dn_track *track, const dn_parallel *par, shown *s)
{
   size_t bytes = dn_carry_scratch(rig, par ? par->workers : 1);
   void *scratch = test_aligned(bytes);
   memset(scratch, 0x5a, bytes);
   shown_aim(s);
   s->code = dn_carry(rig, pose, track, &s->out, scratch, bytes, par, NULL);
   test_aligned_free(scratch);
}
static dn_track track_of(size_t nodes, void **memory)
{
   dn_track t;
   size_t bytes = dn_track_size(nodes);
   *memory = test_aligned(bytes);
   memset(*memory, 0xa5, bytes);
   dn_track_init(&t, nodes, *memory);
   return t;
}
static double furthest(const float *a, const float *b, size_t n)
{
   double most = 0;
   size_t i;
   for (i = 0; i < n; i++) {
      double d = fabs((double)a[i] - (double)b[i]);
      if (!(d <= most)) most = d; /* NaN stays */
   }
   return most;
}
static pair p0;
static shown a0, b0;

TEST(evaluated_every_frame_it_is_dn_deform)
{
   size_t skinning, f, compared = 0;
   double moved = 0, worst = 0;
   pair_make(&p0);
   for (skinning = 0; skinning < 2; skinning++) {
      dn_model *m = tiny_model(0);
      dn_rig *rig;
      dn_rig_view view;
      dn_track track;
      void *memory;
      float *correction;
      p0.desc.skinning = skinning ? DN_DQS : DN_LBS;
      rig = pair_bind(m, &p0);
      dn_rig_describe(rig, &view);
      CHECK(view.nodes == PAIR_V);
      track = track_of(view.nodes, &memory);
      correction = (float *)test_block(view.nodes * 12);
      for (f = 0; f < 12; f++) {
         dn_pose pose = pose_of(p0.palette);
         static float skinned[PAIR_V * 3];
         double d[4];
         pair_pose(&p0, 0.2 * (double)f - 0.7, 0.5 * (double)f);
         pose.strength = f % 3 == 2 ? 0.4f : 1;
         pose.mask = f % 3 ? p0.mask : NULL;
         if (f % 4 == 3) { /* an engine that has skinned already */
            (skinning ? dn_dqs : dn_lbs)(p0.positions, view.skin_joint, view.skin_weight, view.influences, PAIR_V, p0.palette, skinned);
            pose.skinned = skinned;
         }
         deform(rig, &pose, &a0);
         CHECK(evaluate(rig, &pose, correction, NULL) == DN_OK);
         dn_track_put(&track, correction, 1, 0);
         dn_track_advance(&track, 1);
         carry(rig, &pose, &track, NULL, &b0);
         CHECK(a0.code == DN_OK && b0.code == DN_OK);
         d[0] = furthest(a0.positions, b0.positions, 3 * PAIR_V);
         d[1] = furthest(a0.displacement, b0.displacement, 3 * PAIR_V);
         d[2] = furthest(a0.normals, b0.normals, 3 * PAIR_V) * 0.01;
         d[3] = furthest(a0.rest_delta, b0.rest_delta, 3 * PAIR_V) * 0.1;
         CHECK_MSG(d[0] <= 1e-6 && d[1] <= 1e-6 && d[2] <= 1e-6 && d[3] <= 1e-6, "frame %lu: %.1e %.1e %.1e %.1e", (unsigned long)f,
                   d[0], d[1], d[2], d[3]);
         CHECK(furthest(a0.out.bounds_min, b0.out.bounds_min, 3) <= 1e-6 && furthest(a0.out.bounds_max, b0.out.bounds_max, 3) <= 1e-6);
         worst = d[0] > worst ? d[0] : worst;
         if (fabs((double)a0.displacement[0]) > moved) moved = fabs((double)a0.displacement[0]);
         compared += PAIR_V;
      }
      free(correction);
      test_aligned_free(memory);
      dn_rig_free(rig);
      dn_model_free(m);
   }
   CHECK_MSG(moved > 1e-3, "the network should move something: %.1e", moved);
   AT_LEAST(compared, 24 * PAIR_V, "vertices");
}

TEST(the_glide)
{
   enum { N = 5 };
   static const float first[3 * N] = {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
   float next[3 * N], now[3 * N];
   void *memory;
   dn_track t = track_of(N, &memory);
   size_t i, f, checked = 0;
   uint64_t seed = 5;
   CHECK(!t.filled && t.nodes == N && dn_track_size(N) >= 9 * N * sizeof(float) && dn_track_size(SIZE_MAX / 4) == SIZE_MAX);
   dn_track_advance(&t, 1); /* nothing there yet: nothing happens */
   dn_track_put(&t, first, 4, 1);
   for (i = 0; i < 3 * N; i++) CHECK(dn__track_value(&t, dn__track_place(&t), i) == first[i]); /* the first is shown at once */
   dn_track_advance(&t, 1);
   for (i = 0; i < 3 * N; i++) CHECK(dn__track_value(&t, dn__track_place(&t), i) == first[i]);
   for (i = 0; i < 3 * N; i++) next[i] = first[i] + 4 * (float)(i + 1);
   dn_track_put(&t, next, 4, 0);
   for (f = 0; f <= 6; f++, dn_track_advance(&t, 1)) /* linear, arrives after 4 to the bit, stays */
      for (i = 0; i < 3 * N; i++, checked++) {
         float want = f < 4 ? first[i] + (float)f * (float)(i + 1) : next[i];
         CHECK(fabsf(dn__track_value(&t, dn__track_place(&t), i) - want) <= (f < 4 ? 1e-5f : 0.0f));
      }
   dn_track_put(&t, first, 4, 0.5f); /* a lead: aims past `first` by half the step from `next` */
   dn_track_advance(&t, 4);
   for (i = 0; i < 3 * N; i++) CHECK(fabsf(dn__track_value(&t, dn__track_place(&t), i) - (first[i] - 2 * (float)(i + 1))) <= 1e-4f);
   for (f = 0; f < 200; f++) { /* whenever an evaluation comes, the glide goes on from what was shown */
      float place = dn__track_place(&t);
      for (i = 0; i < 3 * N; i++) now[i] = dn__track_value(&t, place, i), next[i] = test_uniform(&seed, -1, 1);
      dn_track_put(&t, next, test_uniform(&seed, 0.1f, 3), test_uniform(&seed, 0, 1));
      place = dn__track_place(&t);
      for (i = 0; i < 3 * N; i++, checked++) CHECK(dn__track_value(&t, place, i) == now[i]);
      dn_track_advance(&t, test_uniform(&seed, 0, 2));
   }
   dn_track_put(&t, first, 0, 0); /* no span: at once */
   for (i = 0; i < 3 * N; i++) CHECK(dn__track_value(&t, dn__track_place(&t), i) == first[i]);
   test_aligned_free(memory);
   AT_LEAST(checked, 3000, "values");
}

TEST(an_empty_track_is_plain_skinning)
{
   dn_model *m = tiny_model(0);
   dn_rig *rig, *bare;
   dn_track track;
   void *memory;
   dn_pose pose = pose_of(p0.palette);
   pair_make(&p0);
   pair_pose(&p0, 0.6, 0.3);
   rig = pair_bind(m, &p0);
   bare = pair_bind(NULL, &p0);
   track = track_of(PAIR_V, &memory);
   carry(rig, &pose, &track, NULL, &b0);
   deform(bare, &pose, &a0);
   CHECK(a0.code == DN_OK && b0.code == DN_OK);
   CHECK(memcmp(a0.positions, b0.positions, sizeof a0.positions) == 0 && memcmp(a0.normals, b0.normals, sizeof a0.normals) == 0);
   CHECK(dn_carry_scratch(rig, 1) == dn_scratch_size(bare, 1) && dn_carry_scratch(rig, 1) < dn_scratch_size(rig, 1));
   { /* the model is not needed to carry */
      float *correction = (float *)test_block(PAIR_V * 12);
      static shown c0;
      static const float zeros[3 * PAIR_V];
      CHECK(evaluate(rig, &pose, correction, NULL) == DN_OK);
      dn_track_put(&track, correction, 1, 0);
      carry(rig, &pose, &track, NULL, &b0);
      carry(bare, &pose, &track, NULL, &c0);
      CHECK(memcmp(b0.positions, c0.positions, sizeof b0.positions) == 0 && memcmp(a0.positions, b0.positions, sizeof a0.positions) != 0);
      CHECK(evaluate(bare, &pose, correction, NULL) == DN_OK);
      CHECK(furthest(correction, zeros, 3 * PAIR_V) == 0);
      free(correction);
   }
   test_aligned_free(memory);
   dn_rig_free(rig);
   dn_rig_free(bare);
   dn_model_free(m);
}

TEST(turning_the_character_does_not_change_its_correction)
{
   size_t skinning, q, checked = 0;
   pair_make(&p0);
   p0.desc.skeleton.names = NULL; /* tiny_mlp has none: frame "root", features relative and normal */
   for (skinning = 0; skinning < 2; skinning++) {
      dn_model *m = tiny_model(1);
      dn_rig *rig;
      dn_pose pose = pose_of(p0.palette);
      void *memory;
      dn_track track = track_of(PAIR_V, &memory);
      float *first = (float *)test_block(PAIR_V * 12), *turned = (float *)test_block(PAIR_V * 12);
      p0.desc.skinning = skinning ? DN_DQS : DN_LBS;
      rig = pair_bind(m, &p0);
      pair_pose(&p0, 0.8, 0);
      CHECK(evaluate(rig, &pose, first, NULL) == DN_OK);
      dn_track_put(&track, first, 1, 0);
      for (q = 1; q < 9; q++) {
         double d;
         pair_pose(&p0, 0.8, 0.7 * (double)q);
         CHECK(evaluate(rig, &pose, turned, NULL) == DN_OK);
         d = furthest(first, turned, 3 * PAIR_V);
         CHECK_MSG(d <= 5e-6, "turn %lu: %.1e m", (unsigned long)q, d);
         deform(rig, &pose, &a0); /* so one evaluation serves all of them */
         carry(rig, &pose, &track, NULL, &b0);
         d = furthest(a0.positions, b0.positions, 3 * PAIR_V);
         CHECK_MSG(d <= 5e-6, "turn %lu: %.1e m carried", (unsigned long)q, d);
         checked += PAIR_V;
      }
      pair_pose(&p0, 0.2, 0); /* so that the test can fail */
      CHECK(evaluate(rig, &pose, turned, NULL) == DN_OK);
      CHECK(furthest(first, turned, 3 * PAIR_V) > 1e-4);
      free(first), free(turned);
      test_aligned_free(memory);
      dn_rig_free(rig);
      dn_model_free(m);
   }
   AT_LEAST(checked, 16 * PAIR_V, "vertices");
}

/* ranges in falling order, cut unevenly, handed to the workers in turn */
static void uneven(void *user, size_t count, size_t grain, dn_range_fn *fn, void *job)
{
   unsigned workers = *(const unsigned *)user, turn = 0;
   size_t end = count, step = 1;
   while (end > 0) {
      size_t size = grain * step, begin = end > size ? (end - size + grain - 1) / grain * grain : 0;
      if (begin >= end) begin = end - 1 - (end - 1) % grain;
      fn(job, begin, end, turn++ % workers);
      end = begin;
      step = step % 3 + 1;
   }
}
TEST(threads_do_not_change_a_bit)
{
   static const unsigned counts[3] = {2, 3, 7};
   dn_model *m = tiny_model(0);
   dn_rig *rig;
   dn_pose pose = pose_of(p0.palette);
   void *memory;
   dn_track track;
   float *one = (float *)test_block(PAIR_V * 12), *many = (float *)test_block(PAIR_V * 12);
   size_t k, before;
   pair_make(&p0);
   pair_pose(&p0, 0.6, 0.3);
   rig = pair_bind(m, &p0);
   track = track_of(PAIR_V, &memory);
   before = allocations;
   CHECK(evaluate(rig, &pose, one, NULL) == DN_OK);
   dn_track_put(&track, one, 3, 0);
   pair_pose(&p0, 0.5, 0.2);
   CHECK(evaluate(rig, &pose, one, NULL) == DN_OK);
   dn_track_put(&track, one, 3, 0.5f);
   dn_track_advance(&track, 1);
   carry(rig, &pose, &track, NULL, &a0);
   for (k = 0; k < 3; k++) {
      unsigned workers = counts[k];
      dn_parallel par;
      par.run = uneven;
      par.user = &workers;
      par.workers = workers;
      CHECK(evaluate(rig, &pose, many, &par) == DN_OK);
      CHECK(memcmp(one, many, PAIR_V * 12) == 0);
      carry(rig, &pose, &track, &par, &b0);
      CHECK(memcmp(a0.positions, b0.positions, sizeof a0.positions) == 0 && memcmp(a0.normals, b0.normals, sizeof a0.normals) == 0 &&
            memcmp(a0.rest_delta, b0.rest_delta, sizeof a0.rest_delta) == 0);
   }
   CHECK_MSG(allocations == before, "%lu allocations in frames", (unsigned long)(allocations - before));
   free(one), free(many);
   test_aligned_free(memory);
   dn_rig_free(rig);
   dn_model_free(m);
}

TEST(too_little_memory_and_numbers_that_are_none)
{
   dn_model *m = tiny_model(0);
   dn_rig *rig;
   dn_pose pose = pose_of(p0.palette);
   void *memory, *scratch;
   dn_track track;
   dn_error e;
   float *correction = (float *)test_block(PAIR_V * 12);
   size_t bytes, i;
   pair_make(&p0);
   pair_pose(&p0, 0.6, 0.3);
   rig = pair_bind(m, &p0);
   track = track_of(PAIR_V, &memory);
   bytes = dn_scratch_size(rig, 1);
   scratch = test_aligned(bytes);
   correction[0] = 77;
   memset(&e, 0, sizeof e);
   CHECK(dn_evaluate(rig, &pose, correction, scratch, bytes - 1, NULL, &e) == DN_TOO_SMALL && e.code == DN_TOO_SMALL && correction[0] == 77);
   CHECK(dn_evaluate(rig, &pose, correction, scratch, bytes, NULL, &e) == DN_OK && correction[0] < 1);
   dn_track_put(&track, correction, 1, 0);
   shown_aim(&a0);
   a0.positions[0] = 77;
   memset(&e, 0, sizeof e);
   CHECK(dn_carry(rig, &pose, &track, &a0.out, scratch, dn_carry_scratch(rig, 1) - 1, NULL, &e) == DN_TOO_SMALL);
   CHECK(e.code == DN_TOO_SMALL && strstr(e.info, "needed") && a0.positions[0] == 77);
   CHECK(dn_carry(rig, &pose, &track, &a0.out, scratch, dn_carry_scratch(rig, 1), NULL, &e) == DN_OK && a0.positions[0] < 7);
   p0.palette[12 + 5] = (float)NAN; /* the middle joint */
   CHECK(dn_carry(rig, &pose, &track, &a0.out, scratch, bytes, NULL, &e) == DN_NOT_FINITE);
   for (i = 0; i < 3 * PAIR_V; i++) CHECK(test_finite(a0.displacement[i]));
   CHECK(a0.out.fallback_nodes > PAIR_V / 2);
   CHECK(dn_evaluate(rig, &pose, correction, scratch, bytes, NULL, &e) == DN_NOT_FINITE && e.code == DN_NOT_FINITE);
   for (i = 0; i < 3 * PAIR_V; i++) CHECK(test_finite(correction[i]));
   free(correction);
   test_aligned_free(memory);
   test_aligned_free(scratch);
   dn_rig_free(rig);
   dn_model_free(m);
}

/* --- coarse meshes */
typedef struct thin { dn_coarse c; void *memory; dn_result code; } thin;
static thin thin_of(const dn_rig *full, float share, int garbage)
{
   thin t;
   size_t bytes, scratch_bytes;
   void *scratch;
   dn_error e;
   memset(&t, 0, sizeof t);
   CHECK(dn_coarse_size(full, &bytes, &scratch_bytes, &e) == DN_OK);
   t.memory = test_aligned(bytes), scratch = test_aligned(scratch_bytes);
   memset(t.memory, garbage, bytes), memset(scratch, garbage, scratch_bytes);
   t.code = dn_coarse_init(full, share, t.memory, bytes, scratch, scratch_bytes, &t.c, &e);
   CHECK_MSG(t.code == DN_OK, "%s", t.code == DN_OK ? "" : e.info);
   CHECK(t.c.bytes <= bytes);
   test_aligned_free(scratch);
   return t;
}
/* what must hold of every coarse mesh; returns how many numbers were looked at */
static size_t thin_sound(const thin *t, const dn_rig_view *v)
{
   const dn_coarse *c = &t->c;
   const uint32_t *q = (const uint32_t *)c->mesh.indices;
   size_t i, k, m, sum_bad = 0, own_bad = 0, strange = 0, kept = 0;
   uint32_t *coarse_of = (uint32_t *)test_block(v->nodes * 4), *label = (uint32_t *)test_block(v->nodes * 8);
   CHECK(c->full == v->nodes && c->nodes >= 1 && c->nodes <= v->nodes && c->mesh.vertices == c->nodes);
   memset(coarse_of, 0xff, v->nodes * 4);
   for (m = 0; m < c->nodes; m++) {
      size_t n = c->node[m], from = v->first_vertex[n];
      CHECK(n < v->nodes && coarse_of[n] == 0xffffffffu);
      CHECK(m == 0 || v->first_vertex[c->node[m - 1]] < v->first_vertex[n]);
      coarse_of[n] = (uint32_t)m;
      own_bad += memcmp(c->mesh.positions + 3 * m, v->rest + 3 * n, 12) != 0;
      own_bad += memcmp(c->skin_joint + v->influences * m, v->skin_joint + v->influences * from, 4 * v->influences) != 0;
      own_bad += memcmp(c->skin_weight + v->influences * m, v->skin_weight + v->influences * from, 4 * v->influences) != 0;
   }
   for (i = 0; i < c->mesh.triangles; i++)
      CHECK(q[3 * i] < c->nodes && q[3 * i + 1] < c->nodes && q[3 * i + 2] < c->nodes && q[3 * i] != q[3 * i + 1] &&
            q[3 * i + 1] != q[3 * i + 2] && q[3 * i + 2] != q[3 * i]);
   dn__graph_components(&v->graph, label, label + v->nodes);
   for (i = 0; i < v->nodes; i++) {
      double sum = 0;
      for (k = 0; k < 3; k++) {
         float w = c->spread_weight[3 * i + k];
         CHECK(c->spread_node[3 * i + k] < c->nodes && w >= 0 && w <= 1);
         sum += (double)w;
         strange += label[c->node[c->spread_node[3 * i + k]]] != label[i]; /* another part of the mesh */
      }
      sum_bad += !(fabs(sum - 1) <= 1e-6);
      if (coarse_of[i] == 0xffffffffu) continue;
      kept++;
      own_bad += c->spread_node[3 * i] != coarse_of[i] || c->spread_weight[3 * i] != 1 || c->spread_weight[3 * i + 1] != 0 ||
                 c->spread_weight[3 * i + 2] != 0;
   }
   CHECK_MSG(sum_bad == 0 && own_bad == 0 && strange == 0 && kept == c->nodes, "%lu sums, %lu of the kept, %lu across parts",
             (unsigned long)sum_bad, (unsigned long)own_bad, (unsigned long)strange);
   free(coarse_of), free(label);
   return 3 * v->nodes;
}
/* no edge in more than two triangles, and in no triangle twice the same way round */
static int thin_surface(const thin *t)
{
   const uint32_t *q = (const uint32_t *)t->c.mesh.indices;
   size_t i, j, k, l, n = 3 * t->c.mesh.triangles;
   for (i = 0; i < n; i++)
      for (j = 0; j < i; j++) {
         k = i - i % 3 + (i % 3 + 1) % 3, l = j - j % 3 + (j % 3 + 1) % 3;
         if (q[i] == q[j] && q[k] == q[l]) return 0;
      }
   return 1;
}
static dn_rig *thin_bind(const thin *t, const dn_model *m, const dn_rig_desc *full, dn_report *report)
{
   dn_rig_desc d;
   dn_error e;
   dn_rig *r;
   dn_coarse_describe(&t->c, full, &d);
   r = dn_rig_create(m, &d, NULL, report, &e);
   CHECK_MSG(r != NULL, "%s", r ? "" : e.info);
   return r;
}

TEST(all_nodes_kept_it_is_dn_deform)
{
   size_t skinning, near, f, compared = 0;
   pair_make(&p0);
   for (skinning = 0; skinning < 2; skinning++)
      for (near = 0; near < 2; near++) {
         dn_model *m = tiny_model(0);
         dn_rig *rig, *coarse;
         dn_rig_view view;
         dn_report report;
         dn_track track;
         void *memory;
         thin t;
         float *correction = (float *)test_block(PAIR_V * 12), *full = (float *)test_block(PAIR_V * 12);
         p0.desc.skinning = skinning ? DN_DQS : DN_LBS;
         p0.desc.order = near ? DN_ORDER_NEAR : DN_ORDER_GIVEN;
         rig = pair_bind(m, &p0);
         dn_rig_describe(rig, &view);
         t = thin_of(rig, 1, 0xa5);
         compared += thin_sound(&t, &view);
         CHECK(t.c.nodes == PAIR_V && t.c.mesh.triangles == PAIR_T);
         coarse = thin_bind(&t, m, &p0.desc, &report);
         CHECK(report.nodes == PAIR_V && report.components == 2 && report.solid_cells == 0); /* geodesic distances were sampled */
         track = track_of(PAIR_V, &memory);
         for (f = 0; f < 4; f++) {
            dn_pose pose = pose_of(p0.palette);
            double d;
            pair_pose(&p0, 0.25 * (double)f, 0.4 * (double)f);
            deform(rig, &pose, &a0);
            CHECK(evaluate(coarse, &pose, correction, NULL) == DN_OK);
            dn_spread(&t.c, coarse, correction, full, NULL);
            dn_track_put(&track, full, 0, 0);
            pose.strength = 1;
            carry(rig, &pose, &track, NULL, &b0);
            d = furthest(a0.positions, b0.positions, 3 * PAIR_V);
            CHECK_MSG(d <= 1e-6, "frame %lu: %.1e", (unsigned long)f, d);
         }
         free(correction), free(full);
         test_aligned_free(memory), test_aligned_free(t.memory);
         dn_rig_free(coarse);
         dn_rig_free(rig);
         dn_model_free(m);
      }
   AT_LEAST(compared, 12 * PAIR_V, "weights");
}

TEST(fewer_nodes_keep_borders_and_parts)
{
   static const float shares[5] = {0.75f, 0.5f, 0.25f, 0.1f, 0.001f};
   static const unsigned counts[3] = {2, 3, 7};
   size_t s, k, i, compared = 0;
   dn_model *m = tiny_model(0);
   dn_rig *rig;
   dn_rig_view view;
   pair_make(&p0);
   rig = pair_bind(m, &p0);
   dn_rig_describe(rig, &view);
   for (s = 0; s < 5; s++) {
      thin t = thin_of(rig, shares[s], 0xa5), again = thin_of(rig, shares[s], 0x5a);
      dn_report report;
      dn_rig *coarse = thin_bind(&t, m, &p0.desc, &report);
      dn_rig_view cv;
      float *x = (float *)test_block(view.nodes * 12), *y = (float *)test_block(view.nodes * 12), *z = (float *)test_block(view.nodes * 12);
      double worst = 0, ends[2] = {9, -9};
      size_t wanted = (size_t)((double)shares[s] * PAIR_V + 0.5);
      compared += thin_sound(&t, &view);
      CHECK_MSG(s >= 3 || t.c.nodes == wanted, "%lu nodes, wanted %lu", (unsigned long)t.c.nodes, (unsigned long)wanted);
      CHECK(t.c.nodes >= wanted && t.c.nodes <= wanted + 40); /* a tube ends as two border triangles with strips between */
      CHECK(report.components == 2 && report.isolated_nodes == 0 && report.nodes == t.c.nodes && report.seams_welded == 0);
      CHECK(t.c.nodes + t.c.mesh.triangles == report.edges && thin_surface(&t)); /* Euler: two tubes, still open */
      CHECK(again.c.nodes == t.c.nodes && memcmp(again.c.spread_weight, t.c.spread_weight, PAIR_V * 12) == 0 &&
            memcmp(again.c.spread_node, t.c.spread_node, PAIR_V * 12) == 0 && memcmp(again.c.node, t.c.node, 4 * t.c.nodes) == 0);
      for (i = 0; i < t.c.nodes; i++) {
         ends[0] = fmin(ends[0], (double)t.c.mesh.positions[3 * i]), ends[1] = fmax(ends[1], (double)t.c.mesh.positions[3 * i]);
         CHECK(memcmp(t.c.geodesic + PAIR_S * i, view.geodesic + PAIR_S * (size_t)t.c.node[i], PAIR_S * 4) == 0);
      }
      CHECK_MSG(ends[0] < 0.01 && ends[1] > 1.15, "from %.3f to %.3f m", ends[0], ends[1]); /* both borders are there */
      dn_rig_describe(coarse, &cv); /* spreading the places themselves shows how far the coarse surface is from the full one */
      for (i = 0; i < t.c.nodes; i++) memcpy(x + 3 * (size_t)cv.node_of_vertex[i], t.c.mesh.positions + 3 * i, 12);
      dn_spread(&t.c, coarse, x, y, NULL);
      for (i = 0; i < view.nodes; i++) {
         double d = 0;
         for (k = 0; k < 3; k++) d += pow((double)y[3 * i + k] - (double)view.rest[3 * i + k], 2);
         worst = sqrt(d) > worst ? sqrt(d) : worst;
      }
      CHECK_MSG(worst <= (s == 0 ? 0.015 : s == 1 ? 0.02 : s == 2 ? 0.04 : 0.2), "share %.3f: %.1f mm", (double)shares[s], 1000 * worst);
      for (i = 0; i < t.c.nodes; i++) CHECK(memcmp(y + 3 * (size_t)t.c.node[i], view.rest + 3 * (size_t)t.c.node[i], 12) == 0);
      for (k = 0; k < 3; k++) {
         unsigned workers = counts[k];
         dn_parallel par;
         par.run = uneven, par.user = &workers, par.workers = workers;
         dn_spread(&t.c, coarse, x, z, &par);
         CHECK(memcmp(y, z, view.nodes * 12) == 0);
      }
      free(x), free(y), free(z);
      dn_rig_free(coarse);
      test_aligned_free(t.memory), test_aligned_free(again.memory);
   }
   dn_rig_free(rig);
   dn_model_free(m);
   AT_LEAST(compared, 15 * PAIR_V, "weights");
}

/* triangles over points in a plane or where `place` puts them, all on one joint; bound, thinned, checked */
typedef struct odd { size_t vertices, triangles; float *positions; uint32_t *indices; } odd;
static size_t odd_check(const odd *o, float share, size_t least, size_t most)
{
   dn_rig_desc d;
   dn_skin_set skin;
   dn_rig *rig;
   dn_rig_view view;
   dn_error e;
   thin t;
   uint8_t *joint = (uint8_t *)test_block(o->vertices);
   float *weight = (float *)test_block(o->vertices * 4);
   size_t i, checked;
   memset(&d, 0, sizeof d), memset(&skin, 0, sizeof skin);
   for (i = 0; i < o->vertices; i++) joint[i] = 0, weight[i] = 1;
   skin.influences = 1, skin.joints = joint, skin.joint_type = DN_U8, skin.weights = weight, skin.weight_type = DN_F32;
   d.mesh.vertices = o->vertices, d.mesh.positions = o->positions, d.mesh.triangles = o->triangles, d.mesh.indices = o->indices;
   d.mesh.index_type = DN_U32, d.mesh.skin_sets = 1, d.mesh.skin = &skin, d.skeleton.joints = 1;
   rig = dn_rig_create(NULL, &d, NULL, NULL, &e);
   CHECK_MSG(rig != NULL, "%s", rig ? "" : e.info);
   dn_rig_describe(rig, &view);
   t = thin_of(rig, share, 0x5a);
   checked = thin_sound(&t, &view);
   CHECK_MSG(t.c.nodes >= least && t.c.nodes <= most, "%lu nodes of %lu", (unsigned long)t.c.nodes, (unsigned long)view.nodes);
   CHECK(t.c.geodesic == NULL);
   test_aligned_free(t.memory);
   dn_rig_free(rig);
   free(joint), free(weight);
   return checked;
}
static odd odd_of(size_t vertices, size_t triangles)
{
   odd o;
   o.vertices = vertices, o.triangles = triangles;
   o.positions = (float *)test_block(vertices * 12), o.indices = (uint32_t *)test_block(triangles * 12);
   memset(o.positions, 0, vertices * 12), memset(o.indices, 0, triangles * 12);
   return o;
}
static void odd_free(odd *o) { free(o->positions), free(o->indices); }
TEST(meshes_that_are_hardly_meshes)
{
   static const uint32_t tetra[12] = {0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3};
   size_t i, k, n, checked = 0;
   uint64_t seed = 3;
   odd o = odd_of(4, 4); /* a tetrahedron has no triangle to spare */
   for (i = 0; i < 12; i++) o.indices[i] = tetra[i], o.positions[i] = i == 3 || i == 7 || i == 11 ? 1.0f : 0.0f;
   checked += odd_check(&o, 0.25f, 4, 4);
   o.triangles = 0; /* points */
   checked += odd_check(&o, 0.25f, 4, 4);
   o.triangles = 1;
   checked += odd_check(&o, 0.25f, 4, 4);
   odd_free(&o);

   n = 3000; /* a fan of so many spokes, and every triangle twice */
   o = odd_of(n + 1, 2 * n);
   for (i = 0; i < n; i++) {
      o.positions[3 * i + 3] = (float)cos(6.283185 * (double)i / (double)n), o.positions[3 * i + 4] = (float)sin(6.283185 * (double)i / (double)n);
      o.indices[3 * i + 1] = o.indices[3 * (n + i) + 1] = (uint32_t)i + 1;
      o.indices[3 * i + 2] = o.indices[3 * (n + i) + 2] = (uint32_t)((i + 1) % n) + 1;
   }
   o.triangles = n;
   checked += odd_check(&o, 0.25f, n / 8, n);
   o.triangles = 2 * n;
   checked += odd_check(&o, 0.25f, n / 4, n + 1);
   odd_free(&o);

   n = 400; /* three sheets that meet in one line, which must stay */
   o = odd_of(n + 3 * n, 6 * (n - 1));
   for (i = 0; i < n; i++)
      for (k = 0; k < 4; k++) {
         float *p = o.positions + 3 * (k * n + i);
         p[0] = 0.01f * (float)i;
         if (k) p[1] = (float)cos(2.1 * (double)k), p[2] = (float)sin(2.1 * (double)k);
         if (k && i + 1 < n) {
            uint32_t *q = o.indices + 6 * ((k - 1) * (n - 1) + i), a = (uint32_t)i, b = (uint32_t)(k * n + i);
            q[0] = a, q[1] = a + 1, q[2] = b, q[3] = a + 1, q[4] = b + 1, q[5] = b;
         }
      }
   checked += odd_check(&o, 0.5f, 2 * n, 2 * n + n / 4);
   checked += odd_check(&o, 0.01f, n, 2 * n);
   odd_free(&o);

   for (k = 0; k < 40; k++) { /* soups: random triangles, repeats and needles among them, huge and tiny */
      float size = k % 4 == 0 ? 1e-30f : k % 4 == 1 ? 1e30f : 1;
      n = 3 + test_random(&seed) % 120;
      o = odd_of(n, 2 * n);
      for (i = 0; i < 3 * n; i++) o.positions[i] = size * (k % 3 ? test_uniform(&seed, -1, 1) : (float)(test_random(&seed) % 3));
      for (i = 0; i < 6 * n; i++) o.indices[i] = test_random(&seed) % (uint32_t)n;
      checked += odd_check(&o, 0.3f, 1, n);
      odd_free(&o);
   }
   AT_LEAST(checked, 20000, "weights");
}

TEST(coarse_meshes_refuse_what_does_not_fit)
{
   static const float shares[5] = {0, -0.5f, 1.5f, NAN, 1e30f};
   dn_rig *rig;
   dn_error e;
   dn_coarse c;
   size_t bytes, scratch_bytes, k;
   void *memory, *scratch;
   pair_make(&p0);
   rig = pair_bind(NULL, &p0);
   CHECK(dn_coarse_size(rig, &bytes, &scratch_bytes, &e) == DN_OK);
   memory = test_aligned(bytes), scratch = test_aligned(scratch_bytes);
   for (k = 0; k < 5; k++) {
      memset(&e, 0, sizeof e);
      CHECK(dn_coarse_init(rig, shares[k], memory, bytes, scratch, scratch_bytes, &c, &e) == DN_BAD_VALUE && e.code == DN_BAD_VALUE && e.info[0]);
   }
   CHECK(dn_coarse_init(rig, 1, memory, bytes, scratch, scratch_bytes - 1, &c, &e) == DN_TOO_SMALL && strstr(e.info, "scratch"));
   CHECK(dn_coarse_init(rig, 1, memory, bytes - 1, scratch, scratch_bytes, &c, &e) == DN_TOO_SMALL && strstr(e.info, "memory"));
   CHECK(dn_coarse_init(rig, 0.5f, memory, bytes, scratch, scratch_bytes, &c, &e) == DN_OK && c.bytes < bytes);
   k = c.bytes; /* an upper bound: what was used is enough */
   CHECK(dn_coarse_init(rig, 0.5f, memory, k, scratch, scratch_bytes, &c, &e) == DN_OK && c.bytes == k);
   CHECK(dn_coarse_init(rig, 0.5f, memory, k - 1, scratch, scratch_bytes, &c, &e) == DN_TOO_SMALL);
   test_aligned_free(memory), test_aligned_free(scratch);
   dn_rig_free(rig);
}

/* --- the demo: a body of 8,357 vertices, its trained model, and the truth of a clip at 24 frames a second */
typedef struct demo {
   unsigned char *body, *clip, *weights;
   void *views[2];
   dn_tensors *tensors[2];
   float *positions, *skin_weights, *inverse_bind;
   uint32_t *skin_joints, *triangles;
   int32_t *parents;
   const char *names[128];
   char joined[4096];
   const dn_tensor *palettes, *vertices;
   size_t V, T, S, I;
   dn_skin_set skin;
   dn_rig_desc desc;
   dn_model *model;
} demo;
static const dn_tensor *demo_tensor(const demo *d, size_t file, const char *name)
{
   const dn_tensor *t = dn_tensors_find(d->tensors[file], name);
   CHECK_MSG(t != NULL, "the demo has no %s", name);
   if (!t) exit(2);
   return t;
}
static float *demo_floats(const demo *d, const char *name)
{
   const dn_tensor *t = demo_tensor(d, 0, name);
   float *x = (float *)test_block(t->count * 4);
   dn_tensor_floats(t, 0, t->count, x);
   return x;
}
static void *demo_ints(const demo *d, const char *name)
{
   const dn_tensor *t = demo_tensor(d, 0, name);
   int32_t *x = (int32_t *)test_block(t->count * 4);
   dn_tensor_ints(t, 0, t->count, x);
   return x;
}
static void demo_open(demo *d)
{
   static const char *const paths[3] = {"../examples/demo/humanoid.safetensors", "../examples/demo/truth.safetensors",
                                        "../examples/models/humanoid.safetensors"};
   size_t size[3], k, bytes;
   char *at;
   dn_error e;
   memset(d, 0, sizeof *d);
   d->body = test_file(paths[0], &size[0]);
   d->clip = test_file(paths[1], &size[1]);
   d->weights = test_file(paths[2], &size[2]);
   for (k = 0; k < 2; k++) {
      const unsigned char *file = k ? d->clip : d->body;
      CHECK(dn_tensors_size(file, size[k], &bytes, &e) == DN_OK);
      d->views[k] = test_aligned(bytes);
      CHECK(dn_tensors_open(file, size[k], d->views[k], bytes, &d->tensors[k], &e) == DN_OK);
   }
   d->model = dn_model_load(d->weights, size[2], NULL, NULL, &e);
   CHECK_MSG(d->model != NULL, "%s", d->model ? "" : e.info);
   d->V = demo_tensor(d, 0, "positions")->shape[0], d->T = demo_tensor(d, 0, "triangles")->shape[0];
   d->S = demo_tensor(d, 0, "parents")->shape[0], d->I = demo_tensor(d, 0, "skin_joints")->shape[1];
   d->positions = demo_floats(d, "positions"), d->skin_weights = demo_floats(d, "skin_weights");
   d->inverse_bind = demo_floats(d, "inverse_bind");
   d->skin_joints = (uint32_t *)demo_ints(d, "skin_joints"), d->triangles = (uint32_t *)demo_ints(d, "triangles");
   d->parents = (int32_t *)demo_ints(d, "parents");
   snprintf(d->joined, sizeof d->joined, "%s", dn_tensors_meta(d->tensors[0], "joint_names"));
   for (at = d->joined, k = 0; at && k < 128; k++) {
      d->names[k] = at;
      at = strchr(at, ',');
      if (at) *at++ = 0;
   }
   CHECK(k == d->S);
   d->palettes = demo_tensor(d, 1, "palettes"), d->vertices = demo_tensor(d, 1, "vertices");
   d->skin.influences = d->I;
   d->skin.joints = d->skin_joints, d->skin.joint_type = DN_U32;
   d->skin.weights = d->skin_weights, d->skin.weight_type = DN_F32;
   d->desc.mesh.vertices = d->V, d->desc.mesh.positions = d->positions;
   d->desc.mesh.triangles = d->T, d->desc.mesh.indices = d->triangles, d->desc.mesh.index_type = DN_U32;
   d->desc.mesh.skin_sets = 1, d->desc.mesh.skin = &d->skin;
   d->desc.skeleton.joints = d->S, d->desc.skeleton.names = d->names, d->desc.skeleton.parents = d->parents;
   d->desc.skeleton.inverse_bind = d->inverse_bind, d->desc.skeleton.matrix = DN_3X4_ROWS;
   d->desc.resolution = 64;
}
static void demo_close(demo *d)
{
   dn_model_free(d->model);
   test_aligned_free(d->views[0]), test_aligned_free(d->views[1]);
   free(d->body), free(d->clip), free(d->weights), free(d->positions), free(d->skin_weights), free(d->inverse_bind);
   free(d->skin_joints), free(d->triangles), free(d->parents);
}
static double demo_error(const demo *d, size_t frame, const float *positions, float *truth) /* mean, centimetres; truth (V,3) scratch */
{
   double sum = 0;
   size_t v;
   dn_tensor_floats(d->vertices, frame * d->V * 3, d->V * 3, truth);
   for (v = 0; v < d->V; v++) {
      double x = (double)positions[3 * v] - (double)truth[3 * v], y = (double)positions[3 * v + 1] - (double)truth[3 * v + 1];
      double z = (double)positions[3 * v + 2] - (double)truth[3 * v + 2];
      sum += sqrt(x * x + y * y + z * z);
   }
   return 100 * sum / (double)d->V;
}

/* Bounds a little above what README's table has: mean error over skinning's, k = 3, in the clip's liveliest second */
TEST(every_third_frame_of_the_demo)
{
   enum { FIRST = 24, FRAMES = 12, K = 3, WAYS = 5 }; /* plain, glide, lead, ahead, hold */
   static const char *const name[WAYS] = {"plain", "glide", "lead 0.5", "ahead", "hold"};
   static demo d;
   dn_rig *rig;
   dn_rig_view view;
   dn_error e;
   float *correction, *positions, *truth, *palettes;
   void *scratch, *memory[WAYS];
   dn_track track[WAYS];
   double sum[WAYS] = {0}, skinned = 0;
   size_t bytes, f, w, frames = 0;
   demo_open(&d);
   rig = dn_rig_create(d.model, &d.desc, NULL, NULL, &e);
   CHECK_MSG(rig != NULL, "%s", rig ? "" : e.info);
   if (!rig) return;
   dn_rig_describe(rig, &view);
   for (w = 0; w < WAYS; w++) track[w] = track_of(view.nodes, &memory[w]);
   correction = (float *)test_block(view.nodes * 12);
   positions = (float *)test_block(d.V * 12), truth = (float *)test_block(d.V * 12);
   palettes = (float *)test_block(d.palettes->count * 4);
   dn_tensor_floats(d.palettes, 0, d.palettes->count, palettes);
   bytes = dn_scratch_size(rig, 1);
   scratch = test_aligned(bytes);
   for (f = 0; f < FRAMES; f++, frames++) {
      const float *palette = palettes + (FIRST + f) * d.S * 12;
      dn_pose pose = pose_of(palette);
      dn_output out;
      CHECK(dn_evaluate(rig, &pose, correction, scratch, bytes, NULL, &e) == DN_OK);
      for (w = 0; w < WAYS; w++) {
         if (w && f % K) continue;
         if (w == 3) {
            pose.palette = palettes + (FIRST + f + K - 1) * d.S * 12;
            CHECK(dn_evaluate(rig, &pose, correction, scratch, bytes, NULL, &e) == DN_OK);
            pose.palette = palette;
         }
         dn_track_put(&track[w], correction, w == 0 || w == 4 ? 0 : K, w == 2 ? 0.5f : 0);
         if (w == 3) CHECK(dn_evaluate(rig, &pose, correction, scratch, bytes, NULL, &e) == DN_OK);
      }
      memset(&out, 0, sizeof out);
      out.positions = positions;
      for (w = 0; w < WAYS; w++) {
         dn_track_advance(&track[w], 1);
         CHECK(dn_carry(rig, &pose, &track[w], &out, scratch, bytes, NULL, &e) == DN_OK);
         sum[w] += demo_error(&d, FIRST + f, positions, truth);
      }
      pose.strength = 0;
      CHECK(dn_carry(rig, &pose, &track[0], &out, scratch, bytes, NULL, &e) == DN_OK);
      skinned += demo_error(&d, FIRST + f, positions, truth);
   }
   for (w = 0; w < WAYS; w++) printf("   %s %.4f", name[w], sum[w] / skinned);
   printf(" of skinning's %.3f cm\n", skinned / (double)frames);
   CHECK(sum[0] < 0.7 * skinned);
   CHECK(sum[3] < 1.02 * sum[0] && sum[2] < 1.15 * sum[0] && sum[4] < 1.15 * sum[0] && sum[1] < 1.3 * sum[0]);
   CHECK(sum[3] < sum[1] && sum[2] < sum[1]); /* a lead is worth having, knowing the motion more so */
   for (w = 0; w < WAYS; w++) test_aligned_free(memory[w]);
   free(correction), free(positions), free(truth), free(palettes);
   test_aligned_free(scratch);
   dn_rig_free(rig);
   demo_close(&d);
   AT_LEAST(frames, 12, "frames");
}

/* Half of the nodes, a quarter, and both together with every second frame; and the coarse demo is still one closed surface */
TEST(the_demo_on_fewer_nodes)
{
   enum { FIRST = 20, STEP = 3, FRAMES = 8 };
   static const float shares[2] = {0.5f, 0.25f};
   static demo d;
   dn_rig *rig;
   dn_rig_view view;
   dn_error e;
   float *correction, *full, *positions, *truth, *palettes;
   void *scratch, *memory;
   dn_track track;
   double plain = 0, skinned = 0;
   size_t bytes, f, s, checked = 0;
   demo_open(&d);
   rig = dn_rig_create(d.model, &d.desc, NULL, NULL, &e);
   CHECK_MSG(rig != NULL, "%s", rig ? "" : e.info);
   if (!rig) return;
   dn_rig_describe(rig, &view);
   correction = (float *)test_block(view.nodes * 12), full = (float *)test_block(view.nodes * 12);
   positions = (float *)test_block(d.V * 12), truth = (float *)test_block(d.V * 12);
   palettes = (float *)test_block(d.palettes->count * 4);
   dn_tensor_floats(d.palettes, 0, d.palettes->count, palettes);
   bytes = dn_scratch_size(rig, 1);
   scratch = test_aligned(bytes);
   track = track_of(view.nodes, &memory);
   for (s = 0; s < 3; s++) { /* 0: the full mesh */
      thin t;
      dn_rig *coarse = NULL;
      dn_report report;
      double sum = 0;
      memset(&t, 0, sizeof t);
      if (s) {
         t = thin_of(rig, shares[s - 1], 0xa5);
         checked += thin_sound(&t, &view);
         coarse = thin_bind(&t, d.model, &d.desc, &report);
         CHECK(report.components == 1 && report.isolated_nodes == 0);
         CHECK(3 * t.c.mesh.triangles == 2 * report.edges && t.c.nodes + t.c.mesh.triangles == report.edges + 2); /* Euler: a sphere */
         CHECK(t.c.nodes == (size_t)((double)shares[s - 1] * (double)view.nodes + 0.5));
      }
      for (f = 0; f < FRAMES; f++) {
         dn_pose pose = pose_of(palettes + (FIRST + STEP * f) * d.S * 12);
         dn_output out;
         memset(&out, 0, sizeof out);
         out.positions = positions;
         CHECK(evaluate(coarse ? coarse : rig, &pose, correction, NULL) == DN_OK);
         if (coarse) dn_spread(&t.c, coarse, correction, full, NULL);
         dn_track_put(&track, coarse ? full : correction, 0, 0);
         CHECK(dn_carry(rig, &pose, &track, &out, scratch, bytes, NULL, &e) == DN_OK);
         sum += demo_error(&d, FIRST + STEP * f, positions, truth);
         if (s) continue;
         pose.strength = 0;
         CHECK(dn_carry(rig, &pose, &track, &out, scratch, bytes, NULL, &e) == DN_OK);
         skinned += demo_error(&d, FIRST + STEP * f, positions, truth);
      }
      if (s == 0) plain = sum;
      printf("   %.2f of the nodes %.4f", s ? (double)shares[s - 1] : 1.0, sum / skinned);
      CHECK(sum < (s == 2 ? 1.12 : 1.03) * plain && sum < 0.7 * skinned);
      dn_rig_free(coarse);
      test_aligned_free(t.memory);
   }
   printf(" of skinning's %.3f cm\n", skinned / FRAMES);
   free(correction), free(full), free(positions), free(truth), free(palettes);
   test_aligned_free(scratch), test_aligned_free(memory);
   dn_rig_free(rig);
   demo_close(&d);
   AT_LEAST(checked, 40000, "weights");
}

int main(int argc, char **argv)
{
   TEST_BEGIN(argc, argv);
   RUN(evaluated_every_frame_it_is_dn_deform);
   RUN(the_glide);
   RUN(an_empty_track_is_plain_skinning);
   RUN(turning_the_character_does_not_change_its_correction);
   RUN(threads_do_not_change_a_bit);
   RUN(too_little_memory_and_numbers_that_are_none);
   RUN(all_nodes_kept_it_is_dn_deform);
   RUN(fewer_nodes_keep_borders_and_parts);
   RUN(meshes_that_are_hardly_meshes);
   RUN(coarse_meshes_refuse_what_does_not_fit);
   RUN(every_third_frame_of_the_demo);
   RUN(the_demo_on_fewer_nodes);
   return TEST_END();
}
