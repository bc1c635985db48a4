/*  kernels.c - every kernel this machine runs against the plain text, and the plain text against double precision

    shows   exp and tanh over their ranges; products and attention on random shapes with tails, strides and misaligned
            pointers, nothing written outside; what sums of up to 12288 terms and batch norms lose to rounding; dense
            modules; any split over threads gives the same bits
    build   cc -O2 kernels.c -o kernels -lm */
#define DEFORMNET_IMPLEMENTATION
#define DEFORMNET_STATIC
#include "../deformnet.h"
#include "test.h"
#include <math.h>

#define GUARD 12345.5f /* written around every output; must still be there afterwards */
static const dn_activation all_activations[] = { DN_ACT_NONE, DN_ACT_TANH, DN_ACT_RELU, DN_ACT_LEAKYRELU,
                                                 DN_ACT_TANHSHRINK, DN_ACT_SOFTMAX };

static int is_nan(float x) /* by its bits, as test_finite */
{
   uint32_t u;
   memcpy(&u, &x, 4);
   return (u & 0x7fffffffu) > 0x7f800000u;
}
static size_t pick(uint64_t *seed, size_t low, size_t high) { return low + test_random(seed) % (high - low + 1); }
static float *random_floats(uint64_t *seed, size_t count, float size)
{
   float *p = (float *)test_block(count * sizeof(float));
   size_t i;
   for (i = 0; i < count; i++) p[i] = test_uniform(seed, -size, size);
   return p;
}
static int close_to(double a, double b) { return fabs(a - b) <= 1e-5 + 1e-4 * fabs(b); } /* false for NaN */
static int same_bits(const void *a, const void *b, size_t size) { return memcmp(a, b, size) == 0; }
/* (rows,width) of a against b where both have `stride` floats a row; whatever lies between the rows is GUARD */
static size_t rows_differ(const float *a, const float *b, size_t rows, size_t width, size_t stride)
{
   size_t r, c, bad = 0;
   for (r = 0; r < rows; r++)
      for (c = 0; c < stride; c++)
         bad += c < width ? !close_to((double)a[r * stride + c], (double)b[r * stride + c])
                          : a[r * stride + c] != GUARD;
   return bad;
}
static void fill(float *p, size_t count, float value)
{
   while (count) p[--count] = value;
}

