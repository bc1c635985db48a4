/*  garment.c - garments on a bending body: what must not change the result (order, other components, threads, who
    allocates, change against create), what must (strength, body, fit), and files that mean harm
    build     cc -g garment.c -o garment -lm -lpthread
    run       ./garment [part of a test's name]      in this folder: the models are those of data/golden */
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
#include <math.h>
#include <pthread.h>

/* --- models: the golden ones without their cases, with another frame or pooling ------------------------------ */
typedef struct model_file { unsigned char *data; size_t size; } model_file;
enum { COARSE, FIT, CLOTH, KINDS };
static const char *const paths[KINDS] = {"data/golden/garfit_coarse_small.safetensors", "data/golden/garfitnet_small.safetensors",
                                         "data/golden/clothnet_small.safetensors"};
static size_t spare; /* garfitnet: so many more channels that global.0 makes and global.1 multiplies by zero */
static void sides_of(const dn_tensor *t, size_t side[2])
{
   side[0] = t->shape[0], side[1] = t->rank > 1 ? t->shape[1] : 1;
   if (strstr(t->name, "global.0.self.") || strstr(t->name, "global.0.bn.")) side[0] += spare;
   if (strstr(t->name, "global.1.lin.") || strstr(t->name, "global.1.self.")) side[1] += spare;
}
static size_t put_tensor(const dn_tensor *t, unsigned char *at) /* its bytes, with the spare channels */
{
   size_t side[2], r, c, columns = t->rank > 1 ? t->shape[1] : 1;
   sides_of(t, side);
   for (r = 0; r < side[0]; r++)
      for (c = 0; c < side[1]; c++, at += 4) {
         float x = strstr(t->name, "global.1.") ? 0.0f : t->rank == 1 ? 1.0f : 0.01f * (float)((7 * r + 13 * c) % 11);
         if (r < t->shape[0] && c < columns) memcpy(at, (const unsigned char *)t->data + 4 * (r * columns + c), 4);
         else memcpy(at, &x, 4);
      }
   return 4 * side[0] * side[1];
}
/* zero: tensors whose names contain it become zeros, or NULL */
static model_file model_bytes(int kind, const char *pooling, const char *frame, const char *zero)
{
   static const char *const keys[] = {"deformnet.version", "deformnet.arch", "deformnet.features", "deformnet.features.detail", "deformnet.joints"};
   size_t size, need, i, bytes = 0, header;
   unsigned char *file = test_file(paths[kind], &size), *at;
   char *text, *end;
   dn_tensors *t = NULL;
   dn_error err;
   model_file out;
   void *memory;
   if (dn_tensors_size(file, size, &need, &err) != DN_OK) exit(2);
   memory = test_aligned(need);
   if (dn_tensors_open(file, size, memory, need, &t, &err) != DN_OK) exit(2);
   text = end = (char *)test_block(1024 + 160 * dn_tensors_count(t));
   end += sprintf(end, "{\"__metadata__\":{\"deformnet.pooling\":\"%s\",\"deformnet.frame\":\"%s\"", pooling, frame);
   for (i = 0; i < sizeof keys / sizeof *keys; i++)
      if (dn_tensors_meta(t, keys[i])) end += sprintf(end, ",\"%s\":\"%s\"", keys[i], dn_tensors_meta(t, keys[i]));
   end += sprintf(end, "}");
   for (i = 0; i < dn_tensors_count(t); i++) {
      const dn_tensor *x = dn_tensors_at(t, i);
      size_t side[2], more;
      if (strncmp(x->name, "golden.", 7) == 0) continue;
      sides_of(x, side);
      more = 4 * side[0] * side[1];
      end += sprintf(end, ",\"%s\":{\"dtype\":\"F32\",\"shape\":[%lu", x->name, (unsigned long)side[0]);
      if (x->rank > 1) end += sprintf(end, ",%lu", (unsigned long)side[1]);
      end += sprintf(end, "],\"data_offsets\":[%lu,%lu]}", (unsigned long)bytes, (unsigned long)(bytes + more));
      bytes += more;
   }
   end += sprintf(end, "}");
   header = (size_t)(end - text);
   out.size = 8 + header + bytes;
   at = out.data = (unsigned char *)test_block(out.size);
   for (i = 0; i < 8; i++) *at++ = (unsigned char)((uint64_t)header >> (8 * i));
   memcpy(at, text, header);
   at += header;
   for (i = 0; i < dn_tensors_count(t); i++) {
      const dn_tensor *x = dn_tensors_at(t, i);
      if (strncmp(x->name, "golden.", 7) == 0) continue;
      size = put_tensor(x, at);
      if (zero && strstr(x->name, zero)) memset(at, 0, size);
      at += size;
   }
   free(text);
   free(file);
   test_aligned_free(memory);
   return out;
}
static dn_model *model_of(int kind, const char *pooling, const char *frame, const char *zero)
{
   model_file f = model_bytes(kind, pooling, frame, zero);
   dn_error err;
   dn_model *m = dn_model_load(f.data, f.size, NULL, NULL, &err);
   CHECK_MSG(m != NULL, "%s: %s", paths[kind], m ? "" : err.info);
   free(f.data);
   if (!m) exit(2);
   return m;
}

/* --- a body: a bent, lumpy tube of five joints with a seam; a garment: a sleeve around it with two open ends, a patch of
   its own, two lone vertices, and a vertex that lies on the body. No two places are alike. ----------------------- */
enum { RINGS = 26, AROUND = 20, BODY_V = RINGS * (AROUND + 1), BODY_T = 2 * (RINGS - 1) * AROUND, S = 5,
       G_RINGS = 40, G_AROUND = 28, SLEEVE_V = G_RINGS * (G_AROUND + 1), SLEEVE_T = 2 * (G_RINGS - 1) * G_AROUND,
       P_SIDE = 5, PATCH_V = P_SIDE * P_SIDE, PATCH_T = 2 * (P_SIDE - 1) * (P_SIDE - 1), LONE = 2, ON_BODY = SLEEVE_V + PATCH_V + 1,
       GARMENT_V = SLEEVE_V + PATCH_V + LONE, GARMENT_T = SLEEVE_T + PATCH_T, ALPHAS = 3, BETAS = 10, THETAS = 72 };
typedef struct scene {
   float body[BODY_V * 3], weights[BODY_V * 4], garment[GARMENT_V * 3], inverse_bind[S * 12], palette[S * 12];
   uint32_t joints[BODY_V * 4], body_triangles[BODY_T * 3], triangles[GARMENT_T * 3];
   float alpha[ALPHAS], beta[BETAS], theta[THETAS];
   const char *names[S];
   dn_skin_set skin;
   dn_garment_desc desc;
} scene;

