/*  analytic_geodesic.c - volumetric distance and voxel binding where the answer is known

    shows   a box and a ball (convex: the straight line), a U-shaped tube (tangent, arc, tangent), joints outside, parts
            out of reach, meshes without volume, binding; the same bits for every way of sharing the work
    build   cc -O2 analytic_geodesic.c -o analytic_geodesic -lm */
#define DEFORMNET_IMPLEMENTATION
#define DEFORMNET_STATIC
#include "../deformnet.h"
#include "test.h"
#include <math.h>

/* --- meshes */
typedef struct mesh {
   float *p;    /* (nodes,3) */
   uint32_t *t; /* (triangles,3) */
   size_t nodes, triangles;
} mesh;
static mesh mesh_new(size_t nodes, size_t triangles)
{
   mesh m;
   m.p = (float *)test_block(nodes * 3 * sizeof(float));
   m.t = (uint32_t *)test_block(triangles * 3 * sizeof(uint32_t));
   m.nodes = m.triangles = 0;
   return m;
}
static void mesh_free(mesh *m)
{
   free(m->p);
   free(m->t);
}
static void add_node(mesh *m, double x, double y, double z)
{
   float *p = m->p + 3 * m->nodes++;
   p[0] = (float)x;
   p[1] = (float)y;
   p[2] = (float)z;
}
static void add_triangle(mesh *m, size_t a, size_t b, size_t c)
{
   uint32_t *t = m->t + 3 * m->triangles++;
   t[0] = (uint32_t)a;
   t[1] = (uint32_t)b;
   t[2] = (uint32_t)c;
}
#define BOX_NODES(n) (6 * ((n) + 1) * ((n) + 1))
#define BOX_TRIANGLES(n) (12 * (n) * (n))
static void add_box(mesh *m, const double lo[3], const double hi[3], size_t n) /* sides of n x n quads, not welded */
{
   size_t side, i, j, k;
   for (side = 0; side < 6; side++) {
      size_t first = m->nodes, axis = side / 2;
      for (j = 0; j <= n; j++)
         for (i = 0; i <= n; i++) {
            double p[3];
            p[axis] = side % 2 ? hi[axis] : lo[axis];
            for (k = 1; k < 3; k++) {
               size_t a = (axis + k) % 3;
               p[a] = lo[a] + (hi[a] - lo[a]) * (double)(k == 1 ? i : j) / (double)n;
            }
            add_node(m, p[0], p[1], p[2]);
         }
      for (j = 0; j < n; j++)
         for (i = 0; i < n; i++) {
            size_t a = first + j * (n + 1) + i;
            add_triangle(m, a, a + 1, a + n + 2);
            add_triangle(m, a, a + n + 2, a + n + 1);
         }
   }
}
static mesh ball(double radius, size_t rings, size_t round)
{
   mesh m = mesh_new((rings + 1) * round, 2 * rings * round);
   size_t i, j;
   for (i = 0; i <= rings; i++)
      for (j = 0; j < round; j++) {
         double a = 3.14159265358979 * (double)i / (double)rings, b = 6.28318530717959 * (double)j / (double)round;
         add_node(&m, radius * sin(a) * cos(b), radius * cos(a), radius * sin(a) * sin(b));
      }
   for (i = 0; i < rings; i++)
      for (j = 0; j < round; j++) {
         size_t a = i * round + j, b = i * round + (j + 1) % round;
         add_triangle(&m, a, b, b + round);
         add_triangle(&m, a, b + round, a + round);
      }
   return m;
}
/* two legs of length `leg` at x = -bend and +bend, going down from y = 0, joined by a half ring above; tube of radius
   a, ends closed. Ring i has its nodes 0 and round/2 in the plane z = 0: on the outer and on the inner line. */