/* --- exp and tanh. Each value goes through a whole row of the kernel's own text. */
static double ulp_of(double x) /* of the float nearest to x */
{
   int e;
   frexp(x, &e);
   return ldexp(1.0, (e < -125 ? -125 : e) - 24);
}
static void activate_by(dn_kernel kernel, float *row, dn_activation activation) /* 16 numbers */
{
   const dn__kernel *k = dn__kernel_of(kernel);
   size_t i;
   if (k) k->activate(row, 16, row, 16, 1, 16, activation);
   else
      for (i = 0; i < 16; i++) row[i] = dn__activate(row[i], activation);
}
static void activate_against_libm(dn_kernel kernel)
{
   double tanh_error = 0, shrink_error = 0, x;
   float row[16], shrunk[16], before = -2;
   size_t i, drops = 0, checked = 0, bad = 0;
   for (x = -12; x < 12; x += 16 * 0.00073) {
      for (i = 0; i < 16; i++) row[i] = shrunk[i] = (float)(x + 0.00073 * (double)i);
      activate_by(kernel, row, DN_ACT_TANH);
      activate_by(kernel, shrunk, DN_ACT_TANHSHRINK);
      for (i = 0; i < 16; i++, checked++) {
         double at = (double)(float)(x + 0.00073 * (double)i), t = tanh(at);
         double e = fabs((double)row[i] - t), s = fabs((double)shrunk[i] - (at - t));
         if (!(e <= 1e-7)) bad++;
         if (!(s <= 1e-7 + 6e-8 * fabs(at))) bad++;
         if (e > tanh_error) tanh_error = e;
         if (s > shrink_error) shrink_error = s;
         if (row[i] < before - 1.2e-7f) drops++;
         before = row[i];
      }
   }
   printf("   kernel %d: tanh within %.2e, x - tanh x within %.2e\n", (int)kernel, tanh_error, shrink_error);
   CHECK_MSG(bad == 0, "kernel %d: %lu values off", (int)kernel, (unsigned long)bad);
   CHECK_MSG(drops == 0, "kernel %d: tanh falls %lu times", (int)kernel, (unsigned long)drops);
   AT_LEAST(checked, 30000, "values");
}
TEST(tanh_is_within_its_bound)
{
   int k;
   for (k = 0; k < DN_KERNEL_COUNT; k++)
      if (dn_kernel_available((dn_kernel)k)) activate_against_libm((dn_kernel)k);
}
TEST(tanhshrink_keeps_the_digits_of_small_numbers)
{
   int k;
   size_t i, checked = 0;
   for (k = 0; k < DN_KERNEL_COUNT; k++) {
      double size;
      if (!dn_kernel_available((dn_kernel)k)) continue;
      for (size = 1e-9; size < 0.9; size *= 1.7) {
         float row[16];
         for (i = 0; i < 16; i++) row[i] = (float)((i & 1 ? -size : size) * (1 + (double)i / 16));
         activate_by((dn_kernel)k, row, DN_ACT_TANHSHRINK);
         for (i = 0; i < 16; i++, checked++) {
            double at = (double)(float)((i & 1 ? -size : size) * (1 + (double)i / 16)), z = at * at;
            /* long series below 0.1, where x - tanh x would itself cancel in double */
            double truth = fabs(at) < 0.1 ? at * z * (1 / 3.0 - z * (2 / 15.0 - z * (17 / 315.0 - z * 62 / 2835.0)))
                                          : at - tanh(at);
            double tolerance = fabs(truth) * (fabs(at) < 0.6 ? 5e-7 : 2e-6) + 1e-44;
            CHECK_MSG(fabs((double)row[i] - truth) <= tolerance, "kernel %d: x = %g gives %g, not %g", k, at,
                      (double)row[i], truth);
         }
      }
   }
   AT_LEAST(checked, 600, "values");
}
TEST(activations_at_their_corners)
{
   int k;
   uint32_t bits = 0x7fc00001u;
   float nan_value, infinite;
   memcpy(&nan_value, &bits, 4);
   bits = 0x7f800000u;
   memcpy(&infinite, &bits, 4);
   for (k = 0; k < DN_KERNEL_COUNT; k++) {
      size_t a, i;
      if (!dn_kernel_available((dn_kernel)k)) continue;
      for (a = 0; a < 5; a++) {
         float row[16] = { 0 };
         row[1] = -0.0f, row[2] = 9.5f, row[3] = -9.5f, row[4] = 1e30f, row[5] = -1e30f, row[6] = nan_value;
         row[7] = infinite, row[8] = -infinite;
         activate_by((dn_kernel)k, row, all_activations[a]);
         CHECK(row[0] == 0 && row[1] == 0);
         CHECK(is_nan(row[6]));
         for (i = 9; i < 16; i++) CHECK(row[i] == 0);
         switch (all_activations[a]) {
         case DN_ACT_TANH:
            CHECK(row[2] == 1 && row[3] == -1 && row[4] == 1 && row[5] == -1 && row[7] == 1 && row[8] == -1);
            break;
         case DN_ACT_RELU: CHECK(row[2] == 9.5f && row[3] == 0 && row[7] == infinite && row[8] == 0); break;
         case DN_ACT_LEAKYRELU: CHECK(row[2] == 9.5f && close_to((double)row[3], -1.9) && row[8] == -infinite); break;
         case DN_ACT_TANHSHRINK:
            CHECK(row[2] == 8.5f && row[3] == -8.5f && row[7] == infinite && row[8] == -infinite);
            break;
         default: CHECK(row[2] == 9.5f && close_to((double)row[5], -1e30) && row[8] == -infinite);
         }
      }
   }
}
TEST(exp_is_within_one_ulp)
{
   double worst = 0, x;
   size_t checked = 0;
   for (x = -87.3; x < 88; x += 0.0007, checked++) {
      float at = (float)x;
      double truth = exp((double)at), e;
      if ((double)at < -87.3 || at > 88.0f) continue;
      e = fabs((double)dn__exp(at) - truth) / ulp_of(truth);
      if (e > worst) worst = e;
   }
   printf("   exp within %.2f ulp\n", worst);
   CHECK(worst <= 1);
   CHECK(dn__exp(0) == 1 && dn__exp(-0.0f) == 1);
   CHECK(dn__exp(-1e30f) > 0 && dn__exp(-1e30f) < 1.3e-38f && dn__exp(1e30f) > 1e38f);
   AT_LEAST(checked, 200000, "values");
}

