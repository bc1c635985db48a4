/*  kit.c - the parts of >>kit against what is known without other people's data: closed forms, brute force, bad files
    build     cc -g -fsanitize=address,undefined kit.c -o kit -lm
    run       ./kit [part of a test's name] */
#define DEFORMNET_IMPLEMENTATION
#include "../deformnet.h"
#include "test.h"
#include "tiny.h"
#include <math.h>

/* a parallel loop that runs its ranges backwards, one grain each: what depends on the order shows */
static void backwards(void *user, size_t count, size_t grain, dn_range_fn *fn, void *job)
{
   size_t ranges = (count + grain - 1) / grain, r;
   (void)user;
   for (r = ranges; r-- > 0;) fn(job, r * grain, (r + 1) * grain < count ? (r + 1) * grain : count, (unsigned)(r % 3));
}
static dn_parallel backwards_of(void)
{
   dn_parallel p;
   memset(&p, 0, sizeof p);
   p.run = backwards;
   p.workers = 3;
   return p;
}

/* --- meshes */
typedef struct made { float *p; uint32_t *t; size_t v, n; } made; /* v vertices, n triangles */
static void made_free(made *m) { free(m->p), free(m->t); }
/* a ball of rings x sides quads between two poles, radius r about c, stretched along y */
static made ball(size_t rings, size_t sides, float radius, float stretch, float cx, float cy, float cz)
{
   made m;
   size_t i, j, k = 0;
   m.v = (rings - 1) * sides + 2;
   m.n = 2 * sides * (rings - 1);
   m.p = (float *)test_block(12 * m.v);
   m.t = (uint32_t *)test_block(12 * m.n);
   for (i = 1; i < rings; i++)
      for (j = 0; j < sides; j++) {
         double a = 3.14159265358979 * (double)i / (double)rings, b = 6.28318530717959 * (double)j / (double)sides;
         float *p = m.p + 3 * ((i - 1) * sides + j);
         p[0] = cx + radius * (float)(sin(a) * cos(b));
         p[1] = cy + radius * stretch * (float)cos(a);
         p[2] = cz - radius * (float)(sin(a) * sin(b));
      }
   for (i = 0; i < 2; i++) {
      float *p = m.p + 3 * (m.v - 2 + i);
      p[0] = cx, p[1] = cy + (i ? -1.0f : 1.0f) * radius * stretch, p[2] = cz;
   }
   for (j = 0; j < sides; j++) {
      size_t s = (j + 1) % sides;
      m.t[k++] = (uint32_t)(m.v - 2), m.t[k++] = (uint32_t)j, m.t[k++] = (uint32_t)s;
      m.t[k++] = (uint32_t)(m.v - 1), m.t[k++] = (uint32_t)((rings - 2) * sides + s), m.t[k++] = (uint32_t)((rings - 2) * sides + j);
      for (i = 0; i + 2 < rings; i++) {
         uint32_t a = (uint32_t)(i * sides + j), b = (uint32_t)(i * sides + s), c = (uint32_t)((i + 1) * sides + j), d = (uint32_t)((i + 1) * sides + s);
         m.t[k++] = a, m.t[k++] = c, m.t[k++] = b;
         m.t[k++] = b, m.t[k++] = c, m.t[k++] = d;
      }
   }
   return m;
}
static dn_graph graph_of(const made *m, uint32_t **first, uint32_t **next)
{
   dn_graph g;
   void *scratch = test_aligned(dn_graph_scratch(m->v, m->n));
   *first = (uint32_t *)test_block(4 * (m->v + 1));
   *next = (uint32_t *)test_block(24 * m->n);
   dn_graph_build(m->t, m->n, m->v, *first, *next, &g, scratch);
   test_aligned_free(scratch);
   return g;
}
static float *cloud(size_t n, float size, uint64_t *seed)
{
   float *p = (float *)test_block(12 * n);
   size_t i;
   for (i = 0; i < 3 * n; i++) p[i] = test_uniform(seed, -size, size);
   return p;
}

/* --- association */
static size_t associate_is(const float *body, size_t b, const float *points, size_t n)
{
   uint32_t *fast = (uint32_t *)test_block(4 * n), *again = (uint32_t *)test_block(4 * n), *plain = (uint32_t *)test_block(4 * n);
   void *scratch = test_aligned(dn_associate_scratch(b));
   dn_parallel p = backwards_of();
   dn_associate(body, b, points, n, fast, scratch, NULL);
   memset(scratch, 0xa5, dn_associate_scratch(b));
   dn_associate(body, b, points, n, again, scratch, &p);
   dn_associate_ref(body, b, points, n, plain);
   CHECK(memcmp(fast, plain, 4 * n) == 0);
   CHECK(memcmp(fast, again, 4 * n) == 0);
   test_aligned_free(scratch);
   free(fast), free(again), free(plain);
   return n;
}
TEST(association_equals_every_pair)
{
   static const float sizes[] = {1e-3f, 1.0f, 300.0f};
   uint64_t seed = 1;
   size_t done = 0, k, i;
   for (k = 0; k < 12; k++) {
      size_t b = 1 + test_random(&seed) % 900, n = 300;
      float *body = cloud(b, sizes[k % 3], &seed), *points = cloud(n, sizes[k % 3] * (k < 6 ? 1.0f : 4.0f), &seed);
      if (k == 3) for (i = 0; i < b; i++) body[3 * i + 1] = 0.25f;                  /* flat */
      if (k == 4) for (i = 0; i < b; i++) body[3 * i + 1] = body[3 * i] = 0.0f;     /* a line */
      if (k == 5) for (i = 0; i < 3 * b; i++) body[i] = 1.0f;                       /* one place */
      if (k == 7) body[0] = 1e6f;                                                   /* one far away: all others share a cell */
      if (k == 8) for (i = 0; i < b; i++) memcpy(body + 3 * i, body + 3 * (i % 7), 12); /* each place many times */
      if (k == 9) for (i = 0; i < 3 * b; i++) body[i] = (float)(int)(4.0f * body[i]) * 0.25f; /* a lattice: ties */
      if (k == 9) for (i = 0; i < 3 * n; i++) points[i] = (float)(int)(8.0f * points[i]) * 0.125f;
      if (k == 10) for (i = 0; i < 3 * b; i++) body[i] += 1000.0f;
      for (i = 0; i < n && i < b; i += 3) memcpy(points + 3 * i, body + 3 * i, 12); /* on top of a node */
      done += associate_is(body, b, points, n);
      free(body), free(points);
   }
   {
      made m = ball(40, 40, 1.0f, 1.7f, 0, 0, 0);
      done += associate_is(m.p, m.v, m.p, m.v); /* each is its own, the poles too */
      made_free(&m);
   }
   AT_LEAST(done, 5000, "points");
}
TEST(association_of_coincident_nodes_is_the_lowest)
{
   float body[5][3] = {{9, 9, 9}, {1, 2, 3}, {1, 2, 3}, {0, 0, 0}, {1, 2, 3}}, point[3] = {1, 2, 3};
   uint32_t nearest = 99;
   void *scratch = test_aligned(dn_associate_scratch(5));
   dn_associate(body[0], 5, point, 1, &nearest, scratch, NULL);
   CHECK(nearest == 1);
   test_aligned_free(scratch);
}
TEST(association_keeps_its_time) /* 13,000 x 5,000 under 20 ms; ten times that under sanitizers and on busy machines */
{
   made body = ball(115, 115, 0.5f, 2.0f, 0, 0, 0), cloth = ball(71, 71, 0.51f, 2.0f, 0, 0, 0);
   uint32_t *nearest = (uint32_t *)test_block(4 * cloth.v);
   void *scratch = test_aligned(dn_associate_scratch(body.v));
   double best = 1e9;
   int k;
   for (k = 0; k < 5; k++) {
      clock_t start = clock();
      double ms;
      dn_associate(body.p, body.v, cloth.p, cloth.v, nearest, scratch, NULL);
      ms = 1e3 * (double)(clock() - start) / CLOCKS_PER_SEC;
      if (ms < best) best = ms;
   }
   CHECK_MSG(best < 200, "%.1f ms", best);
   AT_LEAST(body.v, 13000, "nodes");
   AT_LEAST(cloth.v, 4900, "points");
   test_aligned_free(scratch);
   free(nearest);
   made_free(&body), made_free(&cloth);
}

