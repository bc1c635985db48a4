/*  blend.c - Neural Blend Shapes: the layers against plain loops, what must not change the result, what a file may hold,
    memory, threads
    build     cc -g blend.c -o blend -lm
    run       ./blend [part of a test's name] */
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

/* --- model files of any widths, in memory */
enum { MOST_S = 24 };
typedef struct widths { /* lists end at 0; the first entry is what goes in */
   size_t S, att[6], geo[6], gen[6], geo2[6], dec[6], coff[6];
   int32_t parents[MOST_S];
} widths;
static const int32_t smpl[MOST_S] = {-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21};
static const widths small = {5, {3, 6, 5}, {3, 7, 6}, {6, 4, 3}, {3, 6}, {11, 6}, {9, 4, 2}, {-1, 0, 1, 2, 3}};
static const widths sliced = {5, {3, 10, 5}, {3, 7, 6}, {6, 4, 3}, {3, 7, 9, 70}, {75, 9, 8, 6}, {9, 4, 2}, {-1, 0, 1, 2, 2}};
/* N table 5, but for the 100 million numbers of gen */
static const widths paper = {24, {3, 64, 128, 256, 24}, {3, 64, 128, 256, 512}, {512, 4, 4, 3}, {3, 64, 128, 256, 512}, {536, 256, 27}, {9, 18, 32, 9},
                             {-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21}};
typedef struct maker {
   char *header;
   unsigned char *data;
   size_t used, header_cap, bytes, data_cap;
   int half; /* F16 in place of F32 */
   uint64_t seed;
} maker;
static void *grown(void *p, size_t size)
{
   p = realloc(p, size);
   if (!p) exit(2);
   return p;
}
static unsigned half_of(float x) /* cut, not rounded; what is too small is 0 */
{
   uint32_t u;
   int e;
   memcpy(&u, &x, 4);
   e = (int)(u >> 23 & 255) - 112;
   return e <= 0 ? 0 : (u >> 16 & 0x8000u) | (unsigned)e << 10 | (u >> 13 & 1023u);
}
static void put(maker *m, const char *name, const char *shape, size_t count, float most)
{
   size_t i, size = m->half ? 2 : 4;
   if (m->used + 256 > m->header_cap) m->header = (char *)grown(m->header, m->header_cap = 2 * m->header_cap + 4096);
   if (m->bytes + count * size > m->data_cap) m->data = (unsigned char *)grown(m->data, m->data_cap = 2 * m->data_cap + count * size);
   m->used += (size_t)snprintf(m->header + m->used, m->header_cap - m->used, ",\"%s\":{\"dtype\":\"%s\",\"shape\":[%s],\"data_offsets\":[%lu,%lu]}",
                               name, m->half ? "F16" : "F32", shape, (unsigned long)m->bytes, (unsigned long)(m->bytes + count * size));
   for (i = 0; i < count; i++, m->bytes += size) {
      float x = test_uniform(&m->seed, -most, most);
      uint32_t u;
      memcpy(&u, &x, 4);
      if (m->half) u = half_of(x);
      m->data[m->bytes] = (unsigned char)u, m->data[m->bytes + 1] = (unsigned char)(u >> 8);
      if (!m->half) m->data[m->bytes + 2] = (unsigned char)(u >> 16), m->data[m->bytes + 3] = (unsigned char)(u >> 24);
   }
}
static void put_chain(maker *m, const char *stem, const size_t *w, size_t joints /* 0: convolutions, else a matrix of joints blocks a side */)
{
   size_t i, J = joints ? joints : 1;
   for (i = 0; w[i + 1]; i++) {
      char name[64], shape[64];
      float most = (float)sqrt(1.5 / ((joints ? 1.0 : 5.0) * (double)w[i]));
      snprintf(name, sizeof name, "%s%lu.weight", stem, (unsigned long)i);
      snprintf(shape, sizeof shape, joints ? "%lu,%lu" : "%lu,%lu,1,5", (unsigned long)(w[i + 1] * J), (unsigned long)(w[i] * J));
      put(m, name, shape, w[i] * w[i + 1] * J * J * (joints ? 1 : 5), joints > 1 ? 0.6f * most : 1.3f * most);
      snprintf(name, sizeof name, "%s%lu.bias", stem, (unsigned long)i);
      snprintf(shape, sizeof shape, "%lu", (unsigned long)(w[i + 1] * J));
      put(m, name, shape, w[i + 1] * J, 0.3f);
   }
}
static unsigned char *model_file(const widths *w, int half, const char *parents, const char *meta, size_t *size)
{
   maker m;
   char own[256], stem[32];
   size_t j, n = 0;
   unsigned char *file;
   memset(&m, 0, sizeof m);
   m.half = half, m.seed = 7;
   for (own[0] = 0, j = 0; j < w->S; j++) n += (size_t)snprintf(own + n, sizeof own - n, j ? ",%ld" : "%ld", (long)w->parents[j]);
   m.header = (char *)grown(NULL, m.header_cap = 4096);
   m.used = (size_t)snprintf(m.header, m.header_cap, "{\"__metadata__\":{" TINY_META "\"deformnet.arch\":\"neuralblendshapes\",\"deformnet.parents\":\"%s\"%s}",
                             parents ? parents : own, meta);
   put_chain(&m, "att.", w->att, 0);
   put_chain(&m, "geo.", w->geo, 0);
   put_chain(&m, "gen.", w->gen, w->S);
   put_chain(&m, "geo2.", w->geo2, 0);
   put_chain(&m, "dec.", w->dec, 0);
   for (j = 0; j + 1 < w->S; j++) {
      snprintf(stem, sizeof stem, "coff.%lu.", (unsigned long)j);
      put_chain(&m, stem, w->coff, 1);
   }
   m.header[m.used++] = '}';
   m.header[m.used] = 0;
   file = tiny_join(m.header, (8 - m.used % 8) % 8, m.data, m.bytes, size);
   free(m.header);
   free(m.data);
   return file;
}
static dn_model *model_of(const widths *w)
{
   dn_error e;
   size_t size;
   unsigned char *file = model_file(w, 0, NULL, "", &size);
   dn_model *m = dn_model_load(file, size, NULL, NULL, &e);
   if (!CHECK_MSG(m != NULL, "%s", e.info)) exit(1);
   free(file);
   return m;
}
static float *data_of(unsigned char *file, size_t size, const char *name, size_t *count) /* of an F32 tensor, in place */
{
   dn_error e;
   size_t bytes;
   void *memory;
   dn_tensors *t;
   const dn_tensor *found;
   float *data;
   if (dn_tensors_size(file, size, &bytes, &e) != DN_OK) exit(2);
   memory = test_aligned(bytes);
   if (dn_tensors_open(file, size, memory, bytes, &t, &e) != DN_OK || (found = dn_tensors_find(t, name)) == NULL) exit(2);
   *count = found->count;
   data = (float *)(void *)(file + (found->data - file));
   test_aligned_free(memory);
   return data;
}

/* --- meshes: a lumpy ball of rings, an open sheet beside it, two nodes without triangles */
typedef struct shape { size_t V, T; float *p; uint32_t *f; } shape;
static void triangle(shape *s, size_t a, size_t b, size_t c)
{
   uint32_t *f = s->f + 3 * s->T++;
   f[0] = (uint32_t)a, f[1] = (uint32_t)b, f[2] = (uint32_t)c;
}
static shape shape_of(size_t rings, size_t around, size_t sheet /* side, 0: none */, size_t loners)
{
   shape s;
   size_t i, k, ball = rings * around + 2;
   s.V = ball + sheet * sheet + loners, s.T = 0;
   s.p = (float *)test_block(12 * s.V);
   s.f = (uint32_t *)test_block(4 * (6 * rings * around + 6 * sheet * sheet));
   for (i = 0; i < ball; i++) {
      double at = i < ball - 2 ? (double)(i / around + 1) / (double)(rings + 1) : i == ball - 2 ? 0 : 1;
      double t = at * 3.14159265, q = (double)(i % around) / (double)around * 6.2831853, r = 0.3 * (1 + 0.2 * sin(3 * q + 5 * t) + 0.1 * cos(11 * t - q));
      s.p[3 * i] = (float)(r * sin(t) * cos(q)), s.p[3 * i + 1] = (float)(0.9 * cos(t) + 0.05 * sin(7 * q) * sin(t)), s.p[3 * i + 2] = (float)(r * sin(t) * sin(q));
   }
   for (k = 0; k < around; k++) {
      size_t l = (k + 1) % around;
      triangle(&s, ball - 2, l, k);
      for (i = 0; i + 1 < rings; i++) {
         triangle(&s, i * around + k, i * around + l, (i + 1) * around + k);
         triangle(&s, i * around + l, (i + 1) * around + l, (i + 1) * around + k);
      }
      triangle(&s, ball - 1, (rings - 1) * around + k, (rings - 1) * around + l);
   }
   for (i = 0; i < sheet * sheet; i++) {
      double x = (double)(i % sheet), y = (double)(i / sheet);
      s.p[3 * (ball + i)] = (float)(0.6 + 0.05 * x + 0.003 * sin(5 * y)), s.p[3 * (ball + i) + 1] = (float)(0.05 * y), s.p[3 * (ball + i) + 2] = (float)(0.02 * sin(x * y));
      if (i % sheet + 1 < sheet && i / sheet + 1 < sheet) triangle(&s, ball + i, ball + i + 1, ball + i + sheet), triangle(&s, ball + i + 1, ball + i + sheet + 1, ball + i + sheet);
   }
   for (i = 0; i < loners; i++) s.p[3 * (s.V - 1 - i)] = 2, s.p[3 * (s.V - 1 - i) + 1] = (float)i, s.p[3 * (s.V - 1 - i) + 2] = -1;
   return s;
}
static void shape_free(shape *s)
{
   free(s->p);
   free(s->f);
}
static dn_blend_desc desc_of(const shape *s)
{
   dn_blend_desc d;
   memset(&d, 0, sizeof d);
   d.mesh.vertices = s->V, d.mesh.positions = s->p;
   d.mesh.triangles = s->T, d.mesh.indices = s->f, d.mesh.index_type = DN_U32;
   return d;
}
static int near_by(double a, double b, double scale) { return fabs(a - b) <= scale * (2e-5 + 2e-4 * fabs(b)); }

