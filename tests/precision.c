/*  precision.c - half, bfloat16 and 8-bit layers: each kernel that this machine runs against plain texts and double precision

    shows   conversions of single numbers, all halves among them; products and attention on random shapes with tails 0 to 17,
            strides and odd addresses, nothing written outside; 8-bit blocks give the same bits in every kernel; their sums are
            exact at the ends of the range and at the longest row; what each precision loses is within its bound
            whole networks stay near float32, in every kernel, with any split over threads; ranges that are missing or make no
            sense, and networks that have no such precision, are refused by name
    build   cc -O2 precision.c -o precision -lm */
#define DEFORMNET_IMPLEMENTATION
#define DEFORMNET_STATIC
#include "../deformnet.h"
#include "test.h"
#include "tiny.h"
#include <math.h>

#define GUARD 0xa5 /* in every byte around what is written */
enum { PRECISIONS = 3 };
static const dn_precision precisions[PRECISIONS] = { DN_PRECISION_F16, DN_PRECISION_BF16, DN_PRECISION_INT8 };
static const dn_activation activations[] = { DN_ACT_NONE, DN_ACT_TANH, DN_ACT_RELU, DN_ACT_LEAKYRELU, DN_ACT_TANHSHRINK };
static const dn__cell cells[] = { DN__FLOAT, DN__HALF, DN__BF16, DN__BYTE };

static size_t pick(uint64_t *seed, size_t low, size_t high) { return low + test_random(seed) % (high - low + 1); }
static float *random_floats(uint64_t *seed, size_t count, float size)
{
   float *p = (float *)test_block((count + 1) * sizeof(float));
   size_t i;
   for (i = 0; i < count; i++) p[i] = test_uniform(seed, -size, size);
   return p;
}
static float of_bits(uint32_t u)
{
   float x;
   memcpy(&x, &u, 4);
   return x;
}
static uint32_t bits(float x)
{
   uint32_t u;
   memcpy(&u, &x, 4);
   return u;
}

/* --- single numbers */
TEST(halves_and_bfloat16s_round_to_the_nearest_even)
{
   uint32_t h, checked = 0;
   uint64_t seed = 1;
   size_t i;
   for (h = 0; h < 0x10000u; h++) {
      float x = of_bits(dn__half_bits(h)), above;
      if ((h & 0x7c00u) == 0x7c00u) continue; /* infinite, NaN */
      CHECK(dn__half_of(x) == h || (x == 0 && (dn__half_of(x) & 0x7fffu) == 0));
      if ((h & 0x7fffu) < 0x7bffu) { /* halfway to the next: the even one; a little on either side: that side */
         above = of_bits(dn__half_bits(h + 1));
         CHECK(dn__half_of((x + above) / 2) == h + (h & 1));
         CHECK(dn__half_of(of_bits(bits((x + above) / 2) + 1)) == h + 1 && dn__half_of(of_bits(bits((x + above) / 2) - 1)) == h);
      }
      checked++;
   }
   AT_LEAST(checked, 60000, "halves");
   CHECK(dn__half_of(1e30f) == 0x7bffu && dn__half_of(-1e30f) == 0xfbffu && dn__half_of(of_bits(0x7f800000u)) == 0x7bffu);
   CHECK((dn__half_of(of_bits(0x7fc00000u)) & 0x7c00u) == 0x7c00u && (dn__bf16_of(of_bits(0x7f800001u)) & 0x7fffu) > 0x7f80u);
   for (i = 0; i < 100000; i++) {
      uint32_t u = test_random(&seed), down = u & 0xffff0000u, rest = u & 0xffffu, want;
      if ((u & 0x7f800000u) == 0x7f800000u) continue;
      want = down + (rest > 0x8000u || (rest == 0x8000u && (u >> 16 & 1u)) ? 0x10000u : 0);
      CHECK(dn__bf16_of(of_bits(u)) << 16 == want);
   }
   for (i = 0; i < 512; i++) { /* 127.5 steps are halfway between 127 and 128 */
      float x = (float)i / 2;
      unsigned want = i < 2 ? 1 : i % 2 == 0 ? (unsigned)i / 2 : (unsigned)(i / 2 + (i / 2) % 2);
      CHECK(dn__byte_of(x, 1, 0) == (want < 1 ? 1 : want > 255 ? 255 : want));
   }
   CHECK(dn__byte_of(1e30f, 1, 128) == 255 && dn__byte_of(-1e30f, 1, 128) == 1 && dn__byte_of(of_bits(0x7fc00000u), 1, 128) == 1);
   for (i = 0; i <= 254; i++) CHECK(dn__weight_byte((double)i / 2) == (i % 2 == 0 ? (int)i / 2 : (int)(i / 2 + (i / 2) % 2)));
   CHECK(dn__weight_byte(-3.5) == -4 && dn__weight_byte(-4.5) == -4 && dn__weight_byte(1e9) == 127 && dn__weight_byte(-1e9) == -127);
}
TEST(exp_and_tanh_are_near)
{
   double worst = 0, tanh_worst = 0, shrink_worst = 0, x, e;
   size_t n = 0;
   CHECK(dn__reduced_exp(0) == 1 && dn__reduced_exp(-0.0f) == 1 && dn__reduced_exp(-1e30f) > 0 && dn__reduced_exp(-1e30f) < 2e-38f);
   for (x = -87; x < 0; x += 0.00031, n++) {
      float at = (float)x;
      e = fabs((double)dn__reduced_exp(at) / exp((double)at) - 1);
      worst = e > worst ? e : worst;
   }
   for (x = -12; x < 12; x += 0.000173, n++) {
      float at = (float)x;
      double t = tanh((double)at), s = (double)at - t;
      e = fabs((double)dn__reduced_tanh(at, 0) - t);
      tanh_worst = e > tanh_worst ? e : tanh_worst;
      if (fabs((double)at) < 1e-3) continue;
      if (fabs((double)at) < 0.3) s = pow((double)at, 3) * (1.0 / 3 - 2 * (double)at * (double)at / 15 + 17 * pow((double)at, 4) / 315 - 62 * pow((double)at, 6) / 2835);
      e = fabs((double)dn__reduced_tanh(at, 1) / s - 1);
      shrink_worst = e > shrink_worst ? e : shrink_worst;
   }
   printf("   exp within %.1e of itself, tanh %.1e, x - tanh x %.1e of itself\n", worst, tanh_worst, shrink_worst);
   CHECK(worst < 1.2e-5 && tanh_worst < 4e-4 && shrink_worst < 1e-4);
   CHECK(dn__reduced_tanh(0, 0) == 0 && dn__reduced_tanh(0, 1) == 0 && dn__reduced_tanh(1e30f, 0) > 0.999f);
   CHECK(dn__nan(dn__reduced_tanh(of_bits(0x7fc00000u), 0)));
   AT_LEAST(n, 300000, "values");
}
/* sums -> cells: each text gives the plain one's bits, whatever the activation and the cell */
TEST(every_kernel_finishes_with_the_same_bits)
{
   size_t k, p, a, c, round, cases = 0;
   uint64_t seed = 2;
   for (k = 0; k < DN_KERNEL_COUNT; k++) {
      if (!dn_kernel_available((dn_kernel)k)) continue;
      for (p = 0; p < PRECISIONS; p++)
         for (a = 0; a < sizeof activations / sizeof *activations; a++)
            for (c = 0; c < 4; c++)
               for (round = 0; round < 8; round++, cases++) {
                  const dn__reduced_text *t = dn__reduced_text_of(precisions[p], (dn_kernel)k);
                  float columns[32], inverse[32], offset[32];
                  int32_t sums[DN__REDUCED_ROWS * DN_PANEL];
                  unsigned char y[DN__REDUCED_ROWS * 80 + 64], want[sizeof y];
                  size_t i, count = pick(&seed, 1, 16), rows = pick(&seed, 1, t->rows), pitch = 64 + 4 * pick(&seed, 0, 3);
                  int whole = precisions[p] == DN_PRECISION_INT8;
                  for (i = 0; i < DN__REDUCED_ROWS * DN_PANEL; i++) {
                     float x = round == 0 ? 0 : test_uniform(&seed, -6, 6) * (round == 1 ? 1e-6f : round == 2 ? 1e6f : 1);
                     if (whole) sums[i] = (int32_t)(x * 1000 > 2e9f ? 2e9f : x * 1000 < -2e9f ? -2e9f : x * 1000);
                     else memcpy(sums + i, &x, 4);
                  }
                  for (i = 0; i < 32; i++) {
                     columns[i] = i < 16 ? test_uniform(&seed, 0.1f, 2.0f) * (whole ? 1e-3f : 1) : test_uniform(&seed, -1, 1);
                     inverse[i] = test_uniform(&seed, 10, 90), offset[i] = test_uniform(&seed, 90, 160);
                  }
                  memset(y, GUARD, sizeof y);
                  memset(want, GUARD, sizeof want);
                  t->finish(sums, whole, columns, activations[a], rows, y, pitch, count, cells[c], inverse, offset);
                  dn__finish_ref(sums, whole, columns, activations[a], rows, want, pitch, count, cells[c], inverse, offset);
                  CHECK_MSG(memcmp(y, want, sizeof y) == 0, "kernel %lu precision %lu activation %lu cell %lu count %lu", (unsigned long)k,
                            (unsigned long)p, (unsigned long)a, (unsigned long)c, (unsigned long)count);
               }
   }
   AT_LEAST(cases, 400, "tiles");
}

