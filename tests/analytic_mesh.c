/*  analytic_mesh.c - weld, graph, normals, rotations, skinning and feature rows against what they must be

    shows   weld and one-rings against brute force, rotations against their definitions, DQS of a screw, the root frame
    build   cc -O2 analytic_mesh.c -o analytic_mesh -lm */
#define DEFORMNET_IMPLEMENTATION
#define DEFORMNET_STATIC
#include "../deformnet.h"
#include "test.h"
#include <math.h>

#define PI 3.14159265358979
static int near(double a, double b, double tolerance) { return fabs(a - b) <= tolerance; } /* false for NaN */

/* --- weld */
typedef struct welded {
   size_t nodes, apart;
   uint32_t *node, *first;
} welded;
static welded weld(const float *p, size_t count, const uint32_t *j, const float *w, size_t influences, float distance)
{
   welded r;
   void *scratch = test_aligned(dn_weld_scratch(count));
   r.node = (uint32_t *)test_block(count * 4);
   r.first = (uint32_t *)test_block(count * 4);
   r.nodes = dn_weld(p, count, j, w, influences, distance, r.node, r.first, &r.apart, scratch);
   test_aligned_free(scratch);
   return r;
}
static void welded_free(welded *r)
{
   free(r->node);
   free(r->first);
}
TEST(weld_by_number_in_order)
{
   /*                              0             1             2              3             4                    5 */
   static const float p[] = { 0.0f, 1, 2, 5, 5, 5, -0.0f, 1, 2, 5, 5, 5.0000005f, 5, 5, 5, 0, 1, 2 };
   static const uint32_t j[] = { 0, 1, 0, 1, 1, 0, 0, 0, 2, 2, 0, 1 };
   static const float w[] = { 0.5f, 0.5f, 1, 0, 0.52f, 0.48f, 1, 0, 0.4f, 0.6f, 0.6f, 0.4f };
   static const uint32_t plain[] = { 0, 1, 0, 2, 1, 0 }, weighted[] = { 0, 1, 0, 2, 3, 4 };
   welded r = weld(p, 6, NULL, NULL, 0, 0.0f);
   CHECK(r.nodes == 3 && r.apart == 0 && memcmp(r.node, plain, sizeof plain) == 0);
   CHECK(r.first[0] == 0 && r.first[1] == 1 && r.first[2] == 3);
   welded_free(&r);
   r = weld(p, 6, j, w, 2, 0.0f); /* 2 differs from 0 by 0.02; 4 is on joint 2 and not 0; 5 differs from 0 by 0.1 */
   CHECK(r.nodes == 5 && r.apart == 2 && memcmp(r.node, weighted, sizeof weighted) == 0);
   welded_free(&r);
}
TEST(weld_adds_repeated_joints_and_keeps_the_bar)
{
   static const float p[9] = { 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f };
   static const uint32_t j[] = { 3, 3, 1, 1, 3, 0, 3, 1, 1 };
   static const float w[] = { 0.4f, 0.3f, 0.3f, 0.3f, 0.7f, 0.0f, 0.76f, 0.12f, 0.12f };
   welded r = weld(p, 3, j, w, 3, 0.0f); /* 0 and 1 are the same weights; 2 is 0.06 off */
   CHECK(r.nodes == 2 && r.node[1] == 0 && r.node[2] == 1 && r.apart == 1);
   welded_free(&r);
   { /* the joint that differs too much is listed in one row only, in the earlier or in the later one */
      static const uint32_t one[] = { 5, 1, 1, 0, 5, 1 };
      static const float by[] = { 0.06f, 0.94f, 0.97f, 0.03f, 0.06f, 0.94f };
      r = weld(p, 2, one, by, 2, 0.0f);
      CHECK(r.nodes == 2 && r.apart == 1);
      welded_free(&r);
      r = weld(p, 2, one + 2, by + 2, 2, 0.0f);
      CHECK(r.nodes == 2 && r.apart == 1);
      welded_free(&r);
   }
}
TEST(weld_chains_do_not_creep)
{
   static const float p[] = { 0, 0, 0, 0.75f, 0, 0, 1.5f, 0, 0, 0.875f, 0, 0, 2.5f, 0, 0 };
   static const uint32_t expected[] = { 0, 0, 1, 0, 1 }; /* each against first vertices: 1.5 is out of reach of 0 */
   welded r = weld(p, 5, NULL, NULL, 0, 1.0f);
   CHECK(r.nodes == 2 && memcmp(r.node, expected, sizeof expected) == 0);
   welded_free(&r);
}
TEST(weld_agrees_with_brute_force)
{
   uint64_t seed = 7;
   size_t round, v, n, i, compared = 0, joined = 0;
   for (round = 0; round < 24; round++) {
      size_t count = 400;
      float distance = round % 4 == 0 ? 0.0f : (round % 4 == 1 ? 1e-3f : (round % 4 == 2 ? 0.11f : 2.5f));
      float side = round % 3 == 0 ? 1.0f : (round % 3 == 1 ? 1e-3f : 300.0f);
      size_t influences = round % 2 ? 3 : 0;
      float *p = (float *)test_block(count * 12), *w = (float *)test_block(count * 12 + 1);
      uint32_t *j = (uint32_t *)test_block(count * 12), *node = (uint32_t *)test_block(count * 4),
               *first = (uint32_t *)test_block(count * 4);
      welded r;
      size_t nodes = 0, apart = 0;
      for (v = 0; v < count; v++)
         for (i = 0; i < 3; i++) { /* a coarse lattice, so that many coincide or lie exactly at the distance */
            p[3 * v + i] = side * 0.1f * (float)((int)(test_random(&seed) % 9) - 4);
            j[3 * v + i] = test_random(&seed) % 3;
            w[3 * v + i] = (float)(test_random(&seed) % 4) * 0.25f;
         }
      for (v = 0; v < count; v++) {
         int beside = 0;
         for (n = 0; n < nodes; n++) {
            size_t u = first[n];
            double d = 0.0;
            int alike = 1;
            uint32_t s;
            for (i = 0; i < 3; i++) {
               double x = (double)p[3 * v + i] - (double)p[3 * u + i];
               d += x * x;
            }
            if (d > (double)distance * (double)distance) continue;
            for (s = 0; s < 3 && influences; s++) {
               double a = 0.0;
               for (i = 0; i < 3; i++) a += (j[3 * v + i] == s ? (double)w[3 * v + i] : 0.0) - (j[3 * u + i] == s ? (double)w[3 * u + i] : 0.0);
               alike &= fabs(a) <= 0.05;
            }
            if (alike) break;
            beside = 1;
         }
         if (n == nodes) {
            first[nodes++] = (uint32_t)v;
            apart += (size_t)beside;
         } else joined++;
         node[v] = (uint32_t)n;
      }
      r = weld(p, count, influences ? j : NULL, influences ? w : NULL, influences, distance);
      CHECK(r.nodes == nodes && r.apart == apart);
      CHECK(memcmp(r.node, node, count * 4) == 0 && memcmp(r.first, first, nodes * 4) == 0);
      compared += count;
      welded_free(&r);
      free(p), free(w), free(j), free(node), free(first);
   }
   AT_LEAST(compared, 9000, "vertices");
   AT_LEAST(joined, 1000, "joined");
}