/* a job system that cuts where it likes and takes ranges in a strange order; each range is its own worker in turn */
static void odd_run(void *user, size_t count, size_t grain, dn_range_fn *fn, void *job)
{
   unsigned workers = *(const unsigned *)user, w = 0;
   size_t pieces = (count + grain - 1) / grain, i, at;
   for (i = 0; i < pieces; i++) {
      at = (i % 2 ? pieces - 1 - i / 2 : i / 2) * grain;
      fn(job, at, at + grain < count ? at + grain : count, w++ % workers);
   }
}
/* --- edges */
typedef struct edge_set { uint32_t *ends, *ring, *first, *at, *skipped; dn_edges e; } edge_set;
static edge_set edges_of(const shape *s)
{
   edge_set a;
   void *scratch = test_aligned(dn_edges_scratch(s->V, s->T));
   a.ends = (uint32_t *)test_block(24 * s->T), a.ring = (uint32_t *)test_block(48 * s->T), a.at = (uint32_t *)test_block(24 * s->T);
   a.first = (uint32_t *)test_block(4 * (s->V + 1)), a.skipped = (uint32_t *)test_block(4 * s->T);
   dn_edges_build(s->p, s->f, s->T, s->V, a.ends, a.ring, a.first, a.at, a.skipped, &a.e, scratch);
   test_aligned_free(scratch);
   return a;
}
static void edges_free(edge_set *a)
{
   free(a->ends), free(a->ring), free(a->first), free(a->at), free(a->skipped);
}
/* the definition once more, by search through lists */
static void check_edges(const shape *s, const edge_set *a, size_t *sides)
{
   uint32_t (*directed)[3] = (uint32_t(*)[3])test_block(12 * (3 * s->T + 1)); /* from, to, edge */
   uint32_t *ring = (uint32_t *)test_block(48 * s->T + 1);
   size_t t, i, k, n = 0, E = 0, skipped = 0;
   memset(ring, 0xff, 48 * s->T);
   for (t = 0; t < s->T; t++) {
      const uint32_t *f = s->f + 3 * t;
      uint32_t id[3];
      int other[3], skip;
      double u[3], v[3];
      for (i = 0; i < 3; i++) u[i] = (double)s->p[3 * f[1] + i] - (double)s->p[3 * f[0] + i], v[i] = (double)s->p[3 * f[2] + i] - (double)s->p[3 * f[0] + i];
      skip = u[1] * v[2] == u[2] * v[1] && u[2] * v[0] == u[0] * v[2] && u[0] * v[1] == u[1] * v[0];
      for (k = 0; k < 3; k++)
         for (i = 0; i < n; i++) skip |= directed[i][0] == f[k] && directed[i][1] == f[(k + 1) % 3];
      if (skip) {
         CHECK(skipped < a->e.skipped && a->skipped[skipped] == t);
         skipped++;
         continue;
      }
      for (k = 0; k < 3; k++) {
         other[k] = 0;
         for (i = 0; i < n; i++)
            if (directed[i][1] == f[k] && directed[i][0] == f[(k + 1) % 3]) other[k] = 1, id[k] = directed[i][2];
         if (!other[k]) {
            uint32_t low = f[k] < f[(k + 1) % 3] ? f[k] : f[(k + 1) % 3], high = f[k] + f[(k + 1) % 3] - low;
            id[k] = (uint32_t)E++;
            CHECK(E <= a->e.count && a->ends[2 * id[k]] == low && a->ends[2 * id[k] + 1] == high);
         }
      }
      for (k = 0; k < 3; k++) {
         directed[n][0] = f[k], directed[n][1] = f[(k + 1) % 3], directed[n++][2] = id[k];
         ring[4 * id[k] + (other[k] ? 2 : 0)] = id[(k + 1) % 3], ring[4 * id[k] + (other[k] ? 3 : 1)] = id[(k + 2) % 3];
      }
   }
   CHECK(E == a->e.count && skipped == a->e.skipped);
   CHECK(memcmp(ring, a->ring, 16 * E) == 0);
   for (i = 0; i < s->V; i++) { /* each node's edges, ascending, all of them */
      size_t found = 0;
      for (k = a->first[i]; k < a->first[i + 1]; k++) {
         uint32_t e = a->at[k];
         found++;
         CHECK(e < E && (a->ends[2 * e] == i || a->ends[2 * e + 1] == i) && (k == a->first[i] || a->at[k - 1] < e));
      }
      for (k = 0; k < 2 * E; k++) found -= a->ends[k] == i;
      CHECK(found == 0);
   }
   CHECK(a->first[s->V] == 2 * E);
   *sides += n;
   free(directed);
   free(ring);
}
TEST(edges_by_definition)
{
   size_t sides = 0, skipped = 0, k, i;
   uint64_t seed = 3;
   for (k = 0; k < 60; k++) { /* soups: the fewer nodes, the more that is not manifold; some corners repeat, some positions do */
      shape s;
      edge_set a;
      s.V = 4 + k, s.T = 10 + 2 * k;
      s.p = (float *)test_block(12 * s.V), s.f = (uint32_t *)test_block(12 * s.T);
      for (i = 0; i < 3 * s.V; i++) s.p[i] = (float)(test_random(&seed) % 4);
      for (i = 0; i < 3 * s.T; i++) s.f[i] = test_random(&seed) % (uint32_t)s.V;
      a = edges_of(&s);
      skipped += a.e.skipped;
      check_edges(&s, &a, &sides);
      edges_free(&a);
      shape_free(&s);
   }
   {
      shape s = shape_of(9, 12, 5, 2);
      edge_set a = edges_of(&s);
      check_edges(&s, &a, &sides);
      CHECK(a.e.skipped == 0 && a.first[s.V] == a.first[s.V - 2]);
      edges_free(&a);
      shape_free(&s);
   }
   AT_LEAST(sides, 1500, "sides");
   AT_LEAST(skipped, 300, "triangles skipped");
}