/* --- layers: one made from the same numbers at any precision, for any kernel */
typedef struct layer {
   size_t in, heads, features, self, out;
   float *lin, *dst, *src, *own, *bias, *bn;
   float *middle, *step, *inverse, *offset;  /* of the row read (in), of the row written (out + 16) */
   float *to_middle, *to_step;
   dn_batchnorm norm;
   dn_activation activation;
} layer;
static layer layer_make(uint64_t *seed, size_t in, size_t heads, size_t features, size_t self, dn_activation activation, int with_bn)
{
   layer l;
   size_t i;
   memset(&l, 0, sizeof l);
   l.in = in, l.heads = heads, l.features = features, l.self = self, l.out = heads * features + self, l.activation = activation;
   l.lin = random_floats(seed, heads * features * in, 0.5f);
   l.dst = random_floats(seed, heads * features, 1);
   l.src = random_floats(seed, heads * features, 1);
   l.own = random_floats(seed, self * in, 0.4f);
   l.bias = random_floats(seed, l.out, 0.5f);
   l.bn = random_floats(seed, 4 * l.out, 0.5f);
   for (i = 0; i < l.out; i++) l.bn[3 * l.out + i] += 0.7f;
   if (with_bn) l.norm.weight = l.bn, l.norm.bias = l.bn + l.out, l.norm.mean = l.bn + 2 * l.out, l.norm.var = l.bn + 3 * l.out;
   l.middle = random_floats(seed, in, 0.5f);
   l.step = random_floats(seed, in, 0.004f);
   for (i = 0; i < in; i++) l.step[i] += 0.006f;
   l.inverse = random_floats(seed, l.out + 32, 20);
   l.offset = random_floats(seed, l.out + 32, 30);
   for (i = 0; i < l.out + 32; i++) l.inverse[i] += 60, l.offset[i] += 128;
   return l;
}
static void layer_free(layer *l)
{
   free(l->lin), free(l->dst), free(l->src), free(l->own), free(l->bias), free(l->bn);
   free(l->middle), free(l->step), free(l->inverse), free(l->offset);
}
static dn__reduced layer_pack(const layer *l, dn_precision precision, dn_kernel kernel, dn__cell to, void **memory)
{
   dn__reduced r;
   dn__arena a = dn__arena_of(NULL, 0);
   dn__span spans[2]; /* as of two blocks side by side */
   double *row = (double *)test_block((l->in + 1) * sizeof *row);
   memset(spans, 0, sizeof spans);
   spans[0].width = l->in / 3, spans[0].middle = l->middle, spans[0].step = l->step;
   spans[1].width = l->in - l->in / 3, spans[1].middle = l->middle + l->in / 3, spans[1].step = l->step + l->in / 3;
   dn__reduced_make(&r, precision, kernel, l->in, l->heads, l->features, l->self, l->activation);
   dn__reduced_lay(&r, &a);
   *memory = test_aligned(dn__gauge(&a));
   a = dn__arena_of(*memory, dn__gauge(&a));
   dn__reduced_lay(&r, &a);
   dn__reduced_fill(&r, l->lin, l->dst, l->src, l->own, l->heads ? NULL : l->bias, l->norm.var ? &l->norm : NULL, spans, row);
   r.to = to;
   if (to == DN__BYTE) r.inverse = l->inverse, r.offset = l->offset;
   free(row);
   return r;
}
/* rows of cells at a byte offset that suits them; what lies between is GUARD */
typedef struct grid { unsigned char *block, *at; size_t pitch, bytes; } grid;
static grid grid_make(uint64_t *seed, size_t rows, size_t width, dn__cell cell)
{
   grid g;
   size_t size = dn__cell_size(cell), off = size * pick(seed, 0, 9);
   g.pitch = (width + pick(seed, 0, 5)) * size;
   g.bytes = off + (rows ? (rows - 1) * g.pitch + width * size : 0);
   g.block = (unsigned char *)test_block(g.bytes + 1);
   memset(g.block, GUARD, g.bytes);
   g.at = g.block + off;
   return g;
}
static void grid_fill(uint64_t *seed, grid *g, size_t rows, size_t width, dn__cell cell)
{
   size_t r, c;
   for (r = 0; r < rows; r++)
      for (c = 0; c < width; c++) {
         unsigned char *p = g->at + r * g->pitch + c * dn__cell_size(cell);
         if (cell == DN__BYTE) *p = (unsigned char)pick(seed, 1, 255);
         else dn__write_cell(p, test_uniform(seed, -1.2f, 1.2f), cell, NULL, NULL);
      }
}
static double value_of(const layer *l, const unsigned char *x, size_t c, dn__cell cell) /* column c of the row at x */
{
   double v = (double)dn__read_cell(x + c * dn__cell_size(cell), cell);
   return cell == DN__BYTE ? (double)l->middle[c] + (double)l->step[c] * (v - 128) : v;
}
static double weight_of(const layer *l, size_t o, size_t c)
{
   size_t kf = l->heads * l->features;
   return (double)(o < kf ? l->lin[o * l->in + c] : l->own[(o - kf) * l->in + c]);
}
/* columns `from` on of one row in doubles, before the activation, and how far rounding of the weights can move each */
static void exact_row(const layer *l, const unsigned char *x, dn_precision precision, dn__cell cell, size_t o, double *value, double *bound)
{
   double sum = l->heads ? 0 : (double)l->bias[o], most = 0, moved = 0, scale, shift;
   size_t c;
   for (c = 0; c < l->in; c++) {
      double w = weight_of(l, o, c);
      sum += w * value_of(l, x, c, cell);
      moved += precision == DN_PRECISION_INT8 ? fabs(value_of(l, x, c, cell) - (double)l->middle[c]) / (double)l->step[c]
         : fabs(w * value_of(l, x, c, cell));
      if (precision == DN_PRECISION_INT8) most = fmax(most, fabs(w * (double)l->step[c]));
   }
   moved *= precision == DN_PRECISION_INT8 ? most / 127 / 2 : precision == DN_PRECISION_F16 ? 1 / 2048.0 : 1 / 256.0;
   dn__fold(l->norm.var ? &l->norm : NULL, o, &scale, &shift);
   *value = sum * scale + shift;
   *bound = fabs(scale) * (moved * 1.01 + 1e-4) + 1e-4;
}
static double act(double x, dn_activation activation)
{
   switch (activation) {
   case DN_ACT_TANH: return tanh(x);
   case DN_ACT_TANHSHRINK: return x - tanh(x);
   case DN_ACT_RELU: return x < 0 ? 0 : x;
   case DN_ACT_LEAKYRELU: return x < 0 ? 0.2 * x : x;
   default: return x;
   }
}
static void linear_case(dn_kernel kernel, dn_precision precision, uint64_t *seed, size_t in, size_t out, size_t rows)
{
   layer l = layer_make(seed, in, 0, 0, out, activations[pick(seed, 0, 4)], (int)pick(seed, 0, 1));
   dn__cell from = dn__precision_cell(precision), to = pick(seed, 0, 2) ? from : DN__FLOAT;
   void *memory, *plain_memory;
   dn__reduced r = layer_pack(&l, precision, kernel, to, &memory), plain = layer_pack(&l, precision, DN_KERNEL_REF, to, &plain_memory);
   grid x = grid_make(seed, rows, in, from), y = grid_make(seed, rows, out, to);
   unsigned char *want = test_copy(y.block, y.bytes + 1), *want_at = want + (y.at - y.block);
   size_t i, o, bad = 0, off = 0;
   grid_fill(seed, &x, rows, in, from);
   dn__reduced_products(&r, x.at, x.pitch, NULL, 0, y.at, y.pitch, rows);
   dn__reduced_products(&plain, x.at, x.pitch, NULL, 0, want_at, y.pitch, rows);
   if (precision == DN_PRECISION_INT8) bad = memcmp(y.block, want, y.bytes) != 0;
   for (i = 0; i < rows; i++)
      for (o = 0; o < out; o++) {
         const unsigned char *p = y.at + i * y.pitch + o * dn__cell_size(to), *q = want_at + i * y.pitch + o * dn__cell_size(to);
         double a = (double)dn__read_cell(p, to), b = (double)dn__read_cell(q, to), value, bound;
         if (precision != DN_PRECISION_INT8) bad += !(fabs(a - b) <= 1e-4 + (to == DN__BF16 ? 0.01 : 1e-3) * fabs(b));
         exact_row(&l, x.at + i * x.pitch, precision, from, o, &value, &bound);
         value = act(value, l.activation);
         if (to == DN__BYTE) {
            a = (a - (double)l.offset[o]) / (double)l.inverse[o];
            if (*p == 1 || *p == 255) continue; /* saturated */
            bound += 0.51 / (double)l.inverse[o];
         } else if (to == DN__BF16) bound += fabs(value) / 256;
         off += !(fabs(a - value) <= bound + 5e-4);
      }
   CHECK_MSG(bad == 0, "kernel %d %s: in %lu out %lu rows %lu activation %d differs from the plain text in %lu", (int)kernel,
             dn_precision_name(precision), (unsigned long)in, (unsigned long)out, (unsigned long)rows, (int)l.activation, (unsigned long)bad);
   CHECK_MSG(off == 0, "kernel %d %s: in %lu out %lu rows %lu activation %d, %lu beyond what rounding of weights explains", (int)kernel,
             dn_precision_name(precision), (unsigned long)in, (unsigned long)out, (unsigned long)rows, (int)l.activation, (unsigned long)off);
   for (i = 0; i < rows; i++) /* nothing between the rows */
      for (o = out * dn__cell_size(to); i + 1 < rows && o < y.pitch; o++) CHECK(y.at[i * y.pitch + o] == GUARD);
   for (i = 0; y.block + i < y.at; i++) CHECK(y.block[i] == GUARD);
   free(x.block), free(y.block), free(want);
   test_aligned_free(memory), test_aligned_free(plain_memory);
   layer_free(&l);
}
TEST(products_equal_the_plain_text)
{
   size_t k, p, n, i, cases = 0;
   for (k = 0; k < DN_KERNEL_COUNT; k++)
      for (p = 0; dn_kernel_available((dn_kernel)k) && p < PRECISIONS; p++) {
         uint64_t seed = 7;
         for (n = 0; n <= 17; n++, cases += 4) { /* each tail of each side */
            linear_case((dn_kernel)k, precisions[p], &seed, n + 1, 19, 15);
            linear_case((dn_kernel)k, precisions[p], &seed, 20, n + 1, 29);
            linear_case((dn_kernel)k, precisions[p], &seed, 9, 33, n + (n == 0));
            linear_case((dn_kernel)k, precisions[p], &seed, 250 + n, 32 + n, 28 + n);
         }
         for (i = 0; i < 40; i++, cases++)
            linear_case((dn_kernel)k, precisions[p], &seed, pick(&seed, 1, 600), pick(&seed, 1, 130), pick(&seed, 1, 70));
      }
   AT_LEAST(cases, 112 * 3, "cases");
}
/* sums of the widest row that a file may have, all cells and weights at the ends of their ranges, against 64-bit sums */
TEST(whole_sums_are_exact_at_the_extremes)
{
   static const size_t widths[] = { 1, 2, 3, 5, 64, 257, 4099, 65536 };
   static const unsigned ends[] = { 0, 1, 127, 128, 129, 254, 255 };
   size_t k, i, round, r, o, c, cases = 0, worst = 0;
   uint64_t seed = 11;
   for (k = 0; k < DN_KERNEL_COUNT; k++)
      for (i = 0; dn_kernel_available((dn_kernel)k) && i < sizeof widths / sizeof *widths; i++)
         for (round = 0; round < 4; round++, cases++) {
            const dn__reduced_text *t = dn__reduced_text_of(DN_PRECISION_INT8, (dn_kernel)k);
            size_t in = widths[i], rows = t->rows, padded = dn__round(in, t->group), bad = 0;
            unsigned char *x = (unsigned char *)test_block(rows * in), *w = (unsigned char *)test_block(t->panels * DN_PANEL * padded);
            int32_t minus[2 * DN_PANEL];
            float sums[2 * DN__REDUCED_ROWS * DN_PANEL];
            dn__reduced l;
            memset(&l, 0, sizeof l);
            memset(w, 0, t->panels * DN_PANEL * padded);
            for (c = 0; c < rows * in; c++) x[c] = (unsigned char)(round == 0 ? 255 : round == 1 ? 0 : ends[pick(&seed, 0, 6)]);
            for (o = 0; o < t->panels * DN_PANEL; o++) {
               int32_t all = 0;
               for (c = 0; c < in; c++) {
                  int v = round < 2 ? (o & 1 ? -127 : 127) : (int)pick(&seed, 0, 254) - 127;
                  w[o / DN_PANEL * DN_PANEL * padded + dn__reduced_at(t->group, o % DN_PANEL, c)] = (unsigned char)(signed char)v;
                  all += v;
               }
               minus[o] = -128 * all;
            }
            l.precision = DN_PRECISION_INT8, l.text = t, l.in = in, l.from = DN__BYTE, l.weights = w, l.minus = minus;
            dn__reduced_sums(&l, x, in, 0, t->panels, sums);
            for (r = 0; r < rows; r++)
               for (o = 0; o < t->panels * DN_PANEL; o++) {
                  int64_t want = 0;
                  int32_t got;
                  for (c = 0; c < in; c++)
                     want += ((int)x[r * in + c] - 128) *
                        (int)(signed char)w[o / DN_PANEL * DN_PANEL * padded + dn__reduced_at(t->group, o % DN_PANEL, c)];
                  memcpy(&got, sums + (o / DN_PANEL * rows + r) * DN_PANEL + o % DN_PANEL, 4);
                  bad += (int64_t)got != want;
                  worst = (size_t)(want < 0 ? -want : want) > worst ? (size_t)(want < 0 ? -want : want) : worst;
               }
            CHECK_MSG(bad == 0, "kernel %lu in %lu: %lu sums are off", (unsigned long)k, (unsigned long)in, (unsigned long)bad);
            free(x), free(w);
         }
   printf("   the largest sum is %lu\n", (unsigned long)worst);
   CHECK(worst > 1000000000u);
   AT_LEAST(cases, 32, "rows");
}