static void surface(double x, double angle, double radius, float p[3])
{
   double lump = 1 + 0.07 * sin(9 * x + 2 * angle) + 0.03 * sin(31 * x - 5 * angle);
   p[0] = (float)(x + 0.02 * sin(3 * angle + x));
   p[1] = (float)(radius * lump * cos(angle) + 0.1 * x * x);
   p[2] = (float)(radius * lump * sin(angle));
}
static void quad(uint32_t *to, uint32_t a, uint32_t b, uint32_t c, uint32_t d)
{
   to[0] = a, to[1] = b, to[2] = d, to[3] = b, to[4] = c, to[5] = d;
}
static void place(scene *s, double girth) /* rest positions of both meshes for one body shape */
{
   size_t r, a, v = 0, g = 0;
   for (r = 0; r < RINGS; r++)
      for (a = 0; a <= AROUND; a++, v++) /* column AROUND repeats column 0: a seam */
         surface(-0.85 + 1.7 * (double)r / (RINGS - 1), 6.28318530717959 * (double)(a % AROUND) / AROUND, 0.2 * girth, s->body + 3 * v);
   for (r = 0; r < G_RINGS; r++)
      for (a = 0; a <= G_AROUND; a++, g++)
         surface(-0.5 + 0.9 * (double)r / (G_RINGS - 1), 0.1 + 6.28318530717959 * (double)(a % G_AROUND) / G_AROUND, 0.24 * girth, s->garment + 3 * g);
   for (r = 0; r < P_SIDE; r++)
      for (a = 0; a < P_SIDE; a++, g++) surface(0.55 + 0.04 * (double)r, 0.3 + 0.21 * (double)a, 0.23 * girth, s->garment + 3 * g);
   surface(0.8, 1.7, 0.3 * girth, s->garment + 3 * g);
   memcpy(s->garment + 3 * (g + 1), s->body + 3 * 100, 12); /* ON_BODY */
}
static void bend(scene *s, double much)
{
   size_t j, i, k;
   for (j = 0; j < S; j++) {
      double angle = much * (0.1 + 0.2 * (double)j), c = cos(angle), n = sin(angle), at[3], m[12] = {0};
      at[0] = -0.85 + 1.7 * (double)j / (S - 1), at[1] = 0.1 * at[0] * at[0], at[2] = 0;
      m[0] = c, m[1] = -n, m[4] = n, m[5] = c, m[10] = 1; /* about z, then tilted by a shear in x */
      m[2] = 0.05 * much * (double)j;
      for (i = 0; i < 3; i++) {
         m[4 * i + 3] = at[i] + (i == 1 ? 0.03 * much * (double)j : 0);
         for (k = 0; k < 3; k++) m[4 * i + 3] -= m[4 * i + k] * at[k];
      }
      for (i = 0; i < 12; i++) s->palette[12 * j + i] = (float)m[i];
      memset(s->inverse_bind + 12 * j, 0, 48);
      s->inverse_bind[12 * j] = s->inverse_bind[12 * j + 5] = s->inverse_bind[12 * j + 10] = 1;
      for (i = 0; i < 3; i++) s->inverse_bind[12 * j + 4 * i + 3] = -(float)at[i];
   }
}
static void scene_make(scene *s)
{
   static const char *const names[S] = {"joint0", "joint1", "joint2", "joint3", "joint4"};
   uint64_t seed = 7;
   uint32_t r, a, n = 0;
   size_t v;
   memset(s, 0, sizeof *s);
   place(s, 1.0);
   bend(s, 1.0);
   for (r = 0; r + 1 < RINGS; r++)
      for (a = 0; a < AROUND; a++, n += 6) quad(s->body_triangles + n, r * (AROUND + 1) + a, r * (AROUND + 1) + a + 1, (r + 1) * (AROUND + 1) + a + 1, (r + 1) * (AROUND + 1) + a);
   for (n = 0, r = 0; r + 1 < G_RINGS; r++)
      for (a = 0; a < G_AROUND; a++, n += 6) quad(s->triangles + n, r * (G_AROUND + 1) + a, r * (G_AROUND + 1) + a + 1, (r + 1) * (G_AROUND + 1) + a + 1, (r + 1) * (G_AROUND + 1) + a);
   for (r = 0; r + 1 < P_SIDE; r++)
      for (a = 0; a + 1 < P_SIDE; a++, n += 6) quad(s->triangles + n, SLEEVE_V + r * P_SIDE + a, SLEEVE_V + r * P_SIDE + a + 1, SLEEVE_V + (r + 1) * P_SIDE + a + 1, SLEEVE_V + (r + 1) * P_SIDE + a);
   for (v = 0; v < BODY_V; v++) {
      double at = ((double)(v / (AROUND + 1)) / (RINGS - 1)) * (S - 1);
      uint32_t first = at >= S - 1 ? S - 2 : (uint32_t)at;
      float share = (float)(at - (double)first);
      s->joints[4 * v] = first, s->joints[4 * v + 1] = first + 1;
      s->weights[4 * v] = 1 - share, s->weights[4 * v + 1] = share;
   }
   for (v = 0; v < ALPHAS; v++) s->alpha[v] = test_uniform(&seed, -1, 1);
   for (v = 0; v < BETAS; v++) s->beta[v] = test_uniform(&seed, -1, 1);
   for (v = 0; v < THETAS; v++) s->theta[v] = test_uniform(&seed, -0.5f, 0.5f);
   memcpy(s->names, names, sizeof names);
   s->skin.influences = 4;
   s->skin.joints = s->joints, s->skin.joint_type = DN_U32;
   s->skin.weights = s->weights, s->skin.weight_type = DN_F32;
   s->desc.body.vertices = BODY_V, s->desc.body.positions = s->body;
   s->desc.body.triangles = BODY_T, s->desc.body.indices = s->body_triangles, s->desc.body.index_type = DN_U32;
   s->desc.body.skin_sets = 1, s->desc.body.skin = &s->skin;
   s->desc.skeleton.joints = S, s->desc.skeleton.names = s->names;
   s->desc.skeleton.inverse_bind = s->inverse_bind, s->desc.skeleton.matrix = DN_3X4_ROWS;
   s->desc.garment.vertices = GARMENT_V, s->desc.garment.positions = s->garment;
   s->desc.garment.triangles = GARMENT_T, s->desc.garment.indices = s->triangles, s->desc.garment.index_type = DN_U32;
   s->desc.alpha = s->alpha, s->desc.alphas = ALPHAS;
   s->desc.beta = s->beta, s->desc.betas = BETAS;
   s->desc.thetas = THETAS;
}
static void wear(scene *s, const dn_model *const m[KINDS], int kind) /* kind KINDS: none; FIT takes its coarse stage along */
{
   s->desc.coarse = kind == COARSE || kind == FIT ? m[COARSE] : NULL;
   s->desc.refine = kind == FIT || kind == CLOTH ? m[kind] : NULL;
}
static dn_garment *make(const scene *s)
{
   dn_error err;
   dn_garment *g = dn_garment_create(&s->desc, NULL, NULL, &err);
   CHECK_MSG(g != NULL, "%s: %s", g ? "" : err.where, g ? "" : err.info);
   if (!g) exit(2);
   return g;
}
static dn_garment_pose pose_of(const scene *s, float strength)
{
   dn_garment_pose p;
   memset(&p, 0, sizeof p);
   p.palette = s->palette, p.theta = s->theta, p.strength = strength;
   return p;
}
/* one frame in scratch of its own: positions, normals, coarse, displacement, (V,3) each, NULL for none */
static dn_result frame(const dn_garment *g, const dn_garment_pose *pose, const dn_parallel *parallel, float *positions,
                       float *normals, float *coarse, float *displacement, dn_garment_output *seen)
{
   size_t bytes;
   void *scratch = dn_garment_scratch_create(g, parallel ? parallel->workers : 1, NULL, &bytes, NULL);
   dn_garment_output out;
   dn_result r;
   memset(&out, 0, sizeof out);
   memset(scratch, 0xa5, bytes);
   out.positions = positions, out.normals = normals, out.coarse = coarse, out.displacement = displacement;
   r = dn_garment_deform(g, pose, &out, scratch, bytes, parallel, NULL);
   if (seen) *seen = out;
   dn_scratch_free(scratch, bytes, NULL);
   return r;
}
static uint64_t hash_of(const dn_garment *g, const dn_garment_pose *pose, const dn_parallel *parallel, size_t vertices)
{
   float *x = (float *)test_block(vertices * 48);
   uint64_t h;
   dn_garment_output out;
   CHECK(frame(g, pose, parallel, x, x + 3 * vertices, x + 6 * vertices, x + 9 * vertices, &out) == DN_OK);
   h = test_hash(test_hash(14695981039346656037u, x, vertices * 48), out.bounds_min, 24);
   free(x);
   return h;
}
static double apart(const float *a, const float *b, size_t count) /* the largest difference beyond 1e-4 of the value */
{
   double worst = 0;
   size_t i;
   for (i = 0; i < count; i++) {
      double e = fabs((double)a[i] - (double)b[i]) - 1e-4 * fabs((double)b[i]);
      if (!(e <= worst)) worst = e;
   }
   return worst;
}

/* --- tests ---------------------------------------------------------------------------------------------------- */
static scene one, two;
static const char *const pools[] = {"dynamic", "rest"};