/* --- layers */
TEST(convolution_equals_its_equation)
{
   static const size_t ins[] = {1, 3, 5, 16, 33, 70}, outs[] = {1, 3, 16, 24, 63, 64, 65, 131};
   shape s = shape_of(4, 7, 4, 1);
   edge_set a = edges_of(&s);
   size_t i, o, k, E = a.e.count, compared = 0, n, c, e;
   uint64_t seed = 5;
   for (i = 0; i < sizeof ins / sizeof *ins; i++)
      for (o = 0; o < sizeof outs / sizeof *outs; o++) {
         size_t in = ins[i], out = outs[o], xs = in + i % 3, ys = out + o % 2;
         float *w = (float *)test_block(20 * in * out), *b = (float *)test_block(4 * out), *x = (float *)test_block(4 * E * xs);
         float *y = (float *)test_block(4 * E * ys), *z = (float *)test_block(4 * E * ys), *q = (float *)test_block(16 * out);
         dn_batchnorm bn;
         dn_meshconv layer;
         void *memory = test_aligned(dn_meshconv_size(in, out)), *scratch;
         int with_bn = (i + o) % 3 == 0;
         dn_activation act = (i + o) % 4 == 1 ? DN_ACT_SOFTMAX : (i + o) % 2 ? DN_ACT_LEAKYRELU : DN_ACT_NONE;
         for (n = 0; n < 5 * in * out; n++) w[n] = test_uniform(&seed, -1, 1);
         for (n = 0; n < out; n++) b[n] = test_uniform(&seed, -1, 1), q[n] = test_uniform(&seed, 0.5f, 2), q[out + n] = b[n], q[2 * out + n] = 0.5f, q[3 * out + n] = q[n];
         for (n = 0; n < E * xs; n++) x[n] = test_uniform(&seed, -1, 1);
         bn.weight = q, bn.bias = q + out, bn.mean = q + 2 * out, bn.var = q + 3 * out;
         dn_meshconv_pack(&layer, in, out, w, o % 3 ? b : NULL, with_bn ? &bn : NULL, act, memory);
         scratch = test_aligned(dn_meshconv_scratch(&layer, 3));
         dn_meshconv_ref(&layer, &a.e, x, xs, z, ys);
         for (e = 0; e < E; e += 5) { /* from the weights as a file has them */
            double *row = (double *)test_block(8 * out), most = 0, sum = 0;
            for (n = 0; n < out; n++) {
               row[n] = o % 3 ? (double)b[n] : 0;
               for (c = 0; c < in; c++) {
                  double r[4];
                  const float *f = w + (n * in + c) * 5;
                  for (k = 0; k < 4; k++) r[k] = a.ring[4 * e + k] == DN_NO_EDGE ? 0 : (double)x[a.ring[4 * e + k] * xs + c];
                  row[n] += (double)f[0] * (double)x[e * xs + c] + (double)f[1] * (r[0] + r[2]) + (double)f[2] * (r[1] + r[3]) + (double)f[3] * fabs(r[0] - r[2]) + (double)f[4] * fabs(r[1] - r[3]);
               }
               if (with_bn) row[n] = (row[n] - 0.5) / sqrt((double)q[3 * out + n] + 1e-5) * (double)q[n] + (double)q[out + n];
               if (act == DN_ACT_LEAKYRELU && row[n] < 0) row[n] *= 0.2;
               if (n == 0 || row[n] > most) most = row[n];
            }
            for (n = 0; act == DN_ACT_SOFTMAX && n < out; n++) sum += row[n] = exp(row[n] - most);
            for (n = 0; n < out; n++, compared++) {
               if (act == DN_ACT_SOFTMAX) row[n] /= sum;
               CHECK_MSG(near_by((double)z[e * ys + n], row[n], 0.5), "in %lu out %lu: %g, expected %g", (unsigned long)in, (unsigned long)out, (double)z[e * ys + n], row[n]);
            }
            free(row);
         }
         for (k = 0; k < DN_KERNEL_COUNT; k++) {
            unsigned workers = 3;
            dn_parallel par;
            uint64_t h;
            if (!dn_kernel_available((dn_kernel)k)) continue;
            layer.kernel = (dn_kernel)k;
            memset(y, 0xff, 4 * E * ys);
            memset(scratch, 0xa5, dn_meshconv_scratch(&layer, 1));
            dn_meshconv_run(&layer, &a.e, x, xs, y, ys, scratch, NULL);
            for (e = 0; e < E; e++)
               for (n = 0; n < out; n++) CHECK(near_by((double)y[e * ys + n], (double)z[e * ys + n], 0.5));
            h = test_hash(1, y, 4 * (E * ys - ys + out));
            par.run = odd_run, par.user = &workers, par.workers = workers;
            memset(y, 0xff, 4 * E * ys);
            memset(scratch, 0x5a, dn_meshconv_scratch(&layer, 3));
            dn_meshconv_run(&layer, &a.e, x, xs, y, ys, scratch, &par);
            CHECK(h == test_hash(1, y, 4 * (E * ys - ys + out)));
         }
         free(w), free(b), free(x), free(y), free(z), free(q);
         test_aligned_free(memory);
         test_aligned_free(scratch);
      }
   CHECK(dn_meshconv_size(0, 3) == 0 && dn_meshconv_size(3, 0) == 0 && dn_meshconv_size(SIZE_MAX / 4, 3) == 0);
   AT_LEAST(compared, 20000, "outputs");
   edges_free(&a);
   shape_free(&s);
}
TEST(means_pools_and_softmax)
{
   enum { WIDTH = 70, STRIDE = 73 };
   shape s = shape_of(6, 9, 4, 2);
   edge_set a = edges_of(&s);
   size_t E = a.e.count, i, e, c, k, checked = 0;
   float *x = (float *)test_block(4 * E * STRIDE), *y = (float *)test_block(4 * E * STRIDE), *v = (float *)test_block(4 * s.V * STRIDE);
   float *att = (float *)test_block(4 * E * 5), pooled[5 * WIDTH], most[WIDTH / 5];
   uint64_t seed = 9;
   unsigned workers = 2;
   dn_parallel par;
   par.run = odd_run, par.user = &workers, par.workers = 2;
   for (i = 0; i < E * STRIDE; i++) x[i] = test_uniform(&seed, -3, 3);
   for (i = 0; i < s.V * STRIDE; i++) v[i] = test_uniform(&seed, -3, 3);
   dn_vertex_to_edge(&a.e, v, STRIDE, WIDTH, y, STRIDE, &par);
   for (e = 0; e < E; e++)
      for (c = 0; c < WIDTH; c++, checked++)
         CHECK(near_by((double)y[e * STRIDE + c], 0.5 * ((double)v[a.ends[2 * e] * STRIDE + c] + (double)v[a.ends[2 * e + 1] * STRIDE + c]), 0.1));
   dn_edge_to_vertex(&a.e, x, STRIDE, WIDTH, v, STRIDE, &par);
   for (i = 0; i < s.V; i++)
      for (c = 0; c < WIDTH; c++, checked++) {
         double sum = 0, n = 0;
         for (e = 0; e < E; e++)
            if (a.ends[2 * e] == i || a.ends[2 * e + 1] == i) sum += (double)x[e * STRIDE + c], n++;
         CHECK(near_by((double)v[i * STRIDE + c], n > 0 ? sum / n : 0, 0.1));
      }
   for (c = 0; c < WIDTH / 5; c++)
      for (most[c] = x[c], e = 1; e < E; e++) most[c] = x[e * STRIDE + c] > most[c] ? x[e * STRIDE + c] : most[c];
   memcpy(y, x, 4 * E * STRIDE);
   dn_channel_pool(y, STRIDE, E, WIDTH, &par);
   for (e = 0; e < E; e++) CHECK(memcmp(y + e * STRIDE, most, sizeof most) == 0 && memcmp(y + e * STRIDE + WIDTH / 5, x + e * STRIDE + WIDTH / 5, 4 * (STRIDE - WIDTH / 5)) == 0);
   dn_channel_pool(y, STRIDE, 0, WIDTH, NULL);
   for (i = 0; i < E * 5; i++) att[i] = test_uniform(&seed, -30, 30);
   dn_edge_softmax(att, 5, E, 5, &par);
   for (e = 0; e < E; e++) {
      double sum = 0;
      for (c = 0; c < 5; c++) sum += (double)att[5 * e + c];
      CHECK(fabs(sum - 1) < 1e-6);
      att[5 * e + 3] = 1e-13f; /* together under 1e-10: they count as 1 */
   }
   dn_skinning_pool(att, 5, x, STRIDE, E, WIDTH, pooled, &par);
   for (k = 0; k < 5; k++)
      for (c = 0; c < WIDTH; c++, checked++) {
         double sum = 0, total = 0;
         for (e = 0; e < E; e++) sum += (double)att[5 * e + k] * (double)x[e * STRIDE + c], total += (double)att[5 * e + k];
         CHECK(k != 3 || total < 1e-10);
         CHECK(fabs((double)pooled[k * WIDTH + c] - (k == 3 ? sum : sum / total)) <= (k == 3 ? 1e-15 : 1e-6));
      }
   AT_LEAST(checked, 19000, "numbers");
   free(x), free(y), free(v), free(att);
   edges_free(&a);
   shape_free(&s);
}
TEST(skeleton_layers_see_two_steps)
{
   size_t trial, j, k, checked = 0, pairs = 0;
   uint64_t seed = 11;
   int32_t parents[40];
   for (trial = 0; trial < 30; trial++) {
      size_t S = trial ? 1 + trial : 24, in = 1 + trial % 7, out = 1 + trial % 5, n;
      float *w = (float *)test_block(4 * S * S * in * out), *b = (float *)test_block(4 * S * out), x[40 * 8], y[40 * 8], z[40 * 8];
      int steps[40][40];
      size_t kept = 0, h;
      dn_skeleton_linear layer;
      void *memory;
      dn_activation act = trial % 2 ? DN_ACT_LEAKYRELU : DN_ACT_NONE;
      unsigned workers = 2;
      dn_parallel par;
      par.run = odd_run, par.user = &workers, par.workers = 2;
      for (j = 0; j < S; j++) parents[j] = trial == 0 ? smpl[j] : j == 0 ? -1 : (int32_t)(test_random(&seed) % (uint32_t)j);
      for (j = 0; j < S; j++)
         for (k = 0; k < S; k++) steps[j][k] = j == k ? 0 : 99;
      for (j = 1; j < S; j++) steps[j][parents[j]] = steps[parents[j]][j] = 1;
      for (h = 0; h < S; h++)
         for (j = 0; j < S; j++)
            for (k = 0; k < S; k++)
               if (steps[j][h] + steps[h][k] < steps[j][k]) steps[j][k] = steps[j][h] + steps[h][k];
      for (n = 0; n < S * S * in * out; n++) {
         size_t to = n / (S * in) / out, from = n % (S * in) / in;
         w[n] = test_uniform(&seed, -1, 1);
         if (steps[to][from] > 2) { /* what is there must not even be looked at */
            uint32_t nan_bits = 0x7fc00000u;
            memcpy(&w[n], &nan_bits, 4);
         }
      }
      for (n = 0; n < S * out; n++) b[n] = test_uniform(&seed, -1, 1);
      for (n = 0; n < S * in; n++) x[n] = test_uniform(&seed, -1, 1);
      for (j = 0; j < S; j++)
         for (k = 0; k < S; k++) kept += steps[j][k] <= 2;
      if (trial == 0) pairs = kept;
      n = dn_skeleton_linear_size(parents, S, in, out);
      CHECK(n >= 4 * kept * in * out && n <= 4 * (kept * in * out + S * out + S + 1 + kept) + 4 * 64);
      memory = test_aligned(n);
      dn_skeleton_linear_pack(&layer, parents, S, in, out, w, b, act, memory);
      dn_skeleton_linear_run(&layer, x, y, NULL);
      dn_skeleton_linear_ref(parents, S, in, out, w, b, act, x, z);
      for (n = 0; n < S * out; n++, checked++) {
         double sum = (double)b[n];
         for (k = 0; k < S * in; k++)
            if (steps[n / out][k / in] <= 2) sum += (double)w[n * S * in + k] * (double)x[k];
         if (trial % 2 && sum < 0) sum *= 0.2;
         CHECK(near_by((double)y[n], sum, 0.1) && near_by((double)z[n], sum, 0.1));
      }
      dn_skeleton_linear_run(&layer, x, z, &par);
      CHECK(memcmp(y, z, 4 * S * out) == 0);
      free(w), free(b);
      test_aligned_free(memory);
   }
   CHECK_MSG(pairs == 122, "%lu of 576 blocks", (unsigned long)pairs);
   AT_LEAST(checked, 1000, "outputs");
}