/* --- even selection and smoothing */
TEST(even_selection_by_its_definition)
{
   uint64_t seed = 7;
   size_t wanted, done = 0;
   made m = ball(24, 30, 1.0f, 1.3f, 0.2f, -0.1f, 0);
   double area = dn_area(m.p, m.t, m.n);
   uint32_t *got = (uint32_t *)test_block(4 * m.v), *want = (uint32_t *)test_block(4 * m.v);
   void *scratch = test_aligned(dn_even_selection_scratch(m.v));
   size_t i;
   for (i = 0; i < 3 * m.v; i++) m.p[i] += test_uniform(&seed, -0.02f, 0.02f);
   for (wanted = 0; wanted <= m.v; wanted += 37) {
      unsigned c, spacing = 0;
      size_t n = 0, k;
      CHECK(dn_even_selection(m.p, m.v, area, wanted, got, &spacing, scratch, NULL) == DN_OK);
      for (c = 1; wanted && c <= 4096 && n < wanted; c++) { /* as spec section 5 words it */
         for (n = i = 0; i < m.v; i++) {
            int taken = 0;
            for (k = 0; k < n && !taken; k++) {
               double x = (double)m.p[3 * i] - (double)m.p[3 * want[k]], y = (double)m.p[3 * i + 1] - (double)m.p[3 * want[k] + 1];
               double z = (double)m.p[3 * i + 2] - (double)m.p[3 * want[k] + 2];
               taken = sqrt(x * x + y * y + z * z) < sqrt(area / ((double)c * (double)wanted));
            }
            if (!taken) want[n++] = (uint32_t)i;
         }
      }
      if (wanted) CHECK_MSG(spacing == c - 1 && memcmp(got, want, 4 * wanted) == 0, "%lu wanted: C %u, expected %u", (unsigned long)wanted, spacing, c - 1);
      done++;
   }
   {
      dn_error e;
      CHECK(dn_even_selection(m.p, 10, area, 11, got, NULL, scratch, &e) == DN_BAD_MESH && strstr(e.info, "10") && strstr(e.info, "11"));
   }
   for (i = 0; i < 3 * m.v; i++) m.p[i] = 0.5f; /* coincident nodes: nothing is rejected in the end */
   {
      unsigned spacing = 0;
      CHECK(dn_even_selection(m.p, m.v, area, 20, got, &spacing, scratch, NULL) == DN_OK && spacing == 4097);
      for (i = 0; i < 20; i++) CHECK(got[i] == i);
      CHECK(dn_even_selection(m.p, m.v, 0.0, 20, got, &spacing, scratch, NULL) == DN_OK && spacing == 4097);
      CHECK(dn_even_selection(m.p, m.v, (double)NAN, 20, got, &spacing, scratch, NULL) == DN_OK && spacing == 4097);
   }
   AT_LEAST(done, 15, "selections");
   test_aligned_free(scratch);
   free(got), free(want);
   made_free(&m);
}
TEST(areas)
{
   made m = ball(100, 100, 1.0f, 1.0f, 0, 0, 0);
   float p[9] = {0, 0, 0, 3, 0, 0, 0, 4, 0};
   uint32_t t[6] = {0, 1, 2, 1, 1, 2};
   CHECK(dn_area(p, t, 2) == 6.0);
   CHECK(dn_area(p, t, 0) == 0.0);
   CHECK(fabs(dn_area(m.p, m.t, m.n) - 4 * 3.14159265) < 0.01);
   made_free(&m);
}
TEST(smoothing_on_a_ring) /* x_i = cos(2 pi k i / n) is multiplied by 1 - f (1 - cos(2 pi k / n)) each time */
{
   enum { N = 24 };
   uint32_t t[3 * N];
   float p[3 * (N + 1)], q[3 * (N + 1)], spare[3 * (N + 1)];
   uint32_t *first, *next;
   made m;
   dn_graph g;
   dn_parallel par = backwards_of();
   size_t i, k, iterations;
   for (i = 0; i < N; i++) t[3 * i] = (uint32_t)i, t[3 * i + 1] = t[3 * i + 2] = (uint32_t)((i + 1) % N); /* edges */
   m.p = p, m.t = t, m.v = N + 1, m.n = N; /* and a node alone */
   g = graph_of(&m, &first, &next);
   for (iterations = 0; iterations <= 41; iterations++) {
      for (i = 0; i < N; i++)
         for (k = 0; k < 3; k++) p[3 * i + k] = (float)cos(6.283185307 * (double)((k + 1) * i) / N);
      p[3 * N] = 5, p[3 * N + 1] = -6, p[3 * N + 2] = 7;
      memcpy(q, p, sizeof q);
      dn_smooth(&g, p, (unsigned)iterations, 0.12f, spare, NULL);
      dn_smooth(&g, q, (unsigned)iterations, 0.12f, spare, &par);
      CHECK(memcmp(p, q, sizeof p) == 0);
      for (i = 0; i < N; i++)
         for (k = 0; k < 3; k++) {
            double want = cos(6.283185307 * (double)((k + 1) * i) / N) * pow(1 - 0.12 * (1 - cos(6.283185307 * (double)(k + 1) / N)), (double)iterations);
            CHECK(fabs((double)p[3 * i + k] - want) < 1e-5);
         }
      CHECK(p[3 * N] == 5 && p[3 * N + 1] == -6 && p[3 * N + 2] == 7);
   }
   free(first), free(next);
}

/* --- factor analysis */
TEST(logarithm)
{
   uint64_t seed = 3;
   double worst = 0;
   size_t k;
   for (k = 0; k < 20000; k++) {
      double x = exp((double)test_uniform(&seed, -300.0f, 300.0f) * (k % 2 ? 1.0 : 1e-3)), e = fabs(dn__log(x) - log(x));
      double share = e / (fabs(log(x)) > 0.3 ? 3e-16 * fabs(log(x)) : 1e-16);
      if (!(share <= worst)) worst = share;
   }
   CHECK_MSG(worst <= 1, "%.2f of the stated error", worst);
   CHECK(dn__log(1.0) == 0.0);
   AT_LEAST(k, 20000, "values");
}
TEST(eigenvectors)
{
   static const size_t sizes[] = {1, 2, 3, 5, 16, 47, 90};
   uint64_t seed = 5;
   size_t s, i, j, k, kind, done = 0;
   for (kind = 0; kind < 4; kind++) /* random, rank 2, diagonal, all one number */
      for (s = 0; s < sizeof sizes / sizeof *sizes; s++) {
         size_t n = sizes[s];
         double *a = (double *)test_block(8 * n * n), *b = (double *)test_block(8 * n * n), *z = (double *)test_block(8 * n * n), *r = (double *)test_block(32 * n);
         double size = 0;
         for (i = 0; i < n; i++)
            for (j = 0; j <= i; j++) {
               double x = (double)test_uniform(&seed, -1, 1);
               if (kind == 1) x = (double)((i + 1) * (j + 1)) + ((i + j) % 2 ? -1.0 : 1.0);
               if (kind == 2 && i != j) x = 0;
               if (kind == 3) x = i == j ? 3.0 : 0.0;
               a[i * n + j] = a[j * n + i] = b[i * n + j] = b[j * n + i] = x;
               size += x * x;
            }
         dn__eigen(b, n, r, z, r + n, r + 2 * n, r + 3 * n);
         size = sqrt(size) + 1e-300;
         for (i = 0; i < n; i++) {
            CHECK(i == 0 || r[i - 1] >= r[i]);
            for (j = 0; j < n; j++) {
               double dot = 0, row = 0;
               for (k = 0; k < n; k++) dot += z[i * n + k] * z[j * n + k], row += a[j * n + k] * z[i * n + k];
               CHECK_MSG(fabs(dot - (i == j)) < 1e-12, "kind %lu, n %lu: z %lu . z %lu = %g", (unsigned long)kind, (unsigned long)n, (unsigned long)i, (unsigned long)j, dot);
               CHECK_MSG(fabs(row - r[i] * z[i * n + j]) < 1e-12 * size, "kind %lu, n %lu: A z = %g, l z = %g", (unsigned long)kind, (unsigned long)n, row, r[i] * z[i * n + j]);
            }
         }
         done += n;
         free(a), free(b), free(z), free(r);
      }
   AT_LEAST(done, 600, "eigenvectors");
}
/* distances made from known factors plus noise */
static float *factor_data(size_t rows, size_t pairs, size_t factors, float noise, uint64_t *seed)
{
   float *d = (float *)test_block(4 * rows * pairs), *l = (float *)test_block(4 * rows * factors), *a = (float *)test_block(4 * pairs * factors);
   size_t i, j, k;
   for (i = 0; i < rows * factors; i++) l[i] = test_uniform(seed, -1, 1);
   for (i = 0; i < pairs * factors; i++) a[i] = test_uniform(seed, -1.7f, 1.7f);
   for (i = 0; i < rows; i++)
      for (j = 0; j < pairs; j++) {
         float sum = 0.3f + 0.1f * (float)i;
         for (k = 0; k < factors; k++) sum += l[i * factors + k] * a[j * factors + k] / (float)(k + 1);
         d[i * pairs + j] = 0.01f * (sum + (noise + 0.2f * (float)(i % 5)) * (test_uniform(seed, -1, 1) + test_uniform(seed, -1, 1)));
      }
   free(l), free(a);
   return d;
}
typedef struct fit { dn_factor_desc q; float *mean, *loading, *noise, *projection, *alpha; double *history; } fit;
static dn_result fit_run(fit *f, const float *d, size_t rows, size_t pairs, size_t factors, const float *start, dn_error *e)
{
   size_t bytes = dn_factor_scratch(rows, pairs, factors);
   void *scratch = test_aligned(bytes);
   dn_result r;
   memset(f, 0, sizeof *f);
   f->q.distances = d, f->q.rows = rows, f->q.pairs = pairs, f->q.factors = factors, f->q.start = start;
   f->q.mean = f->mean = (float *)test_block(4 * rows);
   f->q.loading = f->loading = (float *)test_block(4 * rows * factors);
   f->q.noise = f->noise = (float *)test_block(4 * rows);
   f->q.projection = f->projection = (float *)test_block(4 * rows * factors);
   f->q.alpha = f->alpha = (float *)test_block(4 * pairs * factors);
   f->q.history = f->history = (double *)test_block(8 * 20000);
   f->q.history_count = 20000;
   r = dn_factor_fit(&f->q, scratch, bytes, e);
   test_aligned_free(scratch);
   return r;
}
static void fit_free(fit *f) { free(f->mean), free(f->loading), free(f->noise), free(f->projection), free(f->alpha), free(f->history); }