TEST(without_models_it_follows)
{
   dn_garment *g;
   dn_garment_view v;
   dn_garment_report report;
   dn_garment_pose pose;
   dn_garment_output out;
   float *p = (float *)test_block(GARMENT_V * 48), *want;
   size_t i, b;
   scene_make(&one);
   g = dn_garment_create(&one.desc, NULL, &report, NULL);
   if (!CHECK(g != NULL)) return;
   dn_garment_describe(g, &v);
   CHECK(v.vertices == GARMENT_V && v.nodes == GARMENT_V - G_RINGS && v.body_nodes == BODY_V - RINGS);
   CHECK(report.garment.isolated_nodes == LONE && report.garment.components == 2 + LONE && report.garment.seams_welded == G_RINGS);
   CHECK(report.body_nodes_used > 50 && report.farthest > 0.02f && report.farthest < 0.2f);
   for (i = 0; i < v.nodes; i++) { /* the association, by trying every pair */
      double least = 1e30, mine = 0;
      size_t best = 0, k;
      for (b = 0; b < v.body_nodes; b++) {
         double d = 0;
         for (k = 0; k < 3; k++) {
            double e = (double)v.rest[3 * i + k] - (double)v.body_rest[3 * b + k];
            d += e * e;
         }
         if (d < least) least = d, best = b;
         if (b == v.body_node[i]) mine = d;
      }
      CHECK_MSG(v.body_node[i] == best, "node %lu: body node %lu at %g, expected %lu at %g", (unsigned long)i, (unsigned long)v.body_node[i], mine, (unsigned long)best, least);
   }
   pose = pose_of(&one, 1);
   CHECK(frame(g, &pose, NULL, p, p + 3 * GARMENT_V, p + 6 * GARMENT_V, p + 9 * GARMENT_V, &out) == DN_OK);
   want = (float *)test_block(v.nodes * 12);
   dn_lbs(v.rest, v.skin_joint, v.skin_weight, v.influences, v.nodes, one.palette, want);
   for (i = 0; i < GARMENT_V; i++) CHECK(apart(p + 3 * i, want + 3 * (size_t)v.node_of_vertex[i], 3) < 1e-6);
   CHECK(memcmp(p, p + 6 * GARMENT_V, GARMENT_V * 12) == 0); /* coarse is what was followed */
   for (i = 0; i < 3 * GARMENT_V; i++) CHECK(p[9 * GARMENT_V + i] == 0); /* displacement */
   dn_lbs(one.body + 300, one.joints + 400, one.weights + 400, 4, 1, one.palette, want); /* the vertex on the body stays on it */
   CHECK(apart(p + 3 * ON_BODY, want, 3) < 1e-6);
   for (i = 0; i < 3; i++) CHECK(p[3 * GARMENT_V + 3 * (GARMENT_V - 1) + i] == 0); /* no triangle: no normal */
   for (i = 0; i < GARMENT_V - LONE; i++) {
      const float *n = p + 3 * GARMENT_V + 3 * i;
      CHECK(fabsf(sqrtf(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]) - 1) < 1e-5f);
   }
   free(want);
   free(p);
   dn_garment_free(g);
}

/* three ways to be wrong about memory, one answer */
TEST(no_allocation_in_a_frame)
{
   size_t k, pool;
   scene_make(&one);
   for (pool = 0; pool < 2; pool++) {
      const dn_model *m[KINDS] = {model_of(COARSE, pools[pool], "model", NULL), model_of(FIT, pools[pool], "model", NULL), model_of(CLOTH, pools[pool], "root", NULL)};
      for (k = 0; k <= KINDS; k++) {
         dn_garment *g, *h = NULL;
         dn_garment_pose pose = pose_of(&one, 1);
         size_t bytes, kept, temp, before;
         void *scratch, *memory, *work;
         float *p = (float *)test_block(GARMENT_V * 12);
         dn_garment_output out;
         dn_garment_view v, w;
         dn_error err;
         wear(&one, m, (int)k);
         g = make(&one);
         scratch = dn_garment_scratch_create(g, 1, NULL, &bytes, NULL);
         memset(&out, 0, sizeof out);
         memset(&w, 0, sizeof w);
         out.positions = p;
         before = allocations;
         CHECK(dn_garment_deform(g, &pose, &out, scratch, bytes, NULL, NULL) == DN_OK);
         CHECK(allocations == before);
         CHECK(dn_garment_deform(g, &pose, &out, scratch, bytes - 64, NULL, &err) == DN_TOO_SMALL);
         /* memory of one's own */
         CHECK(dn_garment_size(&one.desc, &kept, &temp, NULL) == DN_OK);
         memory = test_aligned(kept), work = test_aligned(temp);
         before = allocations;
         CHECK(dn_garment_init(&one.desc, memory, kept, work, temp, &h, NULL, &err) == DN_OK);
         CHECK(allocations == before);
         test_aligned_free(work);
         dn_garment_describe(g, &v);
         if (h) {
            dn_garment_describe(h, &w);
            CHECK(w.bytes <= kept && w.bytes == v.bytes);
            CHECK(hash_of(g, &pose, NULL, GARMENT_V) == hash_of(h, &pose, NULL, GARMENT_V));
            dn_garment_free(h); /* its memory is ours */
         }
         work = test_aligned(temp);
         CHECK(dn_garment_init(&one.desc, memory, w.bytes - 64, work, temp, &h, NULL, &err) == DN_TOO_SMALL && !h && strstr(err.info, "needed"));
         CHECK(dn_garment_init(&one.desc, memory, kept, work, temp - 64, &h, NULL, &err) == DN_TOO_SMALL && !h && strstr(err.info, "needed"));
         test_aligned_free(memory);
         test_aligned_free(work);
         dn_scratch_free(scratch, bytes, NULL);
         dn_garment_free(g);
         free(p);
      }
      for (k = 0; k < KINDS; k++) dn_model_free((dn_model *)(uintptr_t)m[k]);
   }
}

/* every vertex and triangle elsewhere in its list, corners turned: the same garment up to rounding */
TEST(order_of_vertices_and_triangles)
{
   static uint32_t to[GARMENT_V], order[GARMENT_T], body_to[BODY_V];
   uint64_t seed = 3;
   size_t i, k, pool;
   scene_make(&one);
   scene_make(&two);
   for (i = 0; i < GARMENT_V; i++) to[i] = (uint32_t)i;
   for (i = 0; i < GARMENT_T; i++) order[i] = (uint32_t)i;
   for (i = 0; i < BODY_V; i++) body_to[i] = (uint32_t)i;
#define SHUFFLE(x, n) for (i = (n) - 1; i > 0; i--) { size_t j = test_random(&seed) % (i + 1); uint32_t t = x[i]; x[i] = x[j], x[j] = t; }
   SHUFFLE(to, (size_t)GARMENT_V)
   SHUFFLE(order, (size_t)GARMENT_T)
   SHUFFLE(body_to, (size_t)BODY_V)
   for (i = 0; i < GARMENT_V; i++) memcpy(two.garment + 3 * (size_t)to[i], one.garment + 3 * i, 12);
   for (i = 0; i < GARMENT_T; i++)
      for (k = 0; k < 3; k++) two.triangles[3 * (size_t)order[i] + (k + i) % 3] = to[one.triangles[3 * i + k]];
   for (i = 0; i < BODY_V; i++) {
      memcpy(two.body + 3 * (size_t)body_to[i], one.body + 3 * i, 12);
      memcpy(two.joints + 4 * (size_t)body_to[i], one.joints + 4 * i, 16);
      memcpy(two.weights + 4 * (size_t)body_to[i], one.weights + 4 * i, 16);
   }
   for (i = 0; i < 3 * BODY_T; i++) two.body_triangles[i] = body_to[one.body_triangles[i]];
   for (pool = 0; pool < 2; pool++) {
      const dn_model *m[KINDS] = {model_of(COARSE, pools[pool], "model", NULL), model_of(FIT, pools[pool], "model", NULL), model_of(CLOTH, pools[pool], "model", NULL)};
      for (k = 0; k <= KINDS; k++) {
         float *a = (float *)test_block(GARMENT_V * 36), *b = (float *)test_block(GARMENT_V * 36), *c = (float *)test_block(GARMENT_V * 36);
         dn_garment_pose pose = pose_of(&one, 1);
         dn_garment *g, *h;
         double e;
         size_t f;
         wear(&one, m, (int)k);
         wear(&two, m, (int)k);
         g = make(&one), h = make(&two);
         CHECK(frame(g, &pose, NULL, a, a + 3 * GARMENT_V, a + 6 * GARMENT_V, NULL, NULL) == DN_OK);
         CHECK(frame(h, &pose, NULL, b, b + 3 * GARMENT_V, b + 6 * GARMENT_V, NULL, NULL) == DN_OK);
         for (f = 0; f < 3; f++)
            for (i = 0; i < GARMENT_V; i++) memcpy(c + 3 * (f * GARMENT_V + i), b + 3 * (f * GARMENT_V + to[i]), 12);
         e = apart(c, a, 3 * GARMENT_V);
         CHECK_MSG(e < 1e-4, "kind %lu, %s pooling: positions %g apart", (unsigned long)k, pools[pool], e);
         e = apart(c + 6 * GARMENT_V, a + 6 * GARMENT_V, 3 * GARMENT_V);
         CHECK_MSG(e < 1e-5, "kind %lu, %s pooling: coarse positions %g apart", (unsigned long)k, pools[pool], e);
         free(a);
         free(b);
         free(c);
         dn_garment_free(g);
         dn_garment_free(h);
      }
      for (k = 0; k < KINDS; k++) dn_model_free((dn_model *)(uintptr_t)m[k]);
   }
}