/* --- a bound mesh */
typedef struct posed { size_t V, S, B; float *weight, *shape, offset[3 * MOST_S], *displacement, *position; unsigned char *near_bar; dn_blend_view view; } posed; /* per vertex */
static void pose_rotations(const dn_blend_view *v, float *r) /* some pose */
{
   size_t j;
   for (j = 0; j < v->joints; j++) {
      float a[3];
      a[0] = 0.4f * (float)sin(3.0 * (double)j), a[1] = 0.3f * (float)cos(5.0 * (double)j), a[2] = -0.5f * (float)sin(1.0 + (double)j);
      dn_rodrigues(a, r + 9 * j);
   }
}
static posed posed_of(const dn_model *m, const dn_blend_desc *d, const dn_allocator *allocator)
{
   posed p;
   dn_error e;
   dn_blend *b = dn_blend_create(m, d, allocator, &e);
   dn_blend_view v;
   dn_blend_input in;
   dn_blend_output out;
   size_t i, j, bytes;
   void *scratch;
   float r[9 * MOST_S];
   if (!CHECK_MSG(b != NULL, "%s", e.info)) exit(1);
   dn_blend_describe(b, &v);
   p.V = v.vertices, p.S = v.joints, p.B = v.shapes, p.view = v;
   p.weight = (float *)test_block(4 * p.V * p.S), p.shape = (float *)test_block(12 * p.V * p.B);
   p.displacement = (float *)test_block(12 * p.V), p.position = (float *)test_block(12 * p.V);
   p.near_bar = (unsigned char *)test_block(p.V);
   memcpy(p.offset, v.joint_offset, 12 * p.S);
   for (i = 0; i < p.V; i++) {
      memcpy(p.weight + i * p.S, v.skin_weight + v.node_of_vertex[i] * p.S, 4 * p.S);
      memcpy(p.shape + i * 3 * p.B, v.shape + v.node_of_vertex[i] * 3 * p.B, 12 * p.B);
      for (p.near_bar[i] = 0, j = 0; j < p.S; j++) p.near_bar[i] |= fabs((double)p.weight[i * p.S + j] - 0.05) < 1e-4 || fabs((double)p.weight[i * p.S + j] - 0.02) < 1e-4;
   }
   scratch = dn_blend_scratch_create(b, allocator, &bytes, &e);
   CHECK(scratch != NULL);
   pose_rotations(&v, r);
   memset(&in, 0, sizeof in), memset(&out, 0, sizeof out);
   in.rotations = r, in.strength = 1;
   out.positions = p.position, out.displacement = p.displacement;
   CHECK(dn_blend_pose(b, &in, &out, scratch, bytes, d->parallel, &e) == DN_OK);
   dn_scratch_free(scratch, bytes, allocator);
   dn_blend_free(b);
   return p;
}
static void posed_free(posed *p)
{
   free(p->weight), free(p->shape), free(p->displacement), free(p->position), free(p->near_bar);
}
static uint64_t posed_hash(const posed *p)
{
   uint64_t h = test_hash(3, p->weight, 4 * p->V * p->S);
   h = test_hash(h, p->shape, 12 * p->V * p->B);
   h = test_hash(h, p->offset, 12 * p->S);
   return test_hash(test_hash(h, p->displacement, 12 * p->V), p->position, 12 * p->V);
}
/* vertex i of p is vertex of[i] of q */
static size_t same_rows(const posed *p, const posed *q, const uint32_t *of, const char *what)
{
   size_t i, k, bad = 0, compared = 0;
   for (i = 0; i < p->V; i++) {
      size_t o = of ? of[i] : i;
      for (k = 0; k < p->S; k++) bad += !near_by((double)p->weight[i * p->S + k], (double)q->weight[o * p->S + k], 1);
      for (k = 0; k < 3 * p->B; k++) bad += !near_by((double)p->shape[i * 3 * p->B + k], (double)q->shape[o * 3 * p->B + k], 1);
      if (p->near_bar[i] || q->near_bar[o]) continue;
      compared++;
      for (k = 0; k < 3; k++) bad += !near_by((double)p->displacement[3 * i + k], (double)q->displacement[3 * o + k], 1) || !near_by((double)p->position[3 * i + k], (double)q->position[3 * o + k], 1);
   }
   for (k = 0; k < 3 * p->S; k++) bad += !near_by((double)p->offset[k], (double)q->offset[k], 1);
   CHECK_MSG(bad == 0, "%s: %lu numbers differ", what, (unsigned long)bad);
   CHECK(compared * 10 >= p->V * 8);
   return compared;
}
static void shuffle(uint32_t *order, size_t n, uint64_t *seed)
{
   size_t i;
   for (i = 0; i < n; i++) order[i] = (uint32_t)i;
   for (i = n; i > 1; i--) {
      size_t k = test_random(seed) % (uint32_t)i;
      uint32_t t = order[i - 1];
      order[i - 1] = order[k], order[k] = t;
   }
}
TEST(order_does_not_matter)
{
   const widths *kinds[2];
   size_t kind, i, k, compared = 0;
   kinds[0] = &small, kinds[1] = &sliced;
   for (kind = 0; kind < 2; kind++) {
      dn_model *m = model_of(kinds[kind]);
      shape s = shape_of(14, 15, 6, 2), t; /* closed, open, alone */
      dn_blend_desc d = desc_of(&s);
      posed p = posed_of(m, &d, NULL), q;
      uint32_t *vertex = (uint32_t *)test_block(4 * s.V), *tri = (uint32_t *)test_block(4 * s.T);
      uint64_t seed = 21;
      size_t moved = 0;
      CHECK(p.view.isolated_nodes == 2 && p.view.nodes == s.V && p.view.skipped_triangles == 0 && p.view.edges > s.V);
      for (i = 0; i < s.V; i++) {
         double sum = 0;
         for (k = 0; k < p.S; k++) sum += (double)p.weight[i * p.S + k];
         CHECK(fabs(sum - 1) < 1e-5);
         moved += fabs((double)p.displacement[3 * i]) > 1e-4;
      }
      CHECK_MSG(moved * 3 > s.V, "only %lu vertices are displaced", (unsigned long)moved);
      for (i = s.V - 2; i < s.V; i++) { /* nodes without edges: on joint 0, no shapes */
         CHECK(p.weight[i * p.S] >= 1.0f && p.weight[i * p.S] <= 1.0f);
         for (k = 0; k < 3 * p.B; k++) CHECK(fabs((double)p.shape[i * 3 * p.B + k]) <= 0);
         for (k = 1; k < p.S; k++) CHECK(fabs((double)p.weight[i * p.S + k]) <= 0);
      }
      shuffle(vertex, s.V, &seed); /* new vertex i is old vertex[i] */
      shuffle(tri, s.T, &seed);
      t = s;
      t.p = (float *)test_block(12 * s.V), t.f = (uint32_t *)test_block(12 * s.T);
      for (i = 0; i < s.V; i++) memcpy(t.p + 3 * i, s.p + 3 * vertex[i], 12);
      for (i = 0; i < s.T; i++)
         for (k = 0; k < 3; k++) {
            uint32_t old = s.f[3 * tri[i] + (k + i) % 3], at = 0; /* corners turned too */
            while (vertex[at] != old) at++;
            t.f[3 * i + k] = at;
         }
      d = desc_of(&t);
      q = posed_of(m, &d, NULL);
      compared += same_rows(&q, &p, vertex, "vertices and triangles in another order");
      CHECK(q.view.edges == p.view.edges);
      posed_free(&p);
      posed_free(&q);
      shape_free(&s);
      shape_free(&t);
      free(vertex);
      free(tri);
      dn_model_free(m);
   }
   AT_LEAST(compared, 300, "vertices");
}
TEST(seams_types_and_strides)
{
   dn_model *m = model_of(&small);
   shape s = shape_of(10, 11, 0, 0);
   dn_blend_desc d = desc_of(&s);
   posed p = posed_of(m, &d, NULL), q;
   size_t i, V2 = s.V, k;
   uint32_t *of = (uint32_t *)test_block(8 * s.V), *f = (uint32_t *)test_block(12 * s.T);
   uint16_t *narrow = (uint16_t *)test_block(6 * s.T);
   float *wide = (float *)test_block(20 * 2 * s.V);
   for (i = 0; i < s.V; i++) of[i] = (uint32_t)i;
   for (i = 0; i < 3 * s.T; i++) { /* every seventh corner gets a vertex of its own */
      f[i] = s.f[i];
      if (i % 7 == 0 && V2 < 2 * s.V) of[V2] = s.f[i], f[i] = (uint32_t)V2++;
      narrow[i] = (uint16_t)f[i];
   }
   for (i = 0; i < V2; i++)
      for (k = 0; k < 3; k++) wide[5 * i + k] = s.p[3 * of[i] + k] + 0.0f * (float)k;
   wide[0] = wide[0] == 0.0f ? -wide[0] : wide[0];
   d.mesh.vertices = V2, d.mesh.positions = wide, d.mesh.position_stride = 20, d.mesh.indices = narrow, d.mesh.index_type = DN_U16;
   q = posed_of(m, &d, NULL);
   CHECK(q.view.nodes == s.V && q.view.seams_welded == V2 - s.V && V2 > s.V + 50);
   AT_LEAST(same_rows(&q, &p, of, "seams"), 150, "vertices");
   for (i = 0; i < V2; i++) CHECK(memcmp(q.position + 3 * i, q.position + 3 * of[i], 12) == 0);
   posed_free(&q);
   for (i = s.V; i < V2; i++) wide[5 * i] += 1e-5f; /* split vertices a hair apart: one node, each keeps its place */
   d.weld_distance = 1e-4f;
   q = posed_of(m, &d, NULL);
   CHECK(q.view.nodes == s.V);
   for (i = s.V; i < V2; i++) CHECK(fabs((double)q.position[3 * i] - (double)q.position[3 * of[i]]) < 1.1e-5 && memcmp(q.position + 3 * i, q.position + 3 * of[i], 12) != 0);
   posed_free(&q);
   posed_free(&p);
   shape_free(&s);
   free(of), free(f), free(narrow), free(wide);
   dn_model_free(m);
}
TEST(any_number_of_workers)
{
   static const unsigned counts[] = {1, 2, 3, 7, 16};
   const widths *kinds[2];
   size_t kind, i;
   kinds[0] = &small, kinds[1] = &sliced;
   for (kind = 0; kind < 2; kind++) {
      dn_model *m = model_of(kinds[kind]);
      shape s = shape_of(20, 25, 5, 1);
      dn_blend_desc d = desc_of(&s);
      posed p = posed_of(m, &d, NULL);
      uint64_t h = posed_hash(&p);
      posed_free(&p);
      for (i = 0; i < sizeof counts / sizeof *counts; i++) {
         unsigned workers = counts[i];
         dn_parallel par;
         counting c;
         dn_allocator a = counting_allocator(&c, -1);
         par.run = odd_run, par.user = &workers, par.workers = workers;
         d.parallel = &par;
         c.fill = (int)(0x11 * (i + 1));
         p = posed_of(m, &d, &a);
         CHECK_MSG(posed_hash(&p) == h, "%u workers", workers);
         CHECK(c.live == 0 && c.wrong == 0);
         posed_free(&p);
      }
      shape_free(&s);
      dn_model_free(m);
   }
}