static mesh u_tube(double bend, double a, double leg, size_t straight, size_t arc, size_t round)
{
   size_t rings = 2 * straight + arc + 1, i, j;
   mesh m = mesh_new(rings * round + 2, 2 * (rings - 1) * round + 2 * round);
   for (i = 0; i < rings; i++) {
      double angle, down, cx, cy, ox, oy;
      if (i < straight) angle = 0.0, down = leg * (1.0 - (double)i / (double)straight);
      else if (i <= straight + arc) angle = 3.14159265358979 * (double)(i - straight) / (double)arc, down = 0.0;
      else angle = 3.14159265358979, down = leg * (double)(i - straight - arc) / (double)straight;
      ox = -cos(angle); /* outwards from the bend's centre */
      oy = sin(angle);
      cx = bend * ox;
      cy = bend * oy - down;
      for (j = 0; j < round; j++) {
         double b = 6.28318530717959 * (double)j / (double)round;
         add_node(&m, cx + a * cos(b) * ox, cy + a * cos(b) * oy, j == 0 || 2 * j == round ? 0.0 : a * sin(b));
      }
   }
   for (i = 0; i + 1 < rings; i++)
      for (j = 0; j < round; j++) {
         size_t p = i * round + j, q = i * round + (j + 1) % round;
         add_triangle(&m, p, q, q + round);
         add_triangle(&m, p, q + round, p + round);
      }
   for (i = 0; i < 2; i++) {
      size_t first = i ? (rings - 1) * round : 0, hub = m.nodes;
      add_node(&m, i ? bend : -bend, -leg, 0.0);
      for (j = 0; j < round; j++) add_triangle(&m, hub, first + j, first + (j + 1) % round);
   }
   return m;
}

/* --- the call */
typedef struct answer {
   float *d; /* (nodes,joints) */
   size_t cells;
   float cell;
   dn_result result;
} answer;
static answer distances(const mesh *m, const float *joints, size_t count, unsigned resolution, const dn_parallel *par,
                        const dn_progress *progress)
{
   answer a;
   size_t bytes = dn_geodesic_scratch(m->p, m->nodes, m->triangles, resolution, par ? par->workers : 1);
   void *scratch = test_aligned(bytes);
   a.d = (float *)test_block(m->nodes * count * sizeof(float));
   memset(a.d, 0xff, m->nodes * count * sizeof(float));
   memset(scratch, 0x7f, bytes); /* what was there must not matter */
   a.cells = 0;
   a.cell = 0.0f;
   a.result = dn_geodesic(m->p, m->nodes, m->t, m->triangles, joints, count, resolution, a.d, &a.cells, &a.cell, scratch, bytes,
                          par, progress);
   test_aligned_free(scratch);
   return a;
}
static double straight(const float *p, const float *q)
{
   double x = (double)p[0] - (double)q[0], y = (double)p[1] - (double)q[1], z = (double)p[2] - (double)q[2];
   return sqrt(x * x + y * y + z * z);
}
/* 3 % + 1 cell, and how much of it was used */
static void check_near(double got, double expected, double cell, double *worst)
{
   double used = fabs(got - expected) / (0.03 * expected + cell);
   if (!(used <= *worst)) *worst = used;
   CHECK_MSG(used <= 1.0, "distance %g, expected %g, cell %g", got, expected, cell);
}