/* --- products */
static void linear_case(dn_kernel kernel, uint64_t *seed, size_t in, size_t out, size_t rows, size_t x_off,
                        size_t y_off, dn_activation activation, int with_bn)
{
   size_t x_stride = in + pick(seed, 0, 5), y_stride = out + pick(seed, 0, 5), i;
   float *w = random_floats(seed, out * in, 0.4f), *b = random_floats(seed, out, 1);
   float *x = random_floats(seed, rows * x_stride + x_off, 1.5f);
   float *y = (float *)test_block((rows * y_stride + y_off) * 4);
   float *want = (float *)test_block((rows * y_stride + y_off) * 4);
   float *bn_values = random_floats(seed, 4 * out, 0.5f), *add = random_floats(seed, rows * out, 0.7f);
   void *memory = test_aligned(dn_linear_size(in, out));
   dn_batchnorm bn;
   dn_linear l;
   bn.weight = bn_values, bn.bias = bn_values + out, bn.mean = bn_values + 2 * out, bn.var = bn_values + 3 * out;
   for (i = 0; i < out; i++) bn_values[3 * out + i] += 0.6f;
   dn_linear_pack(&l, in, out, w, b, with_bn ? &bn : NULL, activation, memory);
   l.kernel = kernel;
   if (pick(seed, 0, 1)) l.add = add;
   fill(y, rows * y_stride + y_off, GUARD);
   fill(want, rows * y_stride + y_off, GUARD);
   dn_linear_ref(&l, x + x_off, x_stride, rows, want + y_off, y_stride);
   dn_linear_run(&l, x + x_off, x_stride, rows, y + y_off, y_stride, NULL);
   CHECK_MSG(rows_differ(y + y_off, want + y_off, rows, out, y_stride) == 0,
             "kernel %d: in %lu out %lu rows %lu activation %d differs from the reference", (int)kernel,
             (unsigned long)in, (unsigned long)out, (unsigned long)rows, (int)activation);
   for (i = 0; i < y_off; i++) CHECK(y[i] == GUARD);
   test_aligned_free(memory);
   free(w), free(b), free(x), free(y), free(want), free(bn_values), free(add);
}
TEST(products_equal_the_reference)
{
   int k;
   size_t cases = 0;
   for (k = 0; k < DN_KERNEL_COUNT; k++) {
      uint64_t seed = 7;
      size_t n, i;
      if (!dn_kernel_available((dn_kernel)k)) continue;
      for (n = 0; n <= 17; n++) { /* each tail of each side */
         linear_case((dn_kernel)k, &seed, n + 1, 19, 15, n % 4, n % 5, all_activations[n % 6], 0), cases++;
         linear_case((dn_kernel)k, &seed, 20, n + 1, 29, n % 3, n % 4, all_activations[(n + 1) % 6], 1), cases++;
         linear_case((dn_kernel)k, &seed, 9, 33, n + (n == 0), n % 5, n % 3, all_activations[(n + 2) % 6], 1), cases++;
         linear_case((dn_kernel)k, &seed, 33, 32 + n, 28 + n, n % 2, 0, DN_ACT_TANH, 0), cases++;
         linear_case((dn_kernel)k, &seed, 64 + n, 48 + n, 84 + n, n % 7, n % 9, all_activations[(n + 5) % 6], 1), cases++;
      }
      for (i = 0; i < 60; i++, cases++)
         linear_case((dn_kernel)k, &seed, pick(&seed, 1, 130), pick(&seed, 1, 130), pick(&seed, 1, 70),
                     pick(&seed, 0, 15), pick(&seed, 0, 15), all_activations[pick(&seed, 0, 5)], (int)pick(&seed, 0, 1));
   }
   AT_LEAST(cases, 132, "shapes");
}
/* whether a row stands alone, among a few or among many: the same bits */
TEST(a_row_does_not_depend_on_the_others)
{
   enum { IN = 45, ROWS = 103 };
   static const size_t outs[] = { 3, 16, 32, 41, 88 };
   int k;
   size_t cases = 0;
   for (k = 0; k < DN_KERNEL_COUNT; k++) {
      uint64_t seed = 61;
      size_t o, r, i, count;
      if (!dn_kernel_available((dn_kernel)k)) continue;
      for (o = 0; o < sizeof outs / sizeof *outs; o++) {
         size_t out = outs[o];
         float *w = random_floats(&seed, out * IN, 0.4f), *b = random_floats(&seed, out, 1);
         float *x = random_floats(&seed, ROWS * IN, 1.5f);
         float *all = (float *)test_block(ROWS * out * 4), *few = (float *)test_block(ROWS * out * 4);
         void *memory = test_aligned(dn_linear_size(IN, out));
         dn_linear l;
         dn_linear_pack(&l, IN, out, w, b, NULL, DN_ACT_TANHSHRINK, memory);
         l.kernel = (dn_kernel)k;
         dn_linear_run(&l, x, IN, ROWS, all, out, NULL);
         for (count = 1; count <= 17; count++, cases++) {
            for (r = 0; r < ROWS; r += i) {
               i = ROWS - r < count ? ROWS - r : count;
               dn_linear_run(&l, x + r * IN, IN, i, few + r * out, out, NULL);
            }
            CHECK_MSG(same_bits(all, few, ROWS * out * 4), "kernel %d: %lu columns by %lu rows", k, (unsigned long)out,
                      (unsigned long)count);
         }
         test_aligned_free(memory);
         free(w), free(b), free(x), free(all), free(few);
      }
   }
   AT_LEAST(cases, 85, "ways to cut");
}
TEST(the_reference_is_the_definition)
{
   uint64_t seed = 11;
   size_t n, o, c, r;
   for (n = 0; n < 40; n++) {
      size_t in = pick(&seed, 1, 60), out = pick(&seed, 1, 60), rows = pick(&seed, 1, 5);
      float *w = random_floats(&seed, in * out, 0.5f), *x = random_floats(&seed, rows * in, 1);
      float *q = random_floats(&seed, 5 * out, 1), *add = random_floats(&seed, rows * out, 1);
      float *y = (float *)test_block(rows * out * 4);
      void *memory = test_aligned(dn_linear_size(in, out));
      dn_batchnorm bn;
      dn_linear l;
      bn.weight = q, bn.bias = q + out, bn.mean = q + 2 * out, bn.var = q + 3 * out;
      for (o = 0; o < out; o++) q[3 * out + o] = q[3 * out + o] * q[3 * out + o];
      dn_linear_pack(&l, in, out, w, q + 4 * out, &bn, DN_ACT_LEAKYRELU, memory);
      if (n % 2) l.add = add;
      dn_linear_ref(&l, x, in, rows, y, out);
      for (r = 0; r < rows; r++)
         for (o = 0; o < out; o++) {
            double u = (double)q[4 * out + o], scale;
            for (c = 0; c < in; c++) u += (double)w[o * in + c] * (double)x[r * in + c];
            scale = (double)bn.weight[o] / sqrt((double)bn.var[o] + 1e-5);
            u = (u - (double)bn.mean[o]) * scale + (double)bn.bias[o] + (n % 2 ? (double)add[r * out + o] : 0.0);
            /* terms that cancel leave the rounding of their sizes */
            CHECK(fabs((double)y[r * out + o] - (u < 0 ? 0.2 * u : u)) <= 1e-5 + 1e-4 * fabs(u) + 2e-6 * fabs(scale));
         }
      test_aligned_free(memory);
      free(w), free(x), free(q), free(y), free(add);
   }
}
/* Terms added one after another in float lose more the more they are: 7 units at 504 terms, 34 at 12288. The unit is
   2^-24 sqrt(sum (w x)^2), the rounding of one number of the sum's size. */
