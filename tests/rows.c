/*  rows.c - what the network reads: whole rows, and a first layer whose geodesic columns were summed at bind

    shows   dn_rows lists every descriptor in the model's order; wherever the geodesic columns stand, with and without batch
            norm, bias and scales, in every kernel, the network is the one the file describes, evaluated here in double
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

int main(int argc, char **argv)
{
   TEST_BEGIN(argc, argv);
   RUN(the_first_layer_is_whole_wherever_its_columns_are_summed);
   return TEST_END();
}