/* --- graph */
static dn_graph graph_of(const uint32_t *t, size_t triangles, size_t nodes, uint32_t **first, uint32_t **next)
{
   dn_graph g;
   void *scratch = test_aligned(dn_graph_scratch(nodes, triangles));
   *first = (uint32_t *)test_block((nodes + 1) * 4);
   *next = (uint32_t *)test_block(6 * triangles * 4);
   dn_graph_build(t, triangles, nodes, *first, *next, &g, scratch);
   test_aligned_free(scratch);
   return g;
}
TEST(one_rings_agree_with_brute_force)
{
   uint64_t seed = 3;
   size_t round, i, j, k, entries = 0;
   for (round = 0; round < 60; round++) {
      size_t nodes = 1 + test_random(&seed) % 40, triangles = test_random(&seed) % 70;
      uint32_t *t = (uint32_t *)test_block(triangles * 12), *first, *next;
      unsigned char *edge = (unsigned char *)test_block(nodes * nodes);
      size_t isolated = 0, components = 0;
      uint32_t *label = (uint32_t *)test_block(nodes * 4), *queue = (uint32_t *)test_block(nodes * 4);
      dn_graph g;
      memset(edge, 0, nodes * nodes);
      for (i = 0; i < 3 * triangles; i++) t[i] = test_random(&seed) % (uint32_t)nodes; /* repeats, non-manifold, anything */
      for (i = 0; i < triangles; i++)
         for (j = 0; j < 3; j++)
            for (k = 0; k < 3; k++)
               if (t[3 * i + j] != t[3 * i + k]) edge[t[3 * i + j] * nodes + t[3 * i + k]] = 1;
      g = graph_of(t, triangles, nodes, &first, &next);
      CHECK(g.nodes == nodes && g.first[0] == 0);
      for (i = 0; i < nodes; i++) {
         size_t at = g.first[i];
         for (j = 0; j < nodes; j++)
            if (edge[i * nodes + j]) {
               CHECK(at < g.first[i + 1] && g.next[at] == j); /* ascending, each once */
               at++;
               entries++;
            }
         CHECK(at == g.first[i + 1]);
         isolated += g.first[i] == g.first[i + 1];
      }
      CHECK(dn__isolated_nodes(&g) == isolated);
      for (k = 0; k < nodes; k++) /* transitive closure */
         for (i = 0; i < nodes; i++)
            for (j = 0; j < nodes; j++) edge[i * nodes + j] |= edge[i * nodes + k] & edge[k * nodes + j];
      k = dn__graph_components(&g, label, queue);
      for (i = 0; i < nodes; i++) {
         size_t lowest = i;
         for (j = 0; j < nodes; j++) {
            CHECK((label[i] == label[j]) == (i == j || edge[i * nodes + j]));
            if (edge[i * nodes + j] && j < lowest) lowest = j;
         }
         components += lowest == i;
      }
      CHECK(k == components);
      free(t), free(first), free(next), free(edge), free(label), free(queue);
   }
   AT_LEAST(entries, 5000, "neighbours");
}
TEST(a_hub_with_many_spokes)
{
   size_t spokes = 200000, i;
   uint32_t *t = (uint32_t *)test_block(spokes * 12), *first, *next;
   dn_graph g;
   for (i = 0; i < spokes; i++) {
      t[3 * i] = (uint32_t)spokes; /* the hub is the last node */
      t[3 * i + 1] = (uint32_t)(spokes - 1 - i);
      t[3 * i + 2] = (uint32_t)(i == 0 ? 0 : spokes - i);
   }
   g = graph_of(t, spokes, spokes + 1, &first, &next);
   CHECK(g.first[spokes + 1] - g.first[spokes] == spokes && g.first[spokes + 1] == 4 * spokes);
   for (i = 0; i < spokes; i++) CHECK(g.next[g.first[spokes] + i] == i);
   free(t), free(first), free(next);
}