/* --- tests */
TEST(convex_solids_have_straight_distances)
{
   static const double lo[3] = { -0.3, 0.1, -0.2 }, hi[3] = { 0.5, 1.9, 0.15 };
   static const float joints[] = { 0.1f, 1.0f, 0.0f, -0.299f, 0.101f, -0.199f, 0.5f, 1.9f, 0.15f, 0.2f, 1.7f, -0.2f };
   static const float inside[] = { 0.0f, 0.0f, 0.0f, 0.4f, -0.3f, 0.5f, -0.7f, 0.0f, 0.01f };
   static const unsigned resolutions[] = { 7, 40, 70 };
   size_t r, i, s, compared = 0;
   for (r = 0; r < 3; r++) {
      mesh m = mesh_new(BOX_NODES(9), BOX_TRIANGLES(9));
      answer a;
      add_box(&m, lo, hi, 9);
      a = distances(&m, joints, 4, resolutions[r], NULL, NULL);
      CHECK(a.result == DN_OK);
      CHECK(fabs((double)a.cell - 1.8 / resolutions[r]) < 1e-6);
      for (i = 0; i < m.nodes; i++)
         for (s = 0; s < 4; s++, compared++)
            CHECK_MSG(fabs((double)a.d[4 * i + s] - straight(m.p + 3 * i, joints + 3 * s)) < 1e-4, "box, joint %d", (int)s);
      free(a.d);
      mesh_free(&m);
      m = ball(0.9, 24, 40);
      a = distances(&m, inside, 3, resolutions[r], NULL, NULL);
      for (i = 0; i < m.nodes; i++)
         for (s = 0; s < 3; s++, compared++)
            CHECK_MSG(fabs((double)a.d[3 * i + s] - straight(m.p + 3 * i, inside + 3 * s)) < 1e-4, "ball, joint %d", (int)s);
      free(a.d);
      mesh_free(&m);
   }
   AT_LEAST(compared, 10000, "distances");
}
/* the taut string round a disc of radius r at the origin whose shadow reaches down for ever: tangent, arc, tangent */
static double round_bend(const float *p, const float *q, double r)
{
   const float *end[2];
   double length[2], angle[2], arc;
   int k;
   end[0] = p;
   end[1] = q;
   for (k = 0; k < 2; k++) {
      double x = (double)end[k][0], y = (double)end[k][1];
      length[k] = sqrt(x * x + y * y) > r ? sqrt(x * x + y * y) : r;
      angle[k] = atan2(y, -x); /* 0 on the left, pi/2 at the top, pi on the right */
      if (angle[k] < -1.5707963) angle[k] += 6.28318530717959; /* below on the right */
   }
   arc = fabs(angle[1] - angle[0]) - acos(r / length[0]) - acos(r / length[1]);
   if (arc <= 0.0) return straight(p, q);
   return sqrt(length[0] * length[0] - r * r) + r * arc + sqrt(length[1] * length[1] - r * r);
}
TEST(u_tube_has_taut_string_distances)
{
   static const float joints[] = { -0.5f, -0.8f, 0.0f, -0.45f, -1.2f, 0.0f, -0.35f, 0.35f, 0.0f, 0.0f, 0.5f, 0.0f, 0.55f, -0.1f, 0.0f };
   static const unsigned resolutions[] = { 40, 64, 128 };
   size_t r, i, s, compared = 0;
   double worst = 0.0;
   for (r = 0; r < 3; r++) {
      mesh m = u_tube(0.5, 0.15, 1.25, 40, 96, 32);
      answer a = distances(&m, joints, 5, resolutions[r], NULL, NULL);
      CHECK(a.result == DN_OK);
      for (i = 0; i < m.nodes; i++)
         for (s = 0; s < 5; s++) {
            const float *p = m.p + 3 * i;
            CHECK((double)a.d[5 * i + s] > straight(p, joints + 3 * s) - 1e-4);
            if (p[2] < 0.0f || p[2] > 0.0f) continue; /* in the plane of the U a shortest path stays in it */
            check_near((double)a.d[5 * i + s], round_bend(p, joints + 3 * s, 0.35), (double)a.cell, &worst);
            compared++;
         }
      free(a.d);
      mesh_free(&m);
   }
   AT_LEAST(compared, 5000, "distances");
   AT_LEAST(100.0 * worst, 1, "% of the tolerance used");
}
TEST(joint_outside_starts_at_the_nearest_cell)
{
   static const float joints[] = { 2.0f, 0.0f, 0.0f, -0.5f, 1.9f, 0.4f, 0.0f, -1.0005f, 0.0f, 50.0f, 0.0f, 0.0f };
   mesh m = ball(1.0, 40, 64);
   answer a = distances(&m, joints, 4, 64, NULL, NULL);
   size_t i, s;
   double worst = 0.0;
   CHECK(a.result == DN_OK);
   for (s = 0; s < 4; s++) {
      const float *j = joints + 3 * s;
      static const float centre[3] = { 0.0f, 0.0f, 0.0f };
      double length = straight(j, centre);
      float foot[3];
      for (i = 0; i < 3; i++) foot[i] = (float)((double)j[i] / length);
      for (i = 0; i < m.nodes; i++)
         check_near((double)a.d[4 * i + s], length - 1.0 + straight(m.p + 3 * i, foot), (double)a.cell, &worst);
   }
   AT_LEAST(4 * m.nodes, 10000, "distances");
   free(a.d);
   mesh_free(&m);
}
TEST(parts_out_of_reach_add_the_straight_gap)
{
   static const double lo[2][3] = { { 0.0, 0.0, 0.0 }, { 0.9, 0.1, 0.0 } }, hi[2][3] = { { 0.6, 0.5, 0.4 }, { 1.6, 0.4, 0.3 } };
   static const float joints[] = { 0.3f, 0.25f, 0.2f, 1.3f, 0.3f, 0.1f, 0.01f, 0.49f, 0.39f };
   mesh m = mesh_new(2 * BOX_NODES(8) + 1, 2 * BOX_TRIANGLES(8));
   answer a;
   size_t i, s;
   double worst = 0.0;
   for (i = 0; i < 2; i++) add_box(&m, lo[i], hi[i], 8);
   add_node(&m, -0.8, 0.25, 0.2); /* a node by itself, far from both */
   a = distances(&m, joints, 3, 64, NULL, NULL);
   CHECK(a.result == DN_OK);
   for (i = 0; i < m.nodes; i++) /* two convex parts: the straight line leaves one for good, so it is the least sum */
      for (s = 0; s < 3; s++) check_near((double)a.d[3 * i + s], straight(m.p + 3 * i, joints + 3 * s), (double)a.cell, &worst);
   AT_LEAST(3 * m.nodes, 2000, "distances");
   free(a.d);
   mesh_free(&m);
   /* across the mouth of a U: round the bend inside one leg, straight to a part beside the other leg's end. The
      least sum goes out of the near leg directly. */
   {
      static const float low[] = { -0.5f, -1.2f, 0.0f };
      static const double box_lo[3] = { -0.04, -1.2, -0.04 }, box_hi[3] = { 0.04, -1.1, 0.04 };
      mesh u = u_tube(0.5, 0.15, 1.25, 40, 96, 32), both = mesh_new(u.nodes + BOX_NODES(2), u.triangles + BOX_TRIANGLES(2));
      worst = 0.0;
      memcpy(both.p, u.p, u.nodes * 12);
      memcpy(both.t, u.t, u.triangles * 12);
      both.nodes = u.nodes;
      both.triangles = u.triangles;
      add_box(&both, box_lo, box_hi, 2);
      a = distances(&both, low, 1, 80, NULL, NULL);
      for (i = u.nodes; i < both.nodes; i++) check_near((double)a.d[i], straight(both.p + 3 * i, low), (double)a.cell, &worst);
      CHECK((double)a.d[u.nodes - 1] > 3.0); /* the other leg's end, in reach, is still far */
      free(a.d);
      mesh_free(&u);
      mesh_free(&both);
   }
}
TEST(meshes_without_volume_give_finite_distances)
{
   static const float joints[] = { 0.0f, 0.0f, 0.0f, 3.0f, -2.0f, 1.0f };
   size_t kind, i, s;
   for (kind = 0; kind < 6; kind++) {
      mesh m = mesh_new(64, 64);
      answer a;
      if (kind == 0) add_node(&m, 1.0, 2.0, 3.0);                                    /* one point */
      if (kind == 1) for (i = 0; i < 5; i++) add_node(&m, 4.0, 4.0, 4.0);            /* many at one place */
      if (kind == 2) for (i = 0; i < 5; i++) add_node(&m, (double)i * 1e-3, 0.0, 0.0); /* a row of points */
      if (kind == 3) { /* a sheet that lies in the grid's own planes */
         for (i = 0; i < 4; i++) add_node(&m, (double)(i & 1), (double)(i >> 1), 0.0);
         add_triangle(&m, 0, 1, 2);
         add_triangle(&m, 1, 3, 2);
      }
      if (kind == 4) { /* triangles without area, and one with a repeated node */
         for (i = 0; i < 3; i++) add_node(&m, (double)i * 1e6, (double)i * 2e6, (double)i);
         add_triangle(&m, 0, 1, 2);
         add_triangle(&m, 1, 1, 2);
      }
      if (kind == 5) { /* a needle across the grid */
         add_node(&m, -1.0, -1.0, -1.0);
         add_node(&m, 1.0, 1.0, 1.0);
         add_node(&m, 1.0, 1.0, 1.0000001);
         add_triangle(&m, 0, 1, 2);
      }
      a = distances(&m, joints, 2, 50, NULL, NULL);
      CHECK(a.result == DN_OK && a.cells > 0);
      for (i = 0; i < m.nodes; i++)
         for (s = 0; s < 2; s++) {
            double far_off = straight(m.p + 3 * i, joints + 3 * s);
            CHECK(test_finite(a.d[2 * i + s]) && (double)a.d[2 * i + s] >= far_off * 0.9999 - 1.8 * (double)a.cell);
            CHECK((double)a.d[2 * i + s] <= 4.0 * far_off + 1.0);
         }
      free(a.d);
      mesh_free(&m);
   }
}