static double sum_error(dn_kernel kernel, uint64_t *seed, size_t in)
{
   enum { OUT = 19, ROWS = 31 };
   float *w = random_floats(seed, OUT * in, 1), *x = random_floats(seed, ROWS * in, 1), y[ROWS * OUT];
   void *memory = test_aligned(dn_linear_size(in, OUT));
   double square = 0;
   dn_linear l;
   size_t r, o, c;
   dn_linear_pack(&l, in, OUT, w, NULL, NULL, DN_ACT_NONE, memory);
   l.kernel = kernel;
   dn_linear_run(&l, x, in, ROWS, y, OUT, NULL);
   for (r = 0; r < ROWS; r++)
      for (o = 0; o < OUT; o++) {
         double sum = 0, size = 0, error;
         for (c = 0; c < in; c++) {
            double term = (double)w[o * in + c] * (double)x[r * in + c];
            sum += term;
            size += term * term;
         }
         error = ((double)y[r * OUT + o] - sum) / ldexp(sqrt(size), -24);
         square += error * error;
      }
   test_aligned_free(memory);
   free(w), free(x);
   return sqrt(square / (ROWS * OUT));
}
TEST(long_sums_round_little)
{
   static const size_t widths[] = { 72, 504, 1024, 4096, 12288 };
   int k;
   for (k = 0; k < DN_KERNEL_COUNT; k++) {
      uint64_t seed = 101;
      size_t i;
      if (!dn_kernel_available((dn_kernel)k)) continue;
      printf("   kernel %d:", k);
      for (i = 0; i < sizeof widths / sizeof *widths; i++) {
         double e = sum_error((dn_kernel)k, &seed, widths[i]);
         printf(" %lu terms %.2f", (unsigned long)widths[i], e);
         CHECK_MSG(e < 2.5, "kernel %d: %lu terms lose %.2f roundings", k, (unsigned long)widths[i], e);
      }
      printf("\n");
   }
}
/* What is the same for every row must not be rounded for every row: weights times a batch norm's scale, b - mean. The
   rows are alike, as a mesh's are, so the error of a rounded constant (7 units) stays when the rows' own average out. */
TEST(constants_do_not_round)
{
   enum { IN = 96, OUT = 33, ROWS = 2000 };
   int k;
   for (k = 0; k < DN_KERNEL_COUNT; k++) {
      uint64_t seed = 103;
      float *w, *x, *y, *q;
      dn_batchnorm bn;
      dn_linear l;
      void *memory;
      double square = 0;
      size_t r, o, c;
      if (!dn_kernel_available((dn_kernel)k)) continue;
      w = random_floats(&seed, OUT * IN, 1), x = random_floats(&seed, ROWS * IN, 0.3f);
      y = (float *)test_block(ROWS * OUT * 4), q = random_floats(&seed, 5 * OUT, 1);
      memory = test_aligned(dn_linear_size(IN, OUT));
      for (c = 0; c < IN; c++) { /* rows around one in the middle */
         float middle = test_uniform(&seed, -1, 1);
         for (r = 0; r < ROWS; r++) x[r * IN + c] += middle;
      }
      bn.weight = q, bn.bias = q + OUT, bn.mean = q + 2 * OUT, bn.var = q + 3 * OUT;
      for (o = 0; o < OUT; o++) q[3 * OUT + o] = 1.5f + q[3 * OUT + o];
      dn_linear_pack(&l, IN, OUT, w, q + 4 * OUT, &bn, DN_ACT_NONE, memory);
      l.kernel = (dn_kernel)k;
      dn_linear_run(&l, x, IN, ROWS, y, OUT, NULL);
      for (o = 0; o < OUT; o++) {
         double scale = (double)bn.weight[o] / sqrt((double)bn.var[o] + 1e-5), size = 0, error = 0;
         for (r = 0; r < ROWS; r++) {
            double u = (double)q[4 * OUT + o] - (double)bn.mean[o];
            for (c = 0; c < IN; c++) {
               double term = (double)w[o * IN + c] * (double)x[r * IN + c];
               u += term;
               size += term * term;
            }
            error += (double)y[r * OUT + o] - (u * scale + (double)bn.bias[o]);
         }
         error /= ROWS * ldexp(fabs(scale) * sqrt(size / ROWS), -24);
         square += error * error;
      }
      square = sqrt(square / OUT);
      printf("   kernel %d: %.3f roundings of a row, on average over %d rows\n", k, square, ROWS);
      CHECK_MSG(square < 0.6, "kernel %d: %.3f roundings are the same in all rows", k, square);
      test_aligned_free(memory);
      free(w), free(x), free(y), free(q);
   }
}
TEST(strange_variances_stay_numbers_or_nan)
{
   static const float w[] = { 1, 2, 3, 4 };
   static const float one[] = { 1, 1, 1, 1 }, zero[] = { 0, 0, 0, 0 };
   float var[4] = { 0, -1e-5f, -1, 0 }, x = 1, y[4];
   uint32_t nan_bits = 0x7fc00000u;
   void *memory = test_aligned(dn_linear_size(1, 4));
   dn_batchnorm bn;
   dn_linear l;
   memcpy(&var[3], &nan_bits, 4);
   bn.weight = one, bn.bias = zero, bn.mean = zero, bn.var = var;
   dn_linear_pack(&l, 1, 4, w, NULL, &bn, DN_ACT_NONE, memory);
   dn_linear_ref(&l, &x, 1, 1, y, 4);
   CHECK(fabs((double)y[0] - 1 / sqrt(1e-5)) < 0.01);
   CHECK(is_nan(y[2]) && is_nan(y[3]));
   test_aligned_free(memory);
}
TEST(sizes_that_do_not_fit_are_refused)
{
   CHECK(dn_linear_size(0, 4) == 0 && dn_linear_size(4, 0) == 0);
   CHECK(dn_linear_size(SIZE_MAX / 2, 16) == 0 && dn_linear_size(1, SIZE_MAX) == 0);
   CHECK(dn_gat_size(0, 1, 1, 1) == 0 && dn_gat_size(1, 0, 1, 1) == 0 && dn_gat_size(1, 1, 0, 1) == 0);
   CHECK(dn_gat_size(8, SIZE_MAX / 3, 5, 0) == 0 && dn_gat_size(8, 2, 2, SIZE_MAX - 2) == 0);
   CHECK(dn_gat_size(8, 2, 2, 0) > 0);
   CHECK(dn_pool_size(0, 3) == 0 && dn_pool_size(SIZE_MAX / 4, 3) == 0);
}