/* --- normals */
TEST(normals_gathered_and_scattered_are_the_same_bits)
{
   uint64_t seed = 11;
   size_t nodes = 300, triangles = 900, i, cut;
   float *p = (float *)test_block(nodes * 12), *a = (float *)test_block(nodes * 12), *b = (float *)test_block(nodes * 12);
   double *fine = (double *)test_block(nodes * 24);
   uint32_t *t = (uint32_t *)test_block(triangles * 12), *first = (uint32_t *)test_block((nodes + 1) * 4),
            *corner = (uint32_t *)test_block(triangles * 12);
   for (i = 0; i < 3 * nodes; i++) p[i] = test_uniform(&seed, -1.0f, 1.0f);
   for (i = 0; i < 3 * triangles; i++) t[i] = test_random(&seed) % (uint32_t)(nodes - 1); /* the last has none */
   dn_normals(p, nodes, t, triangles, a);
   dn__corners_build(t, triangles, nodes, first, corner);
   for (cut = 0; cut <= nodes; cut += 37) {
      memset(b, 0xff, nodes * 12);
      dn__normals_range(p, t, first, corner, cut, nodes, b);
      dn__normals_range(p, t, first, corner, 0, cut, b);
      CHECK(memcmp(a, b, nodes * 12) == 0);
   }
   for (i = 0; i < 3 * nodes; i++) fine[i] = (double)p[i];
   dn__normals_fine_range(fine, t, first, corner, 0, nodes, b);
   for (i = 0; i < 3 * nodes; i++) CHECK(near((double)a[i], (double)b[i], 2e-5)); /* the same in double */
   for (i = 0; i < 3 * nodes; i++) fine[i] += 1e6; /* where floats lie 6 cm apart */
   dn__normals_fine_range(fine, t, first, corner, 0, nodes, a);
   for (i = 0; i < 3 * nodes; i++) CHECK(near((double)a[i], (double)b[i], 1e-6));
   for (i = 0; i + 1 < nodes; i++)
      CHECK(near((double)a[3 * i] * (double)a[3 * i] + (double)a[3 * i + 1] * (double)a[3 * i + 1] +
                 (double)a[3 * i + 2] * (double)a[3 * i + 2], 1.0, 1e-5));
   CHECK(a[3 * nodes - 3] == 0.0f && a[3 * nodes - 2] == 0.0f && a[3 * nodes - 1] == 0.0f);
   free(p), free(a), free(b), free(fine), free(t), free(first), free(corner);
}
TEST(normals_weigh_by_area_and_survive_anything)
{
   /* a large triangle in z = 0 and one a hundredth of its area in y = 0 meet at node 0 */
   static float p[] = { 0, 0, 0, 10, 0, 0, 0, 10, 0, 0, 0, 1, 1, 0, 0, 3, 3, 3, 1e-20f, 0, 0, 0, 1e-20f, 0, 1e30f, 0, 0, 0, 1e30f, 0 };
   static const uint32_t t[] = { 0, 1, 2, 0, 3, 4, 5, 5, 1, 6, 7, 0, 8, 9, 0 };
   float n[30];
   double length = sqrt(100.0 * 100.0 + 1.0);
   size_t seen = 0;
   int k;
   dn_normals(p, 10, t, 2, n);
   CHECK(near((double)n[0], 0.0, 1e-6) && near((double)n[1], 1.0 / length, 1e-6) && near((double)n[2], 100.0 / length, 1e-6));
   dn_normals(p, 10, t + 6, 1, n); /* a repeated node */
   CHECK(n[15] == 0.0f && n[16] == 0.0f && n[17] == 0.0f);
   dn_normals(p, 10, t + 9, 1, n); /* shorter than 1e-18 */
   CHECK(n[18] == 0.0f && n[19] == 0.0f && n[20] == 0.0f);
   dn_normals(p, 10, t + 12, 1, n); /* longer than a float holds */
   CHECK(n[24] == 0.0f && n[25] == 0.0f && n[26] == 0.0f);
   p[0] = (float)NAN;
   dn_normals(p, 10, t, 2, n);
   CHECK(n[0] == 0.0f && n[1] == 0.0f && n[2] == 0.0f);
   p[0] = 0.0f;
   for (k = 0; k < DN_KERNEL_COUNT; k++) { /* of all that cannot have a normal, in every text, floats and doubles */
      static const float odd[] = { (float)NAN, (float)INFINITY, 1e30f };
      float q[9 + 1], found[9];
      double fine[9 + 1];
      uint32_t first[4], corner[3];
      size_t o, i;
      if (!dn_kernel_available((dn_kernel)k)) continue;
      dn__corners_build(t, 1, 3, first, corner);
      for (o = 0; o < 3; o++) {
         for (i = 0; i < 10; i++) q[i] = i < 9 ? p[i] : 0.0f;
         q[0] = odd[o], q[7] = 1e30f;
         for (i = 0; i < 10; i++) fine[i] = (double)q[i];
         memset(found, 0xff, sizeof found);
         dn__normals_run((dn_kernel)k, q, t, first, corner, 0, 3, found);
         for (i = 0; i < 9; i++) CHECK_MSG(found[i] == 0.0f, "%s, %g: %g", dn_kernel_name((dn_kernel)k), (double)odd[o], (double)found[i]);
         memset(found, 0xff, sizeof found);
         dn__normals_fine_run((dn_kernel)k, fine, t, first, corner, 0, 3, found);
         for (i = 0; i < 9; i++) CHECK_MSG(found[i] == 0.0f, "%s, fine, %g: %g", dn_kernel_name((dn_kernel)k), (double)odd[o], (double)found[i]);
         seen++;
      }
   }
   AT_LEAST(seen, 3, "texts and odd places");
}

