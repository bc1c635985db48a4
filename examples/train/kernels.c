/*  kernels.c - the graph parts of a training step, forward and backward

    shows     attention over one-rings, batch norm + activation, pooling: each with its derivative written out
    why       a graph layer in plain PyTorch gathers and scatters (N, neighbours, width) arrays and is limited by memory;
              here a node's neighbourhood is walked in cache. nets.py has the plain form of each and uses it on a GPU;
              check_nets.py compares values and gradients of the two.
    build     make libdeformnet.so (this file with -O3 -march=native -ffast-math -fopenmp: training needs no bit equality)

    A batch is a disjoint union of patches: nodes of patch p are offset[p] .. offset[p+1]-1 and have neighbours only there.
    Threads take whole patches, so that the scatter of a backward pass needs no locks.
    Tables: table (n,width) int32, entry 0 the node itself, then its one-ring; degree (n) entries used. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define API __attribute__((visibility("default")))
#define INLINE static inline __attribute__((always_inline))
#define SLOPE 0.2f   /* of the LeakyReLU in the scores */
#define MAX_HEADS 64 /* nets.py checks it */

/* ------------------------------------------------------------------ attention (T 3.2 - 3.5)
   u (n,ld) = v times [W | H | W^T att_dst | W^T att_src], columns K*F z, B self, K dst, K src
   y (n,K*F+B); alpha (n,width,K) is kept for the way back */
INLINE void gat_forward(const float *u, size_t ld, const int32_t *table, size_t width, const int32_t *degree, size_t from,
                        size_t to, size_t K, size_t F, size_t B, float *y, float *alpha)
{
   const size_t KF = K * F;
   for (size_t i = from; i < to; i++) {
      const int32_t *ring = table + i * width;
      const size_t m = (size_t)degree[i];
      const float *dst = u + i * ld + KF + B;
      float *a = alpha + i * width * K, *row = y + i * (KF + B);
      float top[MAX_HEADS], sum[MAX_HEADS];
      for (size_t k = 0; k < K; k++) top[k] = -1e30f, sum[k] = 0;
      for (size_t c = 0; c < m; c++) { /* e_ij = leaky(dst_i + src_j) */
         const float *src = u + (size_t)ring[c] * ld + KF + B + K;
         for (size_t k = 0; k < K; k++) {
            float e = dst[k] + src[k];
            e = e > 0 ? e : SLOPE * e;
            a[c * K + k] = e;
            top[k] = e > top[k] ? e : top[k];
         }
      }
      for (size_t c = 0; c < m; c++)
         for (size_t k = 0; k < K; k++) sum[k] += a[c * K + k] = expf(a[c * K + k] - top[k]);
      for (size_t k = 0; k < K; k++) sum[k] = 1 / sum[k];
      for (size_t c = 0; c < m; c++)
         for (size_t k = 0; k < K; k++) a[c * K + k] *= sum[k];
      memset(row, 0, KF * sizeof *row);
      for (size_t c = 0; c < m; c++) { /* y_i = sum_j a_ij z_j */
         const float *z = u + (size_t)ring[c] * ld;
         for (size_t k = 0; k < K; k++) {
            const float w = a[c * K + k];
            for (size_t f = 0; f < F; f++) row[k * F + f] += w * z[k * F + f];
         }
      }
      memcpy(row + KF, u + i * ld + KF, B * sizeof *row);
   }
}
INLINE void gat_backward(const float *u, size_t ld, const int32_t *table, size_t width, const int32_t *degree, size_t from,
                         size_t to, size_t K, size_t F, size_t B, const float *alpha, const float *gy, float *gu)
{
   const size_t KF = K * F;
   float ga[MAX_HEADS];
   memset(gu + from * ld, 0, (to - from) * ld * sizeof *gu);
   for (size_t i = from; i < to; i++) {
      const int32_t *ring = table + i * width;
      const size_t m = (size_t)degree[i];
      const float *a = alpha + i * width * K, *g = gy + i * (KF + B), *dst = u + i * ld + KF + B;
      float *gdst = gu + i * ld + KF + B;
      float dot[MAX_HEADS], mean[MAX_HEADS];
      for (size_t k = 0; k < K; k++) mean[k] = 0;
      float *da = (float *)__builtin_alloca(m * K * sizeof(float));
      for (size_t c = 0; c < m; c++) {
         const float *z = u + (size_t)ring[c] * ld;
         float *gz = gu + (size_t)ring[c] * ld;
         for (size_t k = 0; k < K; k++) {
            const float w = a[c * K + k];
            float s = 0;
            for (size_t f = 0; f < F; f++) { /* dL/da_ij = g_i . z_j;  dL/dz_j += a_ij g_i */
               s += g[k * F + f] * z[k * F + f];
               gz[k * F + f] += w * g[k * F + f];
            }
            dot[k] = s;
         }
         for (size_t k = 0; k < K; k++) {
            da[c * K + k] = dot[k];
            mean[k] += a[c * K + k] * dot[k];
         }
      }
      for (size_t k = 0; k < K; k++) ga[k] = 0;
      for (size_t c = 0; c < m; c++) {
         const float *src = u + (size_t)ring[c] * ld + KF + B + K;
         float *gsrc = gu + (size_t)ring[c] * ld + KF + B + K;
         for (size_t k = 0; k < K; k++) { /* through the softmax, then the LeakyReLU */
            float de = a[c * K + k] * (da[c * K + k] - mean[k]);
            de *= dst[k] + src[k] > 0 ? 1 : SLOPE;
            ga[k] += de;
            gsrc[k] += de;
         }
      }
      for (size_t k = 0; k < K; k++) gdst[k] += ga[k];
      memcpy(gu + i * ld + KF, g + KF, B * sizeof *gu);
   }
}
/* constant K and F let the compiler keep a head in one vector register */
#define SHAPES(X) X(4, 16) X(8, 16) X(4, 8) X(8, 8) X(4, 4) X(2, 16) X(6, 16) X(4, 32) X(8, 32)
API void dnt_gat_forward(const float *u, size_t ld, const int32_t *table, size_t width, const int32_t *degree,
                         const int64_t *offset, size_t patches, size_t K, size_t F, size_t B, float *y, float *alpha)
{
#pragma omp parallel for schedule(dynamic, 1)
   for (size_t p = 0; p < patches; p++) {
      size_t a = (size_t)offset[p], b = (size_t)offset[p + 1];
#define CASE(k, f) if (K == k && F == f) gat_forward(u, ld, table, width, degree, a, b, k, f, B, y, alpha); else
      SHAPES(CASE) gat_forward(u, ld, table, width, degree, a, b, K, F, B, y, alpha);
#undef CASE
   }
}
API void dnt_gat_backward(const float *u, size_t ld, const int32_t *table, size_t width, const int32_t *degree,
                          const int64_t *offset, size_t patches, size_t K, size_t F, size_t B, const float *alpha,
                          const float *gy, float *gu)
{
#pragma omp parallel for schedule(dynamic, 1)
   for (size_t p = 0; p < patches; p++) {
      size_t a = (size_t)offset[p], b = (size_t)offset[p + 1];
#define CASE(k, f) if (K == k && F == f) gat_backward(u, ld, table, width, degree, a, b, k, f, B, alpha, gy, gu); else
      SHAPES(CASE) gat_backward(u, ld, table, width, degree, a, b, K, F, B, alpha, gy, gu);
#undef CASE
   }
}