/* --- attention */
typedef struct ring_graph {
   dn_graph g;
   uint32_t *first, *next;
} ring_graph;
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
   r.next = (uint32_t *)test_block(at * 4);
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
static void graph_free(ring_graph *r)
{
   free(r->first);
   free(r->next);
}
typedef struct gat_case {
   dn_gat block;
   size_t width;
   float *lin, *dst, *src, *self_weight, *bn;
   void *memory;
} gat_case;
static gat_case random_gat(uint64_t *seed, size_t in, size_t heads, size_t features, size_t self,
                           dn_activation activation, int with_bn)
{
   gat_case c;
   dn_batchnorm bn;
   size_t i;
   c.width = heads * features + self;
   c.lin = random_floats(seed, heads * features * in, 0.5f);
   c.dst = random_floats(seed, heads * features, 1);
   c.src = random_floats(seed, heads * features, 1);
   c.self_weight = random_floats(seed, self * in, 0.5f);
   c.bn = random_floats(seed, 4 * c.width, 0.5f);
   for (i = 0; i < c.width; i++) c.bn[3 * c.width + i] += 0.7f;
   bn.weight = c.bn, bn.bias = c.bn + c.width, bn.mean = c.bn + 2 * c.width, bn.var = c.bn + 3 * c.width;
   c.memory = test_aligned(dn_gat_size(in, heads, features, self));
   dn_gat_pack(&c.block, in, heads, features, self, c.lin, c.dst, c.src, self ? c.self_weight : NULL,
               with_bn ? &bn : NULL, activation, c.memory);
   return c;
}
static void gat_free(gat_case *c)
{
   test_aligned_free(c->memory);
   free(c->lin), free(c->dst), free(c->src), free(c->self_weight), free(c->bn);
}
static void gat_compare(dn_kernel kernel, uint64_t *seed, size_t in, size_t heads, size_t features, size_t self,
                        size_t nodes, size_t fan, dn_activation activation)
{
   gat_case c = random_gat(seed, in, heads, features, self, activation, (int)pick(seed, 0, 1));
   ring_graph r = random_graph(seed, nodes, nodes * 3, fan);
   size_t v_off = pick(seed, 0, 7), y_off = pick(seed, 0, 7);
   size_t v_stride = in + pick(seed, 0, 3), y_stride = c.width + pick(seed, 0, 3);
   float *v = random_floats(seed, nodes * v_stride + v_off, 1);
   float *y = (float *)test_block((nodes * y_stride + y_off) * 4);
   float *want = (float *)test_block((nodes * y_stride + y_off) * 4);
   void *scratch = test_aligned(dn_gat_scratch(&c.block, nodes)); /* exactly: sanitizers watch its end */
   fill(y, nodes * y_stride + y_off, GUARD);
   fill(want, nodes * y_stride + y_off, GUARD);
   dn_gat_ref(&c.block, &r.g, v + v_off, v_stride, want + y_off, y_stride, scratch);
   c.block.kernel = kernel;
   dn_gat_run(&c.block, &r.g, v + v_off, v_stride, y + y_off, y_stride, scratch, NULL);
   CHECK_MSG(rows_differ(y + y_off, want + y_off, nodes, c.width, y_stride) == 0,
             "kernel %d: in %lu K %lu F %lu B %lu N %lu activation %d differs from the reference", (int)kernel,
             (unsigned long)in, (unsigned long)heads, (unsigned long)features, (unsigned long)self,
             (unsigned long)nodes, (int)activation);
   test_aligned_free(scratch);
   graph_free(&r);
   gat_free(&c);
   free(v), free(y), free(want);
}
TEST(attention_equals_the_reference)
{
   int k;
   size_t cases = 0, n;
   for (k = 0; k < DN_KERNEL_COUNT; k++) {
      uint64_t seed = 23;
      if (!dn_kernel_available((dn_kernel)k)) continue;
      for (n = 1; n <= 17; n++, cases += 3) {
         gat_compare((dn_kernel)k, &seed, 12, n, 5, 3, 20, 0, DN_ACT_TANHSHRINK);   /* more than 8 heads: other paths */
         gat_compare((dn_kernel)k, &seed, 9, 3, n, n - 1, 15, 0, DN_ACT_TANH);
         gat_compare((dn_kernel)k, &seed, n, 8, 8, 8, n, 0, DN_ACT_RELU);
      }
      /* a fan larger than the buffer, and at its very size: 63, 64, 65 */
      gat_compare((dn_kernel)k, &seed, 32, 8, 8, 8, 150, 140, DN_ACT_TANHSHRINK);
      gat_compare((dn_kernel)k, &seed, 32, 8, 8, 8, 66, 62, DN_ACT_TANHSHRINK);
      gat_compare((dn_kernel)k, &seed, 32, 8, 8, 8, 66, 63, DN_ACT_TANHSHRINK);
      gat_compare((dn_kernel)k, &seed, 32, 8, 8, 8, 66, 64, DN_ACT_TANHSHRINK);
      gat_compare((dn_kernel)k, &seed, 40, 8, 16, 128, 61, 0, DN_ACT_TANHSHRINK);
      gat_compare((dn_kernel)k, &seed, 40, 4, 64, 256, 31, 0, DN_ACT_TANH);
      gat_compare((dn_kernel)k, &seed, 7, 2, 33, 0, 1, 0, DN_ACT_NONE);
      for (n = 0; n < 40; n++, cases++)
         gat_compare((dn_kernel)k, &seed, pick(&seed, 1, 50), pick(&seed, 1, 10), pick(&seed, 1, 35),
                     pick(&seed, 0, 40), pick(&seed, 1, 40), pick(&seed, 0, 12), all_activations[pick(&seed, 0, 4)]);
   }
   AT_LEAST(cases, 91, "blocks");
}
/* the equations once more, edge by edge, in double, from the weights as given */
TEST(attention_is_the_definition)
{
   uint64_t seed = 31;
   size_t n;
   for (n = 0; n < 12; n++) {
      size_t in = pick(&seed, 1, 20), K = pick(&seed, 1, 5), F = pick(&seed, 1, 9), B = pick(&seed, 0, 6);
      size_t N = pick(&seed, 1, 25);
      gat_case c = random_gat(&seed, in, K, F, B, DN_ACT_TANHSHRINK, 1);
      ring_graph r = random_graph(&seed, N, 2 * N, 0);
      float *v = random_floats(&seed, N * in, 1), *y = (float *)test_block(N * c.width * 4);
      float *alpha = (float *)test_block((N + r.first[N]) * K * 4);
      double *z = (double *)test_block(N * K * F * sizeof(double));
      void *scratch = test_aligned(dn_gat_scratch(&c.block, N));
      size_t i, j, k, f, d;
      dn_gat_run(&c.block, &r.g, v, in, y, c.width, scratch, NULL);
      dn_gat_attention(&c.block, &r.g, v, in, alpha, scratch);
      for (i = 0; i < N; i++)
         for (f = 0; f < K * F; f++)
            for (z[i * K * F + f] = 0, d = 0; d < in; d++)
               z[i * K * F + f] += (double)c.lin[f * in + d] * (double)v[i * in + d];
      for (i = 0; i < N; i++) {
         size_t count = r.first[i + 1] - r.first[i] + 1;
         for (f = 0; f < c.width; f++) {
            double sum = 0, top = 0, total = 0, scale;
            k = f < K * F ? f / F : 0;
            for (j = 0; f < K * F && j < count; j++) {
               size_t m = j ? r.next[r.first[i] + j - 1] : i;
               double e = 0, w;
               for (d = 0; d < F; d++)
                  e += (double)c.dst[k * F + d] * z[i * K * F + k * F + d]
                     + (double)c.src[k * F + d] * z[m * K * F + k * F + d];
               w = exp(e < 0 ? 0.2 * e : e);
               sum += w;
               top += w * z[m * K * F + f];
               total += (double)alpha[(r.first[i] + i + j) * K + k];
            }
            for (d = 0; f >= K * F && d < in; d++)
               top += (double)c.self_weight[(f - K * F) * in + d] * (double)v[i * in + d];
            if (f < K * F) {
               top /= sum;
               CHECK(fabs(total - 1) < 1e-5);
            }
            scale = (double)c.bn[f] / sqrt((double)c.bn[3 * c.width + f] + 1e-5);
            top = (top - (double)c.bn[2 * c.width + f]) * scale + (double)c.bn[c.width + f];
            CHECK(close_to((double)y[i * c.width + f], top - tanh(top)));
         }
      }
      test_aligned_free(scratch);
      graph_free(&r);
      gat_free(&c);
      free(v), free(y), free(alpha), free(z);
   }
}
/* nodes that are all alike: whatever the attention, sum_j a_ij z_j is z_i, to the last bit */
TEST(alike_neighbours_change_nothing)
{
   int k;
   size_t cases = 0;
   for (k = 0; k < DN_KERNEL_COUNT; k++) {
      uint64_t seed = 107;
      size_t n;
      if (!dn_kernel_available((dn_kernel)k)) continue;
      for (n = 0; n < 12; n++, cases++) {
         size_t in = pick(&seed, 1, 80), K = pick(&seed, 1, 9), F = pick(&seed, 1, 40), B = pick(&seed, 0, 20);
         size_t N = 40, i;
         gat_case c = random_gat(&seed, in, K, F, B, DN_ACT_NONE, 1);
         ring_graph r = random_graph(&seed, N, 3 * N, n % 2 ? 30 : 0);
         float *row = random_floats(&seed, in, 1), *v = (float *)test_block(N * in * 4);
         float *y = (float *)test_block(N * c.width * 4), *z = (float *)test_block(K * F * 4);
         void *scratch = test_aligned(dn_gat_scratch(&c.block, N)), *memory = test_aligned(dn_linear_size(in, K * F));
         dn_batchnorm bn;
         dn_linear l;
         bn.weight = c.bn, bn.bias = c.bn + c.width, bn.mean = c.bn + 2 * c.width, bn.var = c.bn + 3 * c.width;
         dn_linear_pack(&l, in, K * F, c.lin, NULL, &bn, DN_ACT_NONE, memory);
         c.block.kernel = l.kernel = (dn_kernel)k;
         dn_linear_run(&l, row, in, 1, z, K * F, NULL);
         for (i = 0; i < N; i++) memcpy(v + i * in, row, in * 4);
         dn_gat_run(&c.block, &r.g, v, in, y, c.width, scratch, NULL);
         for (i = 0; i < N; i++) CHECK(same_bits(y + i * c.width, z, K * F * 4));
         test_aligned_free(scratch), test_aligned_free(memory);
         graph_free(&r);
         gat_free(&c);
         free(row), free(v), free(y), free(z);
      }
   }
   AT_LEAST(cases, 12, "blocks");
}
TEST(large_logits_do_not_overflow)
{
   int k;
   for (k = 0; k < DN_KERNEL_COUNT; k++) {
      uint64_t seed = 3;
      size_t i;
      float v[9 * 4], y[9 * 10];
      gat_case c;
      ring_graph r;
      void *scratch;
      if (!dn_kernel_available((dn_kernel)k)) continue;
      c = random_gat(&seed, 4, 2, 4, 2, DN_ACT_NONE, 0);
      r = random_graph(&seed, 9, 20, 0);
      scratch = test_aligned(dn_gat_scratch(&c.block, 9));
      c.block.kernel = (dn_kernel)k;
      for (i = 0; i < 36; i++) v[i] = test_uniform(&seed, -1, 1) * 1e6f;
      dn_gat_run(&c.block, &r.g, v, 4, y, 10, scratch, NULL);
      for (i = 0; i < 90; i++) CHECK(test_finite(y[i]));
      test_aligned_free(scratch);
      graph_free(&r);
      gat_free(&c);
   }
}
/* a NaN row reaches its own ring and no further */
TEST(nan_stays_in_its_neighbourhood)
{
   int k;
   for (k = 0; k < DN_KERNEL_COUNT; k++) {
      uint64_t seed = 5;
      float v[12 * 4], y[12 * 18];
      uint32_t nan_bits = 0x7fc00000u;
      size_t i, j, f;
      gat_case c;
      ring_graph r;
      void *scratch;
      if (!dn_kernel_available((dn_kernel)k)) continue;
      c = random_gat(&seed, 4, 4, 4, 2, DN_ACT_TANHSHRINK, 0);
      r = random_graph(&seed, 12, 14, 0);
      scratch = test_aligned(dn_gat_scratch(&c.block, 12));
      c.block.kernel = (dn_kernel)k;
      for (i = 0; i < 48; i++) v[i] = test_uniform(&seed, -1, 1);
      memcpy(&v[5 * 4 + 1], &nan_bits, 4);
      dn_gat_run(&c.block, &r.g, v, 4, y, 18, scratch, NULL);
      for (i = 0; i < 12; i++) {
         int touched = i == 5;
         for (j = r.first[i]; j < r.first[i + 1]; j++) touched |= r.next[j] == 5;
         for (f = 0; f < 16; f++) CHECK(test_finite(y[i * 18 + f]) == !touched);
         for (; f < 18; f++) CHECK(test_finite(y[i * 18 + f]) == (i != 5));
      }
      test_aligned_free(scratch);
      graph_free(&r);
      gat_free(&c);
   }
}