/* --- rotations */
static void random_rotation(uint64_t *seed, float r[9])
{
   float a[3];
   int k;
   for (k = 0; k < 3; k++) a[k] = test_uniform(seed, -3.0f, 3.0f);
   dn_rodrigues(a, r);
}
static double off_orthonormal(const float r[9]) /* max |R^T R - I|, plus 9 when mirrored */
{
   double worst = 0.0, det;
   int i, j, k;
   for (i = 0; i < 3; i++)
      for (j = 0; j < 3; j++) {
         double d = i == j ? -1.0 : 0.0;
         for (k = 0; k < 3; k++) d += (double)r[3 * k + i] * (double)r[3 * k + j];
         worst = fabs(d) > worst ? fabs(d) : worst;
      }
   det = (double)r[0] * ((double)r[4] * (double)r[8] - (double)r[5] * (double)r[7]) -
         (double)r[1] * ((double)r[3] * (double)r[8] - (double)r[5] * (double)r[6]) +
         (double)r[2] * ((double)r[3] * (double)r[7] - (double)r[4] * (double)r[6]);
   return det > 0.0 ? worst : worst + 9.0;
}
TEST(rodrigues_turns_about_its_axis)
{
   static const double angles[] = { 0.0, 1e-12, 1e-8, 1e-4, 0.3, 1.5707963, 3.0, PI, 4.0, 6.2831853, 20.0 };
   uint64_t seed = 5;
   size_t i, k;
   for (i = 0; i < sizeof angles / sizeof *angles; i++) {
      float z[3] = { 0.0f, 0.0f, 0.0f }, r[9], any[3];
      double length = 0.0, angle;
      z[2] = (float)angles[i];
      angle = (double)z[2];
      dn_rodrigues(z, r);
      CHECK(near((double)r[0], cos(angle), 2e-6) && near((double)r[3], sin(angle), 2e-6) && near((double)r[1], -sin(angle), 2e-6) && r[8] == 1.0f);
      for (k = 0; k < 3; k++) any[k] = test_uniform(&seed, -1.0f, 1.0f);
      for (k = 0; k < 3; k++) length += (double)any[k] * (double)any[k];
      for (k = 0; k < 3; k++) any[k] = (float)((double)any[k] * angles[i] / sqrt(length));
      dn_rodrigues(any, r);
      CHECK(off_orthonormal(r) < 4e-6);
      CHECK(near((double)r[0] + (double)r[4] + (double)r[8], 1.0 + 2.0 * cos(angles[i]), 1e-5)); /* trace */
      for (k = 0; k < 3; k++) /* R a = a */
         CHECK(near((double)r[3 * k] * (double)any[0] + (double)r[3 * k + 1] * (double)any[1] + (double)r[3 * k + 2] * (double)any[2],
                    (double)any[k], 1e-5 * (1.0 + angles[i])));
   }
}
TEST(orthonormalise_keeps_x_and_the_plane_of_x_and_y)
{
   uint64_t seed = 9;
   static const float flat[][9] = { { 0, 0, 0, 0, 0, 0, 0, 0, 0 },
                                    { 0, 1, 0, 0, 0, 1, 0, 0, 0 },                               /* x = 0 */
                                    { 0.1f, 0.3f, 0, 0.2f, 0.6f, 1, 0.7f, 2.1f, 0 },             /* y along x, in floats */
                                    { 1e-13f, 0, 0, 0, 1, 0, 0, 0, 1 } };
   size_t i, k;
   float r[9], m[9];
   for (i = 0; i < 200; i++) {
      double dot = 0.0, length = 0.0, scale = i % 3 == 0 ? 1e-6 : (i % 3 == 1 ? 1.0 : 1e9);
      for (k = 0; k < 9; k++) m[k] = (float)((double)test_uniform(&seed, -1.0f, 1.0f) * scale);
      dn_orthonormalise(m, r);
      CHECK(off_orthonormal(r) < 1e-6);
      for (k = 0; k < 3; k++) dot += (double)r[3 * k] * (double)m[3 * k], length += (double)m[3 * k] * (double)m[3 * k];
      CHECK(near(dot / sqrt(length), 1.0, 1e-6));
      dot = 0.0;
      for (k = 0; k < 3; k++) dot += (double)r[3 * k + 2] * (double)m[3 * k + 1]; /* z is square to the old y */
      CHECK(near(dot / scale, 0.0, 1e-6));
   }
   for (i = 0; i < sizeof flat / sizeof *flat + 2; i++) {
      if (i < sizeof flat / sizeof *flat) memcpy(m, flat[i], sizeof m);
      else m[3] = i & 1 ? (float)NAN : (float)INFINITY;
      if (i == 2) m[0] = 0.5f, m[3] = 0.25f, m[6] = -2.0f, m[1] = 1.5f, m[4] = 0.75f, m[7] = -6.0f;
      dn_orthonormalise(m, r);
      for (k = 0; k < 9; k++) CHECK(r[k] == (k % 4 == 0 ? 1.0f : 0.0f));
   }
}