/* --- frames */
TEST(poses)
{
   dn_model *m = model_of(&small);
   shape s = shape_of(10, 12, 4, 1);
   dn_blend_desc d = desc_of(&s);
   dn_error e;
   dn_blend *b = dn_blend_create(m, &d, NULL, &e);
   dn_blend_view v;
   dn_blend_input in;
   dn_blend_output out;
   size_t bytes, i, j, k, q, n, before, moved = 0;
   float r[9 * MOST_S], angles[3 * MOST_S], palette[12 * MOST_S], alpha[64], alpha2[64];
   float *p = (float *)test_block(20 * s.V), *p2 = (float *)test_block(12 * s.V), *delta = (float *)test_block(16 * s.V), *sum = (float *)test_block(12 * s.V), *morph = (float *)test_block(12 * s.V);
   void *scratch;
   static const float away[3] = {1, -2, 3};
   const uint32_t nan_bits = 0x7fc00000u;
   if (!CHECK_MSG(b != NULL, "%s", e.info)) exit(1);
   dn_blend_describe(b, &v);
   scratch = dn_blend_scratch_create(b, NULL, &bytes, &e);
   CHECK(bytes == dn_blend_scratch_size(b));
   for (j = 0; j < v.joints; j++) /* offsets from parents add up to rest positions */
      for (k = 0; k < 3; k++) CHECK(near_by((double)v.joint_rest[3 * j + k], (double)v.joint_offset[3 * j + k] + (j ? (double)v.joint_rest[3 * (size_t)v.parents[j] + k] : 0), 0.1));
   before = allocations;
   memset(&in, 0, sizeof in), memset(&out, 0, sizeof out);
   memset(alpha, 0, sizeof alpha);
   out.positions = p, out.position_stride = 20, out.palette = palette;
   CHECK(dn_blend_pose(b, &in, &out, scratch, bytes, NULL, &e) == DN_OK); /* rest, strength 0 */
   for (i = 0; i < s.V; i++)
      for (k = 0; k < 3; k++) CHECK(near_by((double)p[5 * i + k], (double)s.p[3 * i + k], 0.5));
   for (j = 0; j < v.joints; j++)
      for (k = 0; k < 12; k++) CHECK(fabs((double)palette[12 * j + k] - (k % 5 == 0 ? 1 : 0)) < 1e-6);
   memset(angles, 0, sizeof angles);
   angles[0] = 0.3f, angles[1] = -0.8f, angles[2] = 0.5f; /* the root alone, about its own place; coefficients of nothing */
   in.axis_angle = angles, in.translation = away, in.coefficients = alpha, in.strength = 1;
   CHECK(dn_blend_pose(b, &in, &out, scratch, bytes, NULL, &e) == DN_OK);
   dn_rodrigues(angles, r);
   for (i = 0; i < s.V; i++)
      for (k = 0; k < 3; k++) {
         double x = (double)v.joint_rest[k] + (double)away[k];
         for (q = 0; q < 3; q++) x += (double)r[3 * k + q] * ((double)s.p[3 * i + q] - (double)v.joint_rest[q]);
         CHECK(near_by((double)p[5 * i + k], x, 0.5));
      }
   /* coefficients: of rotations or of the same as axis and angle, given or found, all one */
   for (j = 0; j < 3 * v.joints; j++) angles[j] = 0.5f * (float)sin(2.0 * (double)j);
   for (j = 0; j < v.joints; j++) dn_rodrigues(angles + 3 * j, r + 9 * j);
   dn_blend_coefficients(b, r, alpha, scratch);
   n = (v.joints - 1) * v.shapes;
   memset(&in, 0, sizeof in), memset(&out, 0, sizeof out);
   in.axis_angle = angles, in.strength = 1;
   out.positions = p2, out.displacement = delta, out.displacement_stride = 16, out.coefficients = alpha2;
   CHECK(dn_blend_pose(b, &in, &out, scratch, bytes, NULL, &e) == DN_OK);
   CHECK(memcmp(alpha, alpha2, 4 * n) == 0);
   in.axis_angle = NULL, in.rotations = r, in.coefficients = alpha;
   out.positions = p, out.coefficients = NULL;
   CHECK(dn_blend_pose(b, &in, &out, scratch, bytes, NULL, &e) == DN_OK);
   CHECK(memcmp(p, p2, 12 * s.V) == 0);
   /* the sum of all morph targets times their coefficients is the displacement; the mask is as N 5 has it */
   memset(sum, 0, 12 * s.V);
   for (j = 1; j < v.joints; j++)
      for (q = 0; q < v.shapes; q++) {
         size_t count = dn_blend_morph(b, j, q, morph, 0), nonzero = 0;
         for (i = 0; i < s.V; i++) {
            const float *w = v.skin_weight + v.node_of_vertex[i] * v.joints;
            int on = w[j] > 0.05f || w[v.parents[j]] > 0.05f, zero = 1;
            for (k = 0; k < 3; k++) {
               sum[3 * i + k] += alpha[(j - 1) * v.shapes + q] * morph[3 * i + k];
               zero &= !(fabs((double)morph[3 * i + k]) > 0);
               CHECK(fabs((double)morph[3 * i + k] - (on ? (double)v.shape[(v.node_of_vertex[i] * v.shapes + q) * 3 + k] : 0)) <= 0);
            }
            nonzero += !zero;
         }
         CHECK(count == nonzero && dn_blend_morph(b, j, q, NULL, 0) == count);
         moved += count;
      }
   for (i = 0; i < s.V; i++)
      for (k = 0; k < 3; k++) CHECK(near_by((double)delta[4 * i + k], (double)sum[3 * i + k], 0.5));
   dn_blend_displace(b, alpha, morph, 0, NULL);
   for (i = 0; i < s.V; i++) CHECK(memcmp(morph + 3 * i, delta + 4 * i, 12) == 0);
   in.strength = 0.5f, out.positions = NULL;
   CHECK(dn_blend_pose(b, &in, &out, scratch, bytes, NULL, &e) == DN_OK);
   for (i = 0; i < 3 * s.V; i++) CHECK(near_by((double)delta[i / 3 * 4 + i % 3], 0.5 * (double)morph[i], 0.1));
   /* numbers that are none: named, and the output is finite and whole */
   memcpy(&r[9 + 4], &nan_bits, 4);
   memcpy(&alpha[1], &nan_bits, 4);
   memset(p, 0xff, 12 * s.V);
   out.positions = p;
   CHECK(dn_blend_pose(b, &in, &out, scratch, bytes, NULL, &e) == DN_NOT_FINITE && e.code == DN_NOT_FINITE && strstr(e.info, "2 "));
   for (i = 0; i < 3 * s.V; i++) CHECK(test_finite(p[i]));
   memset(p, 0xff, 12 * s.V);
   CHECK(dn_blend_pose(b, &in, &out, scratch, bytes - 1, NULL, &e) == DN_TOO_SMALL && strstr(e.info, "scratch") && !test_finite(p[0]));
   CHECK_MSG(allocations == before, "%lu allocations in frames", (unsigned long)(allocations - before));
   AT_LEAST(moved, 500, "rows of morph targets");
   dn_scratch_free(scratch, bytes, NULL);
   dn_blend_free(b);
   dn_blend_free(NULL);
   free(p), free(p2), free(delta), free(sum), free(morph);
   shape_free(&s);
   dn_model_free(m);
}
TEST(wrists_have_a_lower_bar)
{
   dn_model *m = model_of(&paper);
   shape s = shape_of(4, 6, 0, 0);
   dn_blend_desc d = desc_of(&s);
   posed p;
   dn_error e;
   dn_blend *b = dn_blend_create(m, &d, NULL, &e);
   dn_blend_view v;
   size_t i, j, k, low = 0;
   if (!CHECK_MSG(b != NULL, "%s", e.info)) exit(1);
   dn_blend_describe(b, &v);
   CHECK(v.joints == 24 && v.shapes == 9);
   { /* the masks of weights made up for it */
      dn__nbs_bind bind;
      float *w = (float *)test_block(4 * 24 * v.nodes);
      uint32_t *first = (uint32_t *)test_block(4 * (v.nodes + 1)), *joint = (uint32_t *)test_block(4 * 23 * v.nodes);
      uint64_t seed = 4;
      memset(&bind, 0, sizeof bind);
      bind.net = m->blend, bind.nodes = v.nodes;
      for (i = 0; i < 24 * v.nodes; i++) w[i] = test_uniform(&seed, 0, 0.1f);
      dn__nbs_masks(&bind, w, first, joint);
      for (k = 0, i = 0; i < v.nodes; i++)
         for (j = 1; j < 24; j++) {
            double bar = j == 20 || j == 21 ? 0.02 : 0.05;
            int on = (double)w[24 * i + j] > bar || (double)w[24 * i + (size_t)smpl[j]] > bar;
            low += on && bar < 0.05 && (double)w[24 * i + j] <= 0.05 && (double)w[24 * i + (size_t)smpl[j]] <= 0.05;
            CHECK(on == (k < first[i + 1] && joint[k] == j));
            k += (size_t)on;
         }
      free(w), free(first), free(joint);
   }
   AT_LEAST(low, 5, "wrists between the bars");
   p = posed_of(m, &d, NULL);
   CHECK(p.B == 9);
   posed_free(&p);
   dn_blend_free(b);
   shape_free(&s);
   dn_model_free(m);
}