/* a component, and whether other components or lone vertices stand beside it: the same bits */
TEST(components_are_on_their_own)
{
   size_t k, pool;
   scene_make(&one);
   scene_make(&two);
   two.desc.garment.vertices = SLEEVE_V, two.desc.garment.triangles = SLEEVE_T;
   for (pool = 0; pool < 2; pool++) {
      const dn_model *m[KINDS] = {model_of(COARSE, pools[pool], "model", NULL), model_of(FIT, pools[pool], "model", NULL), model_of(CLOTH, pools[pool], "root", NULL)};
      for (k = 0; k <= KINDS; k++) {
         float *a = (float *)test_block(GARMENT_V * 24), *b = (float *)test_block(GARMENT_V * 24);
         dn_garment_pose pose = pose_of(&one, 1);
         dn_garment *g, *h;
         size_t i;
         wear(&one, m, (int)k);
         wear(&two, m, (int)k);
         g = make(&one), h = make(&two);
         CHECK(frame(g, &pose, NULL, a, a + 3 * GARMENT_V, NULL, NULL, NULL) == DN_OK);
         CHECK(frame(h, &pose, NULL, b, b + 3 * GARMENT_V, NULL, NULL, NULL) == DN_OK);
         CHECK(memcmp(a, b, SLEEVE_V * 12) == 0);
         CHECK(memcmp(a + 3 * GARMENT_V, b + 3 * GARMENT_V, SLEEVE_V * 12) == 0);
         for (i = 0; i < 3 * GARMENT_V; i++) CHECK(test_finite(a[i])); /* lone vertices, too */
         free(a);
         free(b);
         dn_garment_free(g);
         dn_garment_free(h);
      }
      for (k = 0; k < KINDS; k++) dn_model_free((dn_model *)(uintptr_t)m[k]);
   }
}

/* no triangle at all: every node is its own component */
TEST(vertices_without_triangles)
{
   size_t k, pool, i;
   for (pool = 0; pool < 2; pool++) {
      const dn_model *m[KINDS] = {model_of(COARSE, pools[pool], "model", NULL), model_of(FIT, pools[pool], "model", NULL), model_of(CLOTH, pools[pool], "model", NULL)};
      for (k = 0; k <= KINDS; k++)
         for (i = 1; i < 400; i += 133) {
            dn_garment *g;
            dn_garment_pose pose;
            dn_garment_output out;
            float *p = (float *)test_block(i * 12), *alone = (float *)test_block(12);
            scene_make(&one);
            pose = pose_of(&one, 1);
            wear(&one, m, (int)k);
            one.desc.garment.triangles = 0, one.desc.garment.vertices = i;
            g = make(&one);
            CHECK(frame(g, &pose, NULL, p, NULL, NULL, NULL, &out) == DN_OK);
            dn_garment_free(g);
            one.desc.garment.vertices = 1; /* the last one by itself: the same bits */
            one.desc.garment.positions = one.garment + 3 * (i - 1);
            g = make(&one);
            CHECK(frame(g, &pose, NULL, alone, NULL, NULL, NULL, &out) == DN_OK);
            CHECK(memcmp(alone, p + 3 * (i - 1), 12) == 0);
            dn_garment_free(g);
            free(p);
            free(alone);
         }
      for (k = 0; k < KINDS; k++) dn_model_free((dn_model *)(uintptr_t)m[k]);
   }
}

/* output layers of zeros: no direction, so no displacement: the coarse garment is the body's own nodes */
TEST(zero_length_directions)
{
   static float direction[9] = {0, 0, 0, 0, -1, 0, 0, 1e-20f, 0}, length[3] = {2, 3, 4}, y[9];
   dn_model *cloth = model_of(CLOTH, "dynamic", "model", "dir.out"), *fit = model_of(FIT, "rest", "model", "dir.out");
   dn_garment *g;
   dn_garment_view v;
   dn_garment_pose pose;
   dn_garment_output out;
   float *p = (float *)test_block(GARMENT_V * 36), *want;
   size_t i;
   dn_decompose(direction, length, 3, y);
   CHECK(y[0] == 0 && y[1] == 0 && y[2] == 0 && y[3] == 0 && y[4] == -3 && y[5] == 0 && y[6] == 0 && y[7] == 0 && y[8] == 0);
   length[1] = -3;
   dn_decompose(direction, length, 3, y); /* a length under zero is none */
   CHECK(y[4] == 0);
   scene_make(&one);
   pose = pose_of(&one, 1);
   one.desc.refine = cloth;
   g = make(&one);
   dn_garment_describe(g, &v);
   want = (float *)test_block(v.nodes * 12);
   for (i = 0; i < v.nodes; i++) memcpy(want + 3 * i, v.body_rest + 3 * (size_t)v.body_node[i], 12);
   dn_lbs(want, v.skin_joint, v.skin_weight, v.influences, v.nodes, one.palette, want);
   CHECK(frame(g, &pose, NULL, p, p + 3 * GARMENT_V, p + 6 * GARMENT_V, NULL, &out) == DN_OK && out.fallback_nodes == 0);
   for (i = 0; i < GARMENT_V; i++) CHECK(apart(p + 3 * i, want + 3 * (size_t)v.node_of_vertex[i], 3) < 1e-6);
   CHECK(memcmp(p, p + 6 * GARMENT_V, GARMENT_V * 12) == 0);
   dn_garment_free(g);
   one.desc.refine = fit; /* without a coarse stage: the garment that follows, not displaced */
   g = make(&one);
   CHECK(frame(g, &pose, NULL, p, NULL, p + 6 * GARMENT_V, NULL, &out) == DN_OK && out.fallback_nodes == 0);
   dn_lbs(v.rest, v.skin_joint, v.skin_weight, v.influences, 0, one.palette, want);
   CHECK(memcmp(p, p + 6 * GARMENT_V, GARMENT_V * 12) == 0);
   dn_garment_free(g);
   free(want);
   free(p);
   dn_model_free(cloth);
   dn_model_free(fit);
}

