/*  invariance.c - what must not change the result: turning the character, the order of vertices and triangles, threads,
    memory layouts, who allocates; and what must: strength, masks, joints that are not there
    build     cc -g invariance.c -o invariance -lm -lpthread
    run       ./invariance [part of a test's name]      in this folder: the models are those of data/golden */
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
#include <pthread.h>

/* --- a body: a bent, lumpy capsule of 1,920 nodes around a chain of five joints, cut open along a seam as a UV map
   would, so 2,000-odd render vertices. No two places are alike, so that no two pooling scores tie. */
enum { RINGS = 40, AROUND = 48, BODY_V = RINGS * (AROUND + 1) + 2, BODY_N = RINGS * AROUND + 2, BODY_T = 2 * RINGS * AROUND,
       BODY_S = 5, BODY_I = 4 };
typedef struct body {
   float positions[BODY_V * 3], weights[BODY_V * BODY_I], inverse_bind[BODY_S * 12], palette[BODY_S * 12];
   uint32_t joints[BODY_V * BODY_I], indices[BODY_T * 3];
   int32_t parents[BODY_S + 1];
   const char *names[BODY_S + 1];
   dn_skin_set skin;
   dn_rig_desc desc;
} body;

static void body_vertex(body *b, size_t v, double x, double angle, double radius)
{
   double at = (x + 0.9) / 1.8 * (BODY_S - 1), lump = 1 + 0.07 * sin(9 * x + 2 * angle) + 0.03 * sin(31 * x - 5 * angle);
   size_t first = at < 0 ? 0 : at >= BODY_S - 1 ? BODY_S - 2 : (size_t)at, k;
   unsigned share = (unsigned)(255 * (1 - (at - (double)first)) + 0.5), third; /* weights are k/255: exact in every type */
   share = share > 255 ? 255 : share;
   third = share > 20 && share < 235 ? 10 : 0; /* a third joint's small say */
   b->positions[3 * v] = (float)(x + 0.02 * sin(3 * angle + x));
   b->positions[3 * v + 1] = (float)(radius * lump * cos(angle) + 0.1 * x * x);
   b->positions[3 * v + 2] = (float)(radius * lump * sin(angle));
   for (k = 0; k < BODY_I; k++) b->joints[BODY_I * v + k] = 0, b->weights[BODY_I * v + k] = 0;
   b->joints[BODY_I * v] = (uint32_t)first, b->weights[BODY_I * v] = (float)(share - third) / 255.0f;
   b->joints[BODY_I * v + 1] = (uint32_t)first + 1, b->weights[BODY_I * v + 1] = (float)(255 - share) / 255.0f;
   b->joints[BODY_I * v + 2] = (uint32_t)(first + 2) % BODY_S, b->weights[BODY_I * v + 2] = (float)third / 255.0f;
}
/* rotation about a unit axis through `centre`, as 3x4 rows */
static void turn(float m[12], double x, double y, double z, double angle, const double centre[3])
{
   double c = cos(angle), s = sin(angle), t = 1 - c, r[9];
   size_t i;
   r[0] = t * x * x + c, r[1] = t * x * y - s * z, r[2] = t * x * z + s * y;
   r[3] = t * x * y + s * z, r[4] = t * y * y + c, r[5] = t * y * z - s * x;
   r[6] = t * x * z - s * y, r[7] = t * y * z + s * x, r[8] = t * z * z + c;
   for (i = 0; i < 3; i++) {
      double moved = centre[i];
      size_t j;
      for (j = 0; j < 3; j++) m[4 * i + j] = (float)r[3 * i + j], moved -= r[3 * i + j] * centre[j];
      m[4 * i + 3] = (float)moved;
   }
}
static void multiply(const float a[12], const float b[12], float out[12])
{
   double m[12];
   size_t i, j, k;
   for (i = 0; i < 3; i++)
      for (j = 0; j < 4; j++) {
         m[4 * i + j] = j == 3 ? (double)a[4 * i + 3] : 0;
         for (k = 0; k < 3; k++) m[4 * i + j] += (double)a[4 * i + k] * (double)b[4 * k + j];
      }
   for (i = 0; i < 12; i++) out[i] = (float)m[i];
}
static void body_make(body *b)
{
   static const char *const names[BODY_S + 1] = {"joint0", "joint1", "joint2", "joint3", "joint4", "twist"};
   size_t r, a, n = 0, v = 0, s;
   memset(b, 0, sizeof *b);
   for (r = 0; r < RINGS; r++)
      for (a = 0; a <= AROUND; a++, v++) {
         double x = -0.85 + 1.7 * (double)r / (RINGS - 1), radius = 0.3 * sqrt(1 - x * x / 0.81);
         body_vertex(b, v, x, 2 * 3.14159265358979 * (double)(a % AROUND) / AROUND, radius); /* column AROUND repeats column 0 */
      }
   body_vertex(b, v, -0.9, 0, 0);
   body_vertex(b, v + 1, 0.9, 0, 0);
   for (r = 0; r + 1 < RINGS; r++)
      for (a = 0; a < AROUND; a++) {
         uint32_t p = (uint32_t)(r * (AROUND + 1) + a), q = p + AROUND + 1;
         uint32_t t[6];
         t[0] = p, t[1] = p + 1, t[2] = q, t[3] = p + 1, t[4] = q + 1, t[5] = q;
         memcpy(b->indices + n, t, sizeof t);
         n += 6;
      }
   for (a = 0; a < AROUND; a++) {
      uint32_t last = (RINGS - 1) * (AROUND + 1) + (uint32_t)a;
      b->indices[n++] = (uint32_t)v, b->indices[n++] = (uint32_t)a + 1, b->indices[n++] = (uint32_t)a;
      b->indices[n++] = (uint32_t)v + 1, b->indices[n++] = last, b->indices[n++] = last + 1;
   }
   for (s = 0; s < BODY_S; s++) {
      float *m = b->inverse_bind + 12 * s, local[12];
      double centre[3];
      centre[0] = -0.9 + 1.8 * (double)s / (BODY_S - 1), centre[1] = 0.1 * centre[0] * centre[0], centre[2] = 0;
      m[0] = m[5] = m[10] = 1;
      m[3] = -(float)centre[0], m[7] = -(float)centre[1];
      turn(local, 0.6, 0.0, 0.8, s ? 0.35 : 0.2, centre); /* each joint turns all that follow it */
      if (s) multiply(b->palette + 12 * (s - 1), local, b->palette + 12 * s);
      else memcpy(b->palette, local, sizeof local);
      b->parents[s] = (int32_t)s - 1;
   }
   b->parents[BODY_S] = 2;
   memcpy(b->names, names, sizeof names);
   b->skin.influences = BODY_I;
   b->skin.joints = b->joints, b->skin.joint_type = DN_U32;
   b->skin.weights = b->weights, b->skin.weight_type = DN_F32;
   b->desc.mesh.vertices = BODY_V;
   b->desc.mesh.positions = b->positions;
   b->desc.mesh.triangles = BODY_T;
   b->desc.mesh.indices = b->indices, b->desc.mesh.index_type = DN_U32;
   b->desc.mesh.skin_sets = 1, b->desc.mesh.skin = &b->skin;
   b->desc.skeleton.joints = BODY_S;
   b->desc.skeleton.names = b->names;
   b->desc.skeleton.parents = b->parents;
   b->desc.skeleton.inverse_bind = b->inverse_bind, b->desc.skeleton.matrix = DN_3X4_ROWS;
   b->desc.resolution = 32;
}

/* --- models: the golden ones, with another frame or pooling written over the file's text (spaces fill up) */
static void overwrite(unsigned char *file, size_t size, const char *key, const char *value)
{
   char find[96];
   size_t n = (size_t)snprintf(find, sizeof find, "\"%s\":\"", key), i;
   for (i = 8; i + n < size; i++)
      if (memcmp(file + i, find, n) == 0) {
         unsigned char *at = file + i + n;
         size_t room = 0, length = strlen(value);
         while (at[room] != '"') room++;
         if (length > room) break;
         memcpy(at, value, length);
         at[length] = '"';
         memset(at + length + 1, ' ', room - length);
         return;
      }
   fprintf(stderr, "invariance: no room for %s = %s\n", key, value);
   exit(2);
}
static dn_model *model_of(const char *name, const char *frame, const char *pooling)
{
   char path[128];
   size_t size;
   unsigned char *file;
   dn_model *m;
   dn_error e;
   snprintf(path, sizeof path, "data/golden/%s.safetensors", name);
   file = test_file(path, &size);
   if (frame && strcmp(frame, "model") != 0) overwrite(file, size, "deformnet.frame", frame);
   if (pooling && strcmp(pooling, "dynamic") != 0) overwrite(file, size, "deformnet.pooling", pooling);
   m = dn_model_load(file, size, NULL, NULL, &e);
   CHECK_MSG(m != NULL, "%s: %s", name, m ? "" : e.info);
   free(file);
   return m;
}
static const struct { const char *name, *frame, *pooling; } models[] = {
   {"mlp_small", "root", NULL},
   {"gat_small", "root", NULL},
   {"neuroskinning_small", "root", NULL},
   {"densegats_small", "root", NULL},
   {"multiresgnet_small", "root", "dynamic"},
   {"multiresgnet_small", "root", "rest"},
   {"multiresgnet_small", "model", "dynamic"}};
enum { MODELS = sizeof models / sizeof *models, MAX_V = BODY_V + 64 };