TEST(factor_likelihood_never_falls)
{
   static const size_t sizes[][3] = {{12, 60, 2}, {60, 20, 3}, {30, 30, 5}, {5, 400, 1}, {40, 9, 8}, {1, 10, 1}, {7, 7, 7}};
   uint64_t seed = 11;
   size_t s, k, rounds = 0;
   for (s = 0; s < sizeof sizes / sizeof *sizes; s++) {
      float *d = factor_data(sizes[s][0], sizes[s][1], sizes[s][2] > 3 ? 3 : sizes[s][2], 0.05f, &seed);
      fit f;
      dn_error e;
      if (CHECK_MSG(fit_run(&f, d, sizes[s][0], sizes[s][1], sizes[s][2], NULL, &e) == DN_OK, "%s", e.info)) {
         CHECK(f.q.rounds >= 2 && f.q.log_likelihood == f.history[f.q.rounds - 1]);
         for (k = 1; k < f.q.rounds; k++) /* rounding may take 1e-12 of it, which is where the fit ends */
            CHECK_MSG(f.history[k] >= f.history[k - 1] - 1e-12 * fabs(f.history[k]), "case %lu, round %lu: %.17g after %.17g", (unsigned long)s,
                      (unsigned long)k, f.history[k], f.history[k - 1]);
         rounds += f.q.rounds;
      }
      fit_free(&f);
      free(d);
   }
   AT_LEAST(rounds, 100, "rounds");
}
/* log-likelihood of mean, L and Psi from their definition: a Cholesky factor of L L^T + Psi */
static double likelihood(const float *d, size_t rows, size_t pairs, size_t factors, const fit *f)
{
   double *c = (double *)test_block(8 * rows * rows), *x = (double *)test_block(8 * rows), sum = 0;
   size_t i, j, k;
   for (i = 0; i < rows; i++)
      for (j = 0; j < rows; j++) {
         c[i * rows + j] = i == j ? (double)f->noise[i] : 0;
         for (k = 0; k < factors; k++) c[i * rows + j] += (double)f->loading[i * factors + k] * (double)f->loading[j * factors + k];
      }
   for (j = 0; j < rows; j++) {
      for (k = 0; k < j; k++) c[j * rows + j] -= c[j * rows + k] * c[j * rows + k];
      c[j * rows + j] = sqrt(c[j * rows + j]);
      sum += (double)pairs * (2 * log(c[j * rows + j]) + log(6.283185307179586));
      for (i = j + 1; i < rows; i++) {
         for (k = 0; k < j; k++) c[i * rows + j] -= c[i * rows + k] * c[j * rows + k];
         c[i * rows + j] /= c[j * rows + j];
      }
   }
   for (k = 0; k < pairs; k++)
      for (i = 0; i < rows; i++) {
         x[i] = (double)d[i * pairs + k] - (double)f->mean[i];
         for (j = 0; j < i; j++) x[i] -= c[i * rows + j] * x[j];
         x[i] /= c[i * rows + i];
         sum += x[i] * x[i];
      }
   free(c), free(x);
   return -0.5 * sum / (double)pairs;
}
TEST(factor_likelihood_by_definition_and_at_its_top)
{
   uint64_t seed = 21;
   size_t k, tried = 0;
   float *d = factor_data(14, 50, 2, 0.05f, &seed);
   fit f;
   if (CHECK(fit_run(&f, d, 14, 50, 2, NULL, NULL) == DN_OK)) {
      double top = likelihood(d, 14, 50, 2, &f), other;
      CHECK_MSG(fabs(top - f.q.log_likelihood) < 1e-4, "%.9g by definition, %.9g said", top, f.q.log_likelihood);
      for (k = 0; k < 14 * 3; k++) { /* no single number can be changed for the better */
         float *x = k < 28 ? f.loading + k : f.noise + k - 28, keep = *x;
         int up;
         for (up = 0; up < 2; up++) {
            *x = keep * (up ? 1.01f : 0.99f);
            other = likelihood(d, 14, 50, 2, &f);
            CHECK_MSG(other <= top + 1e-6, "number %lu: %.9g over %.9g", (unsigned long)k, other, top);
            tried++;
         }
         *x = keep;
      }
   }
   fit_free(&f);
   free(d);
   AT_LEAST(tried, 80, "changes");
}
TEST(factor_projection_equals_a_direct_solve)
{
   uint64_t seed = 31;
   size_t rows = 40, pairs = 25, n = 3, i, j, k, c, done = 0;
   float *d = factor_data(rows, pairs, n, 0.05f, &seed), alpha[3];
   fit f;
   if (CHECK(fit_run(&f, d, rows, pairs, n, NULL, NULL) == DN_OK))
      for (c = 0; c < pairs; c++) { /* (I + L^T Psi^-1 L) alpha = L^T Psi^-1 (d - mean), by elimination */
         double m[3][4];
         float column[40];
         for (i = 0; i < rows; i++) column[i] = d[i * pairs + c];
         for (j = 0; j < n; j++)
            for (k = 0; k <= n; k++) {
               m[j][k] = j == k;
               for (i = 0; i < rows; i++)
                  m[j][k] += (double)f.loading[i * n + j] / (double)f.noise[i] * (k < n ? (double)f.loading[i * n + k] : (double)column[i] - (double)f.mean[i]);
            }
         for (j = 0; j < n; j++)
            for (i = 0; i < n; i++) {
               double by = i == j ? 0 : m[i][j] / m[j][j];
               for (k = 0; k <= n; k++) m[i][k] -= by * m[j][k];
            }
         dn_factor_project(f.projection, f.mean, column, rows, n, alpha);
         for (j = 0; j < n; j++) {
            double want = m[j][3] / m[j][j];
            CHECK_MSG(fabs((double)alpha[j] - want) < 1e-5, "%.8g, solved %.8g", (double)alpha[j], want);
            CHECK(fabs((double)f.alpha[j * pairs + c] - want) < 1e-5);
            done++;
         }
      }
   fit_free(&f);
   free(d);
   AT_LEAST(done, 75, "factors");
}
TEST(factor_starts_agree)
/* On data that determine the fit: many pairs, no row nearly without noise. Elsewhere starts need not agree: where the
   likelihood is nearly flat the rule by which a fit ends stops it early (with noise from 0.05 here L was seen to differ by
   a hundredth of its largest entry), and with more factors than stand out it has several tops. */
{
   static const size_t sizes[][3] = {{24, 200, 3}, {40, 160, 2}, {30, 250, 3}};
   uint64_t seed = 41;
   size_t s, k, starts, agreed = 0;
   for (s = 0; s < sizeof sizes / sizeof *sizes; s++) {
      size_t rows = sizes[s][0], pairs = sizes[s][1], n = sizes[s][2];
      float *d = factor_data(rows, pairs, n, 0.4f, &seed), start[40];
      fit f;
      if (CHECK(fit_run(&f, d, rows, pairs, n, NULL, NULL) == DN_OK))
         for (starts = 0; starts < 4; starts++) {
            fit g;
            for (k = 0; k < rows; k++) start[k] = test_uniform(&seed, 0.1f, 4.0f) * (starts < 2 ? 1e-4f : f.noise[k]);
            if (CHECK(fit_run(&g, d, rows, pairs, n, start, NULL) == DN_OK)) {
               float most = 0, noise = 0, alpha = 0, worst = 0;
               CHECK(fabs(f.q.log_likelihood - g.q.log_likelihood) < 1e-9 * fabs(f.q.log_likelihood));
               for (k = 0; k < rows * n; k++) most = fabsf(f.loading[k]) > most ? fabsf(f.loading[k]) : most;
               for (k = 0; k < rows; k++) noise = f.noise[k] > noise ? f.noise[k] : noise;
               for (k = 0; k < pairs * n; k++) alpha = fabsf(f.alpha[k]) > alpha ? fabsf(f.alpha[k]) : alpha;
               for (k = 0; k < rows * n; k++) worst = fmaxf(worst, fabsf(f.loading[k] - g.loading[k]) / most);
               for (k = 0; k < rows; k++) worst = fmaxf(worst, fabsf(f.noise[k] - g.noise[k]) / noise);
               for (k = 0; k < pairs * n; k++) worst = fmaxf(worst, fabsf(f.alpha[k] - g.alpha[k]) / alpha);
               CHECK_MSG(worst < 1e-4f, "%lu x %lu, start %lu: L, Psi or alpha %g of the largest entry apart", (unsigned long)rows, (unsigned long)pairs, (unsigned long)starts, (double)worst);
               agreed++;
            }
            fit_free(&g);
         }
      fit_free(&f);
      free(d);
   }
   AT_LEAST(agreed, 12, "starts");
}
static int stop_at_three(void *user, const char *stage, float done) { (void)stage, (void)done; return ++*(int *)user == 3; }
TEST(factor_odd_inputs)
{
   uint64_t seed = 51;
   float *d = factor_data(6, 8, 2, 0.05f, &seed), start[6] = {1, 1, 1, 0, 1, 1};
   size_t k, bytes = dn_factor_scratch(6, 8, 2);
   void *scratch = test_aligned(bytes);
   dn_progress progress;
   int steps = 0;
   dn_error e;
   fit f;
   CHECK(fit_run(&f, d, 0, 8, 1, NULL, &e) == DN_BAD_SHAPE), fit_free(&f);
   CHECK(fit_run(&f, d, 6, 1, 1, NULL, &e) == DN_BAD_SHAPE && strstr(e.info, "1 pairs")), fit_free(&f);
   CHECK(fit_run(&f, d, 6, 8, 0, NULL, &e) == DN_BAD_SHAPE), fit_free(&f);
   CHECK(fit_run(&f, d, 6, 8, 7, NULL, &e) == DN_BAD_SHAPE && strstr(e.info, "7")), fit_free(&f);
   CHECK(fit_run(&f, d, 6, 8, 2, start, &e) == DN_BAD_VALUE && strstr(e.info, "start 3")), fit_free(&f);
   CHECK(dn_factor_scratch(SIZE_MAX / 8, 9, 2) == SIZE_MAX);
   for (k = 0; k < 8; k++) d[8 + k] = 0.75f; /* a row that never changes: its noise is the floor, its loading 0 */
   if (CHECK(fit_run(&f, d, 6, 8, 2, NULL, &e) == DN_OK)) {
      CHECK(f.noise[1] > 0 && f.noise[1] < 2e-12f && fabsf(f.loading[2]) < 1e-15f && fabsf(f.loading[3]) < 1e-15f && f.mean[1] == 0.75f);
      for (k = 0; k < 12; k++) CHECK(test_finite(f.projection[k]));
   }
   memset(&progress, 0, sizeof progress);
   progress.step = stop_at_three, progress.user = &steps;
   f.q.progress = &progress;
   memset(f.mean, 0xff, 24);
   CHECK(dn_factor_fit(&f.q, scratch, bytes, &e) == DN_CANCELLED && f.q.rounds == 3 && test_finite(f.mean[5]));
   CHECK(dn_factor_fit(&f.q, scratch, bytes - 1, &e) == DN_TOO_SMALL);
   d[17] = NAN;
   CHECK(dn_factor_fit(&f.q, scratch, bytes, &e) == DN_BAD_VALUE && strstr(e.info, "row 2, pair 1"));
   fit_free(&f);
   for (k = 0; k < 48; k++) d[k] = 0.5f; /* all rows constant */
   if (CHECK(fit_run(&f, d, 6, 8, 2, NULL, &e) == DN_OK))
      for (k = 0; k < 12; k++) CHECK(f.loading[k] == 0 && f.projection[k] == 0);
   fit_free(&f);
   test_aligned_free(scratch);
   free(d);
}

