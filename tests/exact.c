/*  exact.c - DN_EXACT: a hash of what each part of the library gives, the same from every compiler and processor

    shows   everything gives the same bits twice: whole, and in ranges from the last to the first
    prints  "hash NAME 0123456789abcdef" a case; exact.sh compares these lines between builds
    inputs  are few-bit fractions, so that their arithmetic rounds nowhere, or come from test_uniform: no pragma here hides
            what the header's own does or fails to do
    build   cc -O2 exact.c -o exact -lm */
#define DN_EXACT
#define DEFORMNET_IMPLEMENTATION
#define DEFORMNET_STATIC /* in one file with its callers, which may be contracted and may take it inline */
#include "../deformnet.h"
#include "test.h"
#include "tiny.h"

static uint64_t hash; /* of the case at hand; of numbers, not of their bytes in memory: processors order those differently */
static size_t numbers, dull;
static void hash_start(void) { hash = 14695981039346656037u, numbers = dull = 0; }
static void hash_u32(uint32_t u)
{
   unsigned char b[4];
   b[0] = (unsigned char)u, b[1] = (unsigned char)(u >> 8), b[2] = (unsigned char)(u >> 16), b[3] = (unsigned char)(u >> 24);
   hash = test_hash(hash, b, 4);
   numbers++;
}
static void hash_ints(const uint32_t *x, size_t count)
{
   size_t i;
   for (i = 0; i < count; i++) hash_u32(x[i]);
}
static void hash_floats(const float *x, size_t count)
{
   size_t i;
   for (i = 0; i < count; i++) {
      uint32_t u;
      memcpy(&u, &x[i], 4);
      dull += !test_finite(x[i]) || x[i] == 0;
      hash_u32(u);
   }
}
static void hash_doubles(const double *x, size_t count)
{
   size_t i;
   for (i = 0; i < count; i++) {
      uint64_t u;
      memcpy(&u, &x[i], 8);
      hash_u32((uint32_t)u), hash_u32((uint32_t)(u >> 32));
   }
}
static void report(const char *name) /* a hash of nothing, or of nothing but zeros, would be equal everywhere */
{
   CHECK_MSG(numbers >= 16 && dull <= numbers / 2, "%s: %lu numbers, %lu of them 0 or not finite", name, (unsigned long)numbers, (unsigned long)dull);
   printf("hash %s %08lx%08lx\n", name, (unsigned long)(hash >> 32), (unsigned long)(hash & 0xffffffffu));
}

/* a multiple of size / 4096 in [-size, size); size is a power of two: exact */
static float fraction(uint64_t *seed, float size) { return (float)((int)(test_random(seed) & 0x1fffu) - 0x1000) * (size / 4096.0f); }
static float *fractions(uint64_t *seed, size_t count, float size)
{
   float *p = (float *)test_block(count * sizeof(float));
   size_t i;
   for (i = 0; i < count; i++) p[i] = fraction(seed, size);
   return p;
}
static void split_backwards(void *user, size_t count, size_t grain, dn_range_fn *fn, void *job)
{
   size_t n = (count + grain - 1) / grain;
   (void)user;
   while (n-- > 0) fn(job, n * grain, (n + 1) * grain < count ? (n + 1) * grain : count, (unsigned)(n % 3));
}
static const dn_parallel backwards = {split_backwards, NULL, 3};
static dn_model *load_at(unsigned char *file, size_t size, dn_precision precision)
{
   dn_error e;
   dn_model_options options;
   dn_model *m;
   memset(&options, 0, sizeof options);
   options.precision = precision;
   m = dn_model_load(file, size, &options, NULL, &e);
   free(file);
   if (!CHECK_MSG(m != NULL, "%s", m ? "" : e.info)) exit(1);
   return m;
}

static dn_model *load(unsigned char *file, size_t size) { return load_at(file, size, DN_PRECISION_F32); }