/* --- one frame, everything it writes */
typedef struct result {
   float positions[MAX_V * 3], normals[MAX_V * 3], displacement[MAX_V * 3], rest_delta[MAX_V * 3];
   dn_output out;
   dn_report report;
   dn_result code;
} result;
static int fill = 0x5a; /* what scratch holds beforehand */
static void check_box(const dn_rig *rig, const result *r) /* of the positions that came out, NaN left out */
{
   dn_rig_view view;
   size_t v, k;
   dn_rig_describe(rig, &view);
   for (k = 0; k < 3; k++) {
      float low = 3.402823466e38f, high = -low;
      for (v = 0; v < view.vertices; v++) {
         float x = r->positions[3 * v + k];
         if (x < low) low = x;
         if (x > high) high = x;
      }
      CHECK(r->out.bounds_min[k] >= low && r->out.bounds_min[k] <= low && r->out.bounds_max[k] >= high && r->out.bounds_max[k] <= high);
   }
}
static void frame(const dn_rig *rig, const dn_pose *pose, const dn_parallel *par, result *r)
{
   size_t bytes = dn_scratch_size(rig, par ? par->workers : 1);
   void *scratch = test_aligned(bytes);
   dn_error e;
   memset(scratch, fill, bytes);
   memset(&r->out, 0, sizeof r->out);
   r->out.positions = r->positions;
   r->out.normals = r->normals;
   r->out.displacement = r->displacement;
   r->out.rest_delta = r->rest_delta;
   r->code = dn_deform(rig, pose, &r->out, scratch, bytes, par, &e);
   check_box(rig, r);
   test_aligned_free(scratch);
}
static dn_pose pose_of(const float *palette)
{
   dn_pose p;
   memset(&p, 0, sizeof p);
   p.palette = palette;
   p.strength = 1;
   return p;
}
static result *deformed(const dn_model *m, const body *b) /* free it; NULL and a failed check when bind refuses */
{
   result *r = (result *)test_block(sizeof *r);
   dn_error e;
   dn_rig *rig;
   dn_pose pose = pose_of(b->palette);
   memset(r, 0, sizeof *r);
   rig = dn_rig_create(m, &b->desc, NULL, &r->report, &e);
   CHECK_MSG(rig != NULL, "bind: %s", rig ? "" : e.info);
   if (rig) frame(rig, &pose, NULL, r);
   CHECK_MSG(r->code == DN_OK, "deform: %s", dn_result_text(r->code));
   dn_rig_free(rig);
   return r;
}
static size_t differing(const result *a, const result *b, size_t vertices) /* bytes that are not the same */
{
   const unsigned char *p[4], *q[4];
   size_t i, k, n = 0;
   p[0] = (const unsigned char *)a->positions, q[0] = (const unsigned char *)b->positions;
   p[1] = (const unsigned char *)a->normals, q[1] = (const unsigned char *)b->normals;
   p[2] = (const unsigned char *)a->displacement, q[2] = (const unsigned char *)b->displacement;
   p[3] = (const unsigned char *)a->rest_delta, q[3] = (const unsigned char *)b->rest_delta;
   for (k = 0; k < 4; k++)
      for (i = 0; i < vertices * 12; i++) n += p[k][i] != q[k][i];
   n += memcmp(a->out.bounds_min, b->out.bounds_min, 12) != 0;
   n += memcmp(a->out.bounds_max, b->out.bounds_max, 12) != 0;
   return n + (a->code != b->code) + (a->out.fallback_nodes != b->out.fallback_nodes);
}
static double largest(const float *x, size_t n)
{
   double most = 0;
   size_t i;
   for (i = 0; i < n; i++) most = fabs((double)x[i]) > most ? fabs((double)x[i]) : most;
   return most;
}

static body b0, b1; /* the body, and one that a test spoils */

TEST(turning_the_character_turns_the_result)
{
   static const double axes[3][4] = {{0, 0, 1, 1.2}, {0.6, 0.8, 0, -2.6}, {0.48, -0.6, 0.64, 3.0}};
   size_t k, q, v, i, j, turned = 0;
   double worst = 0, least_change = 1e9;
   body_make(&b0);
   for (k = 0; k < MODELS; k++) {
      dn_model *m = model_of(models[k].name, models[k].frame, models[k].pooling);
      int root = strcmp(models[k].frame, "root") == 0;
      result *a = deformed(m, &b0);
      CHECK(largest(a->displacement, 3 * BODY_V) > 1e-3);
      for (q = 0; q < 3; q++) {
         static const double centres[2][3] = {{0.3, -0.2, 0.5}, {0, 0, 0}};
         const double *origin = centres[strcmp(models[k].name, "densegats_small") == 0]; /* its feature position knows where it is */
         float whole[12];
         double change = 0;
         result *c;
         b1 = b0;
         b1.desc.mesh.skin = &b1.skin;
         turn(whole, axes[q][0], axes[q][1], axes[q][2], axes[q][3], origin);
         for (i = 0; i < BODY_S; i++) multiply(whole, b0.palette + 12 * i, b1.palette + 12 * i);
         c = deformed(m, &b1);
         for (v = 0; v < BODY_V; v++)
            for (i = 0; i < 3; i++) {
               double want = 0, e;
               for (j = 0; j < 3; j++) want += (double)whole[4 * i + j] * (double)a->displacement[3 * v + j];
               e = fabs(want - (double)c->displacement[3 * v + i]);
               change = e > change ? e : change;
            }
         if (root) {
            CHECK_MSG(change <= 1e-5, "%s %s: %.2e m apart after turn %lu", models[k].name, models[k].pooling ? models[k].pooling : "", change,
                      (unsigned long)q);
            worst = change > worst ? change : worst;
            turned++;
         } else least_change = change < least_change ? change : least_change;
         free(c);
      }
      free(a);
      dn_model_free(m);
   }
   CHECK_MSG(least_change > 1e-3, "frame \"model\" should depend on the turn: %.2e", least_change); /* so the test can fail */
   AT_LEAST(turned, 18, "turned frames");
}

static void shuffle(uint32_t *order, size_t n, uint64_t *seed)
{
   size_t i;
   for (i = 0; i < n; i++) order[i] = (uint32_t)i;
   for (i = n; i > 1; i--) {
      size_t j = test_random(seed) % i;
      uint32_t x = order[i - 1];
      order[i - 1] = order[j], order[j] = x;
   }
}
TEST(order_of_vertices_and_triangles)
{
   static uint32_t vertex[BODY_V], triangle[BODY_T];
   size_t k, v, i, compared = 0;
   uint64_t seed = 7;
   body_make(&b0);
   for (k = 0; k < MODELS; k++) {
      dn_model *m = model_of(models[k].name, models[k].frame, models[k].pooling);
      result *a = deformed(m, &b0), *c;
      double worst = 0;
      int pass;
      for (pass = 0; pass < 3; pass++) { /* triangles alone, then vertices too, then with the nodes in another order */
         b1 = b0;
         b1.desc.mesh.skin = &b1.skin;
         b1.desc.mesh.positions = b1.positions, b1.desc.mesh.indices = b1.indices;
         b1.skin.joints = b1.joints, b1.skin.weights = b1.weights;
         b1.desc.order = pass == 2 ? DN_ORDER_NEAR : DN_ORDER_GIVEN;
         shuffle(triangle, BODY_T, &seed);
         if (pass) shuffle(vertex, BODY_V, &seed);
         else
            for (v = 0; v < BODY_V; v++) vertex[v] = (uint32_t)v;
         for (v = 0; v < BODY_V; v++) { /* vertex v moves to place vertex[v] */
            memcpy(b1.positions + 3 * vertex[v], b0.positions + 3 * v, 12);
            memcpy(b1.joints + BODY_I * vertex[v], b0.joints + BODY_I * v, BODY_I * 4);
            memcpy(b1.weights + BODY_I * vertex[v], b0.weights + BODY_I * v, BODY_I * 4);
         }
         for (i = 0; i < BODY_T; i++) {
            uint32_t spin = test_random(&seed) % 3, j;
            for (j = 0; j < 3; j++) b1.indices[3 * triangle[i] + (j + spin) % 3] = vertex[b0.indices[3 * i + j]];
         }
         c = deformed(m, &b1);
         for (v = 0, worst = 0; v < BODY_V; v++)
            for (i = 0; i < 3; i++) {
               double d = fabs((double)a->displacement[3 * v + i] - (double)c->displacement[3 * vertex[v] + i]);
               double p = fabs((double)a->positions[3 * v + i] - (double)c->positions[3 * vertex[v] + i]);
               double n = fabs((double)a->normals[3 * v + i] - (double)c->normals[3 * vertex[v] + i]) * 0.01;
               worst = d > worst ? d : worst;
               worst = p > worst ? p : worst;
               worst = n > worst ? n : worst;
               compared++;
            }
         CHECK_MSG(worst <= 1e-5, "%s %s: %.2e apart, pass %d", models[k].name, models[k].pooling ? models[k].pooling : "", worst, pass);
         CHECK(memcmp(&a->report, &c->report, sizeof a->report) == 0);
         CHECK(a->report.nodes == BODY_N && a->report.seams_welded == RINGS && a->report.seams_apart == 0);
         free(c);
      }
      free(a);
      dn_model_free(m);
   }
   AT_LEAST(compared, 3 * MODELS * BODY_V * 3, "coordinates");
}