/* --- memory */
TEST(memory_stays_within_what_is_stated)
{
   dn_error e;
   size_t size, bytes, scratch, k;
   unsigned char *file;
   shape s = shape_of(100, 120, 0, 0); /* 12,002 vertices */
   dn_blend_desc d = desc_of(&s);
   for (k = 0; k < 2; k++) {
      counting c;
      dn_allocator a = counting_allocator(&c, -1);
      dn_model *m;
      unsigned workers = 2;
      dn_parallel par;
      file = model_file(&paper, (int)k, NULL, "", &size);
      m = dn_model_load(file, size, NULL, &a, &e);
      CHECK_MSG(m != NULL, "%s", e.info);
      CHECK_MSG(c.peak < (k ? 4 : 2) * size, "load: %lu bytes for a file of %lu", (unsigned long)c.peak, (unsigned long)size);
      par.run = odd_run, par.user = &workers, par.workers = 2;
      d.parallel = &par;
      CHECK(dn_blend_size(m, &d, &bytes, &scratch, &e) == DN_OK);
      CHECK_MSG(bytes + scratch < 200000000u, "%lu bytes at 12,002 vertices", (unsigned long)(bytes + scratch));
      CHECK(bytes < 6000000u);
      d.parallel = NULL;
      dn_model_free(m);
      CHECK(c.live == 0 && c.wrong == 0);
      free(file);
   }
   shape_free(&s);
   { /* what create really takes is no more, and about half of it on a closed mesh; more of gen's forbidden blocks cost nothing */
      widths w = sliced;
      counting c;
      dn_allocator a = counting_allocator(&c, -1);
      dn_model *m = model_of(&w);
      dn_blend *b;
      dn_blend_view v;
      s = shape_of(30, 40, 0, 0);
      d = desc_of(&s);
      CHECK(dn_blend_size(m, &d, &bytes, &scratch, &e) == DN_OK);
      b = dn_blend_create(m, &d, &a, &e);
      CHECK(b != NULL);
      if (b) dn_blend_describe(b, &v), CHECK(c.bytes == v.bytes && v.bytes <= bytes);
      CHECK_MSG(c.peak <= (bytes + scratch) * 7 / 10, "peak %lu of %lu", (unsigned long)c.peak, (unsigned long)(bytes + scratch));
      dn_blend_free(b);
      CHECK(c.live == 0);
      dn_model_free(m);
      shape_free(&s);
   }
}
static dn_result load_and_blend(const unsigned char *file, size_t size, const dn_blend_desc *d, dn_allocator *a, dn_error *err)
{
   dn_model *m = dn_model_load(file, size, NULL, a, err);
   dn_blend *b = m ? dn_blend_create(m, d, a, err) : NULL;
   size_t bytes = 0;
   void *scratch = b ? dn_blend_scratch_create(b, a, &bytes, err) : NULL;
   dn_result r = scratch ? DN_OK : err->code;
   dn_scratch_free(scratch, bytes, a);
   dn_blend_free(b);
   dn_model_free(m);
   return r;
}
typedef struct cancel { long at, calls; float last; size_t falls; } cancel;
static int cancel_step(void *user, const char *stage, float done)
{
   cancel *c = (cancel *)user;
   c->falls += !stage || !(done >= c->last && done <= 1.0f);
   c->last = done;
   return c->calls++ == c->at;
}
TEST(allocations_that_fail_and_cancelling)
{
   size_t size, cancelled = 0;
   unsigned char *file = model_file(&sliced, 0, NULL, "", &size);
   shape s = shape_of(8, 9, 3, 1);
   dn_blend_desc d = desc_of(&s);
   counting c;
   dn_error e;
   dn_result r = DN_NO_MEMORY;
   long k;
   cancel stop;
   dn_progress progress;
   for (k = 0; r == DN_NO_MEMORY && k < 1000; k++) {
      dn_allocator a = counting_allocator(&c, k);
      memset(&e, 0, sizeof e);
      r = load_and_blend(file, size, &d, &a, &e);
      CHECK_MSG(r == DN_OK ? c.calls <= k : r == DN_NO_MEMORY && e.info[0], "allocation %ld fails: %s, %s", k, dn_result_text(r), e.info);
      CHECK(c.live == 0 && c.wrong == 0);
   }
   CHECK_MSG(r == DN_OK && k >= 7, "%ld allocations, then %s", k, r ? e.info : "fine");
   r = DN_CANCELLED;
   progress.step = cancel_step, progress.user = &stop;
   d.progress = &progress;
   for (k = 0; r == DN_CANCELLED && k < 1000; k++) {
      dn_allocator a = counting_allocator(&c, -1);
      memset(&stop, 0, sizeof stop);
      stop.at = k;
      r = load_and_blend(file, size, &d, &a, &e);
      cancelled += r == DN_CANCELLED;
      CHECK((r == DN_OK || r == DN_CANCELLED) && stop.falls == 0 && c.live == 0 && c.wrong == 0);
      /* the last report, of 1, comes when all is done: too late to cancel */
      CHECK(r == DN_CANCELLED ? stop.calls == k + 1 : stop.calls <= k + 1 && stop.last >= 1.0f);
   }
   CHECK(r == DN_OK);
   AT_LEAST(cancelled, 12, "places to cancel");
   d.progress = NULL;
   { /* memory of exactly the queried sizes, and too little of it */
      dn_model *m = dn_model_load(file, size, NULL, NULL, &e);
      size_t bytes, scratch, frame;
      dn_blend *b = NULL;
      dn_blend_view v;
      posed p = posed_of(m, &d, NULL);
      void *q[3];
      CHECK(dn_blend_size(m, &d, &bytes, &scratch, &e) == DN_OK);
      q[0] = test_aligned(bytes), q[1] = test_aligned(scratch);
      memset(q[0], 0xa5, bytes), memset(q[1], 0x5a, scratch);
      CHECK(dn_blend_init(m, &d, q[0], 64, q[1], scratch, &b, &e) == DN_TOO_SMALL && !b && strstr(e.info, "memory"));
      CHECK(dn_blend_init(m, &d, q[0], bytes, q[1], 64, &b, &e) == DN_TOO_SMALL && !b && strstr(e.info, "scratch"));
      CHECK(dn_blend_init(m, &d, q[0], bytes, q[1], scratch / 2, &b, &e) == DN_TOO_SMALL && !b && strstr(e.info, "scratch"));
      CHECK_MSG(dn_blend_init(m, &d, q[0], bytes, q[1], scratch, &b, &e) == DN_OK && b, "%s", e.info);
      memset(q[1], 0xff, scratch); /* no longer needed */
      if (b) {
         dn_blend_input in;
         dn_blend_output out;
         float r9[9 * MOST_S], *position = (float *)test_block(12 * s.V);
         dn_blend_describe(b, &v);
         frame = dn_blend_scratch_size(b);
         q[2] = test_aligned(frame);
         memset(q[2], 0xa5, frame);
         memset(&in, 0, sizeof in), memset(&out, 0, sizeof out);
         pose_rotations(&v, r9);
         in.rotations = r9, in.strength = 1, out.positions = position;
         CHECK(dn_blend_pose(b, &in, &out, q[2], frame, NULL, &e) == DN_OK && memcmp(position, p.position, 12 * s.V) == 0);
         test_aligned_free(q[2]);
         free(position);
         dn_blend_free(b); /* the memory is ours: nothing happens */
      }
      posed_free(&p);
      test_aligned_free(q[0]);
      test_aligned_free(q[1]);
      dn_model_free(m);
   }
   free(file);
   shape_free(&s);
}

