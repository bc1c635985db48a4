/*  rows.c - what the network reads: whole rows, and a first layer whose geodesic columns were summed at bind

    shows   dn_rows lists every descriptor in the model's order; wherever the geodesic columns stand, with and without batch
            norm, bias and scales, in every kernel, the network is the one the file describes, evaluated here in double;
            every text of >>features against the plain one, nothing written outside, the same bits wherever a range begins
    build   cc -O2 rows.c -o rows -lm */
#define DEFORMNET_IMPLEMENTATION
#define DEFORMNET_STATIC
#include "../deformnet.h"
#include "test.h"
#include "tiny.h"
#include <math.h>

enum { MOST = 24, WIDE = 19 }; /* columns of a row; outputs of pre.0, not a whole number of panels */
typedef struct list { const char *features; size_t width, bound; } list;
static const list lists[] = {
   {"position,normal,geodesic", 9, 3}, {"geodesic,relative", 6, 3}, {"normal,geodesic,distance", 9, 3},
   {"geodesic,position,geodesic,distance,relative", 15, 6}, {"relative,distance", 6, 0}, {"geodesic", 3, 0}
};
enum { BN = 1, SCALES = 2, BIAS = 4, DEEP = 8 /* pre.0 and out; else out alone reads the rows */, VARIANTS = 16 };