/* --- a lumpy limb, closed, of three joints along x; at 0, 1/2 and 1 */
enum { RINGS = 17, AROUND = 8, V = RINGS * AROUND + 2, T = 2 * AROUND * RINGS, S = 3 };
typedef struct limb {
   float rest[V * 3], weight[V * S], inverse_bind[S * 12], palette[S * 12], rotation[S * 9];
   uint32_t triangle[T * 3], joint[V * S];
   int32_t parents[S];
   const char *names[S];
   dn_skin_set skin;
   dn_mesh mesh;
   dn_skeleton skeleton;
} limb;
static void limb_make(limb *l, float size /* a power of two */, uint64_t seed)
{
   static const float turn[AROUND][2] = {{1, 0}, {0.703125f, 0.703125f}, {0, 1}, {-0.703125f, 0.703125f}, {-1, 0}, {-0.703125f, -0.703125f}, {0, -1}, {0.703125f, -0.703125f}};
   static const float offset[S * 3] = {0, 0, 0, 0.5f, 0, 0, 0.5f, 0, 0};
   static const char *const names[S] = {"hip", "knee", "foot"};
   float transform[S * 12];
   size_t r, a, s, n = 0;
   memset(l, 0, sizeof *l);
   for (r = 0; r <= RINGS; r++) /* the last two are the poles */
      for (a = 0; a < (r < RINGS ? (size_t)AROUND : 2); a++) {
         size_t v = r * AROUND + a;
         float *w = l->weight + S * v, *p = l->rest + 3 * v, share = (float)(r % 8) * 0.125f;
         float round = 0.1875f + (float)(test_random(&seed) & 15u) * 0.00390625f;
         p[0] = r < RINGS ? (float)r * 0.0625f + (float)(test_random(&seed) & 7u) * 0.00390625f : a ? 1.125f : -0.0625f;
         p[1] = r < RINGS ? size * round * turn[a][0] : 0, p[2] = r < RINGS ? size * round * turn[a][1] : 0;
         w[r < RINGS ? r / 8 : a ? 2 : 0] = 1 - share;
         if (r < 16) w[r / 8 + 1] = share;
         for (s = 0; s < S; s++) l->joint[S * v + s] = (uint32_t)s;
      }
   for (r = 0; r + 1 < RINGS; r++)
      for (a = 0; a < AROUND; a++) {
         uint32_t *t = l->triangle + 6 * (r * AROUND + a), b = (uint32_t)((a + 1) % AROUND), i = (uint32_t)(r * AROUND);
         t[0] = i + (uint32_t)a, t[1] = i + b, t[2] = t[0] + AROUND, t[3] = t[1], t[4] = t[1] + AROUND, t[5] = t[2];
         n += 2;
      }
   for (a = 0; a < AROUND; a++, n += 2) {
      uint32_t *t = l->triangle + 3 * n, b = (uint32_t)((a + 1) % AROUND), i = (RINGS - 1) * AROUND;
      t[0] = b, t[1] = (uint32_t)a, t[2] = RINGS * AROUND, t[3] = i + (uint32_t)a, t[4] = i + b, t[5] = RINGS * AROUND + 1;
   }
   for (s = 0; s < S; s++) {
      float *m = l->inverse_bind + 12 * s, axis[3];
      m[0] = m[5] = m[10] = 1, m[3] = -0.5f * (float)s;
      axis[0] = fraction(&seed, 0.5f), axis[1] = fraction(&seed, 0.25f), axis[2] = s ? 0.75f : 0.125f;
      dn_rodrigues(axis, l->rotation + 9 * s);
      l->parents[s] = (int32_t)s - 1, l->names[s] = names[s];
   }
   dn_forward_kinematics(l->parents, offset, l->rotation, S, transform);
   dn_palette(transform, l->inverse_bind, S, l->palette);
   l->skin.influences = S, l->skin.joints = l->joint, l->skin.joint_type = DN_U32;
   l->skin.weights = l->weight, l->skin.weight_type = DN_F32;
   l->mesh.vertices = V, l->mesh.positions = l->rest, l->mesh.triangles = T, l->mesh.indices = l->triangle, l->mesh.index_type = DN_U32;
   l->mesh.skin_sets = 1, l->mesh.skin = &l->skin;
   l->skeleton.joints = S, l->skeleton.names = l->names, l->skeleton.parents = l->parents, l->skeleton.inverse_bind = l->inverse_bind;
}
static limb body, sleeve; /* the second is a little wider: a garment on the first */

/* --- numbers */
TEST(functions)
{
   uint64_t seed = 9;
   size_t i;
   static const float odd[] = {0, -0.0f, 1e-30f, 1e-40f, -1e-40f, 3e38f, -3e38f, 87.5f, -87.5f, 100, -100, 0.625f, -0.625f};
   hash_start();
   for (i = 0; i < 4000 + sizeof odd / sizeof *odd; i++) {
      float x[4], y;
      y = i < 4000 ? fraction(&seed, i % 4 ? 8.0f : 128.0f) : odd[i - 4000];
      x[0] = dn__exp(y), x[1] = dn__tanh(y), x[2] = dn__tanhshrink(y), x[3] = dn__leaky(y);
      hash_floats(x, 4);
   }
   report("exp-tanh");
   hash_start();
   for (i = 0; i < 1000; i++) {
      float x = fraction(&seed, i % 4 ? 8.0f : 4096.0f), s = dn__sine((double)x, 0.0), c = dn__sine((double)x, 0.5);
      double one = (double)s * (double)s + (double)c * (double)c;
      CHECK(one > 0.9999997 && one < 1.0000003);
      hash_floats(&s, 1), hash_floats(&c, 1);
   }
   CHECK(dn__sine(1e30, 0.0) == 0 && !test_finite(dn__sine((double)odd[5] * 1e300, 0.0))); /* nonsense, and infinity */
   CHECK(dn__sine(1.5, 0.0) > 0.997494f && dn__sine(1.5, 0.0) < 0.997496f); /* near the truth, not only the same everywhere */
   CHECK(dn__sine(1.5, 0.5) > 0.0707371f && dn__sine(1.5, 0.5) < 0.0707374f && dn__sine(-3.0, 0.5) < -0.989992f);
   report("sine");
   hash_start();
   for (i = 0; i < 300; i++) {
      float a[3], r[9], m[9];
      size_t k;
      for (k = 0; k < 3; k++) a[k] = fraction(&seed, 4);
      for (k = 0; k < 9; k++) m[k] = fraction(&seed, 2);
      dn_rodrigues(a, r), hash_floats(r, 9);
      dn_orthonormalise(m, r), hash_floats(r, 9);
   }
   hash_floats(body.palette, S * 12);
   report("rotations");
}
TEST(files) /* little-endian, and all halves that are numbers */
{
   static unsigned char data[65536 * 2 + 65536 * 2 + 4 * 64];
   static float out[65536];
   const char *header = "{\"h\":{\"dtype\":\"F16\",\"shape\":[65536],\"data_offsets\":[0,131072]},\"b\":{\"dtype\":\"BF16\",\"shape\":[65536],\"data_offsets\":[131072,262144]},"
                        "\"i\":{\"dtype\":\"I32\",\"shape\":[64],\"data_offsets\":[262144,262400]}}";
   int32_t ints[64];
   uint64_t seed = 10;
   size_t i, size, bytes;
   unsigned char *file;
   void *memory;
   dn_tensors *t = NULL;
   dn_error e;
   for (i = 0; i < 65536; i++) {
      unsigned half = (i >> 10 & 31u) == 31 ? 0x3c00u : (unsigned)i, brain = (i >> 7 & 255u) == 255 ? 0x3f80u : (unsigned)i; /* no NaN */
      data[2 * i] = (unsigned char)half, data[2 * i + 1] = (unsigned char)(half >> 8);
      data[131072 + 2 * i] = (unsigned char)brain, data[131072 + 2 * i + 1] = (unsigned char)(brain >> 8);
   }
   for (i = 262144; i < sizeof data; i++) data[i] = (unsigned char)test_random(&seed);
   file = tiny_join(header, 0, data, sizeof data, &size);
   CHECK(dn_tensors_size(file, size, &bytes, &e) == DN_OK);
   memory = test_aligned(bytes);
   if (CHECK(dn_tensors_open(file, size, memory, bytes, &t, &e) == DN_OK)) {
      hash_start();
      dn_tensor_floats(dn_tensors_find(t, "h"), 0, 65536, out), hash_floats(out, 65536);
      CHECK(out[0x3c00] == 1 && out[0xc000] == -2 && out[1] > 5.96e-8f && out[1] < 5.97e-8f);
      dn_tensor_floats(dn_tensors_find(t, "b"), 0, 65536, out), hash_floats(out, 65536);
      CHECK(out[0x3f80] == 1 && out[0xc000] == -2);
      dn_tensor_ints(dn_tensors_find(t, "i"), 0, 64, ints);
      for (i = 0; i < 64; i++) hash_u32((uint32_t)ints[i]);
      report("halves");
   }
   test_aligned_free(memory), free(file);
}