static size_t reach(const dn_graph *g) /* the largest |i - j| over the edges */
{
   size_t i, e, most = 0;
   for (i = 0; i < g->nodes; i++)
      for (e = g->first[i]; e < g->first[i + 1]; e++) {
         size_t j = g->next[e], d = i > j ? i - j : j - i;
         most = d > most ? d : most;
      }
   return most;
}
TEST(near_order_is_the_same_graph_in_another_order)
{
   static uint32_t vertex[BODY_V];
   static float odd[BODY_N * BODY_S];
   dn_model *m = model_of("densegats_small", "model", NULL);
   dn_rig *given, *near, *known;
   dn_rig_view g, n, q;
   dn_error e;
   uint64_t seed = 3;
   size_t v, i, j, edges = 0, same = 0, rows = 0, seen = 0;
   body_make(&b0);
   b1 = b0;
   b1.desc.mesh.skin = &b1.skin, b1.desc.mesh.positions = b1.positions, b1.desc.mesh.indices = b1.indices;
   b1.skin.joints = b1.joints, b1.skin.weights = b1.weights;
   shuffle(vertex, BODY_V, &seed);
   for (v = 0; v < BODY_V; v++) {
      memcpy(b1.positions + 3 * vertex[v], b0.positions + 3 * v, 12);
      memcpy(b1.joints + BODY_I * vertex[v], b0.joints + BODY_I * v, BODY_I * 4);
      memcpy(b1.weights + BODY_I * vertex[v], b0.weights + BODY_I * v, BODY_I * 4);
   }
   for (i = 0; i < 3 * BODY_T; i++) b1.indices[i] = vertex[b0.indices[i]];
   given = dn_rig_create(m, &b1.desc, NULL, NULL, &e);
   b1.desc.order = DN_ORDER_NEAR;
   near = dn_rig_create(m, &b1.desc, NULL, NULL, &e);
   for (i = 0; i < BODY_N * BODY_S; i++) odd[i] = (float)i; /* known distances come in the given order all the same */
   b1.desc.geodesic = odd, b1.desc.geodesic_nodes = BODY_N;
   known = dn_rig_create(m, &b1.desc, NULL, NULL, &e);
   CHECK(given && near && known);
   dn_rig_describe(given, &g);
   dn_rig_describe(near, &n);
   dn_rig_describe(known, &q);
   CHECK(g.nodes == n.nodes && g.graph.first[g.nodes] == n.graph.first[n.nodes] && g.triangles == n.triangles);
   CHECK_MSG(reach(&g.graph) > BODY_N / 2, "%lu", (unsigned long)reach(&g.graph)); /* so the next can fail */
   CHECK_MSG(reach(&n.graph) < 3 * AROUND, "%lu", (unsigned long)reach(&n.graph));
   for (v = 0; v < BODY_V; v++) CHECK(g.first_vertex[g.node_of_vertex[v]] == n.first_vertex[n.node_of_vertex[v]]);
   for (i = 0; i < g.nodes; i++) {
      size_t to = n.node_of_vertex[g.first_vertex[i]];
      CHECK(g.graph.first[i + 1] - g.graph.first[i] == n.graph.first[to + 1] - n.graph.first[to]);
      for (j = n.graph.first[to]; j < n.graph.first[to + 1]; j++, edges++) {
         size_t back = g.node_of_vertex[n.first_vertex[n.graph.next[j]]], k;
         for (k = g.graph.first[i]; k < g.graph.first[i + 1] && g.graph.next[k] != back; k++) {}
         CHECK(k < g.graph.first[i + 1]);
         CHECK(j == n.graph.first[to] || n.graph.next[j] > n.graph.next[j - 1]);
      }
      rows += memcmp(n.rest + 3 * to, g.rest + 3 * i, 12) == 0;
      same += memcmp(q.geodesic + BODY_S * to, odd + BODY_S * i, BODY_S * 4) == 0;
      seen += to != i;
      for (j = 0; j < BODY_S; j++)
         CHECK(fabs((double)n.geodesic[BODY_S * to + j] - (double)g.geodesic[BODY_S * i + j]) <= 1e-5);
   }
   CHECK(rows == BODY_N && same == BODY_N);
   AT_LEAST(seen, BODY_N / 2, "nodes that moved");
   AT_LEAST(edges, 6 * BODY_N - 12, "directed edges");
   dn_rig_free(given);
   dn_rig_free(near);
   dn_rig_free(known);
   dn_model_free(m);
}

TEST(seams_stay_closed)
{
   size_t k, r, pairs = 0;
   body_make(&b0);
   for (k = 0; k < MODELS; k++) {
      dn_model *m = model_of(models[k].name, models[k].frame, models[k].pooling);
      result *a = deformed(m, &b0);
      for (r = 0; r < RINGS; r++, pairs++) {
         size_t p = 3 * r * (AROUND + 1), q = p + 3 * AROUND;
         CHECK_MSG(memcmp(a->positions + p, a->positions + q, 12) == 0, "ring %lu opens", (unsigned long)r);
         CHECK(memcmp(a->normals + p, a->normals + q, 12) == 0);
         CHECK(memcmp(a->rest_delta + p, a->rest_delta + q, 12) == 0);
      }
      free(a);
      dn_model_free(m);
   }
   AT_LEAST(pairs, MODELS * RINGS, "pairs");
}

/* --- two job systems: one that cuts and mixes ranges in one thread, one with real threads */
typedef struct mixer { uint64_t seed; unsigned workers; size_t ranges; } mixer;
static void mix(void *user, size_t count, size_t grain, dn_range_fn *fn, void *job)
{
   mixer *m = (mixer *)user;
   size_t cuts[4096], n = 0, at = 0, i;
   while (at < count && n < 4095) {
      size_t step = (1 + test_random(&m->seed) % 3) * grain;
      cuts[n++] = at;
      at = step > count - at || n == 4095 ? count : at + step;
   }
   cuts[n] = count;
   for (i = n; i > 0; i--) { /* last first */
      fn(job, cuts[i - 1], cuts[i], test_random(&m->seed) % m->workers);
      m->ranges++;
   }
}
typedef struct share { dn_range_fn *fn; void *job; size_t count, grain; unsigned worker, workers; } share;
static void *work(void *p)
{
   share *s = (share *)p;
   size_t at = s->worker * s->grain, step = s->workers * s->grain;
   for (; at < s->count; at += step) s->fn(s->job, at, at + s->grain < s->count ? at + s->grain : s->count, s->worker);
   return NULL;
}
static void spread(void *user, size_t count, size_t grain, dn_range_fn *fn, void *job)
{
   unsigned workers = *(unsigned *)user, i;
   pthread_t thread[16];
   share s[16];
   for (i = 0; i < workers; i++) {
      s[i].fn = fn, s[i].job = job, s[i].count = count, s[i].grain = grain, s[i].worker = i, s[i].workers = workers;
      if (pthread_create(&thread[i], NULL, work, &s[i])) exit(2);
   }
   for (i = 0; i < workers; i++) pthread_join(thread[i], NULL);
}
TEST(any_number_of_threads_gives_the_same_bits)
{
   static const unsigned counts[] = {2, 3, 7, 16};
   size_t k, n, kind, frames = 0, ranges = 0;
   body_make(&b0);
   for (k = 0; k < MODELS; k++) {
      dn_model *m = model_of(models[k].name, models[k].frame, models[k].pooling);
      result *a = deformed(m, &b0), *c = (result *)test_block(sizeof *c);
      for (kind = 0; kind < 2; kind++)
         for (n = 0; n < sizeof counts / sizeof *counts; n++) {
            dn_parallel par;
            mixer mixed;
            unsigned workers = counts[n];
            dn_error e;
            dn_rig *rig;
            dn_pose pose = pose_of(b0.palette);
            mixed.seed = 11 + k + n, mixed.workers = workers, mixed.ranges = 0;
            par.workers = workers;
            par.run = kind ? spread : mix;
            par.user = kind ? (void *)&workers : (void *)&mixed;
            b0.desc.parallel = &par; /* bind in parallel too */
            memset(c, 0, sizeof *c);
            rig = dn_rig_create(m, &b0.desc, NULL, &c->report, &e);
            b0.desc.parallel = NULL;
            CHECK_MSG(rig != NULL, "%s", rig ? "" : e.info);
            if (!rig) continue;
            frame(rig, &pose, &par, c);
            CHECK_MSG(differing(a, c, BODY_V) == 0, "%s, %u workers, %s: %lu bytes differ", models[k].name, workers, kind ? "threads" : "mixed",
                      (unsigned long)differing(a, c, BODY_V));
            CHECK(memcmp(&a->report, &c->report, sizeof a->report) == 0);
            ranges += mixed.ranges;
            frames++;
            dn_rig_free(rig);
         }
      free(a);
      free(c);
      dn_model_free(m);
   }
   AT_LEAST(ranges, 1000, "ranges cut");
   AT_LEAST(frames, MODELS * 8, "frames");
}

/* --- waves: whatever the graph, the chunk, the rings and who ran what, each node's numbers are the bits of one block after
   another on all nodes */