/* --- any split, any order of ranges: the same bits */
static void split_oddly(void *user, size_t count, size_t grain, dn_range_fn *fn, void *job)
{
   size_t pieces = (count + grain - 1) / grain, step = *(const size_t *)user, done;
   for (done = pieces; done > 0;) { /* from the end, `step` grains at a time */
      size_t take = done < step ? done : step;
      done -= take;
      fn(job, done * grain, (done + take) * grain < count ? (done + take) * grain : count, (unsigned)(done % 3));
   }
}
TEST(bits_do_not_depend_on_the_split)
{
   int k;
   size_t cases = 0;
   for (k = 0; k < DN_KERNEL_COUNT; k++) {
      size_t step, n;
      uint64_t seed = 41;
      if (!dn_kernel_available((dn_kernel)k)) continue;
      for (n = 0; n < 3; n++) {
         static const size_t nodes_of[] = { 700, 505, 169 };
         size_t N = nodes_of[n], in = 21, b, row = 21 + 3 * 31;
         ring_graph r = random_graph(&seed, N, 3 * N, 5);
         gat_case c[3];
         dn_gat blocks[3];
         float *start = random_floats(&seed, N * row, 1);
         float *one = (float *)test_block(N * row * 4), *other = (float *)test_block(N * row * 4);
         void *scratch;
         for (b = 0; b < 3; b++, in += 31) {
            c[b] = random_gat(&seed, in, 3, 8, 7, DN_ACT_TANHSHRINK, 0);
            c[b].block.kernel = (dn_kernel)k;
            blocks[b] = c[b].block;
         }
         scratch = test_aligned(dn_gat_scratch(&blocks[2], N));
         memcpy(one, start, N * row * 4);
         dn_dense_run(blocks, 3, &r.g, one, row, row, scratch, NULL);
         for (step = 1; step <= 3; step++, cases++) {
            dn_parallel split;
            split.run = split_oddly, split.user = &step, split.workers = 3;
            memcpy(other, start, N * row * 4);
            dn_dense_run(blocks, 3, &r.g, other, row, row, scratch, &split);
            CHECK(same_bits(one, other, N * row * 4));
         }
         memcpy(other, start, N * row * 4);
         dn_dense_ref(blocks, 3, &r.g, other, row, row, scratch);
         CHECK(rows_differ(one, other, N, row, row) == 0);
         /* and the module is its blocks, one after the other, copied by hand: T 3.6 */
         for (b = 0, in = 21; b < 3; b++, in += 31) {
            float *y = (float *)test_block(N * 31 * 4);
            size_t i, x;
            dn_gat_ref(&blocks[b], &r.g, start + (row - in), row, y, 31, scratch);
            for (i = 0; i < N; i++)
               for (x = 0; x < 31; x++) start[i * row + row - in - 31 + x] = y[i * 31 + x];
            free(y);
         }
         CHECK(rows_differ(one, start, N, row, row) == 0);
         test_aligned_free(scratch);
         for (b = 0; b < 3; b++) gat_free(&c[b]);
         graph_free(&r);
         free(start), free(one), free(other);
      }
   }
   AT_LEAST(cases, 9, "splits");
}
TEST(the_kernel_named_is_the_one_packed)
{
   static const char *const names[] = { "automatic", "reference", "sse", "avx2", "avx512", "neon", "wasm" };
   static const float w[] = { 1 };
   void *memory = test_aligned(dn_linear_size(1, 1));
   dn_linear l;
   dn_linear_pack(&l, 1, 1, w, NULL, NULL, DN_ACT_NONE, memory);
   CHECK(dn_kernel_available(DN_KERNEL_REF) && dn_kernel_available(l.kernel));
   CHECK(!dn_kernel_available(DN_KERNEL_AUTO) && !dn_kernel_available(DN_KERNEL_COUNT));
   CHECK(strcmp(dn_kernel_name(DN_KERNEL_AUTO), names[l.kernel]) == 0 && strcmp(dn_kernel_name(l.kernel), names[l.kernel]) == 0);
   CHECK(strcmp(dn_kernel_name(DN_KERNEL_COUNT), "unknown") == 0 && strcmp(dn_precision_name(DN_PRECISION_COUNT), "unknown") == 0);
#ifdef DN_NO_SIMD
   CHECK(l.kernel == DN_KERNEL_REF);
#endif
   printf("   packing chooses %s\n", dn_kernel_name(DN_KERNEL_AUTO));
   test_aligned_free(memory);
}

int main(int argc, char **argv)
{
   TEST_BEGIN(argc, argv);
   RUN(exp_is_within_one_ulp);
   RUN(tanh_is_within_its_bound);
   RUN(tanhshrink_keeps_the_digits_of_small_numbers);
   RUN(activations_at_their_corners);
   RUN(the_reference_is_the_definition);
   RUN(products_equal_the_reference);
   RUN(a_row_does_not_depend_on_the_others);
   RUN(long_sums_round_little);
   RUN(constants_do_not_round);
   RUN(strange_variances_stay_numbers_or_nan);
   RUN(sizes_that_do_not_fit_are_refused);
   RUN(attention_is_the_definition);
   RUN(attention_equals_the_reference);
   RUN(alike_neighbours_change_nothing);
   RUN(large_logits_do_not_overflow);
   RUN(nan_stays_in_its_neighbourhood);
   RUN(bits_do_not_depend_on_the_split);
   RUN(the_kernel_named_is_the_one_packed);
   return TEST_END();
}