/* --- meshes */
TEST(meshes)
{
   static uint32_t node[V], first_vertex[V], first[V + 1], next[6 * T], ends[6 * T], ring[12 * T], edge_first[V + 1], at[6 * T], skipped[T];
   static float normal[V * 3], rows[3 * T * 3], means[V * 3];
   size_t nodes, apart;
   dn_graph g;
   dn_edges edges;
   void *memory = test_aligned(dn_weld_scratch(V));
   hash_start();
   nodes = dn_weld(body.rest, V, NULL, NULL, 0, 0.09375f, node, first_vertex, &apart, memory);
   CHECK(nodes > V / 2 && nodes < V);
   hash_ints(node, V), hash_ints(first_vertex, nodes), hash_u32((uint32_t)apart);
   test_aligned_free(memory), memory = test_aligned(dn_graph_scratch(V, T));
   dn_graph_build(body.triangle, T, V, first, next, &g, memory);
   hash_ints(g.first, V + 1), hash_ints(g.next, g.first[V]);
   test_aligned_free(memory), memory = test_aligned(dn_edges_scratch(V, T));
   dn_edges_build(body.rest, body.triangle, T, V, ends, ring, edge_first, at, skipped, &edges, memory);
   CHECK(edges.count == 3 * T / 2 && edges.skipped == 0);
   hash_ints(edges.ends, 2 * edges.count), hash_ints(edges.ring, 4 * edges.count), hash_ints(edges.at, 2 * edges.count);
   report("graphs");
   hash_start();
   dn_normals(body.rest, V, body.triangle, T, normal);
   dn_vertex_to_edge(&edges, normal, 3, 3, rows, 3, &backwards);
   dn_edge_to_vertex(&edges, rows, 3, 3, means, 3, &backwards);
   hash_floats(normal, V * 3), hash_floats(rows, 3 * edges.count), hash_floats(means, V * 3);
   report("normals");
   test_aligned_free(memory);
}
TEST(skinning)
{
   static float many[9 * V * 3], out[9 * V * 3]; /* more than 1,023 points: dn_lbs sums them otherwise */
   static uint32_t joint[9 * V * S];
   static float weight[9 * V * S];
   size_t i;
   for (i = 0; i < 9; i++) memcpy(many + i * V * 3, body.rest, sizeof body.rest), memcpy(joint + i * V * S, body.joint, sizeof body.joint), memcpy(weight + i * V * S, body.weight, sizeof body.weight);
   hash_start();
   dn_lbs(body.rest, body.joint, body.weight, S, V, body.palette, out), hash_floats(out, V * 3);
   dn_lbs(many, joint, weight, S, 9 * V, body.palette, out), hash_floats(out, 9 * V * 3);
   report("lbs");
   hash_start();
   dn_dqs(body.rest, body.joint, body.weight, S, V, body.palette, out), hash_floats(out, V * 3);
   report("dqs");
}
TEST(voxels)
{
   static const float joints[S * 3] = {0, 0.015625f, 0, 0.5f, -0.03125f, 0.0625f, 1.0f, 0.25f, 0.125f};
   static float distance[V * S], again[V * S], weight[V * 2];
   static uint32_t joint[V * 2];
   size_t bytes = dn_geodesic_scratch(body.rest, V, T, 40, 3), cells;
   float cell;
   void *memory = test_aligned(bytes);
   hash_start();
   CHECK(dn_geodesic(body.rest, V, body.triangle, T, joints, S, 40, distance, &cells, &cell, memory, bytes, NULL, NULL) == DN_OK);
   CHECK(dn_geodesic(body.rest, V, body.triangle, T, joints, S, 40, again, NULL, NULL, memory, bytes, &backwards, NULL) == DN_OK);
   CHECK(memcmp(distance, again, sizeof distance) == 0);
   hash_floats(distance, V * S), hash_u32((uint32_t)cells), hash_floats(&cell, 1);
   report("geodesic");
   test_aligned_free(memory);
   bytes = dn_voxel_bind_scratch(body.rest, V, T, S, 24, 1), memory = test_aligned(bytes);
   hash_start();
   CHECK(dn_voxel_bind(body.rest, V, body.triangle, T, joints, body.parents, S, 24, 0.25f, 2, joint, weight, memory, bytes, NULL, NULL) == DN_OK);
   hash_floats(weight, V * 2), hash_ints(joint, V * 2);
   report("voxel-bind");
   test_aligned_free(memory);
}