static float *rows_of(size_t nodes, size_t width, uint64_t *seed)
{
   float *x = (float *)test_block((nodes * width + 1) * sizeof *x);
   size_t i;
   for (i = 0; i < nodes * width; i++) x[i] = (float)((double)test_random(seed) / 2147483648.0 - 1);
   return x;
}
/* edges from each node to some at most `span` on; kind 0 no more, 1 numbered at random, 2 a hub at each end, 3 no edges */
static dn_graph graph_make(size_t nodes, size_t span, int kind, uint64_t *seed, uint32_t **first, uint32_t **next)
{
   uint32_t *triangle = (uint32_t *)test_block(12 * (6 * nodes + 1)), *at = (uint32_t *)test_block(4 * nodes);
   size_t t = 0, i, k;
   void *scratch;
   dn_graph g;
   for (i = 0; i < nodes; i++) at[i] = (uint32_t)i;
   if (kind == 1) shuffle(at, nodes, seed);
   for (i = 0; i < nodes && kind != 3; i++)
      for (k = 0; k < 4; k++) {
         size_t j = k == 3 && kind == 2 ? i % 2 * (nodes - 1) : i + 1 + test_random(seed) % span;
         if (j >= nodes || (k == 3 && kind != 2)) continue;
         triangle[3 * t] = at[i], triangle[3 * t + 1] = triangle[3 * t + 2] = at[j];
         t++;
      }
   *first = (uint32_t *)test_block(4 * (nodes + 1)), *next = (uint32_t *)test_block(4 * (6 * t + 1));
   scratch = test_aligned(dn_graph_scratch(nodes, t));
   dn_graph_build(triangle, t, nodes, *first, *next, &g, scratch);
   test_aligned_free(scratch);
   free(triangle);
   free(at);
   return g;
}
static void plain_linear(const dn__block *b, const float *add, const float *x, size_t x_stride, size_t rows, float *y, size_t y_stride)
{
   dn_linear l = b->linear;
   l.add = add;
   dn_linear_run(&l, x, x_stride, rows, y, y_stride, NULL);
}
static void plain_tail(const dn__block *b, const float *x, size_t stride, size_t nodes, float *y)
{
   float *t0 = (float *)test_block(nodes * b[0].out * 4), *t1 = (float *)test_block(nodes * b[1].out * 4);
   plain_linear(b, NULL, x, stride, nodes, t0, b[0].out);
   plain_linear(b + 1, NULL, t0, b[0].out, nodes, t1, b[1].out);
   plain_linear(b + 2, NULL, t1, b[1].out, nodes, y, 3);
   free(t0);
   free(t1);
}
static void plain_dense(const dn__block *b, size_t count, const dn_graph *g, float *rows, size_t stride, size_t width, void *scratch)
{
   dn_gat gat[6];
   size_t i;
   for (i = 0; i < count; i++) gat[i] = b[i].gat;
   dn_dense_run(gat, count, g, rows, stride, width, scratch, NULL);
}
/* the last module's rows stay in wide (N, width of the last module) for the taps */
static void plain_densegats(const dn_model *m, const dn_graph *g, const float *rows, const float *start, float *wide, float *y)
{
   const dn__block *b = m->blocks;
   size_t N = g->nodes, k, i, stride = b[21].in + b[21].out, most = stride > b[7].in + b[7].out ? stride : b[7].in + b[7].out;
   float *t = (float *)test_block(N * most * 4), *w = (float *)test_block(N * most * 4);
   void *scratch = test_aligned(dn__block_scratch(b, m->block_count, N) + 64);
   plain_linear(b, start, rows, dn__live_width(m->stage), N, t, b[0].out);
   plain_linear(b + 1, NULL, t, b[0].out, N, w, b[1].out);
   for (k = 0; k < 3; k++) {
      const dn__block *into = b + 1 + 7 * k, *module = into + 1;
      size_t width = module[5].in + module[5].out;
      for (i = 0; i < N; i++) memcpy(wide + i * width + width - into->out, w + i * into->out, into->out * 4);
      plain_dense(module, 6, g, wide, width, width, scratch);
      if (k < 2) dn_gat_run(&module[6].gat, g, wide, width, w, module[6].out, scratch, NULL);
   }
   plain_tail(b + 22, wide, stride, N, y);
   free(t);
   free(w);
   test_aligned_free(scratch);
}
static void plain_multiresgnet(const dn_model *m, const dn_graph *g, const float *rows, const float *start, float *wide, float *y)
{
   const dn__block *b = m->blocks;
   const dn_pool *pool = &m->branch[0].pool;
   size_t N = g->nodes, E = g->first[N], stride = b[7].in, x = b[1].out, at = b[3].in + b[3].out - x, u = b[5].out;
   size_t most = u > b[0].out ? u : b[0].out;
   float *t = (float *)test_block(N * most * 4), *v = (float *)test_block(N * (most + x) * 4), *scores = (float *)test_block((E + 1) * 4);
   float *w = (float *)test_block(N * (b[4].out + 1) * 4);
   void *scratch = test_aligned(dn__block_scratch(b, m->block_count, N) + dn_pool_scratch(N, E));
   dn_clusters c;
   dn__arena a = dn__arena_of(NULL, 0);
   unsigned char *memory;
   dn__clusters_layout(&c, N, E, &a);
   memory = (unsigned char *)test_aligned(a.used);
   a = dn__arena_of(memory, a.used);
   dn__clusters_layout(&c, N, E, &a);
   c.score = (float *)test_block(N * 4);
   plain_linear(b, start, rows, dn__live_width(m->stage), N, t, b[0].out);
   plain_linear(b + 1, NULL, t, b[0].out, N, wide + at, stride);
   dn_pool_scores(pool, g, wide + at, stride, scores, scratch, NULL);
   dn_pool_contract(g, scores, &c, scratch);
   dn_pool_gather(pool, &c, wide + at, stride, x, v, x, NULL);
   plain_dense(b + 2, 2, g, wide, stride, at + x, scratch);
   dn_gat_run(&b[4].gat, &c.graph, v, x, w, b[4].out, scratch, NULL);
   dn_gat_run(&b[5].gat, &c.graph, w, b[4].out, v, u, scratch, NULL);
   dn_pool_scatter(pool, &c, v, u, u, N, t, u, NULL);
   dn_gat_run(&b[6].gat, g, t, u, wide + at + x, stride, scratch, NULL);
   plain_tail(b + 7, wide, stride, N, y);
   free(t), free(v), free(w), free(scores), free(c.score);
   test_aligned_free(memory);
   test_aligned_free(scratch);
}
typedef struct watched { const dn_model *m; const float *wide; size_t nodes, columns, equal, next, calls; pthread_t thread; const char *name; } watched;
static void watch_rows(void *user, const char *name, const float *rows, size_t first, size_t count, size_t width, size_t stride)
{
   watched *w = (watched *)user;
   const dn__block *last = w->m->blocks + (w->m->info.arch == DN_DENSEGATS ? 21 : 3);
   size_t made = 0, i, row = w->columns;
   w->calls++;
   CHECK(pthread_equal(pthread_self(), w->thread) && first + count <= w->nodes && stride >= width);
   if (strcmp(name, w->name) == 0) CHECK(first == w->next), w->next = first + count;
   for (; strcmp(name, last->name) != 0; last--) /* its columns are there: later blocks stand to the left of it, x_0 (pre.1, a transition) last */
      if (strncmp(last->name, "dense.2.", 8) != 0 && strncmp(last->name, "local.", 6) != 0) return;
      else made += last->out;
   for (i = 0; i < count; i++) w->equal += memcmp(rows + i * stride, w->wide + (first + i) * row + made, width * 4) == 0;
}
TEST(waves_give_the_bits_of_one_block_after_another)
{
   static const size_t sizes[] = {1, 2, 41, 43, 168, 700, 1500}, spans[] = {1, 20, 90, 100000};
   static const unsigned counts[] = {1, 2, 3, 7, 16};
   size_t k, n, s, c, runs = 0, slid = 0, whole = 0, taps = 0;
   uint64_t seed = 5;
   for (k = 0; k < 2; k++) {
      dn_model *m = model_of(k ? "multiresgnet_small" : "densegats_small", "model", NULL);
      const dn__block *b = m->blocks;
      size_t columns = k ? b[7].in : b[21].in + b[21].out, most = dn__max(columns, k ? 0 : b[7].in + b[7].out);
      for (n = 0; n < sizeof sizes / sizeof *sizes; n++)
         for (s = 0; s < 4; s++) {
            size_t N = sizes[n], i;
            uint32_t *first, *next;
            dn_graph g = graph_make(N, s < 3 ? spans[s] : 30, s == 3 ? (int)(1 + n % 3) : 0, &seed, &first, &next);
            float *rows = rows_of(N, dn__live_width(m->stage), &seed), *start = m->bound.in ? rows_of(N, b[0].out, &seed) : NULL;
            float *wide = (float *)test_block(N * most * 4), *want = (float *)test_block(N * 12), *y = (float *)test_block(N * 12);
            (k ? plain_multiresgnet : plain_densegats)(m, &g, rows, start, wide, want);
            for (c = 0; c < 12; c++) {
               static const size_t chunks[] = {0, 42, 84, 126, 210, 100000}; /* 0: as chosen */
               dn__extent e = dn__extent_of(N, g.first[N], c == 11 ? SIZE_MAX : dn__graph_bandwidth(&g));
               unsigned workers = counts[(c + n) % 5];
               dn__arena a = dn__arena_of(NULL, 0);
               dn_parallel par;
               dn_probe probe;
               mixer mixed;
               watched w;
               dn__net net;
               dn__run r;
               size_t chunk = chunks[c % 6], bytes = 0;
               void *memory, *work = NULL;
               mixed.seed = 3 + c, mixed.workers = workers, mixed.ranges = 0;
               par.workers = workers, par.run = c % 2 && workers > 1 ? spread : mix;
               par.user = c % 2 && workers > 1 ? (void *)&workers : (void *)&mixed;
               dn__net_layout(&net, m, &e, workers, &a);
               memory = test_aligned(a.used);
               memset(memory, 0xff, a.used);
               a = dn__arena_of(memory, a.used);
               dn__net_layout(&net, m, &e, workers, &a);
               for (i = 0; i < 3 && chunk; i++)
                  if (net.plan[i].nodes) dn__plan_at(&net.plan[i], dn__min(chunk, dn__round(N, 2) * 42)), bytes = dn__max(bytes, net.plan[i].bytes);
               if (chunk) net.work = work = test_aligned(bytes), memset(work, 0xff, bytes);
               memset(&r, 0, sizeof r);
               memset(&w, 0, sizeof w);
               memset(&probe, 0, sizeof probe);
               r.m = m, r.stage = m->stage, r.g = &g, r.n = &net, r.par = &par, r.start = start;
               w.m = m, w.wide = wide, w.nodes = N, w.columns = columns, w.thread = pthread_self(), w.name = b[m->block_count - 1].name;
               probe.tap = watch_rows, probe.user = &w;
               if (c % 3 == 0) r.probe = &probe;
               memset(y, 0x55, N * 12);
               dn__run_network(&r, rows, y);
               CHECK_MSG(memcmp(want, y, N * 12) == 0, "%s, %lu nodes, graph %lu, chunk %lu, %u workers", m->info.arch_name, (unsigned long)N,
                         (unsigned long)s, (unsigned long)net.plan[0].chunk, workers);
               if (r.probe) {
                  CHECK_MSG(w.equal == N * (k ? 3 : 7) && w.next == N, "%lu rows of the last module", (unsigned long)w.equal);
                  taps += w.calls;
               }
               slid += net.plan[0].wide_rows < N;
               whole += net.plan[0].z_rows == N;
               runs++;
               test_aligned_free(memory);
               if (work) test_aligned_free(work);
            }
            free(first), free(next), free(rows), free(start), free(wide), free(want), free(y);
         }
      dn_model_free(m);
   }
   AT_LEAST(runs, 2 * 7 * 4 * 12, "runs");
   AT_LEAST(slid, 40, "of them in rings");
   AT_LEAST(whole, 40, "with z of all nodes");
   AT_LEAST(taps, 5000, "taps");
}
/* more workers never need less scratch: what was sized for many serves few */
TEST(scratch_grows_with_workers_and_nodes)
{
   size_t k, tried = 0;
   unsigned w;
   uint64_t seed = 9;
   for (k = 0; k < 2; k++) {
      dn_model *m = model_of(k ? "multiresgnet_small" : "densegats_small", "model", NULL);
      size_t i;
      for (i = 0; i < 300; i++) {
         size_t N = 1 + test_random(&seed) % 40000, bandwidth = test_random(&seed) % (i % 3 ? N / 8 + 1 : N), before = 0;
         for (w = 1; w <= 24; w++, tried++) {
            dn__extent e = dn__extent_of(N, 6 * N, bandwidth), any = dn__extent_of(N + 100, 6 * N + 600, SIZE_MAX);
            dn__arena a = dn__arena_of(NULL, 0), b = dn__arena_of(NULL, 0);
            dn__net net;
            dn__net_layout(&net, m, &e, w, &a);
            dn__net_layout(&net, m, &any, w, &b);
            CHECK_MSG(a.used >= before && a.used <= b.used, "%lu nodes, bandwidth %lu, %u workers: %lu bytes, %lu with one less, at most %lu",
                      (unsigned long)N, (unsigned long)bandwidth, w, (unsigned long)a.used, (unsigned long)before, (unsigned long)b.used);
            before = a.used;
         }
      }
      dn_model_free(m);
   }
   AT_LEAST(tried, 2 * 300 * 24, "sizes");
}