static unsigned char *net_file(const list *l, int how, uint64_t *seed, size_t *size)
{
   static tiny_writer w;
   char meta[512];
   snprintf(meta, sizeof meta, TINY_META TINY_JOINTS ",\"deformnet.arch\":\"mlp\",\"deformnet.features\":\"%s\"", l->features);
   tiny_begin(&w, meta);
   if (how & SCALES) tiny_tensor(&w, "input.mean", l->width, 0, seed, -0.4f, 0.8f);
   if (how & SCALES) tiny_tensor(&w, "input.std", l->width, 0, seed, 0.3f, 1.5f);
   if (how & DEEP) {
      tiny_tensor(&w, "pre.0.weight", WIDE, l->width, seed, -0.7f, 0.7f);
      if (how & BIAS) tiny_tensor(&w, "pre.0.bias", WIDE, 0, seed, -0.5f, 0.5f);
      if (how & BN) tiny_batchnorm(&w, "pre.0", WIDE, seed);
   }
   tiny_tensor(&w, "out.weight", 3, how & DEEP ? WIDE : l->width, seed, -0.7f, 0.7f);
   if (how & BIAS) tiny_tensor(&w, "out.bias", 3, 0, seed, -0.5f, 0.5f);
   if (how & BN) tiny_batchnorm(&w, "out", 3, seed);
   return tiny_file(&w, size);
}
/* tensor name, or `absent` everywhere when the file has none */
static void numbers(const dn_tensors *file, const char *name, const char *part, double absent, size_t count, double *to)
{
   float from[WIDE * MOST];
   char full[64];
   const dn_tensor *t;
   size_t i;
   snprintf(full, sizeof full, "%s%s", name, part);
   t = dn_tensors_find(file, full);
   if (t) CHECK(t->count == count), dn_tensor_floats(t, 0, count, from);
   for (i = 0; i < count; i++) to[i] = t ? (double)from[i] : absent;
}
static void layer(const dn_tensors *file, const char *name, size_t in, size_t out, const double *x, double *y)
{
   double w[WIDE * MOST], b[WIDE], bn[4][WIDE];
   size_t o, c;
   numbers(file, name, ".weight", 0, out * in, w);
   numbers(file, name, ".bias", 0, out, b);
   numbers(file, name, ".bn.weight", 1, out, bn[0]);
   numbers(file, name, ".bn.bias", 0, out, bn[1]);
   numbers(file, name, ".bn.running_mean", 0, out, bn[2]);
   numbers(file, name, ".bn.running_var", 1 - 1e-5, out, bn[3]);
   for (o = 0; o < out; o++) {
      for (c = 0, y[o] = b[o]; c < in; c++) y[o] += w[o * in + c] * x[c];
      y[o] = (y[o] - bn[2][o]) / sqrt(bn[3][o] + 1e-5) * bn[0][o] + bn[1][o];
   }
}
static double worst;
static void network_case(const list *l, int how, dn_kernel kernel, const tube *t, uint64_t *seed)
{
   size_t size, bytes, scratch_bytes, i, k, n;
   unsigned char *file = net_file(l, how, seed, &size);
   dn_tensors *tensors = NULL;
   dn_rig_view view;
   dn_error e;
   dn_model *m;
   dn_rig *rig;
   dn_model_options options;
   dn_pose pose;
   void *table, *scratch;
   float rows[TUBE_V * MOST];
   memset(&options, 0, sizeof options);
   options.kernel = kernel;
   m = dn_model_load(file, size, &options, NULL, &e);
   rig = m ? dn_rig_create(m, &t->desc, NULL, NULL, &e) : NULL;
   if (!CHECK_MSG(rig != NULL, "%s: %s", l->features, rig ? "" : e.info)) return;
   CHECK(dn_tensors_size(file, size, &bytes, NULL) == DN_OK);
   table = test_aligned(bytes);
   CHECK(dn_tensors_open(file, size, table, bytes, &tensors, NULL) == DN_OK);
   CHECK(m->stage[0].row_width == l->width && m->stage[0].bound_width == l->bound && !rig->start == !l->bound);
   CHECK(m->blocks[0].linear.in == l->width - l->bound); /* what the frame multiplies */
   scratch_bytes = dn_scratch_size(rig, 1);
   scratch = test_aligned(scratch_bytes);
   memset(&pose, 0, sizeof pose);
   pose.palette = t->palette, pose.strength = 1.0f;
   CHECK(dn_stage_skin(rig, &pose, scratch, scratch_bytes, NULL, &e) == DN_OK);
   dn_stage_rows(rig, scratch, NULL);
   dn_rows(rig, scratch, rows);
   dn_stage_network(rig, scratch, NULL, NULL);
   dn_rig_describe(rig, &view);
   for (n = 0; n < view.nodes; n++) {
      const char *name = l->features;
      const float *row = rows + n * l->width;
      double mean[MOST], deviation[MOST], x[MOST], hidden[WIDE], y[3];
      for (i = 0; *name;) { /* the columns that stand somewhere else too */
         size_t length = strcspn(name, ",");
         const float *own = *name == 'g' ? view.geodesic + TUBE_S * n : *name == 'p' ? dn_scratch_coarse(rig, scratch) + 3 * n : NULL;
         for (k = 0; own && k < 3; k++) /* a position is summed in double for the network */
            CHECK_MSG(fabs((double)row[i + k] - (double)own[k]) <= (*name == 'g' ? 0.0 : 3e-7), "%s: node %lu, column %lu is not what its name says",
                      l->features, (unsigned long)n, (unsigned long)(i + k));
         i += 3; /* three joints: every descriptor is as wide */
         name += length + (name[length] != 0);
      }
      CHECK(i == l->width);
      numbers(tensors, "input", ".mean", 0, l->width, mean);
      numbers(tensors, "input", ".std", 1, l->width, deviation);
      for (k = 0; k < l->width; k++) x[k] = ((double)row[k] - mean[k]) / deviation[k];
      if (how & DEEP) {
         layer(tensors, "pre.0", l->width, WIDE, x, hidden);
         for (k = 0; k < WIDE; k++) hidden[k] = tanh(hidden[k]);
      }
      layer(tensors, "out", how & DEEP ? WIDE : l->width, 3, how & DEEP ? hidden : x, y);
      for (k = 0; k < 3; k++) {
         double got = (double)dn_scratch_displacement(rig, scratch)[3 * n + k], off = fabs(got - y[k]);
         if (off > worst) worst = off;
         CHECK_MSG(off <= 2e-6, "%s, variant %d, kernel %d, node %lu: %.8g, expected %.8g", l->features, how, (int)kernel,
                   (unsigned long)n, got, y[k]);
      }
   }
   test_aligned_free(scratch);
   test_aligned_free(table);
   dn_rig_free(rig);
   dn_model_free(m);
   free(file);
}
TEST(the_first_layer_is_whole_wherever_its_columns_are_summed)
{
   uint64_t seed = 5;
   size_t i, cases = 0;
   int how, kernel;
   tube t;
   tube_make(&t);
   for (kernel = 0; kernel < DN_KERNEL_COUNT; kernel++)
      for (how = 0; how < VARIANTS && dn_kernel_available((dn_kernel)kernel); how++)
         for (i = 0; i < sizeof lists / sizeof *lists; i++, cases++) network_case(&lists[i], how, (dn_kernel)kernel, &t, &seed);
   printf("   largest error %.2g\n", worst);
   AT_LEAST(cases, 96, "networks");
}