/* --- layers of the papers' sizes: sums are long, logits many, activations over their whole range */
TEST(layers)
{
   enum { IN = 200, K = 8, F = 8, B = 8, WIDTH = K * F + B, ROW = IN + 2 * WIDTH };
   static const dn_activation acts[] = {DN_ACT_NONE, DN_ACT_TANH, DN_ACT_RELU, DN_ACT_LEAKYRELU, DN_ACT_TANHSHRINK, DN_ACT_SOFTMAX};
   static uint32_t first[V + 1], next[6 * T];
   uint64_t seed = 5;
   float *lin = fractions(&seed, K * F * (IN + WIDTH), 0.25f), *self_weight = fractions(&seed, B * (IN + WIDTH), 0.25f);
   float *dst = fractions(&seed, K * F, 1), *src = fractions(&seed, K * F, 1), *q = fractions(&seed, 4 * WIDTH, 0.5f);
   float *v = fractions(&seed, V * IN, 2), *y = (float *)test_block(V * ROW * 4), *again = (float *)test_block(V * ROW * 4);
   void *memory = test_aligned(dn_gat_size(IN, K, F, B)), *second = test_aligned(dn_gat_size(IN + WIDTH, K, F, B));
   void *more = test_aligned(dn_linear_size(IN, WIDTH)), *scratch = test_aligned(dn_graph_scratch(V, T));
   dn_batchnorm bn;
   dn_graph g;
   dn_gat block[2];
   size_t i, k;
   dn_graph_build(body.triangle, T, V, first, next, &g, scratch);
   test_aligned_free(scratch);
   bn.weight = q, bn.bias = q + WIDTH, bn.mean = q + 2 * WIDTH, bn.var = q + 3 * WIDTH;
   for (i = 0; i < WIDTH; i++) q[3 * WIDTH + i] += 0.75f;
   hash_start();
   for (i = 0; i < sizeof acts / sizeof *acts; i++) {
      dn_linear l;
      dn_linear_pack(&l, IN, K * F, lin, q, i % 2 ? &bn : NULL, acts[i], more);
      dn_linear_run(&l, v, IN, V, y, K * F, NULL);
      dn_linear_run(&l, v, IN, V, again, K * F, &backwards);
      CHECK(memcmp(y, again, V * K * F * 4) == 0);
      hash_floats(y, V * K * F);
   }
   report("linear");
   hash_start();
   for (i = 0; i < 5; i++) {
      dn_gat_pack(&block[0], IN, K, F, B, lin, dst, src, self_weight, i % 2 ? &bn : NULL, acts[i], memory);
      scratch = test_aligned(dn_gat_scratch(&block[0], V));
      dn_gat_run(&block[0], &g, v, IN, y, WIDTH, scratch, NULL);
      dn_gat_run(&block[0], &g, v, IN, again, WIDTH, scratch, &backwards);
      CHECK(memcmp(y, again, V * WIDTH * 4) == 0);
      hash_floats(y, V * WIDTH);
      dn_gat_attention(&block[0], &g, v, IN, y, scratch);
      hash_floats(y, (V + first[V]) * K);
      test_aligned_free(scratch);
   }
   report("gat");
   hash_start();
   dn_gat_pack(&block[0], IN, K, F, B, lin, dst, src, self_weight, NULL, DN_ACT_TANHSHRINK, memory);
   dn_gat_pack(&block[1], IN + WIDTH, K, F, B, lin, src, dst, self_weight, &bn, DN_ACT_TANHSHRINK, second);
   scratch = test_aligned(dn_gat_scratch(&block[1], V));
   for (i = 0; i < V; i++)
      for (k = 0; k < IN; k++) y[i * ROW + 2 * WIDTH + k] = v[i * IN + k];
   dn_dense_run(block, 2, &g, y, ROW, ROW, scratch, &backwards);
   hash_floats(y, V * ROW);
   report("dense");
   test_aligned_free(scratch), test_aligned_free(memory), test_aligned_free(second), test_aligned_free(more);
   free(lin), free(self_weight), free(dst), free(src), free(q), free(v), free(y), free(again);
}
TEST(pooling)
{
   enum { IN = 24, F = 5 };
   static uint32_t first[V + 1], next[6 * T], members[2 * V], cluster[V], coarse_first[V + 1], coarse_next[6 * T];
   static float scores[6 * T], again[6 * T], chosen[V], coarse[V * IN], back[V * IN];
   uint64_t seed = 6;
   float *lin = fractions(&seed, F * IN, 0.5f), *dst = fractions(&seed, F, 1), *src = fractions(&seed, F, 1), *v = fractions(&seed, V * IN, 2);
   void *memory = test_aligned(dn_pool_size(IN, F)), *scratch = test_aligned(dn_graph_scratch(V, T));
   dn_pool pool;
   dn_clusters c;
   dn_graph g;
   dn_graph_build(body.triangle, T, V, first, next, &g, scratch);
   test_aligned_free(scratch), scratch = test_aligned(dn_pool_scratch(V, first[V]));
   memset(&c, 0, sizeof c);
   c.members = members, c.score = chosen, c.cluster = cluster, c.coarse_first = coarse_first, c.coarse_next = coarse_next;
   dn_pool_pack(&pool, IN, F, lin, dst, src, 0.25f, memory);
   hash_start();
   dn_pool_scores(&pool, &g, v, IN, scores, scratch, NULL);
   dn_pool_scores(&pool, &g, v, IN, again, scratch, &backwards);
   CHECK(memcmp(scores, again, first[V] * 4) == 0);
   dn_pool_contract(&g, scores, &c, scratch);
   CHECK(c.count < V && c.count > V / 3);
   hash_floats(scores, first[V]), hash_ints(members, 2 * c.count), hash_floats(chosen, c.count), hash_ints(cluster, V);
   hash_ints(coarse_first, c.count + 1), hash_ints(coarse_next, coarse_first[c.count]);
   report("contraction");
   hash_start();
   dn_pool_gather(&pool, &c, v, IN, IN, coarse, IN, &backwards), hash_floats(coarse, c.count * IN);
   dn_pool_scatter(&pool, &c, coarse, IN, IN, V, back, IN, &backwards), hash_floats(back, V * IN);
   dn_pool_rescore(&pool, &g, back, IN, &c, &backwards), hash_floats(chosen, c.count);
   report("gather-scatter");
   test_aligned_free(memory), test_aligned_free(scratch), free(lin), free(dst), free(src), free(v);
}