/* --- surfaces */
static dn_surface surface_of(const made *m, void **memory)
{
   dn_surface s;
   *memory = test_aligned(dn_surface_size(m->v, m->n));
   dn_surface_build(&s, m->p, m->v, m->t, m->n, *memory);
   return s;
}
TEST(distance_equals_every_triangle)
{
   static const size_t sizes[][2] = {{2, 3}, {3, 4}, {5, 9}, {30, 40}};
   uint64_t seed = 61;
   size_t s, k, done = 0;
   for (s = 0; s < 8; s++) {
      made m = ball(sizes[s % 4][0], sizes[s % 4][1], 1.0f, 1.4f, 0, 0, 0);
      dn_surface f;
      void *memory;
      if (s >= 4) /* crumpled, and a tenth of the triangles without area */
         for (k = 0; k < 3 * m.v; k++) m.p[k] += test_uniform(&seed, -0.1f, 0.1f);
      for (k = 0; s >= 4 && k < m.n; k += 10) m.t[3 * k + 1] = m.t[3 * k];
      f = surface_of(&m, &memory);
      for (k = 0; k < 400; k++) {
         float p[3], c[3], n[3], c2[3], n2[3], d, d2;
         int i;
         for (i = 0; i < 3; i++) p[i] = test_uniform(&seed, -2, 2);
         if (k % 9 == 0) memcpy(p, m.p + 3 * (k % m.v), sizeof p); /* on a vertex */
         d = dn_surface_distance(&f, p, c, n);
         d2 = dn_surface_distance_ref(&f, p, c2, n2);
         CHECK(d == d2 && memcmp(c, c2, sizeof c) == 0 && memcmp(n, n2, sizeof n) == 0);
         CHECK(d == dn_surface_distance(&f, p, NULL, NULL));
         for (d2 = 0, i = 0; i < 3; i++) d2 += (p[i] - c[i]) * (p[i] - c[i]);
         CHECK(fabsf(sqrtf(d2) - fabsf(d)) < 2e-6f);
         done++;
      }
      test_aligned_free(memory);
      made_free(&m);
   }
   AT_LEAST(done, 3000, "points");
}
/* inside or outside by counting crossings of a ray: the other way to tell */
static int encloses(const made *m, const float *p)
{
   static const double way[3] = {0.57357644, 0.35836795, 0.7366};
   int crossings = 0, k;
   size_t t;
   for (t = 0; t < m->n; t++) {
      double a[3], u[3], v[3], w[3], h[3], q[3], det, x, y;
      for (k = 0; k < 3; k++) {
         a[k] = (double)m->p[3 * m->t[3 * t] + (uint32_t)k];
         u[k] = (double)m->p[3 * m->t[3 * t + 1] + (uint32_t)k] - a[k];
         v[k] = (double)m->p[3 * m->t[3 * t + 2] + (uint32_t)k] - a[k];
         w[k] = (double)p[k] - a[k];
      }
      h[0] = way[1] * v[2] - way[2] * v[1], h[1] = way[2] * v[0] - way[0] * v[2], h[2] = way[0] * v[1] - way[1] * v[0];
      det = u[0] * h[0] + u[1] * h[1] + u[2] * h[2];
      if (det == 0) continue;
      x = (w[0] * h[0] + w[1] * h[1] + w[2] * h[2]) / det;
      q[0] = w[1] * u[2] - w[2] * u[1], q[1] = w[2] * u[0] - w[0] * u[2], q[2] = w[0] * u[1] - w[1] * u[0];
      y = (way[0] * q[0] + way[1] * q[1] + way[2] * q[2]) / det;
      if (x >= 0 && y >= 0 && x + y <= 1 && (v[0] * q[0] + v[1] * q[1] + v[2] * q[2]) / det > 0) crossings++;
   }
   return crossings & 1;
}
TEST(sides_of_closed_surfaces) /* a star of spikes and grooves: edges and corners of every kind are nearest somewhere */
{
   uint64_t seed = 71;
   size_t s, k, done = 0, inside = 0;
   for (s = 0; s < 6; s++) {
      made m = ball(5 + s, 7 + s, 1.0f, 1.0f, 0, 0, 0);
      dn_surface f;
      void *memory;
      for (k = 0; k < m.v; k++) {
         float scale = test_uniform(&seed, 0.35f, 1.4f); /* radial, so that nothing crosses itself */
         m.p[3 * k] *= scale, m.p[3 * k + 1] *= scale, m.p[3 * k + 2] *= scale;
      }
      f = surface_of(&m, &memory);
      for (k = 0; k < 600; k++) {
         float p[3], d;
         int i;
         for (i = 0; i < 3; i++) p[i] = test_uniform(&seed, -1.3f, 1.3f);
         d = dn_surface_distance(&f, p, NULL, NULL);
         if (fabsf(d) < 1e-4f) continue;
         CHECK_MSG((d < 0) == encloses(&m, p), "star %lu, point %lu: distance %g", (unsigned long)s, (unsigned long)k, (double)d);
         inside += d < 0;
         done++;
      }
      test_aligned_free(memory);
      made_free(&m);
   }
   AT_LEAST(done, 3000, "points");
   AT_LEAST(inside, 300, "of them inside");
}
TEST(borders_and_odd_surfaces)
{
   float square[12] = {0, 0, 0, 1, 0, 0, 1, 0, -1, 0, 0, -1}; /* in the plane y = 0, facing +y */
   uint32_t two[6] = {0, 1, 2, 0, 2, 3}, flat[9] = {0, 1, 1, 0, 0, 0, 1, 2, 1};
   float p[3] = {0.5f, -0.25f, -0.25f}, closest[3], normal[3];
   made m;
   dn_surface s;
   void *memory;
   m.p = square, m.t = two, m.v = 4, m.n = 2;
   s = surface_of(&m, &memory);
   CHECK(dn_surface_distance(&s, p, closest, normal) == -0.25f && normal[1] == 1 && closest[1] == 0);
   p[1] = 0.25f;
   CHECK(dn_surface_distance(&s, p, closest, normal) == 0.25f && normal[1] == 1);
   p[0] = 2, p[1] = -0.5f; /* past the border and a little under it */
   CHECK(dn_surface_distance(&s, p, closest, normal) > 1.1f);
   p[0] = 1.1f; /* under it, within 60 degrees of the normal */
   CHECK(dn_surface_distance(&s, p, closest, normal) < -0.5f);
   p[0] = 0.5f, p[1] = 0;
   CHECK(dn_surface_distance(&s, p, closest, normal) == 0 && normal[1] == 1); /* on it */
   test_aligned_free(memory);
   m.t = flat, m.n = 3; /* no triangle has an area: distances, but no inside */
   s = surface_of(&m, &memory);
   p[0] = 0.5f, p[1] = -0.5f, p[2] = 0;
   CHECK(dn_surface_distance(&s, p, closest, normal) == 0.5f);
   test_aligned_free(memory);
   square[1] = NAN; /* triangles that are not finite are not there */
   m.t = two, m.n = 2;
   s = surface_of(&m, &memory);
   CHECK(dn_surface_distance(&s, p, closest, normal) > 1e30f && closest[0] == p[0]);
   test_aligned_free(memory);
}