TEST(strength_and_mask)
{
   static float mask[BODY_V], skinned[BODY_V * 3];
   dn_model *m = model_of("multiresgnet_small", "root", "dynamic");
   dn_error e;
   dn_rig *rig, *plain;
   dn_pose pose;
   result *full, *part, *none, *bare;
   dn_rig_view view;
   size_t v, k, touched = 0;
   body_make(&b0);
   full = deformed(m, &b0), part = deformed(m, &b0), none = deformed(m, &b0), bare = deformed(NULL, &b0);
   rig = dn_rig_create(m, &b0.desc, NULL, NULL, &e), plain = dn_rig_create(NULL, &b0.desc, NULL, NULL, &e);
   CHECK(rig && plain);
   dn_rig_describe(plain, &view);
   dn_lbs(b0.positions, view.skin_joint, view.skin_weight, view.influences, BODY_V, b0.palette, skinned);
   CHECK_MSG(memcmp(bare->positions, skinned, sizeof skinned) == 0, "a rig without a model skins as dn_lbs does");
   CHECK(largest(bare->displacement, 3 * BODY_V) == 0 && largest(bare->rest_delta, 3 * BODY_V) == 0);

   pose = pose_of(b0.palette);
   pose.strength = 0;
   frame(rig, &pose, NULL, none);
   CHECK_MSG(memcmp(none->positions, skinned, sizeof skinned) == 0, "strength 0 is plain skinning, bit for bit");
   CHECK(memcmp(none->normals, bare->normals, sizeof(float) * BODY_V * 3) == 0);
   pose.strength = -3;
   frame(rig, &pose, NULL, none);
   CHECK(memcmp(none->positions, skinned, sizeof skinned) == 0);
   pose.strength = 1;
   pose.mask = mask; /* all zero */
   frame(rig, &pose, NULL, none);
   CHECK_MSG(memcmp(none->positions, skinned, sizeof skinned) == 0, "mask 0 is plain skinning, bit for bit");

   for (v = 0; v < BODY_V; v++) mask[v] = (float)(v % 5) * 0.25f;
   frame(rig, &pose, NULL, part);
   for (v = 0; v < BODY_V; v++)
      for (k = 0; k < 3; k++, touched++) {
         float want = mask[v] * full->displacement[3 * v + k];
         CHECK(fabsf(part->displacement[3 * v + k] - want) <= 1e-7f);
         CHECK(mask[v] > 0 || part->positions[3 * v + k] == skinned[3 * v + k]);
      }
   pose.mask = NULL;
   pose.strength = 0.5f;
   frame(rig, &pose, NULL, part);
   for (v = 0; v < 3 * BODY_V; v++) CHECK(fabsf(part->displacement[v] - 0.5f * full->displacement[v]) <= 1e-7f);
   pose.strength = 7; /* clamped */
   frame(rig, &pose, NULL, part);
   CHECK(differing(full, part, BODY_V) == 0);

   pose.skinned = skinned; /* an engine that has skinned already */
   frame(rig, &pose, NULL, part);
   for (v = 0; v < 3 * BODY_V; v++) CHECK(fabsf(part->positions[v] - full->positions[v]) <= 1e-5f);
   free(full), free(part), free(none), free(bare);
   dn_rig_free(rig);
   dn_rig_free(plain);
   dn_model_free(m);
   AT_LEAST(touched, BODY_V * 3, "coordinates");
}

TEST(rest_delta_gives_the_same_positions)
{
   size_t k, v, i, skinning, checked = 0;
   double worst = 0;
   body_make(&b0);
   for (skinning = 0; skinning < 2; skinning++)
      for (k = 3; k < MODELS; k++) {
         static float moved[BODY_V * 3], again[BODY_V * 3];
         dn_model *m = model_of(models[k].name, models[k].frame, models[k].pooling);
         result *a;
         dn_rig *rig;
         dn_rig_view view;
         b0.desc.skinning = skinning ? DN_DQS : DN_LBS;
         a = deformed(m, &b0);
         rig = dn_rig_create(NULL, &b0.desc, NULL, NULL, NULL);
         dn_rig_describe(rig, &view);
         for (v = 0; v < BODY_V * 3; v++) moved[v] = b0.positions[v] + a->rest_delta[v];
         (skinning ? dn_dqs : dn_lbs)(moved, view.skin_joint, view.skin_weight, view.influences, BODY_V, b0.palette, again);
         for (v = 0; v < BODY_V; v++)
            for (i = 0; i < 3; i++, checked++) {
               double e = fabs((double)again[3 * v + i] - (double)a->positions[3 * v + i]);
               worst = e > worst ? e : worst;
            }
         CHECK_MSG(worst <= 1e-5, "%s, %s: %.2e m apart", models[k].name, skinning ? "DQS" : "LBS", worst);
         free(a);
         dn_rig_free(rig);
         dn_model_free(m);
      }
   AT_LEAST(checked, 2 * 4 * BODY_V * 3, "coordinates");
}

TEST(a_palette_that_is_not_finite_falls_back)
{
   size_t k, s, v, i, kind, finite = 0, lost = 0;
   for (k = 0; k < MODELS; k++) {
      dn_model *m = model_of(models[k].name, models[k].frame, models[k].pooling);
      body_make(&b0);
      for (s = 0; s < BODY_S; s++)
         for (kind = 0; kind < 2; kind++) {
            result *r = (result *)test_block(sizeof *r), *bare = (result *)test_block(sizeof *bare);
            dn_rig *rig, *plain;
            dn_pose pose;
            b1 = b0;
            b1.palette[12 * s + 5] = kind ? (float)INFINITY : (float)NAN;
            pose = pose_of(b1.palette);
            rig = dn_rig_create(m, &b0.desc, NULL, NULL, NULL);
            plain = dn_rig_create(NULL, &b0.desc, NULL, NULL, NULL);
            CHECK(rig && plain);
            frame(rig, &pose, NULL, r);
            frame(plain, &pose, NULL, bare);
            CHECK(r->code == DN_NOT_FINITE && bare->code == DN_NOT_FINITE && r->out.fallback_nodes > 0);
            for (v = 0; v < BODY_V; v++) {
               int uses = 0;
               for (i = 0; i < BODY_I; i++) uses |= b0.joints[BODY_I * v + i] == s && b0.weights[BODY_I * v + i] > 0;
               for (i = 0; i < 3; i++)
                  if (uses) lost++;
                  else
                     finite += (size_t)CHECK_MSG(test_finite(r->positions[3 * v + i]) && test_finite(r->normals[3 * v + i]) &&
                                                 test_finite(r->displacement[3 * v + i]), "%s, joint %lu: vertex %lu is %g, %g, %g",
                                                 models[k].name, (unsigned long)s, (unsigned long)v, (double)r->positions[3 * v + i],
                                                 (double)r->normals[3 * v + i], (double)r->displacement[3 * v + i]);
            }
            free(r), free(bare);
            dn_rig_free(rig);
            dn_rig_free(plain);
         }
      dn_model_free(m);
   }
   AT_LEAST(finite, 10000, "finite coordinates");
   AT_LEAST(lost, 1000, "on the joint itself");
}