/* --- skeleton */
TEST(forward_kinematics_and_palette)
{
   static const int32_t parents[] = { -1, 0, 1, 0 };
   static const float offsets[] = { 1, 2, 3, 0, 1, 0, 0, 1, 0, 2, 0, 0 };
   float r[36], t[48], rest[48], bind[48], palette[48], turn[3] = { 0.0f, 0.0f, (float)(PI / 2) };
   size_t s, k;
   for (k = 0; k < 36; k++) r[k] = k % 9 % 4 == 0 ? 1.0f : 0.0f;
   dn_forward_kinematics(parents, offsets, r, 4, rest);
   for (s = 0; s < 4; s++)
      for (k = 0; k < 12; k++) bind[12 * s + k] = k % 4 == 3 ? -rest[12 * s + k] : rest[12 * s + k];
   dn_palette(rest, bind, 4, palette);
   for (k = 0; k < 48; k++) CHECK(palette[k] == (k % 12 % 5 == 0 ? 1.0f : 0.0f)); /* at rest: the identity */
   dn_rodrigues(turn, r + 9); /* joint 1 turns a quarter about z: joint 2 swings from (1,4,3) to (0,3,3) */
   dn_forward_kinematics(parents, offsets, r, 4, t);
   CHECK(near((double)t[24 + 3], 0.0, 1e-6) && near((double)t[24 + 7], 3.0, 1e-6) && near((double)t[24 + 11], 3.0, 1e-6));
   CHECK(near((double)t[36 + 3], 3.0, 1e-6) && near((double)t[36 + 7], 2.0, 1e-6)); /* joint 3 is the root's child: stays */
   dn_palette(t, bind, 4, palette);
   { /* a point one above joint 2 at rest follows it */
      float p[3] = { 1.0f, 5.0f, 3.0f }, q[3];
      dn__transform(palette + 24, p, q);
      CHECK(near((double)q[0], -1.0, 1e-6) && near((double)q[1], 3.0, 1e-6) && near((double)q[2], 3.0, 1e-6));
   }
}
TEST(four_layouts_hold_the_same_matrix)
{
   float m[12], src[16], out[12];
   int r, c, k;
   for (k = 0; k < 12; k++) m[k] = (float)(k + 1);
   for (k = 0; k < 4; k++) {
      dn_matrix layout = k == 0 ? DN_3X4_ROWS : (k == 1 ? DN_3X4_COLUMNS : (k == 2 ? DN_4X4_ROWS : DN_4X4_COLUMNS));
      for (r = 0; r < 16; r++) src[r] = -99.0f;
      for (r = 0; r < 3; r++)
         for (c = 0; c < 4; c++) src[k == 0 || k == 2 ? 4 * r + c : (k == 1 ? 3 * c + r : 4 * c + r)] = m[4 * r + c];
      dn__load_matrix(src, layout, out);
      CHECK(memcmp(m, out, sizeof m) == 0);
      CHECK(dn__matrix_floats(layout) == (k < 2 ? 12u : 16u));
   }
}