/* --- collisions */
static size_t collide_checked;
/* one pass in two ways of splitting; the bars of every pass: who was farther out than the margins keeps his bits, and
   nobody is left closer but those counted. Returns the report */
static dn_collision collide_is(const dn_obstacle *o, size_t count, const dn_graph *g, float *p, size_t v)
{
   float *before = (float *)test_copy(p, 12 * v), *other = (float *)test_copy(p, 12 * v), worst = 0;
   size_t bytes = dn_collide_scratch(v), i, k, moved = 0, close = 0;
   void *scratch = test_aligned(bytes);
   dn_parallel par = backwards_of();
   dn_collision r, r2;
   dn_collide(o, count, g, p, v, &r, scratch, NULL);
   memset(scratch, 0x5a, bytes);
   dn_collide(o, count, g, other, v, &r2, scratch, &par);
   CHECK(memcmp(p, other, 12 * v) == 0 && memcmp(&r, &r2, sizeof r) == 0);
   for (i = 0; i < v; i++) {
      int out = 1, good = 1, finite = test_finite(before[3 * i]) && test_finite(before[3 * i + 1]) && test_finite(before[3 * i + 2]);
      for (k = 0; finite && k < count; k++) {
         float d0 = dn_surface_distance(o[k].surface, before + 3 * i, NULL, NULL), d1 = dn_surface_distance(o[k].surface, p + 3 * i, NULL, NULL);
         if (o[k].reach > 0 && d0 < -o[k].reach) continue;
         if (d0 < o[k].margin) out = 0;
         if (d1 < o[k].margin && !(o[k].reach > 0 && d1 < -o[k].reach)) {
            good = 0;
            if (o[k].margin - d1 > worst) worst = o[k].margin - d1;
         }
      }
      if (out) CHECK_MSG(memcmp(p + 3 * i, before + 3 * i, 12) == 0, "vertex %lu was outside and moved", (unsigned long)i);
      moved += !out;
      close += !good;
      collide_checked++;
   }
   CHECK_MSG(r.moved == moved, "%lu moved, expected %lu", (unsigned long)r.moved, (unsigned long)moved);
   CHECK_MSG(r.squeezed == close, "%lu squeezed, found %lu", (unsigned long)r.squeezed, (unsigned long)close);
   CHECK_MSG(fabsf(r.left - worst) < 1e-6f, "%g left, found %g", (double)r.left, (double)worst);
   test_aligned_free(scratch);
   free(before), free(other);
   return r;
}
TEST(collisions_with_a_ball)
{
   made body = ball(30, 40, 1.0f, 1.0f, 0, 0, 0), cloth = ball(25, 36, 1.03f, 1.0f, 0.1f, 0.02f, 0);
   uint32_t *first, *next;
   void *memory;
   dn_surface s = surface_of(&body, &memory);
   dn_graph g = graph_of(&cloth, &first, &next);
   float *alone = (float *)test_copy(cloth.p, 12 * cloth.v), *before = (float *)test_copy(cloth.p, 12 * cloth.v), rough[2] = {0, 0};
   dn_obstacle o;
   dn_collision r, r2;
   size_t i, k, e;
   o.surface = &s, o.margin = 0.01f, o.reach = 0;
   r = collide_is(&o, 1, NULL, alone, cloth.v);
   r2 = collide_is(&o, 1, &g, cloth.p, cloth.v);
   CHECK(r.squeezed == 0 && r2.squeezed == 0 && r.moved == r2.moved && r.inside == r2.inside && r.deepest == r2.deepest);
   CHECK(r.inside > 100 && r.inside < r.moved && r.moved < cloth.v);
   CHECK_MSG(fabsf(r.deepest - 0.07f) < 0.01f && r.farthest > 0.07f && r.farthest < 0.1f, "deepest %g, farthest %g", (double)r.deepest, (double)r.farthest);
   for (i = 0; i < cloth.v; i++) /* alone: along the normal, to the margin and no further */
      if (memcmp(alone + 3 * i, before + 3 * i, 12)) CHECK(fabsf(dn_surface_distance(&s, alone + 3 * i, NULL, NULL) - 0.01f) < 1e-4f);
   for (i = 0; i < cloth.v; i++) /* spread: a neighbour's push differs less */
      for (e = g.first[i]; e < g.first[i + 1]; e++) {
         float a = 0, b = 0;
         for (k = 0; k < 3; k++) {
            size_t x = 3 * i + k, y = 3 * (size_t)g.next[e] + k;
            a += (alone[x] - before[x] - alone[y] + before[y]) * (alone[x] - before[x] - alone[y] + before[y]);
            b += (cloth.p[x] - before[x] - cloth.p[y] + before[y]) * (cloth.p[x] - before[x] - cloth.p[y] + before[y]);
         }
         rough[0] += a, rough[1] += b;
      }
   CHECK_MSG(rough[1] < rough[0], "roughness %g spread, %g alone", (double)rough[1], (double)rough[0]);
   r = collide_is(&o, 1, &g, cloth.p, cloth.v); /* a second pass has nothing to do */
   CHECK(r.moved == 0 && r.inside == 0 && r.farthest == 0 && r.deepest == 0);
   test_aligned_free(memory);
   free(first), free(next), free(alone), free(before);
   made_free(&body), made_free(&cloth);
}
TEST(collisions_in_grooves)
{
   uint64_t seed = 81;
   size_t s, k, moved = 0, squeezed = 0;
   for (s = 0; s < 6; s++) {
      made m = ball(9 + s, 13, 1.0f, 1.0f, 0, 0, 0);
      dn_surface f;
      void *memory;
      dn_obstacle o;
      dn_collision r;
      float *p = cloud(1500, 1.2f, &seed);
      for (k = 0; k < m.v; k++) {
         float scale = test_uniform(&seed, 0.5f, 1.2f);
         m.p[3 * k] *= scale, m.p[3 * k + 1] *= scale, m.p[3 * k + 2] *= scale;
      }
      f = surface_of(&m, &memory);
      o.surface = &f, o.margin = 0.01f, o.reach = 0;
      r = collide_is(&o, 1, NULL, p, 1500);
      CHECK_MSG(r.left <= 2 * o.margin, "a vertex is left %g inside", (double)(r.left - o.margin)); /* none deeper than the margin */
      moved += r.moved, squeezed += r.squeezed;
      test_aligned_free(memory);
      made_free(&m);
      free(p);
   }
   CHECK_MSG(squeezed * 100 <= moved, "%lu of %lu squeezed", (unsigned long)squeezed, (unsigned long)moved);
   AT_LEAST(moved, 1500, "moved");
}
TEST(collisions_in_layers)
{
   made body = ball(24, 32, 1.0f, 1.0f, 0, 0, 0), inner = ball(20, 30, 0.99f, 1.0f, 0.03f, 0, 0), outer = ball(21, 28, 0.98f, 1.0f, -0.04f, 0, 0);
   void *memory, *memory2;
   dn_surface s = surface_of(&body, &memory), under;
   dn_obstacle o[2];
   dn_collision r;
   size_t i;
   inner.n -= inner.n / 2; /* an open half of the inner garment */
   o[0].surface = &s, o[0].margin = 0.01f, o[0].reach = 0;
   collide_is(o, 1, NULL, inner.p, inner.v);
   under = surface_of(&inner, &memory2);
   o[1].surface = &under, o[1].margin = 0.005f, o[1].reach = 0.05f;
   r = collide_is(o, 2, NULL, outer.p, outer.v);
   CHECK(r.moved > 300 && r.squeezed == 0);
   for (i = 0; i < outer.v; i++) {
      float d = dn_surface_distance(&under, outer.p + 3 * i, NULL, NULL);
      CHECK(dn_surface_distance(&s, outer.p + 3 * i, NULL, NULL) >= 0.01f);
      CHECK(d >= 0.005f || d < -0.05f);
   }
   for (i = 0; i < outer.v; i++) outer.p[3 * i] *= 0.5f, outer.p[3 * i + 1] *= 0.5f, outer.p[3 * i + 2] *= 0.5f;
   o[1].reach = 0.2f;
   r = collide_is(o + 1, 1, NULL, outer.p, outer.v); /* all deeper than the garment's reach */
   CHECK(r.moved == 0);
   test_aligned_free(memory), test_aligned_free(memory2);
   made_free(&body), made_free(&inner), made_free(&outer);
}
TEST(collisions_odd_inputs)
{
   made body = ball(12, 16, 1.0f, 1.0f, 0, 0, 0);
   void *memory, *memory2;
   dn_surface s = surface_of(&body, &memory), t;
   float p[9] = {0.5f, 0, 0, NAN, 0, 0, 0, INFINITY, 0};
   dn_obstacle o;
   dn_collision r;
   size_t k;
   CHECK(collide_is(NULL, 0, NULL, p, 3).moved == 0);
   o.surface = &s, o.margin = 0, o.reach = 0; /* a margin of nothing: out, however little */
   r = collide_is(&o, 1, NULL, p, 3);
   CHECK(r.moved == 1 && r.inside == 1 && dn_surface_distance(&s, p, NULL, NULL) >= 0);
   CHECK(!test_finite(p[3]) && !test_finite(p[7]));
   for (k = 0; k < 3 * body.v; k++) body.p[k] = NAN; /* a body that is not finite holds nobody */
   t = surface_of(&body, &memory2);
   o.surface = &t, p[0] = 0.5f;
   CHECK(collide_is(&o, 1, NULL, p, 1).moved == 0 && p[0] == 0.5f);
   for (k = 0; k < 3 * body.v; k++) body.p[k] = 0.25f; /* a body that is one point: its margin is a ball without a side */
   test_aligned_free(memory2);
   t = surface_of(&body, &memory2);
   o.margin = 0.5f, p[0] = p[1] = p[2] = 0.25f;
   r = collide_is(&o, 1, NULL, p, 1);
   CHECK(r.squeezed == r.moved && test_finite(p[0]));
   AT_LEAST(collide_checked, 1000, "vertices in all of these tests");
   test_aligned_free(memory), test_aligned_free(memory2);
   made_free(&body);
}