/* --- attention */
typedef struct ring_graph { dn_graph g; uint32_t *first, *next; } ring_graph;
/* random, symmetric, ascending; some nodes alone; node 0 joined to `fan` others as a vertex of a big fan is */
static ring_graph random_graph(uint64_t *seed, size_t nodes, size_t edges, size_t fan)
{
   ring_graph r;
   unsigned char *joined = (unsigned char *)test_block(nodes * nodes);
   size_t i, j, at = 0;
   memset(joined, 0, nodes * nodes);
   for (i = 0; i < edges && nodes > 1; i++) {
      size_t a = pick(seed, 0, nodes - 1), b = pick(seed, 0, nodes - 1);
      if (a != b && a % 7 != 3 && b % 7 != 3) joined[a * nodes + b] = joined[b * nodes + a] = 1;
   }
   for (i = 1; i <= fan && i < nodes; i++) joined[i] = joined[i * nodes] = 1;
   for (i = 0; i < nodes * nodes; i++) at += joined[i];
   r.first = (uint32_t *)test_block((nodes + 1) * 4);
   r.next = (uint32_t *)test_block((at + 1) * 4);
   for (i = at = 0; i < nodes; i++) {
      r.first[i] = (uint32_t)at;
      for (j = 0; j < nodes; j++)
         if (joined[i * nodes + j]) r.next[at++] = (uint32_t)j;
   }
   r.first[nodes] = (uint32_t)at;
   r.g.nodes = nodes, r.g.first = r.first, r.g.next = r.next;
   free(joined);
   return r;
}
static void block_run(const dn__reduced *b, dn_kernel kernel, const dn_graph *g, const grid *x, unsigned char *y, size_t y_pitch)
{
   size_t pitch = dn__reduced_z_pitch(b);
   unsigned char *z = (unsigned char *)test_aligned(g->nodes * pitch); /* exactly: sanitizers watch its end */
   dn__reduced_products(b, x->at, x->pitch, z, pitch, y, y_pitch, g->nodes);
   dn__reduced_attend(b, kernel, g, z, pitch, SIZE_MAX, y, y_pitch, 0, g->nodes);
   test_aligned_free(z);
}
/* the block in doubles, from the cells of x -> y (N,out) */
static double *block_exact(const layer *l, const ring_graph *r, const grid *x, dn__cell cell)
{
   size_t n = r->g.nodes, kf = l->heads * l->features, i, j, k, f, c, o;
   double *y = (double *)test_block((n * l->out + 1) * sizeof *y), *z = (double *)test_block((n * l->out + 1) * sizeof *z);
   for (i = 0; i < n; i++)
      for (o = 0; o < l->out; o++)
         for (z[i * l->out + o] = 0, c = 0; c < l->in; c++) z[i * l->out + o] += weight_of(l, o, c) * value_of(l, x->at + i * x->pitch, c, cell);
   for (i = 0; i < n; i++) {
      size_t count = r->first[i + 1] - r->first[i] + 1;
      for (k = 0; k < l->heads; k++) {
         double all = 0, most = -1e300, *e = (double *)test_block(count * sizeof *e);
         for (j = 0; j < count; j++) {
            size_t m = j ? r->next[r->first[i] + j - 1] : i;
            for (e[j] = 0, f = 0; f < l->features; f++)
               e[j] += (double)l->dst[k * l->features + f] * z[i * l->out + k * l->features + f] +
                  (double)l->src[k * l->features + f] * z[m * l->out + k * l->features + f];
            e[j] = act(e[j], DN_ACT_LEAKYRELU), most = fmax(most, e[j]);
         }
         for (j = 0; j < count; j++) all += e[j] = exp(e[j] - most);
         for (f = 0; f < l->features; f++) {
            double sum = 0;
            for (j = 0; j < count; j++) sum += e[j] * z[(j ? r->next[r->first[i] + j - 1] : i) * l->out + k * l->features + f];
            y[i * l->out + k * l->features + f] = sum / all;
         }
         free(e);
      }
      for (o = 0; o < l->out; o++) {
         double scale, shift, v = o < kf ? y[i * l->out + o] : z[i * l->out + o];
         dn__fold(l->norm.var ? &l->norm : NULL, o, &scale, &shift);
         y[i * l->out + o] = act(v * scale + shift, l->activation);
      }
   }
   free(z);
   return y;
}
static double gat_case(dn_kernel kernel, dn_precision precision, uint64_t *seed, size_t in, size_t heads, size_t features, size_t self,
                       size_t nodes, size_t fan)
{
   layer l = layer_make(seed, in, heads, features, self, activations[pick(seed, 0, 4)], (int)pick(seed, 0, 1));
   dn__cell from = dn__precision_cell(precision), to = pick(seed, 0, 2) ? from : DN__FLOAT;
   void *memory, *plain_memory;
   dn__reduced b = layer_pack(&l, precision, kernel, to, &memory), plain = layer_pack(&l, precision, DN_KERNEL_REF, to, &plain_memory);
   ring_graph r = random_graph(seed, nodes, nodes * 3, fan);
   grid x = grid_make(seed, nodes, in, from), y = grid_make(seed, nodes, l.out, to);
   unsigned char *want = test_copy(y.block, y.bytes + 1), *want_at = want + (y.at - y.block);
   double *exact, error = 0, size = 0;
   size_t i, o, bad = 0;
   grid_fill(seed, &x, nodes, in, from);
   block_run(&b, kernel, &r.g, &x, y.at, y.pitch);
   block_run(&plain, DN_KERNEL_REF, &r.g, &x, want_at, y.pitch);
   if (precision == DN_PRECISION_INT8) bad = memcmp(y.block, want, y.bytes) != 0;
   exact = block_exact(&l, &r, &x, from);
   for (i = 0; i < nodes; i++)
      for (o = 0; o < l.out; o++) {
         const unsigned char *p = y.at + i * y.pitch + o * dn__cell_size(to), *q = want_at + i * y.pitch + o * dn__cell_size(to);
         double a = (double)dn__read_cell(p, to), w = (double)dn__read_cell(q, to), v = exact[i * l.out + o];
         if (precision != DN_PRECISION_INT8) bad += !(fabs(a - w) <= 3e-3 + (to == DN__BF16 ? 0.012 : 2e-3) * fabs(w));
         if (to == DN__BYTE) {
            a = (a - (double)l.offset[o]) / (double)l.inverse[o];
            if (*p == 1 || *p == 255) continue;
         }
         error += (a - v) * (a - v), size += v * v;
      }
   CHECK_MSG(bad == 0, "kernel %d %s: in %lu K %lu F %lu B %lu N %lu activation %d differs from the plain text in %lu", (int)kernel,
             dn_precision_name(precision), (unsigned long)in, (unsigned long)heads, (unsigned long)features, (unsigned long)self,
             (unsigned long)nodes, (int)l.activation, (unsigned long)bad);
   for (i = 0; i < nodes; i++)
      for (o = l.out * dn__cell_size(to); i + 1 < nodes && o < y.pitch; o++) CHECK(y.at[i * y.pitch + o] == GUARD);
   for (i = 0; y.block + i < y.at; i++) CHECK(y.block[i] == GUARD);
   free(exact), free(x.block), free(y.block), free(want), free(r.first), free(r.next);
   test_aligned_free(memory), test_aligned_free(plain_memory);
   layer_free(&l);
   return size > 0 ? sqrt(error / size) : 0;
}
TEST(blocks_equal_the_plain_text)
{
   static const double bars[PRECISIONS] = { 1e-3, 8e-3, 4e-2 };
   size_t k, p, n, i, cases = 0;
   for (k = 0; k < DN_KERNEL_COUNT; k++)
      for (p = 0; dn_kernel_available((dn_kernel)k) && p < PRECISIONS; p++) {
         uint64_t seed = 11;
         double worst = 0;
         for (n = 1; n <= 17; n++, cases += 3) {
            gat_case((dn_kernel)k, precisions[p], &seed, 12, n, 5, 3, 20, 0); /* more than 8 heads: the plain text */
            gat_case((dn_kernel)k, precisions[p], &seed, 9, 3, n, n - 1, 15, 0);
            gat_case((dn_kernel)k, precisions[p], &seed, n, 8, 8, 8, n, 0);
         }
         for (i = 60; i <= 65; i++, cases++) gat_case((dn_kernel)k, precisions[p], &seed, 32, 8, 8, 8, 70, i); /* the buffer's end */
         for (i = 0; i < 12; i++, cases++) {
            double e = gat_case((dn_kernel)k, precisions[p], &seed, 200, 8, 8, 8, 60, 0);
            worst = e > worst ? e : worst;
         }
         gat_case((dn_kernel)k, precisions[p], &seed, 40, 4, 64, 256, 31, 0);
         gat_case((dn_kernel)k, precisions[p], &seed, 7, 2, 33, 0, 1, 0);
         for (i = 0; i < 20; i++, cases++)
            gat_case((dn_kernel)k, precisions[p], &seed, pick(&seed, 1, 50), pick(&seed, 1, 10), pick(&seed, 1, 35), pick(&seed, 0, 40), pick(&seed, 1, 60), 0);
         printf("   %s %s: a block of 200 columns is off by at most %.2e of its size\n", dn_kernel_name((dn_kernel)k), dn_precision_name(precisions[p]), worst);
         CHECK_MSG(worst < bars[p], "kernel %lu %s: %.2e", (unsigned long)k, dn_precision_name(precisions[p]), worst);
      }
   AT_LEAST(cases, 250, "blocks");
}
/* z in a ring of rows, y in pieces: the bits of the whole */
TEST(a_ring_of_z_gives_the_same_bits)
{
   size_t k, p, cases = 0;
   for (k = 0; k < DN_KERNEL_COUNT; k++)
      for (p = 0; dn_kernel_available((dn_kernel)k) && p < PRECISIONS; p++, cases++) {
         uint64_t seed = 5;
         size_t n = 96, i, pitch, at;
         layer l = layer_make(&seed, 24, 8, 8, 8, DN_ACT_TANHSHRINK, 1);
         void *memory;
         dn__cell cell = dn__precision_cell(precisions[p]);
         dn__reduced b = layer_pack(&l, precisions[p], (dn_kernel)k, cell, &memory);
         uint32_t first[97], next[2 * 96];
         dn_graph g;
         grid x = grid_make(&seed, n, 24, cell), y = grid_make(&seed, n, l.out, cell);
         unsigned char *want = test_copy(y.block, y.bytes + 1), *ring;
         for (i = at = 0; i < n; i++) { /* a chain: neighbours at most one away */
            first[i] = (uint32_t)at;
            if (i) next[at++] = (uint32_t)i - 1;
            if (i + 1 < n) next[at++] = (uint32_t)i + 1;
         }
         first[n] = (uint32_t)at;
         g.nodes = n, g.first = first, g.next = next;
         grid_fill(&seed, &x, n, 24, cell);
         block_run(&b, (dn_kernel)k, &g, &x, want + (y.at - y.block), y.pitch);
         pitch = dn__reduced_z_pitch(&b);
         ring = (unsigned char *)test_aligned(32 * pitch);
         for (i = 0; i < n; i += 16) { /* 16 rows of z, then the 16 nodes before the last */
            size_t begin = i ? i - 1 : 0, end = i + 16 == n ? n : i + 15;
            dn__reduced_products(&b, x.at + i * x.pitch, x.pitch, ring + (i & 31) * pitch, pitch, y.at + i * y.pitch, y.pitch, 16);
            dn__reduced_attend(&b, (dn_kernel)k, &g, ring, pitch, 31, y.at + begin * y.pitch, y.pitch, begin, end);
         }
         CHECK_MSG(memcmp(y.block, want, y.bytes) == 0, "kernel %lu %s", (unsigned long)k, dn_precision_name(precisions[p]));
         test_aligned_free(ring), test_aligned_free(memory);
         free(x.block), free(y.block), free(want);
         layer_free(&l);
      }
   AT_LEAST(cases, 3, "kernels");
}