/* --- skinning */
static void random_palette(uint64_t *seed, size_t joints, float *palette, int rigid)
{
   size_t s, k;
   for (s = 0; s < joints; s++) {
      float r[9];
      random_rotation(seed, r);
      for (k = 0; k < 12; k++)
         palette[12 * s + k] = k % 4 == 3 ? test_uniform(seed, -2.0f, 2.0f) : r[3 * (k / 4) + k % 4] + (rigid ? 0.0f : test_uniform(seed, -0.3f, 0.3f));
   }
}
TEST(lbs_is_the_weighted_sum)
{
   uint64_t seed = 21;
   float palette[12 * 6], rest[3 * 50], out[3 * 50], weight[50 * 9];
   uint32_t joint[50 * 9];
   size_t influences, v, i, k;
   random_palette(&seed, 6, palette, 0);
   for (influences = 0; influences <= 9; influences++) {
      for (i = 0; i < 150; i++) rest[i] = test_uniform(&seed, -1.0f, 1.0f);
      for (i = 0; i < 50 * influences; i++) {
         joint[i] = test_random(&seed) % 6;
         weight[i] = test_uniform(&seed, 0.0f, 1.0f);
      }
      dn_lbs(rest, joint, weight, influences, 50, palette, out);
      for (v = 0; v < 50; v++)
         for (k = 0; k < 3; k++) {
            double sum = 0.0;
            for (i = 0; i < influences; i++) {
               const float *m = palette + 12 * joint[v * influences + i] + 4 * k;
               sum += (double)weight[v * influences + i] * ((double)m[0] * (double)rest[3 * v] + (double)m[1] * (double)rest[3 * v + 1] +
                                                            (double)m[2] * (double)rest[3 * v + 2] + (double)m[3]);
            }
            CHECK(near((double)out[3 * v + k], sum, 1e-5));
         }
   }
}
TEST(dqs_of_a_screw)
{
   /* joint 0 stays, joint 1 turns by theta about an axis through c and slides d along it: every blend is a screw about
      the same axis. Half way it is half of both; elsewhere tan(phi/2) = w s / (1 - w + w c), c and s of theta/2, and
      the slide is w d (c (1 - w) + w) / ((1 - w + w c)^2 + (w s)^2). */
   static const double thetas[] = { 0.2, 1.0, 2.5, -1.3, 3.1 };
   static const double c[2] = { 0.4, -0.3 };
   size_t i, step;
   uint64_t seed = 2;
   for (i = 0; i < sizeof thetas / sizeof *thetas; i++)
      for (step = 0; step <= 10; step++) {
         double theta = thetas[i], d = 0.7, w = (double)step / 10.0, ch = cos(theta / 2), sh = sin(theta / 2);
         double re = 1 - w + w * ch, im = w * sh, phi = 2 * atan2(im, re), slide = w * d * (ch * (1 - w) + w) / (re * re + im * im);
         float palette[24] = { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0 }, weight[2], rest[3], out[3], dual[16], again[3];
         static const uint32_t joint[2] = { 0, 1 };
         double x, y;
         int k;
         if (step == 5) CHECK(near(phi, theta / 2, 1e-12) && near(slide, d / 2, 1e-12));
         palette[12] = palette[17] = (float)cos(theta);
         palette[13] = (float)-sin(theta);
         palette[16] = (float)sin(theta);
         palette[22] = 1.0f;
         palette[15] = (float)(c[0] - cos(theta) * c[0] + sin(theta) * c[1]);
         palette[19] = (float)(c[1] - sin(theta) * c[0] - cos(theta) * c[1]);
         palette[23] = (float)d;
         weight[0] = (float)(1.0 - w);
         weight[1] = (float)w;
         for (k = 0; k < 3; k++) rest[k] = test_uniform(&seed, -1.0f, 1.0f);
         dn_dqs(rest, joint, weight, 2, 1, palette, out);
         x = (double)rest[0] - c[0];
         y = (double)rest[1] - c[1];
         CHECK(near((double)out[0], c[0] + cos(phi) * x - sin(phi) * y, 2e-6));
         CHECK(near((double)out[1], c[1] + sin(phi) * x + cos(phi) * y, 2e-6));
         CHECK(near((double)out[2], (double)rest[2] + slide, 2e-6));
         dn__dual_quaternions(palette, 2, dual);
         dn__dqs_range(rest, joint, weight, 2, dual, 0, 1, again);
         for (k = 0; k < 3; k++) CHECK(near((double)again[k], (double)out[k], 1e-6));
      }
}
TEST(dqs_is_rigid_and_follows_a_single_joint)
{
   uint64_t seed = 33;
   size_t round, k;
   for (round = 0; round < 300; round++) {
      float palette[12 * 4], m[12], r[9], dual[32], weight[4], one[4] = { 1, 0, 0, 0 }, p[3], a[3], b[3];
      uint32_t joint[4];
      double sum = 0.0;
      random_palette(&seed, 4, palette, 1);
      for (k = 0; k < 4; k++) joint[k] = (uint32_t)((k + round) % 4), weight[k] = test_uniform(&seed, 0.0f, 1.0f), sum += (double)weight[k];
      for (k = 0; k < 4; k++) weight[k] = (float)((double)weight[k] / sum);
      dn__dual_quaternions(palette, 4, dual);
      dn__dqs_blend(joint, weight, 4, dual, m);
      dn__part3x3(m, r);
      CHECK(off_orthonormal(r) < 5e-6);
      for (k = 0; k < 3; k++) p[k] = test_uniform(&seed, -1.0f, 1.0f);
      dn_dqs(p, joint, one, 4, 1, palette, a);
      dn__transform(palette + 12 * joint[0], p, b);
      for (k = 0; k < 3; k++) CHECK(near((double)a[k], (double)b[k], 3e-6));
   }
}
TEST(dqs_signs_follow_the_heaviest_joint)
{
   /* turns about z by twice these angles: some quaternions are more than a right angle apart, and which of them flip
      depends on the pivot. Equal weights: the lowest joint, wherever it stands in the row. */
   static const double halves[] = { 0.0, 60.0 * PI / 180.0, 80.0 * PI / 180.0, 160.0 * PI / 180.0 };
   static const float rows[][4] = { { 0.4f, 0.3f, 0.2f, 0.1f }, { 0.25f, 0.25f, 0.25f, 0.25f }, { 0.1f, 0.2f, 0.3f, 0.4f } };
   static const uint32_t orders[][4] = { { 0, 1, 2, 3 }, { 3, 2, 1, 0 }, { 2, 0, 3, 1 } };
   size_t i, o, k;
   float palette[48] = { 0 };
   for (k = 0; k < 4; k++) {
      double a = 2.0 * halves[k];
      palette[12 * k] = palette[12 * k + 5] = (float)cos(a);
      palette[12 * k + 1] = (float)-sin(a);
      palette[12 * k + 4] = (float)sin(a);
      palette[12 * k + 10] = 1.0f;
   }
   for (i = 0; i < 3; i++)
      for (o = 0; o < 3; o++) {
         float weight[4], rest[3] = { 1.0f, 0.0f, 0.5f }, out[3];
         double re = 0.0, im = 0.0, pivot;
         size_t heavy = 0;
         for (k = 0; k < 4; k++) weight[k] = rows[i][orders[o][k]]; /* the weight goes with the joint */
         for (k = 1; k < 4; k++) heavy = rows[i][k] > rows[i][heavy] ? k : heavy;
         pivot = halves[heavy];
         for (k = 0; k < 4; k++) {
            double half = halves[k], sign = cos(half - pivot) < 0.0 ? -1.0 : 1.0;
            re += sign * (double)rows[i][k] * cos(half);
            im += sign * (double)rows[i][k] * sin(half);
         }
         dn_dqs(rest, orders[o], weight, 4, 1, palette, out);
         CHECK(near((double)out[0], cos(2.0 * atan2(im, re)), 2e-6) && near((double)out[1], sin(2.0 * atan2(im, re)), 2e-6));
         CHECK(near((double)out[2], 0.5, 1e-6));
      }
}
TEST(unskinning_undoes_the_blend)
{
   uint64_t seed = 4;
   size_t round, r;
   for (round = 0; round < 300; round++) {
      float m[12], d[3], rest[3];
      random_palette(&seed, 1, m, 0);
      for (r = 0; r < 3; r++) d[r] = test_uniform(&seed, -0.1f, 0.1f);
      CHECK(dn__unskin(m, d, rest));
      for (r = 0; r < 3; r++)
         CHECK(near((double)m[4 * r] * (double)rest[0] + (double)m[4 * r + 1] * (double)rest[1] + (double)m[4 * r + 2] * (double)rest[2],
                    (double)d[r], 1e-6));
   }
   {
      float m[12] = { 1, 2, 3, 0, 2, 4, 6, 0, 0, 0, 1, 0 }, d[3] = { 1, 1, 1 }, rest[3] = { 9, 9, 9 };
      CHECK(!dn__unskin(m, d, rest) && rest[0] == 0.0f && rest[1] == 0.0f && rest[2] == 0.0f);
      m[0] = (float)NAN;
      rest[0] = 9.0f;
      CHECK(!dn__unskin(m, d, rest) && rest[0] == 0.0f);
      memset(m, 0, sizeof m);
      CHECK(!dn__unskin(m, d, rest));
   }
}
TEST(root_frame_does_not_see_how_the_character_is_turned)
{
   uint64_t seed = 8;
   size_t round, s, k;
   for (round = 0; round < 100; round++) {
      float palette[60], turned[60], turn[12], r[9], a[60], b[60];
      random_palette(&seed, 5, palette, (int)(round & 1));
      random_palette(&seed, 1, turn, 1);
      turn[3] = turn[7] = turn[11] = 0.0f;
      for (s = 0; s < 5; s++) dn__mul3x4(turn, palette + 12 * s, turned + 12 * s);
      dn__root_rotation(palette, r);
      dn__root_palette(palette, 5, r, a);
      dn__root_rotation(turned, r);
      dn__root_palette(turned, 5, r, b);
      for (k = 0; k < 60; k++) CHECK(near((double)a[k], (double)b[k], 1e-5));
      { /* P_root in its own frame: R^T P is what is left of it without the rotation, and R times that is P again */
         float v[3] = { 0.3f, -0.2f, 0.9f }, w[3], u[3];
         dn__transform(b, v, w);
         dn__rotate(r, w, w);
         dn__transform(turned, v, u);
         for (k = 0; k < 3; k++) CHECK(near((double)u[k], (double)w[k], 3e-6));
      }
   }
}
TEST(rows_write_their_own_columns)
{
   /* three features in rows of 11 floats: relative at 1, normal at 4, distance (3 joints) at 7; 0 and 10 are others' */
   uint64_t seed = 6;
   enum { N = 9, D = 11, I = 4 };
   float palette[36], rest[3 * N], coarse[3 * N], normal[3 * N], weight[5 * I], joint_rest[9], posed[3 * 16], rows[N * D];
   double place[3 * N];
   uint32_t joint[5 * I], vertex[N];
   static const uint32_t map[3] = { 2, 0, 1 };
   size_t i, k, s;
   random_palette(&seed, 3, palette, 0);
   for (i = 0; i < 3 * N; i++) rest[i] = test_uniform(&seed, -1, 1), coarse[i] = test_uniform(&seed, -1, 1), normal[i] = test_uniform(&seed, -1, 1);
   for (i = 0; i < 3 * N; i++) place[i] = (double)coarse[i];
   for (i = 0; i < 9; i++) joint_rest[i] = test_uniform(&seed, -1, 1);
   for (i = 0; i < 5 * I; i++) joint[i] = test_random(&seed) % 3, weight[i] = test_uniform(&seed, 0, 1);
   for (i = 0; i < N; i++) vertex[i] = (uint32_t)(i * 2 % 5);
   for (i = 0; i < N * D; i++) rows[i] = 77.0f;
   dn__posed_joints(palette, map, joint_rest, 3, posed);
   for (i = 0; i < N; i += 3) {
      dn__rows_relative(rest, joint, weight, I, vertex, palette, i, i + 3, rows + 1, D);
      dn__rows_normal(normal, i, i + 3, rows + 4, D);
      dn__rows_distance(place, posed, 3, i, i + 3, rows + 7, D);
   }
   for (i = 0; i < N; i++) {
      CHECK(rows[i * D] == 77.0f && rows[i * D + 10] == 77.0f);
      for (k = 0; k < 3; k++) {
         double r = 0.0;
         for (s = 0; s < I; s++) {
            const float *m = palette + 12 * joint[vertex[i] * I + s] + 4 * k;
            r += (double)weight[vertex[i] * I + s] *
                 ((double)m[0] * (double)rest[3 * i] + (double)m[1] * (double)rest[3 * i + 1] + (double)m[2] * (double)rest[3 * i + 2]);
         }
         CHECK(near((double)rows[i * D + 1 + k], r, 1e-5));
         CHECK(rows[i * D + 4 + k] == normal[3 * i + k]);
      }
      for (s = 0; s < 3; s++) {
         double square = 0.0;
         for (k = 0; k < 3; k++) {
            const float *m = palette + 12 * map[s] + 4 * k;
            double x = (double)m[0] * (double)joint_rest[3 * s] + (double)m[1] * (double)joint_rest[3 * s + 1] +
                       (double)m[2] * (double)joint_rest[3 * s + 2] + (double)m[3] - (double)coarse[3 * i + k];
            square += x * x;
         }
         CHECK(near((double)rows[i * D + 7 + s], sqrt(square), 1e-5));
      }
   }
   dn__rows_position(place, 0, N, rows, D);
   dn__rows_geodesic(coarse, 3, 0, N, rows + 4, D);
   for (i = 0; i < 3 * N; i++) CHECK(rows[i / 3 * D + i % 3] == coarse[i] && rows[i / 3 * D + 4 + i % 3] == coarse[i]);
}
TEST(names_lose_their_prefixes)
{
   CHECK(dn__name_equal(dn__name_core("mixamorig:Hips"), "Hips"));
   CHECK(dn__name_equal(dn__name_core("Armature|mixamorig:Hips"), "Hips"));
   CHECK(dn__name_equal(dn__name_core("Hips"), "Hips"));
   CHECK(dn__name_equal(dn__name_core("rig:"), ""));
   CHECK(!dn__name_equal("Hips", "Hip") && !dn__name_equal("Hip", "Hips") && !dn__name_equal("LeftArm", "LeftLeg"));
}

int main(int argc, char **argv)
{
   TEST_BEGIN(argc, argv);
   RUN(weld_by_number_in_order);
   RUN(weld_adds_repeated_joints_and_keeps_the_bar);
   RUN(weld_chains_do_not_creep);
   RUN(weld_agrees_with_brute_force);
   RUN(one_rings_agree_with_brute_force);
   RUN(a_hub_with_many_spokes);
   RUN(normals_gathered_and_scattered_are_the_same_bits);
   RUN(normals_weigh_by_area_and_survive_anything);
   RUN(rodrigues_turns_about_its_axis);
   RUN(orthonormalise_keeps_x_and_the_plane_of_x_and_y);
   RUN(forward_kinematics_and_palette);
   RUN(four_layouts_hold_the_same_matrix);
   RUN(lbs_is_the_weighted_sum);
   RUN(dqs_of_a_screw);
   RUN(dqs_is_rigid_and_follows_a_single_joint);
   RUN(dqs_signs_follow_the_heaviest_joint);
   RUN(unskinning_undoes_the_blend);
   RUN(root_frame_does_not_see_how_the_character_is_turned);
   RUN(rows_write_their_own_columns);
   RUN(names_lose_their_prefixes);
   return TEST_END();
}