/* --- shapes: an octahedron on three joints */
enum { V = 6, T = 8, S = 3, B = 2, P = 9 * (S - 1) };
typedef struct writer { char header[8192]; unsigned char data[16384]; size_t used, bytes; } writer;
static void put(writer *w, const char *name, const char *type, const char *shape, const void *data, size_t count, size_t width)
{
   size_t i, k;
   w->used += (size_t)snprintf(w->header + w->used, sizeof w->header - w->used, ",\"%s\":{\"dtype\":\"%s\",\"shape\":[%s],\"data_offsets\":[%lu,%lu]}",
                               name, type, shape, (unsigned long)w->bytes, (unsigned long)(w->bytes + count * width));
   for (i = 0; i < count; i++) {
      uint32_t u;
      memcpy(&u, (const unsigned char *)data + i * width, width);
      for (k = 0; k < width; k++) w->data[w->bytes++] = (unsigned char)(u >> (8 * k));
   }
}
typedef struct body {
   float rest[V * 3], dirs[V * 3 * B], weights[V * S], pose[V * 3 * P], loose[V * 3], joints[S * 3], joint_dirs[S * 3 * B], regressor[S * V];
   int32_t faces[T * 3], parents[S];
   const char *names, *leave_out;
   int regress;
} body;
static void body_make(body *b)
{
   static const float corners[V * 3] = {1, 0, 0, -1, 0, 0, 0, 1, 0, 0, -1, 0, 0, 0, 1, 0, 0, -1};
   static const int32_t faces[T * 3] = {0, 2, 4, 2, 1, 4, 1, 3, 4, 3, 0, 4, 2, 0, 5, 1, 2, 5, 3, 1, 5, 0, 3, 5};
   uint64_t seed = 91;
   size_t i;
   memset(b, 0, sizeof *b);
   memcpy(b->rest, corners, sizeof corners);
   memcpy(b->faces, faces, sizeof faces);
   for (i = 0; i < V * 3 * B; i++) b->dirs[i] = test_uniform(&seed, -0.1f, 0.1f);
   for (i = 0; i < V * 3 * P; i++) b->pose[i] = test_uniform(&seed, -0.01f, 0.01f);
   for (i = 0; i < V * 3; i++) b->loose[i] = corners[i];
   for (i = 0; i < S * 3; i++) b->joints[i] = test_uniform(&seed, -0.5f, 0.5f);
   for (i = 0; i < S * 3 * B; i++) b->joint_dirs[i] = test_uniform(&seed, -0.05f, 0.05f);
   for (i = 0; i < S * V; i++) b->regressor[i] = i % 4 ? test_uniform(&seed, 0, 0.4f) : 0.0f;
   for (i = 0; i < V; i++) b->weights[3 * i + i % 3] = 0.75f, b->weights[3 * i + (i + 1) % 3] = i % 2 ? 0.25f : 0.0f;
   b->parents[0] = -1, b->parents[1] = 0, b->parents[2] = 1;
   b->names = "[\\\"hip\\\", \\\"kn\\\\u00e9e\\\",\\\"foot\\\"]";
}
static int kept(const body *b, const char *name) { return !b->leave_out || strcmp(b->leave_out, name) != 0; }
static unsigned char *body_file(const body *b, size_t *size)
{
   static writer w;
   char more[256];
   w.bytes = 0;
   snprintf(more, sizeof more, "{\"__metadata__\":{\"licence\":\"CC0-1.0\"%s%s%s}", b->names ? ",\"joint_names\":\"" : "", b->names ? b->names : "", b->names ? "\"" : "");
   w.used = (size_t)snprintf(w.header, sizeof w.header, "%s", more);
   if (kept(b, "template")) put(&w, "template", "F32", "6,3", b->rest, V * 3, 4);
   if (kept(b, "faces")) put(&w, "faces", "I32", "8,3", b->faces, T * 3, 4);
   if (kept(b, "shapedirs")) put(&w, "shapedirs", "F32", "6,3,2", b->dirs, V * 3 * B, 4);
   if (kept(b, "weights")) put(&w, "weights", "F32", "6,3", b->weights, V * S, 4);
   if (kept(b, "posedirs")) put(&w, "posedirs", "F32", "6,3,18", b->pose, V * 3 * P, 4);
   if (kept(b, "looseness_dirs")) put(&w, "looseness_dirs", "F32", "6,3", b->loose, V * 3, 4);
   if (kept(b, "parents")) put(&w, "parents", "I32", "3", b->parents, S, 4);
   if (b->regress) put(&w, "joint_regressor", "F32", "3,6", b->regressor, S * V, 4);
   else {
      if (kept(b, "joint_template")) put(&w, "joint_template", "F32", "3,3", b->joints, S * 3, 4);
      if (kept(b, "joint_shapedirs")) put(&w, "joint_shapedirs", "F32", "3,3,2", b->joint_dirs, S * 3 * B, 4);
   }
   w.header[w.used++] = '}';
   w.header[w.used] = 0;
   return tiny_join(w.header, 0, w.data, w.bytes, size);
}
TEST(shape_values)
{
   static const float betas[][B] = {{0, 0}, {1, 0}, {-2, 0.5f}, {0, 3}};
   body b;
   int regress;
   size_t k, v, c, i, done = 0;
   body_make(&b);
   b.weights[0] = -3, b.weights[1] = 0, b.weights[2] = 0;        /* nothing positive: joint 0 */
   b.weights[3] = 0.5f, b.weights[4] = 3, b.weights[5] = 0.5f;   /* normalised, by falling weight */
   for (regress = 0; regress < 2; regress++) {
      size_t size;
      unsigned char *file;
      dn_shape *s;
      dn_shape_view w;
      dn_error e;
      b.regress = regress;
      file = body_file(&b, &size);
      s = dn_shape_load(file, size, NULL, &e);
      memset(file, 0xee, size); /* not kept */
      free(file);
      if (!CHECK_MSG(s != NULL, "%s", e.info)) return;
      dn_shape_describe(s, &w);
      CHECK(w.vertices == V && w.triangles == T && w.joints == S && w.coefficients == B && w.influences == 3);
      CHECK(w.has_looseness && w.has_pose_offsets && w.bytes > 0);
      CHECK(memcmp(w.rest, b.rest, sizeof b.rest) == 0 && memcmp(w.triangle, b.faces, sizeof b.faces) == 0 && memcmp(w.parents, b.parents, sizeof b.parents) == 0);
      CHECK(strcmp(w.joint_names[0], "hip") == 0 && strcmp(w.joint_names[1], "kn\xc3\xa9" "e") == 0 && strcmp(w.joint_names[2], "foot") == 0);
      CHECK(w.skin_joint[0] == 0 && w.skin_weight[0] == 1 && w.skin_joint[2] == 0 && w.skin_weight[2] == 0);
      CHECK(w.skin_joint[3] == 1 && w.skin_weight[3] == 0.75f && w.skin_joint[4] == 0 && w.skin_joint[5] == 2 && w.skin_weight[5] == 0.125f);
      for (k = 0; k < sizeof betas / sizeof *betas; k++) {
         float p[V * 3], q[V * 3], j[S * 3], r[S * 9], looseness = (float)k * 0.1f;
         dn_parallel par = backwards_of();
         dn_shape_evaluate(s, betas[k], B, looseness, p, j, NULL);
         dn_shape_evaluate(s, betas[k], B, looseness, q, NULL, &par);
         CHECK(memcmp(p, q, sizeof p) == 0);
         if (k == 1) dn_shape_evaluate(s, betas[k], 1, looseness, q, NULL, NULL), CHECK(memcmp(p, q, sizeof p) == 0); /* fewer: the others are 0 */
         for (i = 0; i < V * 3; i++) {
            double want = (double)b.rest[i] + (double)(looseness * b.loose[i]);
            for (c = 0; c < B; c++) want += (double)b.dirs[i * B + c] * (double)betas[k][c];
            CHECK(fabs((double)p[i] - want) < 1e-6);
         }
         for (i = 0; i < S * 3; i++) {
            double want = regress ? 0.0 : (double)b.joints[i];
            for (c = 0; c < B && !regress; c++) want += (double)b.joint_dirs[i * B + c] * (double)betas[k][c];
            for (v = 0; v < V && regress; v++) { /* joints = regressor (template + shapedirs beta); looseness is no part of it */
               double x = (double)b.rest[3 * v + i % 3];
               for (c = 0; c < B; c++) x += (double)b.dirs[(3 * v + i % 3) * B + c] * (double)betas[k][c];
               want += (double)b.regressor[i / 3 * V + v] * x;
            }
            CHECK_MSG(fabs((double)j[i] - want) < 1e-6, "joint %lu: %g, expected %g", (unsigned long)i, (double)j[i], want);
         }
         for (i = 0; i < S; i++) {
            float a[3];
            a[0] = 0.3f * (float)(k + i), a[1] = -0.2f * (float)(i * k), a[2] = 0.1f;
            dn_rodrigues(a, r + 9 * i);
         }
         memcpy(q, p, sizeof q);
         dn_shape_pose_offsets(s, r, q, NULL);
         for (i = 0; i < V * 3; i++) {
            double want = (double)p[i];
            for (c = 0; c < P; c++) want += (double)b.pose[i * P + c] * ((double)r[9 + c] - (c % 9 % 4 == 0));
            CHECK_MSG(fabs((double)q[i] - want) < 1e-6, "pose offset %lu: %g, expected %g", (unsigned long)i, (double)q[i], want);
            done++;
         }
      }
      dn_shape_free(s);
   }
   AT_LEAST(done, 140, "coordinates");
}
TEST(shape_without_the_optional)
{
   body b;
   dn_shape_view w;
   dn_shape *s;
   dn_error e;
   size_t size;
   unsigned char *file;
   float p[V * 3], identity[S * 9];
   static const char *const optional[] = {"posedirs", "looseness_dirs", "parents"};
   size_t k;
   memset(identity, 0, sizeof identity);
   for (k = 0; k < 3; k++) {
      body_make(&b);
      b.leave_out = optional[k], b.names = NULL;
      file = body_file(&b, &size);
      s = dn_shape_load(file, size, NULL, &e);
      if (CHECK_MSG(s != NULL, "%s", e.info)) {
         dn_shape_describe(s, &w);
         CHECK(w.joint_names == NULL && w.has_pose_offsets == (k != 0) && w.has_looseness == (k != 1) && (w.parents == NULL) == (k == 2));
         dn_shape_evaluate(s, NULL, 0, 5.0f, p, NULL, NULL);
         CHECK((memcmp(p, b.rest, sizeof p) == 0) == (k == 1));
         if (k == 0) memcpy(p, b.rest, sizeof p), dn_shape_pose_offsets(s, identity, p, NULL), CHECK(memcmp(p, b.rest, sizeof p) == 0);
      }
      dn_shape_free(s);
      free(file);
   }
   dn_shape_free(NULL);
}
/* a file that must be refused, with the code, and a word in the text; nothing may leak */
static size_t shape_refused(const body *b, dn_result code, const char *word)
{
   size_t size;
   unsigned char *file = body_file(b, &size);
   counting c;
   dn_allocator a = counting_allocator(&c, -1);
   dn_error e;
   dn_shape *s = dn_shape_load(file, size, &a, &e);
   if (CHECK_MSG(!s, "accepted, expected a word on %s", word)) {
      CHECK_MSG(e.code == code, "%d (%s), expected %d", (int)e.code, e.info, (int)code);
      CHECK_MSG(strstr(e.info, word) != NULL, "\"%s\" does not say \"%s\"", e.info, word);
   }
   CHECK(c.live == 0 && c.wrong == 0);
   dn_shape_free(s);
   free(file);
   return 1;
}
TEST(shape_files_that_are_wrong)
{
   static const char *const needed[] = {"template", "faces", "shapedirs", "weights"};
   body b;
   size_t k, n = 0;
   for (k = 0; k < 4; k++) body_make(&b), b.leave_out = needed[k], n += shape_refused(&b, DN_MISSING_TENSOR, needed[k]);
   body_make(&b), b.leave_out = "joint_template", n += shape_refused(&b, DN_MISSING_TENSOR, "joint_template");
   body_make(&b), b.leave_out = "joint_shapedirs", n += shape_refused(&b, DN_MISSING_TENSOR, "joint_shapedirs");
   body_make(&b), b.faces[7] = 6, n += shape_refused(&b, DN_BAD_MESH, "found index 6, expected below 6");
   body_make(&b), b.faces[7] = -1, n += shape_refused(&b, DN_BAD_MESH, "triangle 2");
   body_make(&b), b.parents[1] = 1, n += shape_refused(&b, DN_BAD_SKIN, "joint 1");
   body_make(&b), b.parents[0] = 0, n += shape_refused(&b, DN_BAD_SKIN, "joint 0");
   body_make(&b), b.parents[2] = -2, n += shape_refused(&b, DN_BAD_SKIN, "joint 2");
   body_make(&b), b.rest[4] = NAN, n += shape_refused(&b, DN_BAD_VALUE, "template: element 4");
   body_make(&b), b.dirs[9] = INFINITY, n += shape_refused(&b, DN_BAD_VALUE, "shapedirs: element 9");
   body_make(&b), b.weights[5] = NAN, n += shape_refused(&b, DN_BAD_VALUE, "weights: element 5");
   body_make(&b), b.pose[300] = NAN, n += shape_refused(&b, DN_BAD_VALUE, "posedirs: element 300");
   body_make(&b), b.loose[0] = NAN, n += shape_refused(&b, DN_BAD_VALUE, "looseness_dirs");
   body_make(&b), b.joints[2] = NAN, n += shape_refused(&b, DN_BAD_VALUE, "joint_template");
   body_make(&b), b.joint_dirs[2] = NAN, n += shape_refused(&b, DN_BAD_VALUE, "joint_shapedirs");
   body_make(&b), b.regress = 1, b.regressor[17] = NAN, n += shape_refused(&b, DN_BAD_VALUE, "joint_regressor: element 17");
   body_make(&b), b.names = "[\\\"a\\\",\\\"b\\\"]", n += shape_refused(&b, DN_BAD_VALUE, "found 2 names, expected 3");
   body_make(&b), b.names = "[\\\"a\\\",\\\"b\\\",\\\"c\\\"", n += shape_refused(&b, DN_BAD_HEADER, "']'");
   body_make(&b), b.names = "[\\\"a\\\",3]", n += shape_refused(&b, DN_BAD_HEADER, "joint name");
   body_make(&b), b.names = "", n += shape_refused(&b, DN_BAD_HEADER, "'['");
   body_make(&b), b.names = "[\\\"a\\\",\\\"b\\\",\\\"c\\\"] ]", n += shape_refused(&b, DN_BAD_HEADER, "nothing after");
   AT_LEAST(n, 24, "files");
}
TEST(shape_shapes_that_are_wrong) /* every side of every tensor, one more and one less */
{
   static const char *const wrong[][2] = {
      {"\"shape\":[6,3],", "\"shape\":[3,6],"}, {"\"shape\":[6,3],", "\"shape\":[18],"}, {"\"shape\":[8,3],", "\"shape\":[12,2],"},
      {"\"shape\":[6,3,2],", "\"shape\":[6,2,3],"}, {"\"shape\":[6,3,2],", "\"shape\":[3,3,4],"}, {"\"shape\":[6,3,18],", "\"shape\":[6,18,3],"},
      {"\"shape\":[6,3,18],", "\"shape\":[6,3,9,2],"}, {"\"shape\":[6,3,18],", "\"shape\":[6,54],"}, {"\"shape\":[3],", "\"shape\":[1,3],"},
      {"\"shape\":[3,3],", "\"shape\":[9,1],"}, {"\"shape\":[3,3,2],", "\"shape\":[3,2,3],"}, {"\"shape\":[8,3],", "\"shape\":[2,12],"},
      {"I32\",\"shape\":[8", "F32\",\"shape\":[8"}, {"F32\",\"shape\":[6,3,2", "I32\",\"shape\":[6,3,2"}, {"I32\",\"shape\":[3]", "U32\",\"shape\":[3]"}};
   size_t k, n = 0;
   body b;
   body_make(&b);
   for (k = 0; k < sizeof wrong / sizeof *wrong; k++) {
      size_t size, length = 0, i, from = strlen(wrong[k][0]), to = strlen(wrong[k][1]);
      unsigned char *file = body_file(&b, &size), *changed;
      char header[8192], *at;
      dn_error e;
      dn_shape *s;
      for (i = 0; i < 8; i++) length |= (size_t)file[i] << (8 * i);
      memcpy(header, file + 8, length);
      header[length] = 0;
      at = strstr(header, wrong[k][0]);
      if (!CHECK_MSG(at != NULL, "%s is not in the header", wrong[k][0])) return;
      memmove(at + to, at + from, strlen(at + from) + 1);
      memcpy(at, wrong[k][1], to);
      changed = tiny_join(header, 0, file + 8 + length, size - 8 - length, &i);
      s = dn_shape_load(changed, i, NULL, &e);
      CHECK_MSG(!s && (e.code == DN_BAD_SHAPE || e.code == DN_BAD_TYPE) && strchr(e.info, ':'), "%s as %s: %s", wrong[k][0], wrong[k][1], s ? "accepted" : e.info);
      dn_shape_free(s);
      free(file), free(changed);
      n++;
   }
   AT_LEAST(n, 15, "headers");
}
static void shape_survives(const unsigned char *bytes, size_t size, int whole, const char *label, size_t at)
{
   counting c;
   dn_allocator a = counting_allocator(&c, -1);
   unsigned char *file = test_copy(bytes, size); /* a block of its own: its end is guarded */
   dn_error e;
   dn_shape *s;
   e.info[0] = 0, e.code = DN_OK;
   s = dn_shape_load(file, size, &a, &e);
   if (whole >= 0) CHECK_MSG((s != NULL) == whole, "%s %lu: %s", label, (unsigned long)at, s ? "loaded" : e.info);
   if (!s) CHECK_MSG(e.code != DN_OK && e.info[0], "%s %lu: no reason", label, (unsigned long)at);
   CHECK_MSG(c.total <= 8 * size + 4096, "%s %lu: %lu bytes allocated", label, (unsigned long)at, (unsigned long)c.total);
   if (s) { /* what loads must work */
      dn_shape_view w;
      float *p, beta[64];
      size_t k;
      dn_shape_describe(s, &w);
      p = (float *)test_block(12 * (w.vertices + w.joints));
      for (k = 0; k < 64; k++) beta[k] = 0.5f;
      dn_shape_evaluate(s, beta, w.coefficients < 64 ? w.coefficients : 64, 0.1f, p, w.joint_rest ? p + 3 * w.vertices : NULL, NULL);
      for (k = 0; k < w.vertices * w.influences; k++) CHECK(w.skin_joint[k] < w.joints && test_finite(w.skin_weight[k]));
      for (k = 0; k < 3 * w.triangles; k++) CHECK(w.triangle[k] < w.vertices);
      free(p);
   }
   dn_shape_free(s);
   CHECK_MSG(c.live == 0 && c.wrong == 0, "%s %lu: %ld blocks live", label, (unsigned long)at, c.live);
   free(file);
}
TEST(shape_prefixes_flips_and_allocations)
{
   int regress;
   size_t n = 0, size, k, flips = 0, refusals = 0;
   for (regress = 0; regress < 2; regress++) {
      body b;
      unsigned char *file;
      body_make(&b);
      b.regress = regress;
      file = body_file(&b, &size);
      for (k = 0; k <= size; k++, n++) shape_survives(file, k, k == size, "prefix", k);
      for (k = 0; k < size; k++) {
         unsigned char keep = file[k];
         unsigned bit;
         for (bit = 0; bit < 8; bit += k < 1400 ? 1 : 7, flips++) {
            file[k] = (unsigned char)(keep ^ 1u << bit);
            shape_survives(file, size, -1, "flip", k);
         }
         file[k] = keep;
      }
      for (k = 0;; k++, refusals++) { /* the k-th allocation fails */
         counting c;
         dn_allocator a = counting_allocator(&c, (long)k);
         dn_error e;
         dn_shape *s = dn_shape_load(file, size, &a, &e);
         int loaded = s != NULL;
         CHECK(loaded || e.code == DN_NO_MEMORY);
         dn_shape_free(s);
         CHECK(c.live == 0);
         if (loaded) break;
      }
      free(file);
   }
   AT_LEAST(n, 3000, "prefixes");
   AT_LEAST(flips, 20000, "flips");
   AT_LEAST(refusals, 4, "failed allocations");
}
TEST(shape_sizes)
{
   body b;
   size_t size, table, bytes = 0, scratch = 0, k;
   unsigned char *file;
   dn_tensors *t;
   dn_shape *s;
   dn_error e;
   void *m[3];
   body_make(&b);
   b.regress = 1;
   file = body_file(&b, &size);
   CHECK(dn_tensors_size(file, size, &table, &e) == DN_OK);
   m[0] = test_aligned(table);
   CHECK(dn_tensors_open(file, size, m[0], table, &t, &e) == DN_OK && dn_shape_size(t, &bytes, &scratch, &e) == DN_OK);
   m[1] = test_aligned(bytes), m[2] = test_aligned(scratch);
   CHECK(dn_shape_init(t, m[1], bytes - 1, m[2], scratch, &s, &e) == DN_TOO_SMALL && !s && strstr(e.info, "memory"));
   CHECK(dn_shape_init(t, m[1], bytes, m[2], scratch - 1, &s, &e) == DN_TOO_SMALL && !s && strstr(e.info, "scratch"));
   if (CHECK(dn_shape_init(t, m[1], bytes, m[2], scratch, &s, &e) == DN_OK)) {
      dn_shape_view w;
      dn_shape_describe(s, &w);
      CHECK(w.bytes == bytes && w.vertices == V);
      dn_shape_free(s); /* does nothing: the memory is ours */
      CHECK(w.rest[0] == 1.0f);
   }
   for (k = 0; k < 3; k++) test_aligned_free(m[k]);
   free(file);
   CHECK(dn_shape_load_file("build/there is no such file", NULL, &e) == NULL && e.code == DN_IO);
}

int main(int argc, char **argv)
{
   TEST_BEGIN(argc, argv);
   RUN(association_equals_every_pair);
   RUN(association_of_coincident_nodes_is_the_lowest);
   RUN(association_keeps_its_time);
   RUN(even_selection_by_its_definition);
   RUN(areas);
   RUN(smoothing_on_a_ring);
   RUN(logarithm);
   RUN(eigenvectors);
   RUN(factor_likelihood_never_falls);
   RUN(factor_likelihood_by_definition_and_at_its_top);
   RUN(factor_projection_equals_a_direct_solve);
   RUN(factor_starts_agree);
   RUN(factor_odd_inputs);
   RUN(distance_equals_every_triangle);
   RUN(sides_of_closed_surfaces);
   RUN(borders_and_odd_surfaces);
   RUN(collisions_with_a_ball);
   RUN(collisions_in_grooves);
   RUN(collisions_in_layers);
   RUN(collisions_odd_inputs);
   RUN(shape_values);
   RUN(shape_without_the_optional);
   RUN(shape_files_that_are_wrong);
   RUN(shape_shapes_that_are_wrong);
   RUN(shape_prefixes_flips_and_allocations);
   RUN(shape_sizes);
   return TEST_END();
}