/* threads of its own, cut at every grain */
typedef struct crew { pthread_t thread; dn_range_fn *fn; void *job; size_t count, grain; unsigned worker, workers; } crew;
static void *crew_run(void *p)
{
   crew *c = (crew *)p;
   size_t i, pieces = (c->count + c->grain - 1) / c->grain;
   for (i = c->worker; i < pieces; i += c->workers)
      c->fn(c->job, i * c->grain, (i + 1) * c->grain < c->count ? (i + 1) * c->grain : c->count, c->worker);
   return NULL;
}
static void threads_run(void *user, size_t count, size_t grain, dn_range_fn *fn, void *job)
{
   crew c[8];
   unsigned w, workers = *(unsigned *)user;
   for (w = 0; w < workers; w++) {
      c[w].fn = fn, c[w].job = job, c[w].count = count, c[w].grain = grain, c[w].worker = w, c[w].workers = workers;
      if (w && pthread_create(&c[w].thread, NULL, crew_run, &c[w])) exit(2);
   }
   crew_run(&c[0]);
   for (w = 1; w < workers; w++) pthread_join(c[w].thread, NULL);
}
/* ranges of one row each, last first: no job may lean on its neighbour */
static void backwards_run(void *user, size_t count, size_t grain, dn_range_fn *fn, void *job)
{
   size_t pieces = (count + grain - 1) / grain;
   (void)user;
   while (pieces-- > 0) fn(job, pieces * grain, (pieces + 1) * grain < count ? (pieces + 1) * grain : count, (unsigned)(pieces % 3));
}
TEST(any_threads_the_same_bits)
{
   size_t k, pool, compared = 0;
   scene_make(&one);
   for (pool = 0; pool < 2; pool++) {
      const dn_model *m[KINDS] = {model_of(COARSE, pools[pool], "root", NULL), model_of(FIT, pools[pool], "model", NULL), model_of(CLOTH, pools[pool], "model", NULL)};
      for (k = 0; k <= KINDS; k++) {
         dn_garment_pose pose = pose_of(&one, 0.75f);
         unsigned workers;
         dn_garment *g;
         uint64_t alone;
         dn_parallel par;
         wear(&one, m, (int)k);
         one.desc.parallel = NULL;
         g = make(&one);
         alone = hash_of(g, &pose, NULL, GARMENT_V);
         dn_garment_free(g);
         for (workers = 2; workers <= 5; workers++) {
            par.run = workers == 5 ? backwards_run : threads_run, par.user = &workers, par.workers = workers;
            one.desc.parallel = &par; /* bind's rest-pose run, too */
            g = make(&one);
            CHECK(hash_of(g, &pose, &par, GARMENT_V) == alone);
            compared++;
            dn_garment_free(g);
         }
      }
      for (k = 0; k < KINDS; k++) dn_model_free((dn_model *)(uintptr_t)m[k]);
   }
   AT_LEAST(compared, 32, "garments compared");
}

/* the slider: changed in place, and made anew */
TEST(change_equals_create)
{
   size_t k, pool, what, compared = 0;
   float *coarse = (float *)test_block(GARMENT_V * 12);
   uint64_t seed = 9;
   for (k = 0; k < 3 * GARMENT_V; k++) coarse[k] = test_uniform(&seed, -0.05f, 0.05f);
   for (pool = 0; pool < 2; pool++) {
      const dn_model *m[KINDS] = {model_of(COARSE, pools[pool], "model", NULL), model_of(FIT, pools[pool], "model", NULL), model_of(CLOTH, pools[pool], "root", NULL)};
      for (k = 0; k <= KINDS; k++)
         for (what = 0; what < 7; what++) {
            dn_garment_changes c;
            dn_garment_pose pose;
            dn_garment *g, *fresh;
            dn_garment_view v, w;
            dn_error err;
            size_t bytes;
            void *scratch;
            uint64_t before;
            scene_make(&one);
            scene_make(&two);
            wear(&one, m, (int)k);
            wear(&two, m, (int)k);
            pose = pose_of(&two, 1);
            memset(&c, 0, sizeof c);
            place(&two, 1.25);
            two.alpha[0] = 0.3f, two.beta[4] = -2.0f;
            for (bytes = 0; bytes < S; bytes++) two.inverse_bind[12 * bytes + 7] += 0.01f * (float)bytes; /* joints rest elsewhere */
            if (what == 0 || what == 5) c.body_positions = two.body;
            else memcpy(two.body, one.body, sizeof one.body);
            if (what == 1 || what == 5) c.garment_positions = two.garment;
            else memcpy(two.garment, one.garment, sizeof one.garment);
            if (what == 2 || what == 5) c.alpha = two.alpha;
            else memcpy(two.alpha, one.alpha, sizeof one.alpha);
            if (what == 3 || what == 5) c.beta = two.beta;
            else memcpy(two.beta, one.beta, sizeof one.beta);
            if (what == 4 || what == 5) c.inverse_bind = two.inverse_bind, c.matrix = DN_3X4_ROWS;
            else memcpy(two.inverse_bind, one.inverse_bind, sizeof one.inverse_bind);
            g = make(&one);
            dn_garment_describe(g, &v);
            if (what == 6) c.coarse_rest = two.desc.coarse_rest = coarse, two.desc.coarse_rest_nodes = v.nodes;
            before = hash_of(g, &pose, NULL, GARMENT_V);
            bytes = dn_garment_change_size(g, 1);
            scratch = test_aligned(bytes);
            CHECK(dn_garment_change(g, &c, scratch, bytes - 64, &err) == DN_TOO_SMALL);
            CHECK(hash_of(g, &pose, NULL, GARMENT_V) == before);
            CHECK(dn_garment_change(g, &c, scratch, bytes, &err) == DN_OK);
            fresh = make(&two);
            dn_garment_describe(g, &v);
            dn_garment_describe(fresh, &w);
            CHECK(v.nodes == w.nodes && memcmp(v.body_node, w.body_node, v.nodes * 4) == 0 && memcmp(v.rest, w.rest, v.nodes * 12) == 0);
            CHECK_MSG(hash_of(g, &pose, NULL, GARMENT_V) == hash_of(fresh, &pose, NULL, GARMENT_V), "kind %lu, %s pooling, change %lu", (unsigned long)k, pools[pool], (unsigned long)what);
            compared++;
            dn_garment_free(fresh);
            if (what == 5) { /* refusals: each leaves it as it was */
               float keep;
               before = hash_of(g, &pose, NULL, GARMENT_V);
               keep = two.garment[7], two.garment[7] = (float)INFINITY;
               CHECK(dn_garment_change(g, &c, scratch, bytes, &err) == DN_BAD_MESH && err.offset == 2 && strstr(err.info, "garment vertex 2"));
               two.garment[7] = keep, keep = two.beta[9], two.beta[9] = (float)NAN;
               CHECK(dn_garment_change(g, &c, scratch, bytes, &err) == DN_BAD_VALUE && strstr(err.info, "beta 9"));
               two.beta[9] = keep;
               if (k < KINDS) {
                  memset(two.inverse_bind + 12 * 4, 0, 48);
                  CHECK(dn_garment_change(g, &c, scratch, bytes, &err) == DN_BAD_SKIN && strstr(err.info, "joint 4"));
               }
               CHECK(hash_of(g, &pose, NULL, GARMENT_V) == before);
            }
            dn_garment_free(g);
            test_aligned_free(scratch);
         }
      for (k = 0; k < KINDS; k++) dn_model_free((dn_model *)(uintptr_t)m[k]);
   }
   free(coarse);
   AT_LEAST(compared, 56, "changes compared");
}