/* --- networks: small ones of every architecture, float32 beside the others */
typedef struct seen { /* what the taps of a float32 run saw: ends of every column */
   struct { char name[64]; size_t width; float least[256], most[256]; } at[32];
   size_t count, rows, bad;
} seen;
static void see(void *user, const char *name, const float *rows, size_t first, size_t count, size_t width, size_t stride)
{
   seen *s = (seen *)user;
   size_t k, i, c;
   (void)first;
   for (k = 0; k < s->count && strcmp(s->at[k].name, name) != 0; k++) {}
   if (k == 32 || width > 256) { s->bad++; return; }
   if (k == s->count) {
      s->count++;
      strcpy(s->at[k].name, name);
      s->at[k].width = width;
      for (c = 0; c < width; c++) s->at[k].least[c] = 1e30f, s->at[k].most[c] = -1e30f;
   }
   s->rows += count;
   for (i = 0; i < count; i++)
      for (c = 0; c < width; c++) {
         float x = rows[i * stride + c];
         if (!test_finite(x)) s->bad++;
         s->at[k].least[c] = fminf(s->at[k].least[c], x), s->at[k].most[c] = fmaxf(s->at[k].most[c], x);
      }
}
static void split(void *user, size_t count, size_t grain, dn_range_fn *fn, void *job) /* from the end, a grain at a time */
{
   size_t begin = count / grain * grain, worker = 0;
   (void)user;
   if (begin == count) begin -= grain;
   for (;; begin -= grain, worker++) {
      fn(job, begin, begin + grain < count ? begin + grain : count, (unsigned)(worker % 3));
      if (begin == 0) break;
   }
}
/* displacements (TUBE_V,3) of the tube, bent by `bend`; 0: it failed, and e says why */
static int run_tube(const dn_model *m, float bend, const dn_probe *probe, int workers, float *out, dn_error *e)
{
   tube t;
   dn_rig *rig;
   dn_pose pose;
   dn_output output;
   dn_parallel par;
   size_t bytes, i;
   void *scratch;
   dn_result r;
   tube_make(&t);
   for (i = 0; i < 2; i++) t.palette[12 * (i + 1) + 3] += 0.1f * bend, t.palette[12 * (i + 1) + 7] += 0.05f * bend;
   rig = dn_rig_create(m, &t.desc, NULL, NULL, e);
   if (!rig) return 0;
   memset(&pose, 0, sizeof pose);
   memset(&output, 0, sizeof output);
   memset(&par, 0, sizeof par);
   par.run = split, par.workers = 3;
   pose.palette = t.palette, pose.matrix = DN_3X4_ROWS, pose.strength = 1;
   output.displacement = out;
   bytes = dn_scratch_size(rig, 3);
   scratch = test_aligned(bytes);
   memset(scratch, 0xa5, bytes);
   r = dn_stage_skin(rig, &pose, scratch, bytes, workers ? &par : NULL, e);
   if (r == DN_OK) {
      dn_stage_rows(rig, scratch, workers ? &par : NULL);
      dn_stage_network(rig, scratch, workers ? &par : NULL, probe);
      r = dn_stage_output(rig, &pose, &output, scratch, workers ? &par : NULL, e);
   }
   test_aligned_free(scratch);
   dn_rig_free(rig);
   return r == DN_OK;
}
static dn_model *load(const unsigned char *file, size_t size, dn_precision precision, dn_kernel kernel, dn_error *e)
{
   dn_model_options o;
   memset(&o, 0, sizeof o);
   memset(e, 0, sizeof *e);
   o.precision = precision, o.kernel = kernel;
   return dn_model_load(file, size, &o, NULL, e);
}
/* the file with a range for each name that was seen; but `not`, if that is one of them, gets these numbers, or none */
static unsigned char *with_ranges(const unsigned char *file, size_t size, const seen *s, const char *not, const float *numbers,
                                  size_t rows, size_t width, size_t *joined)
{
   uint64_t length = 0;
   size_t k, c, at, used, bytes;
   char *header = (char *)test_block(65536);
   unsigned char *data, *out;
   for (k = 8; k > 0; k--) length = length << 8 | file[k - 1];
   bytes = size - 8 - (size_t)length;
   data = (unsigned char *)test_block(bytes + 32 * 2 * 256 * 4);
   memcpy(data, file + 8 + length, bytes);
   memcpy(header, file + 8, (size_t)length);
   for (used = (size_t)length; header[used - 1] != '}'; used--) {}
   used--;
   for (k = 0; k < s->count; k++) {
      int other = not && strcmp(not, s->at[k].name) == 0;
      size_t r = other ? rows : 2, w = other ? width : s->at[k].width;
      if (r == 0) continue;
      used += (size_t)snprintf(header + used, 65536 - used, ",\"%s.range\":{\"dtype\":\"F32\",\"shape\":[%lu,%lu],\"data_offsets\":[%lu,%lu]}",
                               s->at[k].name, (unsigned long)r, (unsigned long)w, (unsigned long)bytes, (unsigned long)(bytes + 4 * r * w));
      for (c = 0; c < r * w; c++) {
         float x = other ? numbers[c] : c < w ? s->at[k].least[c] - 1e-3f : s->at[k].most[c - w] + 1e-3f;
         uint32_t u = bits(x);
         for (at = 0; at < 4; at++) data[bytes++] = (unsigned char)(u >> (8 * at));
      }
   }
   header[used++] = '}';
   header[used] = 0;
   out = tiny_join(header, 0, data, bytes, joined);
   free(header), free(data);
   return out;
}
static const float bends[] = { 0, 0.5f, -0.7f, 1 };
static unsigned char *calibrated(const unsigned char *file, size_t size, seen *s, const char *not, const float *numbers, size_t rows,
                                 size_t width, size_t *joined)
{
   float out[TUBE_V * 3];
   dn_error e;
   dn_probe probe;
   size_t i;
   dn_model *m = load(file, size, DN_PRECISION_F32, DN_KERNEL_AUTO, &e);
   memset(s, 0, sizeof *s);
   memset(&probe, 0, sizeof probe);
   probe.tap = see, probe.user = s;
   for (i = 0; m && i < sizeof bends / sizeof *bends; i++) CHECK_MSG(run_tube(m, bends[i], &probe, 0, out, &e), "%s", e.info);
   CHECK(m && s->count > 1 && s->bad == 0);
   dn_model_free(m);
   return with_ranges(file, size, s, not, numbers, rows, width, joined);
}
typedef unsigned char *maker(size_t *size);
static unsigned char *multires_rest(size_t *size) { return tiny_multires("geodesic", "rest", size); }
static unsigned char *multires_dynamic(size_t *size) { return tiny_multires("distance", "dynamic", size); }
static unsigned char *gats(size_t *size) { return tiny_gats("gat", size); }
static unsigned char *neuroskinning(size_t *size) { return tiny_gats("neuroskinning", size); }
/* tiny_dense with its blocks' weights made smaller: as they are, its rows grow to 1e10 */
static unsigned char *dense(size_t *size)
{
   unsigned char *file = tiny_dense(size);
   size_t bytes, i, k;
   dn_error e;
   dn_tensors *t;
   void *memory;
   if (!CHECK(dn_tensors_size(file, *size, &bytes, &e) == DN_OK)) return file;
   memory = test_aligned(bytes);
   CHECK(dn_tensors_open(file, *size, memory, bytes, &t, &e) == DN_OK);
   for (i = 0; i < dn_tensors_count(t); i++) {
      const dn_tensor *w = dn_tensors_at(t, i);
      if ((strncmp(w->name, "dense.", 6) != 0 && strncmp(w->name, "transition.", 11) != 0) || !strstr(w->name, ".weight") || strstr(w->name, ".bn."))
         continue;
      for (k = 0; k < w->count; k++) {
         unsigned char *at = file + (w->data - file) + 4 * k;
         float x = of_bits(at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24) * 0.42f;
         uint32_t u = bits(x);
         at[0] = (unsigned char)u, at[1] = (unsigned char)(u >> 8), at[2] = (unsigned char)(u >> 16), at[3] = (unsigned char)(u >> 24);
      }
   }
   test_aligned_free(memory);
   return file;
}
static unsigned char *cloth(size_t *size) { return tiny_cloth("rest", size); }
static unsigned char *garfit(size_t *size) { return tiny_garfit("dynamic", size); }
static const struct { const char *name; maker *make; double bar[PRECISIONS]; } nets[] = {
   { "mlp", tiny_mlp, { 1e-6, 1e-6, 1e-6 } }, /* all of its layers are first ones, or the last */
   { "gat", gats, { 1e-3, 0.01, 0.05 } },
   { "neuroskinning", neuroskinning, { 1e-3, 0.01, 0.05 } },
   { "densegats", dense, { 2e-3, 0.02, 0.1 } },
   { "multiresgnet, rest", multires_rest, { 2e-3, 0.02, 0.1 } },
   { "multiresgnet, dynamic", multires_dynamic, { 2e-3, 0.02, 0.1 } }
};
TEST(networks_stay_near_float32)
{
   size_t n, p, i, c, cases = 0;
   int k;
   for (n = 0; n < sizeof nets / sizeof *nets; n++) {
      size_t size, joined;
      unsigned char *file = nets[n].make(&size), *both;
      static seen ranges, again;
      dn_error e;
      dn_model *plain = load(file, size, DN_PRECISION_F32, DN_KERNEL_AUTO, &e);
      both = calibrated(file, size, &ranges, NULL, NULL, 0, 0, &joined);
      for (p = 0; p < PRECISIONS; p++) {
         double worst = 0;
         for (k = 0; k < DN_KERNEL_COUNT; k++) {
            double off = 0, all = 0;
            dn_model *m;
            dn_model_info info;
            if (!dn_kernel_available((dn_kernel)k)) continue;
            m = load(both, joined, precisions[p], (dn_kernel)k, &e);
            if (!CHECK_MSG(m != NULL, "%s %s: %s", nets[n].name, dn_precision_name(precisions[p]), e.info)) continue;
            dn_model_describe(m, &info);
            CHECK(info.precision == precisions[p] && info.kernel == (dn_kernel)k);
            memset(&again, 0, sizeof again);
            for (i = 0; i < sizeof bends / sizeof *bends; i++) {
               float a[TUBE_V * 3], b[TUBE_V * 3], shown[TUBE_V * 3], parts[TUBE_V * 3];
               dn_probe probe;
               memset(&probe, 0, sizeof probe);
               probe.tap = see, probe.user = &again;
               if (!CHECK_MSG(run_tube(plain, bends[i], NULL, 0, a, &e) && run_tube(m, bends[i], NULL, 0, b, &e) &&
                              run_tube(m, bends[i], &probe, 0, shown, &e) && run_tube(m, bends[i], NULL, 1, parts, &e), "%s", e.info)) break;
               CHECK_MSG(memcmp(b, shown, sizeof b) == 0, "%s %s: a probe changes what comes out", nets[n].name, dn_precision_name(precisions[p]));
               CHECK_MSG(memcmp(b, parts, sizeof b) == 0, "%s %s: ranges change what comes out", nets[n].name, dn_precision_name(precisions[p]));
               for (c = 0; c < TUBE_V; c++) {
                  double d[3], v[3];
                  size_t x;
                  for (x = 0; x < 3; x++) d[x] = (double)b[3 * c + x] - (double)a[3 * c + x], v[x] = (double)a[3 * c + x];
                  off += sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
                  all += sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
               }
            }
            cases++;
            CHECK(again.count == ranges.count && again.rows == ranges.rows && again.bad == 0); /* the same taps, of the same rows */
            for (i = 0; i < again.count; i++) CHECK(strcmp(again.at[i].name, ranges.at[i].name) == 0 && again.at[i].width == ranges.at[i].width);
            worst = fmax(worst, off / all);
            CHECK_MSG(off > 0 || n == 0, "%s %s is float32 to the bit", nets[n].name, dn_precision_name(precisions[p]));
            dn_model_free(m);
         }
         printf("   %-22s %-4s off by %.2e of the mean displacement\n", nets[n].name, dn_precision_name(precisions[p]), worst);
         CHECK_MSG(worst < nets[n].bar[p], "%s %s: %.2e", nets[n].name, dn_precision_name(precisions[p]), worst);
      }
      dn_model_free(plain);
      free(file), free(both);
   }
   AT_LEAST(cases, sizeof nets / sizeof *nets * PRECISIONS, "runs");
}
TEST(garments_have_half_weights_and_no_less)
{
   static maker *const makers[] = { tiny_coarse, garfit, cloth };
   size_t n, size, cases = 0;
   int k;
   dn_error e;
   unsigned char *file;
   for (n = 0; n < 3; n++) {
      float a[TUBE_V * 3], b[TUBE_V * 3];
      dn_model *plain;
      tube t;
      file = makers[n](&size);
      plain = load(file, size, DN_PRECISION_F32, DN_KERNEL_AUTO, &e);
      tube_make(&t);
      if (!CHECK_MSG(plain && tiny_wear(plain, &t, a, NULL, NULL, &e) == DN_OK, "%s", e.info)) continue;
      for (k = 0; k < DN_KERNEL_COUNT; k++) {
         double worst = 0;
         size_t i;
         dn_model *m = dn_kernel_available((dn_kernel)k) ? load(file, size, DN_PRECISION_F16, (dn_kernel)k, &e) : NULL;
         if (!m) continue;
         CHECK_MSG(tiny_wear(m, &t, b, NULL, NULL, &e) == DN_OK, "%s", e.info);
         for (i = 0; i < TUBE_V * 3; i++) worst = fmax(worst, fabs((double)a[i] - (double)b[i]));
         CHECK_MSG(worst > 0 && worst < 5e-3, "kernel %d, network %lu: %.2e", k, (unsigned long)n, worst);
         cases++;
         dn_model_free(m);
      }
      dn_model_free(plain);
      CHECK(!load(file, size, DN_PRECISION_BF16, DN_KERNEL_AUTO, &e) && e.code == DN_UNSUPPORTED && strstr(e.info, "bf16") && strstr(e.info, "f16"));
      CHECK(!load(file, size, DN_PRECISION_INT8, DN_KERNEL_AUTO, &e) && e.code == DN_UNSUPPORTED && strstr(e.info, "int8"));
      free(file);
   }
   file = tiny_blend(&size);
   CHECK(!load(file, size, DN_PRECISION_F16, DN_KERNEL_AUTO, &e) && e.code == DN_UNSUPPORTED && strstr(e.info, "neuralblendshapes"));
   free(file);
   AT_LEAST(cases, 3, "garments");
}
TEST(ranges_that_make_no_sense_are_refused)
{
   static const char *const names[] = { "pre.1", "local.0", "local.1", "pool", "global.0", "unpool", "global.2", "post.0" };
   size_t n, k, c, cases = 0, size, joined;
   unsigned char *file = multires_rest(&size), *both;
   static seen s;
   dn_error e;
   dn_model *m;
   CHECK(!load(file, size, DN_PRECISION_INT8, DN_KERNEL_AUTO, &e) && e.code == DN_MISSING_TENSOR && strstr(e.info, "pre.1.range") && strstr(e.info, "calibrate"));
   for (n = 0; n < sizeof names / sizeof *names; n++)
      for (k = 0; k < 9; k++, cases++) {
         float numbers[2 * 260];
         size_t rows = 2, width;
         int good = 0;
         free(calibrated(file, size, &s, NULL, NULL, 0, 0, &joined));
         for (c = 0; c < s.count && strcmp(s.at[c].name, names[n]) != 0; c++) {}
         if (!CHECK(c < s.count)) continue;
         width = s.at[c].width;
         for (c = 0; c < width; c++) numbers[c] = -1, numbers[width + c] = 1;
         switch (k) {
         case 0: rows = 0; break;                                              /* not there */
         case 1: width--; break;                                               /* too narrow */
         case 2: rows = 1; break;                                              /* the least alone */
         case 3: numbers[width - 1] = of_bits(0x7fc00000u); break;             /* NaN */
         case 4: numbers[width] = of_bits(0x7f800000u); break;                 /* infinite */
         case 5: numbers[0] = 2; break;                                        /* least above most */
         case 6: numbers[0] = numbers[width] = 0.5f; break;                    /* no width */
         case 7: numbers[0] = 1e6f, numbers[width] = of_bits(bits(1e6f) + 1); break; /* a width that rounding swallows */
         default:
            numbers[0] = -3.4e38f, numbers[width] = 3.4e38f; /* as wide as floats go: allowed */
            good = 1;
         }
         both = with_ranges(file, size, &s, names[n], numbers, rows, width, &joined);
         m = load(both, joined, DN_PRECISION_INT8, DN_KERNEL_AUTO, &e);
         CHECK_MSG((m != NULL) == (good != 0), "%s case %lu: %s", names[n], (unsigned long)k, e.info);
         if (!m) CHECK_MSG(strstr(e.info, names[n]) && strstr(e.info, ".range"), "%s case %lu: %s", names[n], (unsigned long)k, e.info);
         if (!m) CHECK(e.code == (k == 0 ? DN_MISSING_TENSOR : k < 3 ? DN_BAD_SHAPE : DN_BAD_VALUE));
         if (m) {
            float out[TUBE_V * 3];
            (void)run_tube(m, 1, NULL, 0, out, &e);
            for (c = 0; c < TUBE_V * 3; c++) CHECK(test_finite(out[c]));
         }
         dn_model_free(m);
         m = load(both, joined, DN_PRECISION_BF16, DN_KERNEL_AUTO, &e); /* which has no use for ranges */
         CHECK_MSG(m != NULL, "%s", e.info);
         dn_model_free(m);
         free(both);
      }
   free(file);
   AT_LEAST(cases, 72, "files");
}

int main(int argc, char **argv)
{
   TEST_BEGIN(argc, argv);
   RUN(halves_and_bfloat16s_round_to_the_nearest_even);
   RUN(exp_and_tanh_are_near);
   RUN(every_kernel_finishes_with_the_same_bits);
   RUN(products_equal_the_plain_text);
   RUN(whole_sums_are_exact_at_the_extremes);
   RUN(blocks_equal_the_plain_text);
   RUN(a_ring_of_z_gives_the_same_bits);
   RUN(networks_stay_near_float32);
   RUN(garments_have_half_weights_and_no_less);
   RUN(ranges_that_make_no_sense_are_refused);
   return TEST_END();
}