/* --- whole networks, on a character */
enum { OUTPUTS = 4 * V * 3 };
static void deform(const dn_model *model, dn_skinning skinning, const dn_parallel *parallel, float *out) /* (4,V,3) */
{
   dn_error e;
   dn_rig_desc d;
   dn_pose pose;
   dn_output o;
   dn_rig *rig;
   void *scratch;
   size_t bytes;
   memset(&d, 0, sizeof d), memset(&pose, 0, sizeof pose), memset(&o, 0, sizeof o), memset(out, 0xff, OUTPUTS * sizeof *out);
   d.mesh = body.mesh, d.skeleton = body.skeleton, d.skinning = skinning, d.resolution = 24, d.parallel = parallel;
   rig = dn_rig_create(model, &d, NULL, NULL, &e);
   if (!CHECK_MSG(rig != NULL, "%s", rig ? "" : e.info)) exit(1);
   scratch = dn_scratch_create(rig, parallel ? parallel->workers : 1, NULL, &bytes, &e);
   pose.palette = body.palette, pose.strength = 0.75f;
   o.positions = out, o.normals = out + V * 3, o.displacement = out + 2 * V * 3, o.rest_delta = out + 3 * V * 3;
   CHECK(dn_deform(rig, &pose, &o, scratch, bytes, parallel, &e) == DN_OK && o.fallback_nodes == 0);
   hash_floats(o.bounds_min, 3), hash_floats(o.bounds_max, 3);
   dn_scratch_free(scratch, bytes, NULL), dn_rig_free(rig);
}
static uint64_t both(const char *name, dn_model *model, const float *one, const float *two, const float *displacement)
{
   size_t i, moved = 0;
   for (i = 0; i < V * 3; i++) moved += displacement[i] != 0;
   CHECK_MSG(memcmp(one, two, OUTPUTS * sizeof *one) == 0, "%s: ranges change the bits", name);
   CHECK_MSG(moved > V, "%s: moves next to nothing", name);
   hash_floats(one, OUTPUTS);
   report(name);
   dn_model_free(model);
   return hash;
}
static uint64_t network(const char *name, dn_model *model, dn_skinning skinning)
{
   static float one[OUTPUTS], two[OUTPUTS];
   hash_start();
   deform(model, skinning, NULL, one), deform(model, skinning, &backwards, two);
   return both(name, model, one, two, one + 2 * V * 3);
}
TEST(networks)
{
   size_t size;
   uint64_t dynamic;
   unsigned char *file;
   CHECK(strcmp(dn_kernel_name(DN_KERNEL_AUTO), "reference") == 0);
   file = tiny_mlp(&size), network("mlp", load(file, size), DN_LBS);
   file = tiny_gats("gat", &size), network("gat-network", load(file, size), DN_LBS);
   file = tiny_gats("neuroskinning", &size), network("neuroskinning", load(file, size), DN_DQS);
   file = tiny_dense(&size), network("densegats", load(file, size), DN_LBS);
   file = tiny_multires("geodesic", "dynamic", &size), dynamic = network("multiresgnet-dynamic", load(file, size), DN_LBS);
   file = tiny_multires("geodesic", "rest", &size), CHECK(network("multiresgnet-rest", load(file, size), DN_LBS) != dynamic);
}
TEST(precisions)
{
   static const dn_precision precision[] = {DN_PRECISION_F16, DN_PRECISION_BF16, DN_PRECISION_INT8};
   size_t i, size;
   tiny_ranges = 1;
   for (i = 0; i < sizeof precision / sizeof *precision; i++) {
      const char *p = dn_precision_name(precision[i]);
      unsigned char *file;
      char name[64];
      file = tiny_gats("gat", &size), snprintf(name, sizeof name, "gat-network-%s", p), network(name, load_at(file, size, precision[i]), DN_LBS);
      file = tiny_dense(&size), snprintf(name, sizeof name, "densegats-%s", p), network(name, load_at(file, size, precision[i]), DN_LBS);
      file = tiny_multires("geodesic", "dynamic", &size), snprintf(name, sizeof name, "multiresgnet-%s", p), network(name, load_at(file, size, precision[i]), DN_LBS);
   }
   tiny_ranges = 0;
}
static void wear(const dn_model *model, const dn_parallel *parallel, float *out) /* (4,V,3) */
{
   static const float shape[TINY_SHAPE] = {0.5f, -0.25f, 0.75f, 0.125f, -0.0625f, 0.375f, 0.625f}; /* alpha, beta, theta */
   dn_garment_desc d;
   dn_garment_pose pose;
   dn_garment_output o;
   dn_model_info info;
   dn_garment *g;
   dn_error e;
   size_t bytes;
   void *scratch;
   memset(&d, 0, sizeof d), memset(&pose, 0, sizeof pose), memset(&o, 0, sizeof o), memset(out, 0xff, OUTPUTS * sizeof *out);
   dn_model_describe(model, &info);
   d.body = body.mesh, d.skeleton = body.skeleton, d.garment = sleeve.mesh, d.garment.skin_sets = 0;
   if (info.arch == DN_GARFIT_COARSE) d.coarse = model;
   else d.refine = model;
   d.alpha = shape, d.alphas = TINY_ALPHAS, d.beta = shape + TINY_ALPHAS, d.betas = TINY_BETAS, d.thetas = TINY_THETAS, d.parallel = parallel;
   g = dn_garment_create(&d, NULL, NULL, &e);
   if (!CHECK_MSG(g != NULL, "%s", g ? "" : e.info)) exit(1);
   pose.palette = body.palette, pose.theta = shape + TINY_ALPHAS + TINY_BETAS, pose.strength = 0.75f;
   o.positions = out, o.normals = out + V * 3, o.coarse = out + 2 * V * 3;
   if (d.refine) o.displacement = out + 3 * V * 3;
   scratch = dn_garment_scratch_create(g, parallel ? parallel->workers : 1, NULL, &bytes, &e);
   CHECK(dn_garment_deform(g, &pose, &o, scratch, bytes, parallel, &e) == DN_OK && o.fallback_nodes == 0);
   dn_scratch_free(scratch, bytes, NULL), dn_garment_free(g);
}
static uint64_t garment(const char *name, dn_model *model)
{
   static float one[OUTPUTS], two[OUTPUTS];
   hash_start();
   wear(model, NULL, one), wear(model, &backwards, two);
   return both(name, model, one, two, one + 3 * V * 3);
}
TEST(garments)
{
   size_t size;
   uint64_t dynamic;
   unsigned char *file;
   file = tiny_coarse(&size), garment("garfit_coarse", load(file, size));
   file = tiny_garfit("dynamic", &size), dynamic = garment("garfitnet-dynamic", load(file, size));
   file = tiny_garfit("rest", &size), CHECK(garment("garfitnet-rest", load(file, size)) != dynamic);
   file = tiny_cloth("dynamic", &size), dynamic = garment("clothnet-dynamic", load(file, size));
   file = tiny_cloth("rest", &size), CHECK(garment("clothnet-rest", load(file, size)) != dynamic);
}
TEST(blend_shapes)
{
   static float out[4 * V * 3], coefficients[2 * 2], palette[S * 12];
   size_t size, bytes;
   unsigned char *file = tiny_blend(&size);
   dn_model *model = load(file, size);
   dn_blend_desc d;
   dn_blend_input in;
   dn_blend_output o;
   dn_blend_view view;
   dn_blend *b;
   dn_error e;
   void *scratch;
   memset(&d, 0, sizeof d), memset(&in, 0, sizeof in), memset(&o, 0, sizeof o);
   d.mesh = body.mesh, d.parallel = &backwards;
   b = dn_blend_create(model, &d, NULL, &e);
   if (!CHECK_MSG(b != NULL, "%s", b ? "" : e.info)) return;
   dn_blend_describe(b, &view);
   hash_start();
   hash_floats(view.skin_weight, view.nodes * view.joints), hash_floats(view.joint_rest, 3 * view.joints);
   hash_floats(view.shape, view.nodes * view.shapes * 3), hash_ints(view.mask_joint, view.mask_first[view.nodes]);
   report("neuralblendshapes-rig");
   hash_start();
   in.rotations = body.rotation, in.strength = 0.75f;
   o.positions = out, o.displacement = out + V * 3, o.coefficients = coefficients, o.palette = palette;
   scratch = dn_blend_scratch_create(b, NULL, &bytes, &e);
   CHECK(dn_blend_pose(b, &in, &o, scratch, bytes, &backwards, &e) == DN_OK);
   hash_floats(out, 2 * V * 3), hash_floats(coefficients, 4), hash_floats(palette, S * 12);
   report("neuralblendshapes-pose");
   dn_scratch_free(scratch, bytes, NULL), dn_blend_free(b), dn_model_free(model);
}