/* stages, strength, a posed body of one's own, a coarse displacement of one's own */
TEST(what_a_pose_can_say)
{
   const dn_model *m[KINDS] = {model_of(COARSE, "dynamic", "model", NULL), model_of(FIT, "rest", "model", NULL), model_of(CLOTH, "dynamic", "model", NULL)};
   size_t k, i, bytes;
   scene_make(&one);
   for (k = 0; k < KINDS; k++) {
      dn_garment_pose pose = pose_of(&one, 1);
      dn_garment_output out;
      dn_garment_view v;
      dn_garment_nodes at;
      dn_garment *g;
      void *scratch;
      float *p = (float *)test_block(GARMENT_V * 60), *full = p + 3 * GARMENT_V, *half = p + 6 * GARMENT_V, *none = p + 9 * GARMENT_V, *given = p + 12 * GARMENT_V;
      float *body = (float *)test_block(BODY_V * 12);
      wear(&one, m, (int)k);
      g = make(&one);
      dn_garment_describe(g, &v);
      scratch = dn_garment_scratch_create(g, 1, NULL, &bytes, NULL);
      memset(&out, 0, sizeof out);
      out.positions = p;
      CHECK(frame(g, &pose, NULL, full, NULL, NULL, NULL, NULL) == DN_OK);
      CHECK(dn_garment_stage_follow(g, &pose, scratch, bytes, NULL, NULL) == DN_OK);
      dn_garment_stage_coarse(g, &pose, scratch, NULL, NULL);
      dn_garment_stage_refine(g, &pose, scratch, NULL, NULL);
      at = dn_garment_nodes_of(g, scratch);
      CHECK(dn_garment_stage_output(g, &pose, &out, scratch, NULL, NULL) == DN_OK);
      CHECK(memcmp(p, full, GARMENT_V * 12) == 0);
      for (i = 0; i < v.nodes; i++) {
         size_t c;
         for (c = 0; c < 3; c++) CHECK(fabsf(at.refined[3 * i + c] - (at.coarse[3 * i + c] + at.displacement[3 * i + c])) < 1e-6f);
      }
      for (i = 0; i < v.nodes; i++) at.refined[3 * i + 1] += 1; /* moved before output: every vertex of the node goes along */
      CHECK(dn_garment_stage_output(g, &pose, &out, scratch, NULL, NULL) == DN_OK);
      for (i = 0; i < GARMENT_V; i++) CHECK(fabsf(p[3 * i + 1] - full[3 * i + 1] - 1) < 1e-5f && p[3 * i] == full[3 * i]);
      pose.strength = 0.5f;
      CHECK(frame(g, &pose, NULL, half, NULL, NULL, NULL, NULL) == DN_OK);
      pose.strength = -3;
      CHECK(frame(g, &pose, NULL, none, NULL, NULL, NULL, NULL) == DN_OK);
      for (i = 0; i < v.nodes; i++) CHECK(apart(none + 3 * (size_t)v.first_vertex[i], at.followed + 3 * i, 3) == 0);
      for (i = 0; i < 3 * GARMENT_V; i++) CHECK(fabsf(half[i] - 0.5f * (full[i] + none[i])) < 1e-5f);
      /* the body as given: LBS by hand is the same body; a body pushed up takes the garment along */
      pose.strength = 1;
      dn_lbs(one.body, one.joints, one.weights, 4, BODY_V, one.palette, body);
      pose.body = body;
      CHECK(frame(g, &pose, NULL, given, NULL, NULL, NULL, NULL) == DN_OK);
      CHECK_MSG(apart(given, full, 3 * GARMENT_V) < 1e-4, "kind %lu: %g", (unsigned long)k, apart(given, full, 3 * GARMENT_V));
      for (i = 0; i < BODY_V; i++) body[3 * i + 2] += 2;
      pose.strength = 0;
      CHECK(frame(g, &pose, NULL, given, NULL, NULL, NULL, NULL) == DN_OK);
      for (i = 0; i < GARMENT_V; i++) CHECK(fabsf(given[3 * i + 2] - none[3 * i + 2] - 2) < 1e-5f);
      /* a coarse displacement of one's own: that of the coarse stage gives the same garment; a NaN falls back alone */
      pose.body = NULL, pose.strength = 1;
      {
         float *coarse = (float *)test_block(v.nodes * 12);
         memcpy(coarse, at.coarse_displacement, v.nodes * 12);
         pose.coarse_displacement = coarse;
         CHECK(frame(g, &pose, NULL, given, NULL, NULL, NULL, &out) == DN_OK);
         CHECK(memcmp(given, full, GARMENT_V * 12) == 0);
         coarse[3 * 20 + 1] = (float)NAN;
         CHECK(frame(g, &pose, NULL, given, NULL, NULL, NULL, &out) == DN_NOT_FINITE && out.fallback_nodes == 1);
         for (i = 0; i < 3 * GARMENT_V; i++) CHECK(test_finite(given[i]));
         if (k == COARSE) CHECK(apart(given + 3 * (size_t)v.first_vertex[20], none + 3 * (size_t)v.first_vertex[20], 3) == 0);
         free(coarse);
         pose.coarse_displacement = NULL;
      }
      { /* what is not finite in a pose: written in full, and said */
         float keep = one.theta[5];
         one.theta[5] = (float)NAN;
         CHECK(frame(g, &pose, NULL, given, NULL, given, NULL, &out) == (k == COARSE ? DN_OK : DN_NOT_FINITE));
         CHECK(k == COARSE || out.fallback_nodes > 0);
         for (i = 0; i < 3 * GARMENT_V; i++) CHECK(test_finite(given[i]));
         one.theta[5] = keep;
         keep = one.palette[14], one.palette[14] = (float)INFINITY;
         CHECK(frame(g, &pose, NULL, given, given, NULL, NULL, &out) == DN_NOT_FINITE);
         one.palette[14] = keep;
      }
      dn_scratch_free(scratch, bytes, NULL);
      dn_garment_free(g);
      free(p);
      free(body);
   }
   for (k = 0; k < KINDS; k++) dn_model_free((dn_model *)(uintptr_t)m[k]);
}

/* deformnet.frame "root": the character turned, the garment turned */
TEST(turning_the_character)
{
   const dn_model *m[KINDS] = {model_of(COARSE, "dynamic", "root", NULL), model_of(FIT, "dynamic", "root", NULL), model_of(CLOTH, "rest", "root", NULL)};
   size_t k, i, j, c, s;
   scene_make(&one);
   scene_make(&two);
   for (k = 0; k < KINDS; k++) {
      double r[9] = {0.36, 0.48, -0.8, -0.8, 0.6, 0, 0.48, 0.64, 0.6}, e = 0;
      dn_garment_pose pose = pose_of(&one, 1), turned = pose_of(&two, 1);
      float *a = (float *)test_block(GARMENT_V * 12), *b = (float *)test_block(GARMENT_V * 12);
      dn_garment *g;
      for (s = 0; s < S; s++)
         for (i = 0; i < 3; i++)
            for (j = 0; j < 4; j++) {
               double sum = 0;
               for (c = 0; c < 3; c++) sum += r[3 * i + c] * (double)one.palette[12 * s + 4 * c + j];
               two.palette[12 * s + 4 * i + j] = (float)sum;
            }
      wear(&one, m, (int)k);
      g = make(&one);
      CHECK(frame(g, &pose, NULL, a, NULL, NULL, NULL, NULL) == DN_OK && frame(g, &turned, NULL, b, NULL, NULL, NULL, NULL) == DN_OK);
      for (i = 0; i < GARMENT_V; i++)
         for (j = 0; j < 3; j++) {
            double want = r[3 * j] * (double)a[3 * i] + r[3 * j + 1] * (double)a[3 * i + 1] + r[3 * j + 2] * (double)a[3 * i + 2];
            double d = fabs((double)b[3 * i + j] - want);
            e = d > e ? d : e;
         }
      CHECK_MSG(e < 2e-4, "kind %lu: %g", (unsigned long)k, e);
      dn_garment_free(g);
      free(a);
      free(b);
   }
   for (k = 0; k < KINDS; k++) dn_model_free((dn_model *)(uintptr_t)m[k]);
}

/* welded over a distance: vertices of one node rest apart, and stay so */
TEST(vertices_beside_their_node)
{
   dn_model *cloth = model_of(CLOTH, "dynamic", "model", NULL);
   dn_garment *g;
   dn_garment_view v;
   dn_garment_pose pose;
   dn_garment_output out;
   float *p = (float *)test_block(GARMENT_V * 24), low[3] = {1e9f, 1e9f, 1e9f};
   size_t i, k, moved = 0;
   scene_make(&one);
   for (i = 0; i < G_RINGS; i++) one.garment[3 * (i * (G_AROUND + 1) + G_AROUND) + 2] += 0.002f; /* the seam's other side */
   one.desc.weld_distance = 0.004f;
   one.desc.refine = cloth;
   pose = pose_of(&one, 1);
   g = make(&one);
   dn_garment_describe(g, &v);
   CHECK(v.nodes == GARMENT_V - G_RINGS);
   CHECK(frame(g, &pose, NULL, p, NULL, p + 3 * GARMENT_V, NULL, &out) == DN_OK);
   for (i = 0; i < GARMENT_V; i++) {
      size_t first = v.first_vertex[v.node_of_vertex[i]];
      double d = 0;
      for (k = 0; k < 3; k++) {
         double e = (double)p[3 * i + k] - (double)p[3 * first + k];
         d += e * e;
         if (p[3 * i + k] < low[k]) low[k] = p[3 * i + k];
      }
      if (first != i) moved += sqrt(d) > 0.0015 && sqrt(d) < 0.0025;
   }
   CHECK(moved == G_RINGS);
   for (k = 0; k < 3; k++) CHECK(low[k] == out.bounds_min[k]);
   dn_garment_free(g);
   free(p);
   dn_model_free(cloth);
}