/* the palette or inverse binds in another layout; out holds 16 floats a matrix at most */
static void relay(const float *rows, size_t count, dn_matrix layout, float *out)
{
   size_t s, i, j, wide = layout == DN_4X4_ROWS || layout == DN_4X4_COLUMNS ? 16 : 12;
   for (s = 0; s < count; s++) {
      float *m = out + wide * s;
      memset(m, 0, wide * sizeof *m);
      for (i = 0; i < 3; i++)
         for (j = 0; j < 4; j++)
            m[layout == DN_3X4_ROWS || layout == DN_4X4_ROWS ? 4 * i + j : (layout == DN_3X4_COLUMNS ? 3 : 4) * j + i] = rows[12 * s + 4 * i + j];
      if (wide == 16) m[15] = 1;
   }
}
TEST(layouts_and_types_of_the_input)
{
   static float palette[BODY_S * 16], inverse[BODY_S * 16];
   static unsigned char vertex[BODY_V * 96]; /* an engine's interleaved vertex: position, joints, weights somewhere in it */
   static uint16_t indices[BODY_T * 3];
   static const size_t split[][BODY_I] = {{4, 0, 0, 0}, {2, 2, 0, 0}, {1, 1, 1, 1}, {1, 3, 0, 0}};
   size_t layout, joint_type, weight_type, index_type, sets, tried = 0, v, i, bad_output = 0;
   dn_model *m = model_of("multiresgnet_small", "root", "rest");
   result *a, *c = (result *)test_block(sizeof *c);
   body_make(&b0);
   a = deformed(m, &b0);
   for (v = 0; v < BODY_T * 3; v++) indices[v] = (uint16_t)b0.indices[v];
   for (layout = 0; layout < 4; layout++)
      for (joint_type = 0; joint_type < 3; joint_type++)
         for (weight_type = 0; weight_type < 3; weight_type++)
            for (index_type = 0; index_type < 2; index_type++)
               for (sets = 0; sets < 4; sets++) {
                  static const size_t joint_bytes[] = {1, 2, 4}, weight_bytes[] = {4, 1, 2};
                  static const dn_type joint_types[] = {DN_U8, DN_U16, DN_U32}, weight_types[] = {DN_F32, DN_U8N, DN_U16N};
                  size_t stride = 64 + 8 * layout, from = 0, set;
                  dn_skin_set skin[4];
                  dn_rig_desc d = b0.desc;
                  dn_pose pose;
                  dn_error e;
                  dn_rig *rig;
                  if ((layout + joint_type + weight_type + index_type + sets) % 3) continue; /* every pair of choices, not every tuple */
                  memset(vertex, 0xee, sizeof vertex);
                  memset(skin, 0, sizeof skin);
                  for (v = 0; v < BODY_V; v++) {
                     unsigned char *p = vertex + v * stride;
                     memcpy(p, b0.positions + 3 * v, 12);
                     for (i = 0; i < BODY_I; i++) {
                        uint32_t j = b0.joints[BODY_I * v + i], w = (uint32_t)(b0.weights[BODY_I * v + i] * 255.0f + 0.5f);
                        uint8_t j8 = (uint8_t)j, w8 = (uint8_t)w;
                        uint16_t j16 = (uint16_t)j, w16 = (uint16_t)(w * 257);
                        const void *jp = joint_type == 0 ? (const void *)&j8 : joint_type == 1 ? (const void *)&j16 : (const void *)&j;
                        const void *wp = weight_type == 0 ? (const void *)(b0.weights + BODY_I * v + i) : weight_type == 1 ? (const void *)&w8 : (const void *)&w16;
                        memcpy(p + 13 + i * joint_bytes[joint_type], jp, joint_bytes[joint_type]); /* at odd addresses */
                        memcpy(p + 31 + i * weight_bytes[weight_type], wp, weight_bytes[weight_type]);
                     }
                  }
                  for (set = 0; set < 4 && split[sets][set]; set++) {
                     skin[set].influences = split[sets][set];
                     skin[set].joints = vertex + 13 + from * joint_bytes[joint_type];
                     skin[set].joint_type = joint_types[joint_type];
                     skin[set].weights = vertex + 31 + from * weight_bytes[weight_type];
                     skin[set].weight_type = weight_types[weight_type];
                     skin[set].joint_stride = skin[set].weight_stride = stride;
                     from += split[sets][set];
                  }
                  relay(b0.inverse_bind, BODY_S, (dn_matrix)layout, inverse);
                  relay(b0.palette, BODY_S, (dn_matrix)layout, palette);
                  d.mesh.positions = (const float *)(const void *)vertex, d.mesh.position_stride = stride;
                  d.mesh.skin = skin, d.mesh.skin_sets = set;
                  if (index_type) d.mesh.indices = indices, d.mesh.index_type = DN_U16;
                  d.skeleton.inverse_bind = inverse, d.skeleton.matrix = (dn_matrix)layout;
                  memset(c, 0, sizeof *c);
                  rig = dn_rig_create(m, &d, NULL, &c->report, &e);
                  CHECK_MSG(rig != NULL, "%s", rig ? "" : e.info);
                  if (!rig) continue;
                  pose = pose_of(palette);
                  pose.matrix = (dn_matrix)layout;
                  frame(rig, &pose, NULL, c);
                  CHECK_MSG(differing(a, c, BODY_V) == 0, "layout %lu, joints %lu, weights %lu, indices %lu, sets %lu: %lu bytes differ",
                            (unsigned long)layout, (unsigned long)joint_type, (unsigned long)weight_type, (unsigned long)index_type,
                            (unsigned long)sets, (unsigned long)differing(a, c, BODY_V));
                  CHECK(memcmp(&a->report, &c->report, sizeof a->report) == 0);
                  tried++;
                  dn_rig_free(rig);
               }
   { /* output interleaved in one vertex buffer: nothing else in it may change */
      dn_rig *rig = dn_rig_create(m, &b0.desc, NULL, NULL, NULL);
      dn_pose pose = pose_of(b0.palette);
      size_t bytes = dn_scratch_size(rig, 1), stride = 40;
      void *scratch = test_aligned(bytes);
      float *buffer = (float *)test_block(BODY_V * stride);
      dn_output out;
      memset(&out, 0, sizeof out);
      memset(buffer, 0x77, BODY_V * stride);
      out.positions = buffer, out.normals = buffer + 4, out.position_stride = out.normal_stride = stride;
      CHECK(dn_deform(rig, &pose, &out, scratch, bytes, NULL, NULL) == DN_OK);
      for (v = 0; v < BODY_V; v++) {
         const unsigned char *p = (const unsigned char *)buffer + v * stride;
         bad_output += memcmp(p, a->positions + 3 * v, 12) != 0 || memcmp(p + 16, a->normals + 3 * v, 12) != 0;
         for (i = 12; i < stride; i++) bad_output += (i < 16 || i >= 28) && p[i] != 0x77;
      }
      CHECK_MSG(bad_output == 0, "%lu bytes or rows of the vertex buffer are wrong", (unsigned long)bad_output);
      test_aligned_free(scratch);
      free(buffer);
      dn_rig_free(rig);
   }
   free(a);
   free(c);
   dn_model_free(m);
   AT_LEAST(tried, 90, "combinations");
}