/* --- the kit */
TEST(kit)
{
   enum { ROWS = 12, PAIRS = 9, FACTORS = 3, WANTED = 20 };
   static uint32_t nearest[V], selection[WANTED], first[V + 1], next[6 * T];
   static float smooth[V * 3], spare[V * 3];
   uint64_t seed = 12;
   double area = dn_area(sleeve.rest, sleeve.triangle, T), history[8];
   float mean[ROWS], loading[ROWS * FACTORS], noise[ROWS], projection[ROWS * FACTORS], alpha[FACTORS * PAIRS], own[FACTORS];
   float *d = fractions(&seed, ROWS * PAIRS, 0.5f);
   unsigned spacing = 0;
   dn_factor_desc fit;
   dn_graph g;
   dn_error e;
   void *memory = test_aligned(dn_associate_scratch(V));
   size_t bytes;
   hash_start();
   dn_associate(body.rest, V, sleeve.rest, V, nearest, memory, &backwards), hash_ints(nearest, V);
   hash_doubles(&area, 1);
   test_aligned_free(memory), memory = test_aligned(dn_even_selection_scratch(V));
   CHECK(dn_even_selection(sleeve.rest, V, area, WANTED, selection, &spacing, memory, &e) == DN_OK);
   hash_ints(selection, WANTED), hash_u32(spacing);
   test_aligned_free(memory), memory = test_aligned(dn_graph_scratch(V, T));
   dn_graph_build(sleeve.triangle, T, V, first, next, &g, memory);
   memcpy(smooth, sleeve.rest, sizeof smooth);
   dn_smooth(&g, smooth, 40, 0.12f, spare, &backwards), hash_floats(smooth, V * 3);
   report("association-smoothing");
   test_aligned_free(memory);
   memset(&fit, 0, sizeof fit);
   fit.distances = d, fit.rows = ROWS, fit.pairs = PAIRS, fit.factors = FACTORS;
   fit.mean = mean, fit.loading = loading, fit.noise = noise, fit.projection = projection, fit.alpha = alpha, fit.history = history, fit.history_count = 8;
   bytes = dn_factor_scratch(ROWS, PAIRS, FACTORS), memory = test_aligned(bytes);
   CHECK(dn_factor_fit(&fit, memory, bytes, &e) == DN_OK && fit.rounds >= 8);
   hash_start();
   dn_factor_project(projection, mean, sleeve.rest, ROWS, FACTORS, own);
   hash_floats(mean, ROWS), hash_floats(loading, ROWS * FACTORS), hash_floats(noise, ROWS), hash_floats(projection, ROWS * FACTORS);
   hash_floats(alpha, FACTORS * PAIRS), hash_floats(own, FACTORS), hash_doubles(history, 8), hash_u32((uint32_t)fit.rounds);
   report("factors");
   test_aligned_free(memory), free(d);
}
TEST(collisions)
{
   static float p[V * 3], again[V * 3];
   static uint32_t first[V + 1], next[6 * T];
   uint64_t seed = 13;
   void *memory = test_aligned(dn_surface_size(V, T)), *scratch = test_aligned(dn_graph_scratch(V, T));
   dn_surface surface;
   dn_obstacle o;
   dn_collision c;
   dn_graph g;
   size_t i;
   dn_graph_build(sleeve.triangle, T, V, first, next, &g, scratch);
   test_aligned_free(scratch), scratch = test_aligned(dn_collide_scratch(V));
   dn_surface_build(&surface, body.rest, V, body.triangle, T, memory);
   hash_start();
   for (i = 0; i < 400; i++) {
      float q[3], near[3], normal[3], d;
      q[0] = 0.5f + fraction(&seed, 1), q[1] = fraction(&seed, 0.5f), q[2] = fraction(&seed, 0.5f);
      d = dn_surface_distance(&surface, q, near, normal);
      hash_floats(&d, 1), hash_floats(near, 3), hash_floats(normal, 3);
   }
   report("surface");
   for (i = 0; i < V * 3; i++) p[i] = again[i] = i % 3 ? 0.5f * sleeve.rest[i] : sleeve.rest[i]; /* half of it ends inside */
   o.surface = &surface, o.margin = 0.015625f, o.reach = 0;
   hash_start();
   dn_collide(&o, 1, &g, p, V, &c, scratch, NULL), dn_collide(&o, 1, &g, again, V, NULL, scratch, &backwards);
   CHECK(memcmp(p, again, sizeof p) == 0 && c.moved > V / 4);
   hash_floats(p, V * 3), hash_floats(&c.deepest, 1), hash_floats(&c.farthest, 1);
   hash_u32((uint32_t)c.inside), hash_u32((uint32_t)c.moved), hash_u32((uint32_t)c.squeezed);
   report("collisions");
   test_aligned_free(memory), test_aligned_free(scratch);
}