/* a branch of garfitnet may be wider inside than everything beside it; what nothing reads changes nothing */
TEST(channels_that_nothing_reads)
{
   static const size_t more[] = {0, 30, 70, 300};
   dn_model *coarse = model_of(COARSE, "dynamic", "model", NULL);
   float *p = (float *)test_block(GARMENT_V * 24), *q = p + 3 * GARMENT_V;
   size_t k, i, n, moved = 0;
   scene_make(&one);
   one.desc.coarse = coarse;
   for (i = 0; i < 2; i++)
      for (k = 0; k < sizeof more / sizeof *more; k++) {
         dn_model *m;
         dn_garment *g;
         dn_garment_pose pose = pose_of(&one, 1);
         spare = more[k];
         m = model_of(FIT, pools[i], "model", NULL);
         spare = 0;
         one.desc.refine = m;
         g = make(&one);
         CHECK(frame(g, &pose, NULL, NULL, NULL, NULL, k ? q : p, NULL) == DN_OK);
         if (k) CHECK(apart(q, p, 3 * GARMENT_V) <= 1e-6);
         else
            for (n = 0; n < GARMENT_V; n++) moved += fabsf(p[3 * n]) > 1e-5f;
         dn_garment_free(g);
         dn_model_free(m);
      }
   AT_LEAST(moved, GARMENT_V / 4, "vertices that the network moves");
   dn_model_free(coarse);
   free(p);
}

/* --- files and callers that mean harm --------------------------------------------------------------------------- */
static int refuses(const dn_garment_desc *d, dn_result code, const char *where, const char *word)
{
   dn_error err;
   dn_garment *g;
   size_t bytes, scratch;
   memset(&err, 0, sizeof err);
   g = dn_garment_create(d, NULL, NULL, &err);
   dn_garment_free(g);
   if (!CHECK_MSG(!g && err.code == code && strstr(err.where, where) && strstr(err.info, word), "%s: %s: %s, expected %s with \"%s\"", err.where, dn_result_text(err.code),
                  err.info, dn_result_text(code), word)) return 0;
   (void)dn_garment_size(d, &bytes, &scratch, NULL);
   return 1;
}
TEST(refusals_say_what_and_where)
{
   const dn_model *m[KINDS] = {model_of(COARSE, "dynamic", "model", NULL), model_of(FIT, "rest", "model", NULL), model_of(CLOTH, "dynamic", "model", NULL)};
   size_t size;
   unsigned char *file = test_file("data/golden/mlp_small.safetensors", &size);
   dn_model *mlp = dn_model_load(file, size, NULL, NULL, NULL);
   dn_garment_desc d;
   dn_rig_desc r;
   dn_error err;
   float keep;
   uint32_t index;
   free(file);
   scene_make(&one);
   memset(&r, 0, sizeof r);
   r.mesh = one.desc.body, r.skeleton = one.desc.skeleton;
   CHECK(!dn_rig_create(m[FIT], &r, NULL, NULL, &err) && err.code == DN_UNSUPPORTED && strstr(err.info, "garfitnet, which dn_garment_create takes"));
#define WITH(change, code, where, word) d = one.desc; change; refuses(&d, code, where, word)
   WITH(d.refine = mlp, DN_UNSUPPORTED, "garment bind", "mlp, expected garfitnet or clothnet");
   WITH(d.refine = m[COARSE], DN_UNSUPPORTED, "garment bind", "garfit_coarse, expected garfitnet or clothnet");
   WITH(d.coarse = m[FIT], DN_UNSUPPORTED, "garment bind", "garfitnet, expected garfit_coarse or clothnet");
   WITH((d.refine = m[FIT], d.thetas = 71), DN_BAD_SHAPE, "garment bind", "found 3 + 10 + 71, the model reads 85");
   WITH((d.refine = m[CLOTH], d.betas = SIZE_MAX), DN_BAD_SHAPE, "garment bind", "expected at most");
   WITH((d.coarse = m[COARSE], d.alphas = 2), DN_BAD_SHAPE, "garment bind", "alphas: found 2, the model's feature fit reads 3");
   WITH((d.coarse = m[COARSE], d.skeleton.joints = 4), DN_BAD_SKIN, "body", "joint index 4");
   WITH((d.refine = m[FIT], d.skeleton.names = NULL), DN_MISSING_JOINT, "body", "no names");
   WITH((d.refine = m[FIT], d.coarse_rest = one.garment, d.coarse_rest_nodes = 9), DN_BAD_SHAPE, "garment bind", "9 nodes given");
   WITH(d.garment.vertices = 0, DN_BAD_MESH, "garment bind: garment", "no vertices");
   WITH(d.body.skin_sets = 0, DN_BAD_SKIN, "body", "not skinned");
   WITH(d.weld_distance = (float)NAN, DN_BAD_VALUE, "garment bind", "weld_distance");
   keep = one.garment[3 * 17 + 1], one.garment[3 * 17 + 1] = (float)NAN;
   WITH((void)0, DN_BAD_MESH, "garment bind: garment", "vertex 17");
   one.garment[3 * 17 + 1] = keep, keep = one.body[5], one.body[5] = (float)INFINITY;
   WITH((void)0, DN_BAD_MESH, "garment bind: body", "vertex 1");
   one.body[5] = keep, keep = one.alpha[1], one.alpha[1] = (float)NAN;
   WITH((void)0, DN_BAD_VALUE, "garment bind", "alpha 1");
   one.alpha[1] = keep, index = one.triangles[10], one.triangles[10] = GARMENT_V;
   WITH((void)0, DN_BAD_MESH, "garment bind: garment", "triangle 3");
   one.triangles[10] = index;
   one.names[3] = "elbow";
   WITH(d.refine = m[CLOTH], DN_MISSING_JOINT, "body", "joint3");
#undef WITH
   {
      size_t k;
      for (k = 0; k < KINDS; k++) dn_model_free((dn_model *)(uintptr_t)m[k]);
   }
   dn_model_free(mlp);
}