TEST(joints_match_by_name)
{
   static const char *const styles[] = {"mixamorig:", "Armature|", "rig|mixamorig:", ""};
   static char text[BODY_S + 1][64];
   static const size_t order[BODY_S] = {3, 0, 4, 2, 1}; /* the character's joint k is the model's order[k] */
   size_t k, i, s, tried = 0;
   dn_error e;
   body_make(&b0);
   for (k = 3; k < MODELS; k++) {
      dn_model *m = model_of(models[k].name, models[k].frame, models[k].pooling);
      result *a = deformed(m, &b0), *c;
      dn_rig *rig;
      for (s = 0; s < sizeof styles / sizeof *styles; s++) {
         b1 = b0;
         for (i = 0; i < BODY_S; i++) {
            snprintf(text[i], sizeof text[i], "%sjoint%lu", styles[s], (unsigned long)order[i]);
            b1.names[i] = text[i];
            memcpy(b1.palette + 12 * i, b0.palette + 12 * order[i], 48);
            memcpy(b1.inverse_bind + 12 * i, b0.inverse_bind + 12 * order[i], 48);
         }
         for (i = 0; i < BODY_V * BODY_I; i++) {
            size_t j = 0;
            while (order[j] != b0.joints[i]) j++;
            b1.joints[i] = (uint32_t)j;
         }
         b1.skin.joints = b1.joints;
         b1.desc.mesh.skin = &b1.skin;
         b1.desc.skeleton.names = b1.names;
         b1.desc.skeleton.inverse_bind = b1.inverse_bind;
         b1.desc.skeleton.parents = NULL;
         c = deformed(m, &b1);
         CHECK_MSG(differing(a, c, BODY_V) == 0, "%s \"%s\": %lu bytes differ", models[k].name, styles[s], (unsigned long)differing(a, c, BODY_V));
         CHECK(c->report.joints_matched == BODY_S && c->report.joints_folded == 0);
         tried++;
         free(c);
      }

      /* a joint that the model does not know: its vertices are skinned by it, the network sees its ancestor */
      {
         static float palette[(BODY_S + 1) * 12], inverse[(BODY_S + 1) * 12];
         size_t moved = 0;
         b1 = b0;
         memcpy(palette, b0.palette, sizeof b0.palette), memcpy(inverse, b0.inverse_bind, sizeof b0.inverse_bind);
         memcpy(palette + 12 * BODY_S, b0.palette + 12 * 2, 48), memcpy(inverse + 12 * BODY_S, b0.inverse_bind + 12 * 2, 48);
         for (i = 0; i < BODY_V * BODY_I; i++)
            if (b0.joints[i] == 2 && b0.weights[i] > 0) b1.joints[i] = BODY_S, moved++;
         b1.skin.joints = b1.joints;
         b1.desc.mesh.skin = &b1.skin;
         b1.desc.skeleton.joints = BODY_S + 1;
         b1.desc.skeleton.inverse_bind = inverse;
         c = (result *)test_block(sizeof *c);
         memset(c, 0, sizeof *c);
         rig = dn_rig_create(m, &b1.desc, NULL, &c->report, &e);
         CHECK_MSG(rig != NULL, "%s", rig ? "" : e.info);
         if (rig) {
            dn_pose pose = pose_of(palette);
            frame(rig, &pose, NULL, c);
            CHECK_MSG(differing(a, c, BODY_V) == 0, "a twist joint that moves with its parent changes %lu bytes", (unsigned long)differing(a, c, BODY_V));
            CHECK(c->report.joints_matched == BODY_S && c->report.joints_folded == 1 && moved > 100);
         }
         free(c);
         dn_rig_free(rig);
      }

      b1 = b0; /* two joints renamed: the error lists both and no other */
      b1.names[1] = "elbow", b1.names[3] = "spine";
      b1.desc.skeleton.names = b1.names;
      memset(&e, 0, sizeof e);
      CHECK(dn_rig_create(m, &b1.desc, NULL, NULL, &e) == NULL && e.code == DN_MISSING_JOINT);
      CHECK_MSG(strstr(e.info, "joint1") && strstr(e.info, "joint3") && !strstr(e.info, "joint2"), "\"%s\"", e.info);
      b1.desc.skeleton.names = NULL;
      CHECK(dn_rig_create(m, &b1.desc, NULL, NULL, &e) == NULL && e.code == DN_MISSING_JOINT);
      free(a);
      dn_model_free(m);
   }
   AT_LEAST(tried, 4 * 4, "skeletons");
}

TEST(weights_are_normalised_and_counted)
{
   dn_model *m = model_of("multiresgnet_small", "root", "dynamic");
   result *a, *c;
   size_t v, k;
   double worst = 0;
   body_make(&b0);
   b1 = b0;
   b1.desc.mesh.skin = &b1.skin;
   b1.skin.weights = b1.weights;
   for (v = 0; v < BODY_V; v++)
      for (k = 0; k < BODY_I && v % 10 == 0; k++) b1.weights[BODY_I * v + k] *= v % 20 ? 3.0f : 0.25f;
   for (v = 5; v < 5 + 7; v++) b1.weights[BODY_I * v + 3] = -0.5f; /* the fourth is unused */
   a = deformed(m, &b0), c = deformed(m, &b1);
   CHECK(a->report.weights_normalised == 0 && a->report.influences_dropped == 0 && a->report.weightless_vertices == 0);
   CHECK_MSG(c->report.weights_normalised == (BODY_V + 9) / 10, "%lu counted", (unsigned long)c->report.weights_normalised);
   CHECK(c->report.influences_dropped == 7 && c->report.nodes == a->report.nodes);
   for (v = 0; v < BODY_V * 3; v++) {
      double e = fabs((double)a->positions[v] - (double)c->positions[v]);
      worst = e > worst ? e : worst;
   }
   CHECK_MSG(worst <= 1e-5, "%.2e m apart", worst);
   free(c);
   b1 = b0;
   b1.desc.mesh.skin = &b1.skin;
   b1.skin.weights = b1.weights;
   memset(b1.weights, 0, sizeof b1.weights);
   c = deformed(NULL, &b1);
   CHECK(c->report.weightless_vertices == BODY_V && c->report.weights_normalised == 0);
   for (v = 0; v < BODY_V; v++) { /* all on joint 0 */
      const float *p = b0.palette, *x = b0.positions + 3 * v;
      for (k = 0; k < 3; k++)
         CHECK(fabsf(c->positions[3 * v + k] - (p[4 * k] * x[0] + p[4 * k + 1] * x[1] + p[4 * k + 2] * x[2] + p[4 * k + 3])) <= 1e-6f);
   }
   free(a);
   free(c);
   dn_model_free(m);
}

TEST(the_bind_report)
{
   /* two quads side by side, one point between no triangles, one seam vertex welded, one left apart, three bad triangles */
   static const float positions[] = {0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0,       /* 0-3: quad A */
                                     3, 0, 0, 4, 0, 0, 4, 1, 0, 3, 1, 0,       /* 4-7: quad B */
                                     9, 9, 9,                                  /* 8: alone */
                                     1, 0, -0.0f,                              /* 9: vertex 1 again */
                                     1, 1, 0,                                  /* 10: vertex 2's place, other weights */
                                     2, 0, 0};                                 /* 11: in line with 0 and 1 */
   static const uint16_t indices[] = {0, 1, 2, 0, 2, 3, 4, 5, 6, 4, 6, 7, 9, 10, 0, 0, 1, 9, 1, 1, 1, 0, 1, 11};
   static const uint8_t joints[12 * 2] = {0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1};
   float weights[12 * 2];
   dn_skin_set skin;
   dn_rig_desc d;
   dn_report r;
   dn_rig *rig;
   dn_rig_view view;
   size_t i;
   memset(&d, 0, sizeof d);
   memset(&skin, 0, sizeof skin);
   for (i = 0; i < 12; i++) weights[2 * i] = 1, weights[2 * i + 1] = 0;
   weights[2 * 9] = 0.97f, weights[2 * 9 + 1] = 0.03f;  /* within 0.05: welds */
   weights[2 * 10] = 0.9f, weights[2 * 10 + 1] = 0.1f;  /* not */
   weights[2 * 5] = 2;                                  /* sum 2: normalised */
   weights[2 * 6] = 0;                                  /* weightless */
   weights[2 * 7 + 1] = -1;                             /* dropped */
   skin.influences = 2, skin.joints = joints, skin.joint_type = DN_U8, skin.weights = weights, skin.weight_type = DN_F32;
   d.mesh.vertices = 12, d.mesh.positions = positions, d.mesh.triangles = sizeof indices / 6, d.mesh.indices = indices;
   d.mesh.index_type = DN_U16, d.mesh.skin_sets = 1, d.mesh.skin = &skin;
   d.skeleton.joints = 2;
   rig = dn_rig_create(NULL, &d, NULL, &r, NULL);
   CHECK(rig != NULL);
   CHECK_MSG(r.vertices == 12 && r.nodes == 11, "%lu nodes", (unsigned long)r.nodes);
   /* A: 01 12 02 23 03; B: 45 56 46 67 47; 9 is 1: 1-10, 10-0; (0,1,9) adds 01 only; (0,1,11): 1-11, 0-11 */
   CHECK_MSG(r.edges == 14, "%lu edges", (unsigned long)r.edges);
   CHECK_MSG(r.components == 3, "%lu components", (unsigned long)r.components);
   CHECK_MSG(r.isolated_nodes == 1, "%lu isolated", (unsigned long)r.isolated_nodes);
   CHECK_MSG(r.seams_welded == 1 && r.seams_apart == 1, "%lu welded, %lu apart", (unsigned long)r.seams_welded, (unsigned long)r.seams_apart);
   CHECK_MSG(r.degenerate_triangles == 3, "%lu degenerate", (unsigned long)r.degenerate_triangles); /* (0,1,9) (1,1,1) (0,1,11) */
   CHECK_MSG(r.weights_normalised == 1 && r.weightless_vertices == 1 && r.influences_dropped == 1, "%lu normalised, %lu weightless, %lu dropped",
             (unsigned long)r.weights_normalised, (unsigned long)r.weightless_vertices, (unsigned long)r.influences_dropped);
   CHECK(r.influences == 2 && r.solid_cells == 0 && r.joints_folded == 0);
   dn_rig_describe(rig, &view);
   CHECK(view.node_of_vertex[9] == 1 && view.node_of_vertex[10] == 9 && view.node_of_vertex[11] == 10 && view.first_vertex[9] == 10);
   CHECK(view.graph.first[8] == view.graph.first[9]); /* nothing at the lone node */
   dn_rig_free(rig);
}