/* ------------------------------------------------------------------ batch norm + activation
   y = act(weight * (x - mean) * rstd + bias), columns C. mean and rstd are given (inference, frozen) or measured here. */
enum { NONE, TANH, TANHSHRINK, RELU };
#define BLOCK 512 /* rows a thread takes at a time */

API void dnt_moments(const float *x, size_t n, size_t C, float *mean, float *var)
{
   size_t blocks = (n + BLOCK - 1) / BLOCK;
   double *sum = (double *)calloc(2 * C, sizeof *sum);
#pragma omp parallel
   {
      float *part = (float *)malloc(2 * C * sizeof *part);
#pragma omp for schedule(static)
      for (size_t b = 0; b < blocks; b++) {
         size_t to = (b + 1) * BLOCK < n ? (b + 1) * BLOCK : n;
         memset(part, 0, 2 * C * sizeof *part);
         for (size_t i = b * BLOCK; i < to; i++)
            for (size_t c = 0; c < C; c++) {
               float v = x[i * C + c];
               part[c] += v;
               part[C + c] += v * v;
            }
#pragma omp critical
         for (size_t c = 0; c < 2 * C; c++) sum[c] += part[c];
      }
      free(part);
   }
   for (size_t c = 0; c < C; c++) {
      double m = sum[c] / (double)n, v = sum[C + c] / (double)n - m * m;
      mean[c] = (float)m;
      var[c] = (float)(v > 0 ? v : 0);
   }
   free(sum);
}
API void dnt_norm_forward(const float *x, size_t n, size_t C, const float *mean, const float *rstd, const float *weight,
                          const float *bias, int act, float *y)
{
#pragma omp parallel
   {
      float *s = (float *)malloc(2 * C * sizeof *s), *t = s + C; /* one multiply-add a number */
      for (size_t c = 0; c < C; c++) s[c] = weight[c] * rstd[c], t[c] = bias[c] - mean[c] * s[c];
#pragma omp for schedule(static)
      for (size_t i = 0; i < n; i++) {
         const float *p = x + i * C;
         float *q = y + i * C;
         if (act == TANHSHRINK) for (size_t c = 0; c < C; c++) { float v = s[c] * p[c] + t[c]; q[c] = v - tanhf(v); }
         else if (act == TANH) for (size_t c = 0; c < C; c++) q[c] = tanhf(s[c] * p[c] + t[c]);
         else if (act == RELU) for (size_t c = 0; c < C; c++) { float v = s[c] * p[c] + t[c]; q[c] = v > 0 ? v : 0; }
         else for (size_t c = 0; c < C; c++) q[c] = s[c] * p[c] + t[c];
      }
      free(s);
   }
}
/* gx from gy; gweight = sum g xhat, gbias = sum g, where g = gy act'. live: mean and rstd came from this batch */
API void dnt_norm_backward(const float *x, const float *y, const float *gy, size_t n, size_t C, const float *mean,
                           const float *rstd, const float *weight, const float *bias, int act, int live, float *gx,
                           float *gweight, float *gbias)
{
   double *sum = (double *)calloc(2 * C, sizeof *sum);
   float *u = (float *)malloc(3 * C * sizeof *u);
#pragma omp parallel
   {
      float *part = (float *)malloc(4 * C * sizeof *part), *s = part + 2 * C, *t = s + C;
      for (size_t c = 0; c < C; c++) s[c] = weight[c] * rstd[c], t[c] = bias[c] - mean[c] * s[c];
      size_t blocks = (n + BLOCK - 1) / BLOCK;
#pragma omp for schedule(static)
      for (size_t b = 0; b < blocks; b++) {
         size_t to = (b + 1) * BLOCK < n ? (b + 1) * BLOCK : n;
         memset(part, 0, 2 * C * sizeof *part);
         for (size_t i = b * BLOCK; i < to; i++) {
            const float *xi = x + i * C, *yi = y + i * C, *gi = gy + i * C;
            float *q = gx + i * C;
            if (act == TANHSHRINK) for (size_t c = 0; c < C; c++) { /* (v - tanh v)' = tanh^2 v, and tanh v = v - y */
               float th = s[c] * xi[c] + t[c] - yi[c];
               q[c] = gi[c] * th * th;
            }
            else if (act == TANH) for (size_t c = 0; c < C; c++) q[c] = gi[c] * (1 - yi[c] * yi[c]);
            else if (act == RELU) for (size_t c = 0; c < C; c++) q[c] = yi[c] > 0 ? gi[c] : 0;
            else memcpy(q, gi, C * sizeof *q);
            for (size_t c = 0; c < C; c++) {
               part[c] += q[c];
               part[C + c] += q[c] * xi[c];
            }
         }
#pragma omp critical
         for (size_t c = 0; c < 2 * C; c++) sum[c] += part[c];
      }
#pragma omp barrier
#pragma omp single
      for (size_t c = 0; c < C; c++) {
         double gb = sum[c], gw = (sum[C + c] - mean[c] * sum[c]) * rstd[c]; /* sum g xhat */
         gbias[c] = (float)gb;
         gweight[c] = (float)gw;
         /* gx = w rstd (g - [live] (mean g + xhat mean(g xhat))) = u0 g - u1 - u2 x */
         u[c] = weight[c] * rstd[c];
         u[2 * C + c] = live ? (float)(u[c] * gw * rstd[c] / (double)n) : 0;
         u[C + c] = live ? (float)(u[c] * gb / (double)n) - u[2 * C + c] * mean[c] : 0;
      }
#pragma omp for schedule(static)
      for (size_t i = 0; i < n; i++)
         for (size_t c = 0; c < C; c++) gx[i * C + c] = u[c] * gx[i * C + c] - u[C + c] - u[2 * C + c] * x[i * C + c];
      free(part);
   }
   free(sum);
   free(u);
}