/* the text of a header, one part in place of another; the file must still be refused politely */
static void altered(int kind, const char *from, const char *to, dn_result code, const char *word)
{
   model_file f = model_bytes(kind, "dynamic", "model", NULL);
   size_t n = strlen(from), extra = strlen(to), i, header = 0, k;
   unsigned char *out = (unsigned char *)test_block(f.size + extra);
   dn_model *m;
   dn_error err;
   for (k = 0; k < 8; k++) header |= (size_t)f.data[k] << (8 * k);
   for (i = 8; i + n < 8 + header && memcmp(f.data + i, from, n) != 0; i++) {}
   if (!CHECK_MSG(i + n < 8 + header, "%s is not in the header", from)) exit(2);
   memcpy(out, f.data, i);
   memcpy(out + i, to, extra);
   memcpy(out + i + extra, f.data + i + n, f.size - i - n);
   header = header - n + extra;
   for (k = 0; k < 8; k++) out[k] = (unsigned char)((uint64_t)header >> (8 * k));
   memset(&err, 0, sizeof err);
   m = dn_model_load(out, f.size - n + extra, NULL, NULL, &err);
   CHECK_MSG(!m && err.code == code && strstr(err.info, word), "%s -> %s: %s: %s", from, to, dn_result_text(err.code), err.info);
   dn_model_free(m);
   free(out);
   free(f.data);
}
TEST(files_with_one_thing_wrong)
{
   altered(CLOTH, "\"parser.2.weight\"", "\"parser.9.weight\"", DN_MISSING_TENSOR, "parser.2.weight");
   altered(CLOTH, "\"parser.2.weight\":{\"dtype\":\"F32\",\"shape\":[24,14]", "\"parser.2.weight\":{\"dtype\":\"F32\",\"shape\":[14,24]", DN_BAD_SHAPE, "parser.2.weight: expected (24,14), file has (14,24)");
   altered(CLOTH, "\"detail.len.pool.att_src\":{\"dtype\":\"F32\",\"shape\":[1,5]", "\"detail.len.pool.att_src\":{\"dtype\":\"F32\",\"shape\":[5,1]", DN_BAD_SHAPE, "detail.len.pool.att_src: expected (1,5), file has (5,1)");
   altered(CLOTH, "\"detail.dir.gat.3.lin.weight\":{\"dtype\":\"F32\",\"shape\":[4,12]", "\"detail.dir.gat.3.lin.weight\":{\"dtype\":\"F32\",\"shape\":[12,4]", DN_BAD_SHAPE, "detail.dir.gat.3.lin.weight");
   altered(CLOTH, "\"coarse.len.out.weight\":{\"dtype\":\"F32\",\"shape\":[1,7]", "\"coarse.len.out.weight\":{\"dtype\":\"F32\",\"shape\":[7,1]", DN_BAD_SHAPE, "coarse.len.out.weight: expected (1,7), file has (7,1)");
   altered(CLOTH, "\"detail.input.std\":{\"dtype\":\"F32\",\"shape\":[11]", "\"detail.input.std\":{\"dtype\":\"F32\",\"shape\":[1,11]", DN_BAD_SHAPE, "detail.input.std");
   altered(CLOTH, "normal,relative,fit:1", "normal,relative,fit:2", DN_BAD_SHAPE, "rows of 7");
   altered(CLOTH, "normal,relative,fit:1", "normal,relative,fit:", DN_UNSUPPORTED, "fit:n");
   altered(CLOTH, "normal,relative,fit:1", "normal,relative,fit:99999999999999999999", DN_UNSUPPORTED, "fit:n");
   altered(CLOTH, "normal,relative,fit:1", "normal,fit:1,fit:3", DN_UNSUPPORTED, "at most once");
   altered(CLOTH, "\"deformnet.features.detail\":\"normal,relative,distance\",", "", DN_MISSING_TENSOR, "deformnet.features.detail");
   altered(CLOTH, "normal,relative,distance", "normal,relative,geodesic", DN_UNSUPPORTED, "geodesic");
   altered(CLOTH, "joint0,joint1,joint2,joint3,joint4", "joint0,joint1", DN_BAD_SHAPE, "names 2");
   altered(FIT, "\"fit.2.weight\":{\"dtype\":\"F32\",\"shape\":[32,14]", "\"fit.2.weight\":{\"dtype\":\"F32\",\"shape\":[14,32]", DN_BAD_SHAPE, "fit.2.weight: expected (32,14), file has (14,32)");
   altered(FIT, "\"dir.post.0.weight\":{\"dtype\":\"F32\",\"shape\":[9,82]", "\"dir.post.0.weight\":{\"dtype\":\"F32\",\"shape\":[82,9]", DN_BAD_SHAPE, "dir.post.0.weight");
   altered(FIT, "\"len.local.3.self.weight\"", "\"len.local.3.none.weight\"", DN_BAD_SHAPE, "len.post.0.weight");
   altered(FIT, "relative,normal,distance", "relative,normal,distance,fit:3", DN_BAD_SHAPE, "joints");
   altered(COARSE, "\"gat.2.att_src\"", "\"gat.2.att_sra\"", DN_MISSING_TENSOR, "gat.2.att_src");
   altered(COARSE, "garfit_coarse", "garfit_course", DN_UNSUPPORTED, "garfit_coarse, garfitnet, clothnet");
   altered(COARSE, "\"dir.out.weight\":{\"dtype\":\"F32\"", "\"dir.out.weight\":{\"dtype\":\"I32\"", DN_BAD_TYPE, "dir.out.weight");
}

/* a damaged file: either refused with a reason, or a model that binds and runs within its memory */
static int survives(const unsigned char *file, size_t size, int kind)
{
   dn_error err;
   dn_model *m;
   dn_garment *g;
   dn_garment_desc d = one.desc;
   dn_model_info info;
   memset(&err, 0, sizeof err);
   m = dn_model_load(file, size, NULL, NULL, &err);
   if (!m) return (CHECK(err.code != DN_OK && err.info[0]), 0);
   dn_model_describe(m, &info);
   if (info.arch == DN_GARFIT_COARSE) d.coarse = m;
   else d.refine = m;
   (void)kind;
   g = dn_garment_create(&d, NULL, NULL, &err);
   if (g) {
      dn_garment_pose pose = pose_of(&one, 1);
      float *p = (float *)test_block(d.garment.vertices * 12);
      dn_result r = frame(g, &pose, NULL, p, NULL, NULL, NULL, NULL);
      CHECK(r == DN_OK || r == DN_NOT_FINITE);
      free(p);
   } else CHECK(err.code != DN_OK && err.info[0]);
   dn_garment_free(g);
   dn_model_free(m);
   return 1;
}
TEST(every_prefix_and_flipped_bytes)
{
   size_t k, i, header, prefixes = 0, flips = 0, loaded = 0;
   scene_make(&one);
   one.desc.garment.vertices = 2 * (G_AROUND + 1), one.desc.garment.triangles = 2 * G_AROUND; /* one strip: many runs */
   for (k = 0; k < KINDS; k++) {
      model_file f = model_bytes((int)k, k == CLOTH ? "rest" : "dynamic", "root", NULL);
      for (header = 0, i = 0; i < 8; i++) header |= (size_t)f.data[i] << (8 * i);
      for (i = 0; i < f.size; i += i < header ? 29 : 997, prefixes++) {
         unsigned char *cut = test_copy(f.data, i);
         dn_error err;
         memset(&err, 0, sizeof err);
         CHECK(!dn_model_load(cut, i, NULL, NULL, &err) && err.code != DN_OK && err.info[0]);
         free(cut);
      }
      for (i = 0; i < f.size; i += i < header ? 7 : 173, flips++) { /* header densely, numbers here and there */
         unsigned char *bent = test_copy(f.data, f.size);
         bent[i] ^= (unsigned char)(1u << (i / 7 % 8));
         loaded += (size_t)survives(bent, f.size, (int)k);
         free(bent);
      }
      CHECK(survives(f.data, f.size, (int)k));
      free(f.data);
   }
   AT_LEAST(prefixes, 500, "prefixes");
   AT_LEAST(flips, 2500, "flips");
   AT_LEAST(loaded, 300, "of them loaded");
}

typedef struct heap { size_t until, live; int failed; } heap;
static void *heap_alloc(void *user, size_t size, size_t align)
{
   heap *h = (heap *)user;
   void *p;
   if (h->until == 0) return h->failed = 1, NULL;
   h->until--;
   if (posix_memalign(&p, align, size)) return NULL;
   h->live++;
   return p;
}
static void heap_free(void *user, void *ptr, size_t size)
{
   (void)size;
   ((heap *)user)->live--;
   free(ptr);
}
TEST(allocations_that_fail)
{
   size_t k, n, tries = 0;
   scene_make(&one);
   for (k = 0; k < KINDS; k++) {
      model_file f = model_bytes((int)k, "rest", "model", NULL);
      int done = 0;
      for (n = 0; !done && n < 100; n++, tries++) { /* the n-th allocation fails: load, bind, scratch */
         heap h;
         dn_allocator a;
         dn_error err;
         dn_model *m;
         dn_garment *g = NULL;
         dn_garment_desc d = one.desc;
         void *scratch = NULL;
         size_t bytes = 0;
         h.until = n, h.live = 0, h.failed = 0;
         a.alloc = heap_alloc, a.free = heap_free, a.user = &h;
         memset(&err, 0, sizeof err);
         m = dn_model_load(f.data, f.size, NULL, &a, &err);
         if (k == COARSE) d.coarse = m;
         else d.refine = m;
         if (m) g = dn_garment_create(&d, &a, NULL, &err);
         if (g) scratch = dn_garment_scratch_create(g, 1, &a, &bytes, &err);
         done = scratch != NULL;
         CHECK(done || (h.failed && err.code == DN_NO_MEMORY && err.info[0]));
         dn_scratch_free(scratch, bytes, &a);
         dn_garment_free(g);
         dn_model_free(m);
         CHECK(h.live == 0);
      }
      CHECK(done);
      free(f.data);
   }
   AT_LEAST(tries, 18, "failing allocations");
}

int main(int argc, char **argv)
{
   TEST_BEGIN(argc, argv);
   RUN(without_models_it_follows);
   RUN(no_allocation_in_a_frame);
   RUN(order_of_vertices_and_triangles);
   RUN(components_are_on_their_own);
   RUN(vertices_without_triangles);
   RUN(zero_length_directions);
   RUN(any_threads_the_same_bits);
   RUN(change_equals_create);
   RUN(what_a_pose_can_say);
   RUN(turning_the_character);
   RUN(vertices_beside_their_node);
   RUN(channels_that_nothing_reads);
   RUN(refusals_say_what_and_where);
   RUN(files_with_one_thing_wrong);
   RUN(every_prefix_and_flipped_bytes);
   RUN(allocations_that_fail);
   return TEST_END();
}