/* --- the texts of >>features */
#define GUARD 12345.5f
static size_t pick(uint64_t *seed, size_t low, size_t high) { return low + test_random(seed) % (high - low + 1); }
typedef struct scene { /* every array ends with its block; positions and fine have the one number that is loaded past the end */
   size_t nodes, triangles, joints, influences, width;
   float *positions, *rest, *weight, *palette, *posed, *mean, *scale, *part, root[9];
   double *fine;
   uint32_t *triangle, *corner_first, *corner_tri, *joint, *vertex;
   unsigned char *sound; /* (N) its triangles' normals do not cancel: no direction is left to rounding */
} scene;
static float *uniform(uint64_t *seed, size_t count, float low, float high)
{
   float *p = (float *)test_block(count * sizeof *p);
   size_t i;
   for (i = 0; i < count; i++) p[i] = test_uniform(seed, low, high);
   return p;
}
static int sound(const scene *s, size_t node)
{
   double sum[3] = {0, 0, 0}, all = 0;
   size_t e, k;
   for (e = s->corner_first[node]; e < s->corner_first[node + 1]; e++) {
      const uint32_t *t = s->triangle + 3 * s->corner_tri[e];
      double u[3], v[3], n[3];
      for (k = 0; k < 3; k++) u[k] = s->fine[3 * t[1] + k] - s->fine[3 * t[0] + k], v[k] = s->fine[3 * t[2] + k] - s->fine[3 * t[0] + k];
      for (k = 0; k < 3; k++) n[k] = u[(k + 1) % 3] * v[(k + 2) % 3] - u[(k + 2) % 3] * v[(k + 1) % 3], sum[k] += n[k];
      all += sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
   }
   if (s->corner_first[node] == s->corner_first[node + 1]) return 1; /* exactly no normal */
   return all > 1e-6 && sqrt(sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]) >= 0.2 * all;
}
static scene scene_make(uint64_t *seed)
{
   scene s;
   size_t i, k, pitch;
   float *joint_rest;
   s.nodes = pick(seed, 2, 40), s.triangles = pick(seed, 0, 90), s.joints = pick(seed, 1, 40);
   s.influences = pick(seed, 0, 2) ? 4 : pick(seed, 1, 9);
   s.width = pick(seed, 1, 40);
   s.positions = uniform(seed, 3 * s.nodes + 1, -1, 1), s.rest = uniform(seed, 3 * s.nodes, -1, 1);
   s.palette = uniform(seed, 12 * s.joints, -1, 1), s.weight = uniform(seed, s.nodes * s.influences, 0, 1);
   s.mean = uniform(seed, s.width, -1, 1), s.scale = uniform(seed, s.width, 0.1f, 9), s.part = uniform(seed, s.width, -1e-7f, 1e-7f);
   s.fine = (double *)test_block((3 * s.nodes + 1) * sizeof(double));
   for (i = 0; i <= 3 * s.nodes; i++) s.fine[i] = (double)s.positions[i] + (double)test_uniform(seed, -1e-8f, 1e-8f);
   s.positions[3 * s.nodes] = NAN, s.fine[3 * s.nodes] = (double)NAN;
   s.triangle = (uint32_t *)test_block(12 * s.triangles), s.corner_tri = (uint32_t *)test_block(12 * s.triangles);
   s.corner_first = (uint32_t *)test_block(4 * (s.nodes + 1));
   s.joint = (uint32_t *)test_block(4 * s.nodes * s.influences), s.vertex = (uint32_t *)test_block(4 * s.nodes);
   for (i = 0; i < s.triangles; i++) { /* near nodes, with repeats now and then; the last node mostly has none */
      uint32_t at = test_random(seed) % (uint32_t)(s.nodes - 1);
      for (k = 0; k < 3; k++) s.triangle[3 * i + k] = (at + test_random(seed) % 4) % (uint32_t)s.nodes;
   }
   dn__corners_build(s.triangle, s.triangles, s.nodes, s.corner_first, s.corner_tri);
   s.sound = (unsigned char *)test_block(s.nodes);
   for (i = 0; i < s.nodes; i++) s.sound[i] = (unsigned char)sound(&s, i);
   for (i = 0; i < s.nodes * s.influences; i++) s.joint[i] = test_random(seed) % (uint32_t)s.joints, s.weight[i] /= (float)s.influences;
   for (i = 0; i < s.nodes; i++) s.vertex[i] = (uint32_t)(s.nodes - 1 - i);
   for (i = 0; i < 9; i++) s.root[i] = test_uniform(seed, -1, 1);
   pitch = dn__posed_pitch(s.joints);
   s.posed = (float *)test_block(3 * pitch * sizeof(float));
   joint_rest = uniform(seed, 3 * s.joints, -1, 1);
   dn__posed_joints(s.palette, NULL, joint_rest, s.joints, s.posed);
   free(joint_rest);
   return s;
}
static void scene_free(scene *s)
{
   free(s->positions), free(s->rest), free(s->weight), free(s->palette), free(s->posed), free(s->mean), free(s->scale), free(s->part);
   free(s->fine), free(s->triangle), free(s->corner_first), free(s->corner_tri), free(s->joint), free(s->vertex), free(s->sound);
}
enum { NORMALS, FINE, FRAMED, RELATIVE, DISTANCE, NORMALISE, TEXTS };
/* out (nodes,stride) from its second number on; FRAMED fills doubles */
static void text(int which, dn_kernel kernel, const scene *s, size_t begin, size_t end, void *out, size_t stride)
{
   float *f = (float *)out + 1;
   switch (which) {
   case NORMALS: dn__normals_run(kernel, s->positions, s->triangle, s->corner_first, s->corner_tri, begin, end, f); break;
   case FINE: dn__normals_fine_run(kernel, s->fine, s->triangle, s->corner_first, s->corner_tri, begin, end, f); break;
   case FRAMED:
      dn__framed_lbs_run(kernel, s->rest, s->joint, s->weight, s->influences, s->vertex, s->palette, s->root, begin, end, (double *)out + 1);
      break;
   case RELATIVE:
      dn__rows_relative_run(kernel, s->rest, s->joint, s->weight, s->influences, stride % 2 ? s->vertex : NULL, s->palette, begin, end, f, stride);
      break;
   case DISTANCE: dn__rows_distance_run(kernel, s->fine, s->posed, s->joints, begin, end, f, stride); break;
   default: dn__normalise_run(kernel, s->mean, s->scale, s->part, s->width, f, begin, end); break;
   }
}
static void text_case(int which, dn_kernel kernel, const scene *s, uint64_t *seed)
{
   size_t columns = which == DISTANCE ? s->joints : which == NORMALISE ? s->width : 3;
   size_t stride = which == RELATIVE || which == DISTANCE ? columns + pick(seed, 0, 4) : columns;
   size_t begin = pick(seed, 0, s->nodes), end = pick(seed, begin, s->nodes), cut = pick(seed, begin, end), i, c;
   size_t cell = which == FRAMED ? sizeof(double) : sizeof(float), numbers = 2 + s->nodes * stride, bytes = numbers * cell;
   void *out[3]; /* plain, fast, fast in two ranges */
   for (c = 0; c < 3; c++) {
      out[c] = test_block(bytes);
      for (i = 0; i < numbers; i++) {
         if (which == FRAMED) ((double *)out[c])[i] = (double)GUARD;
         else ((float *)out[c])[i] = which == NORMALISE && i > 0 && i + 1 < numbers ? s->positions[i % (3 * s->nodes)] : GUARD;
      }
   }
   text(which, DN_KERNEL_REF, s, begin, end, out[0], stride);
   text(which, kernel, s, begin, end, out[1], stride);
   text(which, kernel, s, begin, cut, out[2], stride);
   text(which, kernel, s, cut, end, out[2], stride);
   CHECK_MSG(memcmp(out[1], out[2], bytes) == 0, "text %d of kernel %d: other bits when a range begins elsewhere", which, (int)kernel);
   for (i = 0; i < numbers; i++) {
      double want = which == FRAMED ? ((double *)out[0])[i] : (double)((float *)out[0])[i];
      double got = which == FRAMED ? ((double *)out[1])[i] : (double)((float *)out[1])[i];
      size_t node = i ? (i - 1) / stride : 0;
      int own = i > 0 && i + 1 < numbers && node >= begin && node < end && (i - 1) % stride < columns;
      if (own && (which == NORMALS || which == FINE) && !s->sound[node]) continue;
      CHECK_MSG(own ? fabs(got - want) <= (which == FRAMED ? 1e-13 : 1e-6) * (1 + fabs(want)) : got >= want && got <= want,
                "text %d of kernel %d, node %lu of %lu to %lu: %.9g, expected %.9g", which, (int)kernel, (unsigned long)node,
                (unsigned long)begin, (unsigned long)end, got, want);
   }
   free(out[0]), free(out[1]), free(out[2]);
}
TEST(every_text_equals_the_plain_one)
{
   uint64_t seed = 3;
   size_t cases = 0;
   int k, which, round;
   for (round = 0; round < 150; round++) {
      scene s = scene_make(&seed);
      for (k = 0; k < DN_KERNEL_COUNT; k++)
         for (which = 0; which < TEXTS && dn_kernel_available((dn_kernel)k); which++, cases++) text_case(which, (dn_kernel)k, &s, &seed);
      scene_free(&s);
   }
   AT_LEAST(cases, 150 * TEXTS, "texts");
}

int main(int argc, char **argv)
{
   TEST_BEGIN(argc, argv);
   RUN(the_first_layer_is_whole_wherever_its_columns_are_summed);
   RUN(every_text_equals_the_plain_one);
   return TEST_END();
}