/* a caller's loop that hands out the ranges backwards, to changing workers */
static void backwards(void *user, size_t count, size_t grain, dn_range_fn *fn, void *job)
{
   unsigned workers = *(unsigned *)user, w = 0;
   size_t ranges = (count + grain - 1) / grain, i;
   for (i = ranges; i > 0; i--, w = (w + 1) % workers) fn(job, (i - 1) * grain, i * grain < count ? i * grain : count, w);
}
TEST(the_same_bits_for_any_number_of_workers)
{
   static const float joints[] = { -0.5f, -0.8f, 0.0f, -0.45f, -1.2f, 0.0f, -0.35f, 0.35f, 0.0f, 0.0f, 0.5f, 0.0f, 2.55f, -0.1f, 0.0f,
                                   0.5f, -0.3f, 0.1f, 0.5f, -0.9f, 0.0f };
   mesh m = u_tube(0.5, 0.15, 1.25, 20, 48, 16);
   answer a = distances(&m, joints, 7, 48, NULL, NULL);
   unsigned workers;
   for (workers = 2; workers < 6; workers++) {
      dn_parallel par;
      answer b;
      par.run = backwards;
      par.user = &workers;
      par.workers = workers;
      b = distances(&m, joints, 7, 48, &par, NULL);
      CHECK(memcmp(a.d, b.d, m.nodes * 7 * sizeof(float)) == 0);
      free(b.d);
   }
   free(a.d);
   mesh_free(&m);
}
typedef struct counter { int calls, stop_at, ordered; float last; } counter;
static int count_step(void *user, const char *stage, float done)
{
   counter *c = (counter *)user;
   c->ordered &= done >= c->last && done >= 0.0f && done <= 1.0f && strcmp(stage, "geodesic") == 0;
   c->last = done;
   return ++c->calls == c->stop_at;
}
TEST(progress_is_reported_and_can_cancel)
{
   static const float joints[] = { 0.0f, 0.0f, 0.0f, 0.1f, 0.0f, 0.0f, 0.2f, 0.0f, 0.0f };
   mesh m = ball(0.5, 8, 12);
   int stop;
   for (stop = 0; stop <= 5; stop++) {
      counter c = { 0, 0, 1, 0.0f };
      dn_progress progress;
      answer a;
      c.stop_at = stop;
      progress.step = count_step;
      progress.user = &c;
      a = distances(&m, joints, 3, 16, NULL, &progress);
      CHECK(c.ordered);
      CHECK(a.result == (stop >= 1 && stop <= 4 ? DN_CANCELLED : DN_OK)); /* at the start, then after each joint */
      CHECK(c.calls == (stop >= 1 && stop <= 4 ? stop : 4));
      CHECK(a.result != DN_OK || c.last >= 1.0f);
      free(a.d);
   }
   mesh_free(&m);
}
TEST(too_little_scratch_is_refused)
{
   static const float joint[] = { 0.0f, 0.0f, 0.0f };
   mesh m = ball(0.5, 6, 8);
   size_t bytes = dn_geodesic_scratch(m.p, m.nodes, m.triangles, 8, 1), n, refused = 0;
   float *d = (float *)test_block(m.nodes * sizeof(float));
   for (n = 0; n <= bytes; n += 64) {
      unsigned char *whole = (unsigned char *)test_aligned(bytes);
      dn_result r;
      memset(whole + n, 0x5a, bytes - n);
      r = dn_geodesic(m.p, m.nodes, m.t, m.triangles, joint, 1, 8, d, NULL, NULL, whole, n, NULL, NULL);
      CHECK(r == DN_OK || r == DN_TOO_SMALL);
      CHECK(n < bytes || r == DN_OK);
      if (r == DN_TOO_SMALL) {
         size_t i, touched = 0;
         for (i = n; i < bytes; i++) touched += whole[i] != 0x5a;
         CHECK(touched == 0);
         refused++;
      }
      test_aligned_free(whole);
   }
   AT_LEAST(refused, 10, "sizes refused");
   CHECK(dn_geodesic(m.p, m.nodes, m.t, m.triangles, joint, 1, 8, d, NULL, NULL, NULL, 0, NULL, NULL) == DN_TOO_SMALL);
   free(d);
   mesh_free(&m);
}
TEST(voxel_binding_follows_the_tube)
{
   /* a chain down one leg, round the bend, down the other; the legs are close, so straight distances would mix them */
   static const float joints[] = { -0.2f, -1.2f, 0.0f, -0.2f, -0.6f, 0.0f, -0.2f, 0.0f, 0.0f, 0.2f, 0.0f, 0.0f, 0.2f, -0.6f, 0.0f,
                                   0.2f, -1.2f, 0.0f };
   static const int32_t parents[] = { -1, 0, 1, 2, 3, 4 };
   mesh m = u_tube(0.2, 0.15, 1.25, 40, 48, 24);
   size_t bytes = dn_voxel_bind_scratch(m.p, m.nodes, m.triangles, 6, 96, 1), i, k, influences, looked = 0;
   void *scratch = test_aligned(bytes);
   for (influences = 1; influences <= 8; influences++) {
      uint32_t *joint = (uint32_t *)test_block(m.nodes * influences * 4);
      float *weight = (float *)test_block(m.nodes * influences * 4);
      CHECK(dn_voxel_bind(m.p, m.nodes, m.t, m.triangles, joints, parents, 6, 96, 0.3f, influences, joint, weight, scratch, bytes,
                          NULL, NULL) == DN_OK);
      for (i = 0; i < m.nodes; i++) {
         const float *p = m.p + 3 * i;
         double sum = 0.0, across = 0.0;
         uint32_t expected = p[1] > -0.55f ? 99u : (p[0] < 0.0f ? (p[1] > -1.15f && p[1] < -0.65f ? 0u : 99u)
                                                                : (p[1] > -1.15f && p[1] < -0.65f ? 4u : 99u));
         for (k = 0; k < influences; k++) {
            float w = weight[i * influences + k];
            CHECK(w >= 0.0f && w <= 1.0f && joint[i * influences + k] < 6);
            CHECK(k == 0 || w <= weight[i * influences + k - 1]);
            sum += (double)w;
            if (p[0] < 0.0f ? joint[i * influences + k] >= 3 : joint[i * influences + k] <= 1) across += (double)w;
         }
         CHECK(fabs(sum - 1.0) < 1e-5);
         if (expected != 99u) {
            CHECK_MSG(joint[i * influences] == expected, "node at %g %g: joint %u", (double)p[0], (double)p[1],
                      joint[i * influences]);
            CHECK_MSG(across < 0.03, "weight %g from the other leg", across);
            looked++;
         }
      }
      free(joint);
      free(weight);
   }
   AT_LEAST(looked, 3000, "nodes of the legs");
   CHECK(dn_voxel_bind(m.p, m.nodes, m.t, m.triangles, joints, parents, 6, 96, 0.3f, 1, NULL, NULL, scratch, 1000, NULL, NULL) ==
         DN_TOO_SMALL);
   test_aligned_free(scratch);
   mesh_free(&m);
}
/* a bone beside the body starts at its own nearest point, wherever that lies on it: as near as a joint just there */
TEST(a_bone_outside_starts_at_its_nearest_point)
{
   static const float joints[] = { 2.0f, 1.5f, 0.25f, 0.0f, 1.0f, 0.25f, 1.0f, 0.25f, 0.25f }; /* joint 1 ends the bone */
   static const int32_t parents[] = { -1, 0, -1 };
   static const double lo[3] = { 0.0, 0.0, 0.0 }, hi[3] = { 2.0, 0.5, 0.5 };
   mesh m = mesh_new(BOX_NODES(8), BOX_TRIANGLES(8));
   size_t bytes, i, k;
   uint32_t *joint;
   float *weight;
   void *scratch;
   add_box(&m, lo, hi, 8);
   bytes = dn_voxel_bind_scratch(m.p, m.nodes, m.triangles, 3, 32, 1), scratch = test_aligned(bytes);
   joint = (uint32_t *)test_block(m.nodes * 3 * sizeof *joint), weight = (float *)test_block(m.nodes * 3 * sizeof *weight);
   CHECK(dn_voxel_bind(m.p, m.nodes, m.t, m.triangles, joints, parents, 3, 32, 0.0f, 3, joint, weight, scratch, bytes, NULL, NULL) == DN_OK);
   for (i = 0; i < m.nodes; i++) {
      float of[3] = { -1, -1, -1 };
      for (k = 0; k < 3; k++) of[joint[3 * i + k]] = weight[3 * i + k];
      CHECK_MSG(of[0] > 0 && fabs((double)of[0] - (double)of[1]) < 0.1 * (double)of[1], "node %lu: bone %g, joint at its end %g",
                (unsigned long)i, (double)of[0], (double)of[1]);
   }
   AT_LEAST(m.nodes, 400, "nodes");
   free(joint), free(weight), test_aligned_free(scratch);
   mesh_free(&m);
}

int main(int argc, char **argv)
{
   TEST_BEGIN(argc, argv);
   RUN(convex_solids_have_straight_distances);
   RUN(u_tube_has_taut_string_distances);
   RUN(joint_outside_starts_at_the_nearest_cell);
   RUN(parts_out_of_reach_add_the_straight_gap);
   RUN(meshes_without_volume_give_finite_distances);
   RUN(the_same_bits_for_any_number_of_workers);
   RUN(progress_is_reported_and_can_cancel);
   RUN(too_little_scratch_is_refused);
   RUN(voxel_binding_follows_the_tube);
   RUN(a_bone_outside_starts_at_its_nearest_point);
   return TEST_END();
}