/* --- files */
TEST(forbidden_blocks_are_ignored)
{
   size_t size, count, i, changed = 0;
   unsigned char *file = model_file(&small, 0, NULL, "", &size);
   shape s = shape_of(6, 8, 0, 0);
   dn_blend_desc d = desc_of(&s);
   dn_error e;
   dn_model *m = dn_model_load(file, size, NULL, NULL, &e);
   posed p = posed_of(m, &d, NULL), q;
   uint64_t h = posed_hash(&p);
   float *w = data_of(file, size, "gen.0.weight", &count);
   const uint32_t nan_bits = 0x7fc00000u;
   CHECK(count == 5 * 4 * 5 * 6);
   for (i = 0; i < count; i++) {
      size_t to = i / 30 / 4, from = i % 30 / 6, apart = to > from ? to - from : from - to; /* joints in a chain */
      if (apart > 2) memcpy(w + i, &nan_bits, 4), changed++;
   }
   dn_model_free(m);
   m = dn_model_load(file, size, NULL, NULL, &e);
   CHECK_MSG(m != NULL, "%s", e.info);
   q = posed_of(m, &d, NULL);
   CHECK(posed_hash(&q) == h);
   AT_LEAST(changed, 100, "numbers");
   posed_free(&p);
   posed_free(&q);
   dn_model_free(m);
   memcpy(w, &nan_bits, 4); /* one that counts */
   CHECK(dn_model_load(file, size, NULL, NULL, &e) == NULL && e.code == DN_BAD_VALUE && strstr(e.info, "gen.0.weight"));
   free(file);
   shape_free(&s);
}
static size_t refusals;
static void refused(const widths *w, const char *parents, const char *meta, dn_result code, const char *word)
{
   size_t size;
   unsigned char *file = model_file(w, 0, parents, meta, &size);
   counting c;
   dn_allocator a = counting_allocator(&c, -1);
   dn_error e;
   dn_model *m = dn_model_load(file, size, NULL, &a, &e);
   CHECK_MSG(!m && e.code == code && strstr(e.info, word), "expected %s about %s, got %s: %s", dn_result_text(code), word, m ? "a model" : dn_result_text(e.code), m ? "" : e.info);
   CHECK(m || c.live == 0);
   refusals++;
   dn_model_free(m);
   free(file);
}
TEST(files_that_do_not_fit_together)
{
   static const char *const lists[] = {"", "0,0,1,2,3", "-1,0,1,2,4", "-1,0,1,2,3,", "-1,0,-1,2,3", "-1,0,1,x,3", "-1,0,1, 2,3", "-1,0,1,2,99999999999", "-1;0", "-2,0,1,2,3"};
   widths w;
   size_t i;
   for (i = 0; i < sizeof lists / sizeof *lists; i++) refused(&small, lists[i], "", DN_BAD_VALUE, "deformnet.parents");
   refused(&small, "-1,0,1,2", "", DN_BAD_SHAPE, "att.1.weight");
   refused(&small, NULL, ",\"deformnet.joints\":\"a,b,c\"", DN_BAD_SHAPE, "deformnet.joints");
   w = small, w.att[0] = 4, refused(&w, NULL, "", DN_BAD_SHAPE, "att.0.weight");
   w = small, w.att[2] = 6, refused(&w, NULL, "", DN_BAD_SHAPE, "att.1.weight");
   w = small, w.att[1] = 0, refused(&w, NULL, "", DN_MISSING_TENSOR, "att.0.weight");
   w = small, w.geo[2] = 9, refused(&w, NULL, "", DN_BAD_SHAPE, "gen.0.weight");
   w = small, w.gen[2] = 4, refused(&w, NULL, "", DN_BAD_SHAPE, "gen.1.weight");
   w = small, w.gen[1] = 0, refused(&w, NULL, "", DN_MISSING_TENSOR, "gen.0.weight");
   w = small, w.geo2[1] = 7, refused(&w, NULL, "", DN_BAD_SHAPE, "dec.0.weight");
   w = small, w.dec[1] = 7, refused(&w, NULL, "", DN_BAD_SHAPE, "dec.0.weight");
   w = small, w.coff[2] = 3, refused(&w, NULL, "", DN_BAD_SHAPE, "coff.0.1.weight");
   w = small, w.coff[0] = 8, refused(&w, NULL, "", DN_BAD_SHAPE, "coff.0.0.weight");
   { /* joints without a network of their own; a list longer than anything here */
      widths more = small;
      size_t n = 0;
      char *list = (char *)test_block(8192);
      more.S = 4;
      refused(&more, "-1,0,1,2,3", "", DN_BAD_SHAPE, "gen.0.weight");
      n += (size_t)snprintf(list, 8192, "-1");
      for (i = 1; i < 1025; i++) n += (size_t)snprintf(list + n, 8192 - n, ",0");
      refused(&small, list, "", DN_UNSUPPORTED, "deformnet.parents");
      free(list);
   }
   { /* each rig call says who takes the other's models; one joint needs no coefficients */
      dn_model *m = model_of(&small), *other;
      shape s = shape_of(4, 5, 0, 0);
      dn_blend_desc d = desc_of(&s);
      tube t;
      dn_error e;
      size_t size;
      unsigned char *file = tiny_mlp(&size);
      dn_model_info info;
      posed p;
      tube_make(&t);
      CHECK(dn_rig_create(m, &t.desc, NULL, NULL, &e) == NULL && e.code == DN_UNSUPPORTED && strstr(e.info, "dn_blend_create"));
      dn_model_describe(m, &info);
      CHECK(info.arch == DN_NEURALBLENDSHAPES && info.joints == 5 && info.parameters > 500 && info.bytes > 2000);
      other = dn_model_load(file, size, NULL, NULL, &e);
      CHECK(other && dn_blend_create(other, &d, NULL, &e) == NULL && e.code == DN_UNSUPPORTED && strstr(e.info, "dn_rig_create"));
      dn_model_free(other);
      dn_model_free(m);
      w = small, w.S = 1, w.att[2] = 1, w.dec[0] = 7;
      m = model_of(&w);
      p = posed_of(m, &d, NULL);
      CHECK(p.S == 1 && p.B == 2 && p.view.joints == 1);
      posed_free(&p);
      dn_model_free(m);
      free(file);
      shape_free(&s);
   }
   AT_LEAST(refusals, 24, "files");
}
TEST(every_prefix_and_every_flipped_byte)
{
   size_t size, n, k, loaded = 0, bound = 0, tried = 0;
   unsigned char *file, *own;
   widths w = small;
   shape s = shape_of(2, 3, 0, 0);
   dn_blend_desc d = desc_of(&s);
   dn_error e;
   w.S = 3, w.att[1] = 3, w.att[2] = 0, w.geo[1] = 2, w.geo[2] = 0, w.gen[0] = 2, w.gen[1] = 3, w.gen[2] = 0, w.geo2[1] = 2, w.dec[0] = 5, w.dec[1] = 3, w.coff[1] = 1, w.coff[2] = 0;
   file = model_file(&w, 0, NULL, ",\"deformnet.joints\":\"a,b,c\"", &size);
   for (n = 0; n < size; n++, tried++) {
      dn_model *m;
      own = test_copy(file, n);
      memset(&e, 0, sizeof e);
      m = dn_model_load(own, n, NULL, NULL, &e);
      CHECK_MSG(m == NULL && e.code != DN_OK && e.info[0], "%lu of %lu bytes load", (unsigned long)n, (unsigned long)size);
      dn_model_free(m);
      free(own);
   }
   for (n = 0; n < size; n++)
      for (k = 0; k < 3; k++, tried++) { /* an error, or a model that gives finite numbers or a refusal */
         static const unsigned char flips[3] = {1, 0x80, 0xff};
         counting c;
         dn_allocator a = counting_allocator(&c, -1);
         dn_model *m;
         own = test_copy(file, size);
         own[n] = (unsigned char)(own[n] ^ flips[k]);
         m = dn_model_load(own, size, NULL, &a, &e);
         if (m) {
            dn_blend *b = dn_blend_create(m, &d, &a, &e);
            loaded++;
            CHECK(b || e.code == DN_BAD_VALUE);
            if (b) {
               dn_blend_view v;
               size_t i, bad = 0;
               dn_blend_describe(b, &v);
               bound++;
               for (i = 0; i < v.nodes * v.joints; i++) bad += !test_finite(v.skin_weight[i]);
               for (i = 0; i < v.nodes * v.shapes * 3; i++) bad += !test_finite(v.shape[i]);
               CHECK(bad == 0);
            }
            dn_blend_free(b);
         } else CHECK(e.info[0]);
         dn_model_free(m);
         CHECK(c.live == 0 && c.wrong == 0 && c.peak < 40 * size);
         free(own);
      }
   AT_LEAST(tried, 8000, "files");
   AT_LEAST(loaded, 1000, "models");
   AT_LEAST(bound, 1000, "meshes");
   free(file);
   shape_free(&s);
}
TEST(meshes_that_are_none)
{
   dn_model *m = model_of(&small);
   shape s = shape_of(4, 5, 0, 0);
   dn_blend_desc d = desc_of(&s);
   dn_error e;
   size_t k, bytes, scratch;
   const uint32_t bits[2] = {0x7fc00000u, 0xff800000u};
   float keep = s.p[4];
   for (k = 0; k < 2; k++) {
      memcpy(&s.p[4], &bits[k], 4);
      CHECK(dn_blend_create(m, &d, NULL, &e) == NULL && e.code == DN_BAD_MESH && e.offset == 1 && strstr(e.info, "vertex 1"));
   }
   s.p[4] = keep;
   {
      shape t = shape_of(4, 5, 0, 0); /* finite, but not what comes of it */
      dn_blend_desc far = desc_of(&t);
      for (k = 0; k < t.V; k++) t.p[3 * k + 1] = k / 5 % 2 ? 3.4e38f : -3.4e38f;
      CHECK(dn_blend_create(m, &far, NULL, &e) == NULL && e.code == DN_BAD_VALUE && strstr(e.info, "not finite"));
      shape_free(&t);
   }
   s.f[7] = (uint32_t)s.V;
   CHECK(dn_blend_create(m, &d, NULL, &e) == NULL && e.code == DN_BAD_MESH && e.offset == 2 && strstr(e.info, "triangle 2"));
   d.mesh.triangles = 0; /* nodes without edges are legal: all on joint 0 */
   {
      posed p = posed_of(m, &d, NULL);
      CHECK(p.view.edges == 0 && p.view.isolated_nodes == s.V && p.weight[0] >= 1.0f);
      posed_free(&p);
   }
   d.mesh.vertices = 0;
   CHECK(dn_blend_create(m, &d, NULL, &e) == NULL && e.code == DN_BAD_MESH);
   d.mesh.vertices = SIZE_MAX / 2;
   CHECK(dn_blend_size(m, &d, &bytes, &scratch, &e) == DN_BAD_MESH);
   {
      dn_model *most = model_of(&paper); /* 24 joints: masks would number more than 32 bits can */
      d.mesh.vertices = 200000000;
      CHECK(dn_blend_size(most, &d, &bytes, &scratch, &e) == DN_BAD_MESH && strstr(e.info, "vertices: found 200000000"));
      d = desc_of(&s); /* a small mesh needs no room for a large one's rows of 512 */
      CHECK(dn_blend_size(most, &d, &bytes, &scratch, &e) == DN_OK && scratch < 2u << 20);
      dn_model_free(most);
   }
   d = desc_of(&s);
   memcpy(&d.weld_distance, &bits[0], 4);
   CHECK(dn_blend_create(m, &d, NULL, &e) == NULL && e.code == DN_BAD_VALUE && strstr(e.info, "weld_distance"));
   shape_free(&s);
   dn_model_free(m);
}
int main(int argc, char **argv)
{
   TEST_BEGIN(argc, argv);
   RUN(edges_by_definition);
   RUN(convolution_equals_its_equation);
   RUN(means_pools_and_softmax);
   RUN(skeleton_layers_see_two_steps);
   RUN(order_does_not_matter);
   RUN(seams_types_and_strides);
   RUN(any_number_of_workers);
   RUN(poses);
   RUN(wrists_have_a_lower_bar);
   RUN(memory_stays_within_what_is_stated);
   RUN(allocations_that_fail_and_cancelling);
   RUN(forbidden_blocks_are_ignored);
   RUN(files_that_do_not_fit_together);
   RUN(every_prefix_and_every_flipped_byte);
   RUN(meshes_that_are_none);
   return TEST_END();
}