/* ------------------------------------------------------------------ pooling (T 3.10 - 3.12)
   members (m,2): the directed pair of every coarse node, (i,i) for one left alone; cluster (n); score (m), at least 1e-6
   forward  down: coarse = score (v_i + v_j) or v_i;   up: v_i = coarse_c / score_c
   backward of each from the other's shape: no scatter is needed, every node is in exactly one cluster */
API void dnt_pool_down(const float *v, const int64_t *members, const float *score, size_t m, size_t C, float *coarse)
{
#pragma omp parallel for schedule(static)
   for (size_t c = 0; c < m; c++) {
      const float *a = v + (size_t)members[2 * c] * C, *b = v + (size_t)members[2 * c + 1] * C, s = score[c];
      float *q = coarse + c * C;
      if (a == b) memcpy(q, a, C * sizeof *q);
      else for (size_t k = 0; k < C; k++) q[k] = s * (a[k] + b[k]);
   }
}
API void dnt_pool_down_back(const float *v, const float *g, const int64_t *members, const float *score, size_t m, size_t C,
                            float *gv, float *gscore)
{
#pragma omp parallel for schedule(static)
   for (size_t c = 0; c < m; c++) {
      size_t i = (size_t)members[2 * c], j = (size_t)members[2 * c + 1];
      const float *q = g + c * C, s = score[c];
      float dot = 0;
      if (i == j) memcpy(gv + i * C, q, C * sizeof *q);
      else for (size_t k = 0; k < C; k++) {
         dot += q[k] * (v[i * C + k] + v[j * C + k]);
         gv[i * C + k] = gv[j * C + k] = s * q[k];
      }
      gscore[c] = dot;
   }
}
API void dnt_pool_up(const float *coarse, const int64_t *members, const float *score, size_t m, size_t C, float *v)
{
#pragma omp parallel for schedule(static)
   for (size_t c = 0; c < m; c++) {
      const float *q = coarse + c * C, s = 1 / score[c];
      float *a = v + (size_t)members[2 * c] * C, *b = v + (size_t)members[2 * c + 1] * C;
      for (size_t k = 0; k < C; k++) a[k] = b[k] = s * q[k];
   }
}
API void dnt_pool_up_back(const float *coarse, const float *gv, const int64_t *members, const float *score, size_t m,
                          size_t C, float *g, float *gscore)
{
#pragma omp parallel for schedule(static)
   for (size_t c = 0; c < m; c++) {
      size_t i = (size_t)members[2 * c], j = (size_t)members[2 * c + 1];
      const float *a = gv + i * C, *b = gv + j * C, s = 1 / score[c], two = i == j ? 0 : 1;
      float dot = 0;
      for (size_t k = 0; k < C; k++) {
         float t = a[k] + two * b[k];
         dot += t * coarse[c * C + k];
         g[c * C + k] = s * t;
      }
      gscore[c] = -dot * s * s;
   }
}
/*  score of each chosen pair (i,j): softmax over N(i) without i of leaky(dst_i + src_j) (+ offset), 1 for a node alone
    ds (n,2) = v times [W^T att_dst | W^T att_src]; slot (m): column of j in the table's row i, 0 for a node alone */