/* --- a dressed character: the limb and the sleeve as shapes of two coefficients */
static dn_shape *shape_of(const limb *l, int joints)
{
   static tiny_writer w;
   uint64_t seed = 14;
   char shape[32];
   size_t i, size;
   unsigned char *file;
   dn_shape *s;
   dn_error e;
   w.bytes = 0;
   w.used = (size_t)snprintf(w.header, sizeof w.header, "{\"__metadata__\":{\"joint_names\":\"[\\\"hip\\\",\\\"knee\\\",\\\"foot\\\"]\"}");
   snprintf(shape, sizeof shape, "%d,3", V), tiny_entry(&w, "template", "F32", shape, V * 3);
   for (i = 0; i < V * 3; i++) tiny_number(&w, &l->rest[i]);
   snprintf(shape, sizeof shape, "%d,3", T), tiny_entry(&w, "faces", "I32", shape, T * 3);
   for (i = 0; i < T * 3; i++) tiny_number(&w, &l->triangle[i]);
   snprintf(shape, sizeof shape, "%d,%d", V, S), tiny_entry(&w, "weights", "F32", shape, V * S);
   for (i = 0; i < V * S; i++) tiny_number(&w, &l->weight[i]);
   snprintf(shape, sizeof shape, "%d,3,2", V), tiny_shaped(&w, "shapedirs", shape, V * 6, &seed, -0.01f, 0.01f);
   snprintf(shape, sizeof shape, "%d,3", V), tiny_shaped(&w, "looseness_dirs", shape, V * 3, &seed, -0.5f, 0.5f);
   if (joints) {
      snprintf(shape, sizeof shape, "%d,3,18", V), tiny_shaped(&w, "posedirs", shape, V * 54, &seed, -0.002f, 0.002f);
      tiny_entry(&w, "parents", "I32", "3", S);
      for (i = 0; i < S; i++) tiny_number(&w, &l->parents[i]);
      snprintf(shape, sizeof shape, "%d,%d", S, V), tiny_tensor(&w, "joint_regressor", S, V, &seed, 0, 0.0078125f);
   }
   file = tiny_file(&w, &size);
   s = dn_shape_load(file, size, NULL, &e);
   if (!CHECK_MSG(s != NULL, "%s", s ? "" : e.info)) exit(1);
   free(file);
   return s;
}
TEST(dressed)
{
   static float out[4 * V * 3], beta[2] = {0.5f, -0.75f}, theta[S * 3], joints[S * 3], palette[S * 12];
   dn_shape *inner = shape_of(&body, 1), *outer = shape_of(&sleeve, 0);
   dn_dressed_garment g;
   dn_dressed_desc d;
   dn_dressed_pose pose;
   dn_dressed_mesh mesh[2];
   dn_dressed *all;
   dn_error e;
   size_t i, bytes;
   void *scratch;
   hash_start();
   dn_shape_evaluate(inner, beta, 2, 0.125f, out, joints, &backwards), hash_floats(joints, S * 3);
   dn_shape_pose_offsets(inner, body.rotation, out, &backwards), hash_floats(out, V * 3);
   report("shape");
   memset(&g, 0, sizeof g), memset(&d, 0, sizeof d), memset(&pose, 0, sizeof pose), memset(mesh, 0, sizeof mesh);
   g.shape = outer, g.looseness = 0.03125f, g.margin = 0.0078125f;
   d.body = inner, d.garment = &g, d.garments = 1, d.beta = beta, d.betas = 2;
   all = dn_dressed_create(&d, NULL, &e);
   if (CHECK_MSG(all != NULL, "%s", all ? "" : e.info)) {
      for (i = 0; i < S * 3; i++) theta[i] = (float)(i % 4) * 0.25f;
      pose.theta = theta, pose.translation[1] = 0.375f, pose.strength = 1;
      for (i = 0; i < 2; i++) mesh[i].positions = out + 2 * i * V * 3, mesh[i].normals = out + (2 * i + 1) * V * 3;
      bytes = dn_dressed_scratch_size(all, 3), scratch = test_aligned(bytes);
      hash_start();
      CHECK(dn_dressed_deform(all, &pose, &mesh[0], &mesh[1], palette, scratch, bytes, &backwards, &e) == DN_OK);
      hash_floats(out, 4 * V * 3), hash_floats(palette, S * 12), hash_u32((uint32_t)mesh[1].collision.moved);
      report("dressed");
      test_aligned_free(scratch), dn_dressed_free(all);
   }
   dn_shape_free(inner), dn_shape_free(outer);
}

int main(int argc, char **argv)
{
   TEST_BEGIN(argc, argv);
   limb_make(&body, 1.0f, 1), limb_make(&sleeve, 1.0f, 2);
   hash_start(), hash_floats(body.rest, V * 3), hash_floats(sleeve.rest, V * 3), hash_floats(sleeve.weight, V * S);
   printf("hash inputs %08lx%08lx\n", (unsigned long)(hash >> 32), (unsigned long)(hash & 0xffffffffu));
   RUN(functions);
   RUN(files);
   RUN(meshes);
   RUN(skinning);
   RUN(voxels);
   RUN(layers);
   RUN(pooling);
   RUN(networks);
   RUN(precisions);
   RUN(garments);
   RUN(blend_shapes);
   RUN(kit);
   RUN(collisions);
   RUN(dressed);
   return TEST_END();
}