TEST(memory_of_ones_own)
{
   dn_model *m = model_of("multiresgnet_small", "root", "rest");
   dn_error e;
   dn_rig *rig = NULL;
   dn_rig_view view;
   dn_pose pose;
   result *a, *c = (result *)test_block(sizeof *c);
   size_t bytes, scratch_bytes, size, k, before;
   unsigned char *file;
   void *memory, *scratch;
   body_make(&b0);
   a = deformed(m, &b0);
   memset(c, 0, sizeof *c);
   CHECK(dn_rig_size(m, &b0.desc, &bytes, &scratch_bytes, &e) == DN_OK && bytes && scratch_bytes);
   memory = test_aligned(bytes), scratch = test_aligned(scratch_bytes);
   memset(memory, 0xcd, bytes), memset(scratch, 0xcd, scratch_bytes);
   before = allocations;
   CHECK(dn_rig_init(m, &b0.desc, memory, bytes, scratch, scratch_bytes, &rig, &c->report, &e) == DN_OK && rig);
   CHECK_MSG(allocations == before, "dn_rig_init allocates");
   test_aligned_free(scratch); /* not needed any more */
   dn_rig_describe(rig, &view);
   CHECK(view.bytes <= bytes && view.nodes == BODY_N && view.vertices == BODY_V);
   pose = pose_of(b0.palette);
   frame(rig, &pose, NULL, c);
   CHECK(differing(a, c, BODY_V) == 0);
   CHECK(memcmp(&a->report, &c->report, sizeof a->report) == 0);
   {
      size_t need = dn_scratch_size(rig, 1), j;
      unsigned char *block = (unsigned char *)test_aligned(need);
      memset(c->positions, 0x33, sizeof c->positions);
      c->out.positions = c->positions, c->out.normals = NULL, c->out.displacement = NULL, c->out.rest_delta = NULL;
      memset(&e, 0, sizeof e);
      CHECK(dn_deform(rig, &pose, &c->out, block, need - 1, NULL, &e) == DN_TOO_SMALL && e.code == DN_TOO_SMALL && e.info[0]);
      for (j = 0, k = 0; j < sizeof c->positions; j++) k += ((unsigned char *)c->positions)[j] != 0x33;
      CHECK_MSG(k == 0, "too small a scratch, and yet %lu bytes are written", (unsigned long)k);
      CHECK(dn_scratch_size(rig, 4) >= need);
      before = allocations;
      for (k = 0; k < 5; k++) CHECK(dn_deform(rig, &pose, &c->out, block, need, NULL, &e) == DN_OK);
      CHECK(dn_stage_skin(rig, &pose, block, need, NULL, &e) == DN_OK);
      dn_stage_rows(rig, block, NULL);
      dn_stage_network(rig, block, NULL, NULL);
      CHECK(dn_stage_output(rig, &pose, &c->out, block, NULL, &e) == DN_OK);
      CHECK_MSG(allocations == before, "%lu allocations in six frames", (unsigned long)(allocations - before));
      CHECK(memcmp(c->positions, a->positions, BODY_V * 12) == 0); /* the four stages are dn_deform */
      test_aligned_free(block);
   }
   rig = NULL;
   memset(&e, 0, sizeof e);
   scratch = test_aligned(scratch_bytes);
   CHECK(dn_rig_init(m, &b0.desc, memory, 64, scratch, scratch_bytes, &rig, NULL, &e) == DN_TOO_SMALL && !rig && e.info[0]);
   memset(&e, 0, sizeof e);
   CHECK(dn_rig_init(m, &b0.desc, memory, bytes, scratch, scratch_bytes / 2, &rig, NULL, &e) == DN_TOO_SMALL && !rig && e.info[0]);
   test_aligned_free(scratch);
   test_aligned_free(memory);
   free(a);

   /* what scratch held does not matter, nor which frames came before */
   rig = dn_rig_create(m, &b0.desc, NULL, NULL, &e);
   CHECK(rig != NULL);
   a = (result *)test_block(sizeof *a);
   memset(a, 0, sizeof *a), memset(c, 0, sizeof *c);
   fill = 0xff; /* NaN everywhere */
   frame(rig, &pose, NULL, a);
   fill = 0x5a;
   frame(rig, &pose, NULL, c);
   CHECK(differing(a, c, BODY_V) == 0);
   dn_rig_free(rig);

   /* all that create allocates goes through the allocator, and comes back */
   {
      counting heap;
      dn_allocator al = counting_allocator(&heap, -1);
      before = allocations;
      file = test_file("data/golden/multiresgnet_small.safetensors", &size);
      dn_model_free(m);
      m = dn_model_load(file, size, NULL, &al, &e);
      CHECK(m != NULL);
      rig = dn_rig_create(m, &b0.desc, &al, NULL, &e);
      CHECK(rig != NULL && heap.live > 0);
      dn_rig_free(rig);
      dn_model_free(m);
      CHECK(heap.live == 0 && heap.wrong == 0 && heap.calls >= 4);
      CHECK_MSG(allocations == before, "%lu allocations past the allocator", (unsigned long)(allocations - before));
      free(file);
   }
   free(a);
   free(c);
}

TEST(a_scale_that_is_absent_is_left_out)
{
   static const struct { const char *name, *other; float neutral; } scales[] = {
      {"\"input.mean\"", "\"input.lean\"", 0}, {"\"input.std\"", "\"input.sad\"", 1},
      {"\"output.mean\"", "\"output.lean\"", 0}, {"\"output.std\"", "\"output.sad\"", 1}};
   size_t size, bytes, i, k, used;
   unsigned char *file = test_file("data/golden/mlp_small.safetensors", &size);
   result *plain;
   dn_error e;
   body_make(&b0);
   {
      dn_model *m = dn_model_load(file, size, NULL, NULL, &e);
      plain = deformed(m, &b0);
      dn_model_free(m);
   }
   for (k = 0; k < 4; k++) {
      unsigned char *neutral = test_copy(file, size), *renamed = test_copy(file, size);
      size_t length = strlen(scales[k].name);
      char name[32];
      dn_tensors *t = NULL;
      const dn_tensor *x;
      dn_model *m[2];
      result *r[2];
      void *memory;
      snprintf(name, sizeof name, "%.*s", (int)length - 2, scales[k].name + 1);
      CHECK(dn_tensors_size(file, size, &bytes, &e) == DN_OK);
      memory = test_aligned(bytes);
      CHECK(dn_tensors_open(file, size, memory, bytes, &t, &e) == DN_OK);
      x = dn_tensors_find(t, name);
      if (CHECK_MSG(x != NULL, "no %s in the file", name))
         for (i = 0; i < x->count; i++) memcpy(neutral + (x->data - file) + 4 * i, &scales[k].neutral, 4);
      for (i = 8, used = 0; i + length < size; i++)
         if (memcmp(renamed + i, scales[k].name, length) == 0) memcpy(renamed + i, scales[k].other, length), used++;
      CHECK(used == 1);
      m[0] = dn_model_load(neutral, size, NULL, NULL, &e), m[1] = dn_model_load(renamed, size, NULL, NULL, &e);
      CHECK_MSG(m[0] && m[1], "without %s: %s", name, e.info);
      r[0] = deformed(m[0], &b0), r[1] = deformed(m[1], &b0);
      CHECK_MSG(m[0] && m[1] && differing(r[0], r[1], BODY_V) == 0, "without %s: not as with a neutral one", name);
      CHECK(differing(plain, r[1], BODY_V) != 0); /* so it does matter */
      free(r[0]), free(r[1]), free(neutral), free(renamed);
      dn_model_free(m[0]), dn_model_free(m[1]);
      test_aligned_free(memory);
   }
   free(plain);
   free(file);
}

static int stop_at(void *user, const char *stage, float done)
{
   size_t *left = (size_t *)user;
   CHECK(stage && *stage && done >= 0 && done <= 1);
   return (*left)-- == 0;
}
TEST(bind_can_be_cancelled_at_every_step)
{
   dn_model *m = model_of("multiresgnet_small", "root", "rest");
   size_t k, cancelled = 0;
   body_make(&b0);
   b0.desc.resolution = 24;
   for (k = 0; k < 400; k++) {
      counting heap;
      dn_allocator al = counting_allocator(&heap, -1);
      dn_progress progress;
      size_t left = k < 40 ? k : 40 + (k - 40) * 37;
      dn_error e;
      dn_rig *rig;
      progress.step = stop_at, progress.user = &left;
      b0.desc.progress = &progress;
      memset(&e, 0, sizeof e);
      rig = dn_rig_create(m, &b0.desc, &al, NULL, &e);
      if (rig) {
         dn_rig_free(rig);
         CHECK(heap.live == 0);
         break;
      }
      CHECK(e.code == DN_CANCELLED && heap.live == 0 && heap.wrong == 0);
      cancelled++;
   }
   CHECK(k < 400);
   dn_model_free(m);
   AT_LEAST(cancelled, 3, "steps");
}

int main(int argc, char **argv)
{
   TEST_BEGIN(argc, argv);
   RUN(turning_the_character_turns_the_result);
   RUN(order_of_vertices_and_triangles);
   RUN(near_order_is_the_same_graph_in_another_order);
   RUN(seams_stay_closed);
   RUN(any_number_of_threads_gives_the_same_bits);
   RUN(waves_give_the_bits_of_one_block_after_another);
   RUN(scratch_grows_with_workers_and_nodes);
   RUN(strength_and_mask);
   RUN(rest_delta_gives_the_same_positions);
   RUN(a_palette_that_is_not_finite_falls_back);
   RUN(layouts_and_types_of_the_input);
   RUN(joints_match_by_name);
   RUN(weights_are_normalised_and_counted);
   RUN(the_bind_report);
   RUN(memory_of_ones_own);
   RUN(a_scale_that_is_absent_is_left_out);
   RUN(bind_can_be_cancelled_at_every_step);
   return TEST_END();
}