API void dnt_pool_score(const float *ds, const int32_t *table, size_t width, const int32_t *degree, const int64_t *members,
                        const int32_t *slot, size_t m, float offset, float *score, float *softmax)
{
#pragma omp parallel for schedule(static)
   for (size_t c = 0; c < m; c++) {
      size_t i = (size_t)members[2 * c], k = (size_t)degree[i];
      const int32_t *ring = table + i * width;
      float *a = softmax + c * width, top = -1e30f, sum = 0;
      score[c] = 1;
      if (slot[c] == 0) continue;
      for (size_t q = 1; q < k; q++) {
         float e = ds[2 * i] + ds[2 * (size_t)ring[q] + 1];
         a[q] = e > 0 ? e : SLOPE * e;
         top = a[q] > top ? a[q] : top;
      }
      for (size_t q = 1; q < k; q++) sum += a[q] = expf(a[q] - top);
      for (size_t q = 1; q < k; q++) a[q] /= sum;
      score[c] = a[slot[c]] + offset;
   }
}
API void dnt_pool_score_back(const float *ds, const int32_t *table, size_t width, const int32_t *degree,
                             const int64_t *members, const int32_t *slot, size_t m, const float *softmax,
                             const float *gscore, float *gds)
{
   for (size_t c = 0; c < m; c++) { /* a few numbers a node: one thread */
      size_t i = (size_t)members[2 * c], k = (size_t)degree[i];
      const int32_t *ring = table + i * width;
      const float *a = softmax + c * width;
      if (slot[c] == 0) continue;
      for (size_t q = 1; q < k; q++) {
         float de = gscore[c] * a[slot[c]] * ((q == (size_t)slot[c] ? 1.0f : 0.0f) - a[q]);
         de *= ds[2 * i] + ds[2 * (size_t)ring[q] + 1] > 0 ? 1 : SLOPE;
         gds[2 * i] += de;
         gds[2 * (size_t)ring[q] + 1] += de;
      }
   }
}
