/*  libdeformnet.c - deformnet.h as a shared library for Python, and batches of training patches made with it

    shows     that training sees exactly the rows that run in a game: coarse mesh, normals and descriptors are computed
              by the header's own functions; only gathering, mirroring and the choice of patches happen here
    build     make libdeformnet.so
    used by   dn.py (ctypes); struct dnt_character is declared once more there

    A patch is n nodes around a seed, in the order a breadth-first walk meets them. It sees neighbours inside the patch
    only, so nodes within `halo` rings of its border get weight 0 in the loss. A pose of a patch is a palette and the
    truth's vertices in that pose. */
#define DEFORMNET_IMPLEMENTATION
#include "../../deformnet.h"
#include <omp.h>
#include <stdlib.h>

#define API __attribute__((visibility("default")))

typedef struct dnt_character {
   size_t nodes, influences, joints, model_joints, width; /* width: of the neighbour table, highest degree + 1 */
   const float *rest;                        /* (N,3) */
   const uint32_t *joint;                    /* (N,I) the character's joints */
   const float *weight;                      /* (N,I) */
   const uint32_t *first_vertex;             /* (N) */
   const uint32_t *triangle;                 /* (T,3) nodes */
   const uint32_t *corner_first, *corner_tri; /* which triangles meet at a node */
   const uint32_t *first, *next;             /* one-rings */
   const float *geodesic;                    /* (N,S) */
   const float *joint_rest;                  /* (S,3) */
   const uint32_t *joint_map;                /* (S) */
   const uint32_t *mirror;                   /* (S) the joint on the other side, or itself */
   const int32_t *partner;                   /* (N) the node it contracts with, or itself; negative: -1 - partner, and
                                                the pair is directed from the partner to this node */
} dnt_character;

typedef struct dnt_patch {
   const dnt_character *character;
   const float *palette; /* (joints,12) */
   const float *truth;   /* (V,3) or NULL */
   int64_t seed;         /* node to grow from; -1: the whole mesh in node order */
   uint64_t random;      /* where to grow on when a part of the mesh is used up */
   int32_t mirror;       /* 1: the mirror image */
   int32_t unused;
} dnt_patch;

/* ctypes cannot ask for sizes of structs: dn.py compares */
API size_t dnt_struct_size(int which) { return which == 0 ? sizeof(dnt_character) : sizeof(dnt_patch); }

API void dnt_corners(const uint32_t *triangle, size_t triangles, size_t nodes, uint32_t *corner_first, uint32_t *corner_tri)
{
   dn__corners_build(triangle, triangles, nodes, corner_first, corner_tri);
}

/* dn_geodesic with scratch of its own and OpenMP as its job system */
static void run_ranges(void *user, size_t count, size_t grain, dn_range_fn *fn, void *job)
{
   size_t pieces = (count + grain - 1) / grain;
   (void)user;
#pragma omp parallel for schedule(dynamic, 1)
   for (size_t k = 0; k < pieces; k++)
      fn(job, k * grain, dn__min(count, (k + 1) * grain), (unsigned)omp_get_thread_num());
}
static dn_parallel all_threads(void)
{
   dn_parallel p = { run_ranges, NULL, (unsigned)omp_get_max_threads() };
   return p;
}
API int dnt_geodesic(const float *positions, size_t nodes, const uint32_t *triangle, size_t triangles, const float *joints,
                     size_t joint_count, unsigned resolution, float *distance)
{
   dn_parallel parallel = all_threads();
   size_t bytes = dn_geodesic_scratch(positions, nodes, triangles, resolution, parallel.workers);
   char *scratch = (char *)malloc(bytes + 64);
   dn_result r = DN_NO_MEMORY;
   if (scratch)
      r = dn_geodesic(positions, nodes, triangle, triangles, joints, joint_count, resolution, distance, NULL, NULL,
                      scratch + (64 - (uintptr_t)scratch % 64), bytes, &parallel, NULL);
   free(scratch);
   return (int)r;
}

/* root frame of a pose: (R^T palette), R; or a copy and the identity */
static void pose_frame(const dnt_character *c, const float *palette, int root, float *out, float rotation[9])
{
   static const float identity[9] = { 1, 0, 0, 0, 1, 0, 0, 0, 1 };
   memcpy(rotation, identity, sizeof identity);
   memcpy(out, palette, 12 * c->joints * sizeof *out);
   if (!root) return;
   dn__root_rotation(palette + 12 * (c->model_joints ? c->joint_map[0] : 0), rotation);
   dn__root_palette(palette, c->joints, rotation, out);
}

/* skinned nodes (N,3) and truth - skinned (N,3), model space: statistics and baselines */
API void dnt_displacement(const dnt_character *c, const float *palette, const float *truth, float *coarse, float *delta)
{
   dn_lbs(c->rest, c->joint, c->weight, c->influences, c->nodes, palette, coarse);
   for (size_t i = 0; i < c->nodes; i++)
      for (size_t k = 0; k < 3; k++) delta[3 * i + k] = truth[3 * (size_t)c->first_vertex[i] + k] - coarse[3 * i + k];
}

/*  the greedy contraction of the whole mesh; ds (N,2): the two halves of every score, W^T att_dst . v and W^T att_src . v
    (to the header a pool layer on rows of two numbers); partner (N) as in dnt_character. 0 when out of memory */
API int dnt_contract(const dnt_character *c, const float *ds, int32_t *partner)
{
   static const float dst[2] = { 1, 0 }, src[2] = { 0, 1 };
   const size_t N = c->nodes, E = c->first[N];
   dn_graph g = { N, c->first, c->next };
   dn_pool pool = { 2, dst, src, 0 };
   dn_clusters k;
   size_t bytes = dn_pool_scratch(N, E);
   char *scratch = (char *)malloc(bytes + 64);
   float *scores = (float *)malloc((E + N) * sizeof *scores);
   uint32_t *ints = (uint32_t *)malloc((2 * N + N + N + 1 + E) * sizeof *ints);
   int ok = scratch && scores && ints;
   if (ok) {
      void *aligned = scratch + (64 - (uintptr_t)scratch % 64);
      memset(&k, 0, sizeof k);
      k.members = ints, k.cluster = ints + 2 * N, k.coarse_first = ints + 3 * N, k.coarse_next = ints + 4 * N + 1;
      k.score = scores + E;
      dn_pool_scores(&pool, &g, ds, 2, scores, aligned, NULL);
      dn_pool_contract(&g, scores, &k, aligned);
      for (size_t m = 0; m < k.count; m++) {
         uint32_t i = k.members[2 * m], j = k.members[2 * m + 1];
         partner[i] = (int32_t)j;
         partner[j] = i == j ? (int32_t)i : -1 - (int32_t)i;
      }
   }
   free(scratch), free(scores), free(ints);
   return ok;
}

/* n nodes into list: breadth first from the seed, then from a random node not yet taken. local (N): index in the list
   or -1, left filled for the caller to clear */
static void grow(const dnt_character *c, const dnt_patch *p, size_t n, uint32_t *list, int32_t *local)
{
   size_t head = 0, tail = 0;
   uint64_t random = p->random | 1;
   if (p->seed < 0) {
      for (; tail < n; tail++) list[tail] = (uint32_t)tail, local[tail] = (int32_t)tail;
      return;
   }
   list[tail] = (uint32_t)p->seed;
   local[p->seed] = (int32_t)tail++;
   while (tail < n) {
      if (head == tail) { /* this part is used up */
         size_t i;
         random ^= random << 13, random ^= random >> 7, random ^= random << 17;
         for (i = random % c->nodes; local[i] >= 0; i = i + 1 < c->nodes ? i + 1 : 0) {}
         list[tail] = (uint32_t)i;
         local[i] = (int32_t)tail++;
      }
      for (uint32_t i = list[head++], e = c->first[i]; e < c->first[i + 1] && tail < n; e++)
         if (local[c->next[e]] < 0) {
            list[tail] = c->next[e];
            local[c->next[e]] = (int32_t)tail++;
         }
   }
}

/*  dnt_batch - rows, neighbour tables, pooling and targets of `patches` patches of n nodes each

    features   list of dn_feature, ending with -1; D is their width
    scale      mean (D) then 1/std (D), or NULL for rows as they are
    width      of table; coarse_width of coarse_table: rows are cut there (dn.py passes enough)
    rows (P*n,D)   target (P*n,3) metres, in the frame's axes   use (P*n) 1 or 0   node (P*n) index in its character
    table (P*n,width)  degree (P*n)
    members (P*n,2)  slot (P*n)  cluster (P*n)  coarse_table (P*n,coarse_width)  coarse_degree (P*n)  coarse_offset (P+1):
               the first coarse_offset[P] rows are written. members NULL: no pooling
    returns    coarse nodes, or 0 when out of memory */
API size_t dnt_batch(const dnt_patch *patch, size_t patches, size_t n, const int32_t *features, int root, int halo,
                     const float *scale, size_t D, size_t width, size_t coarse_width, float *rows, float *target, float *use,
                     uint32_t *node, int32_t *table, int32_t *degree, int64_t *members, int32_t *slot, int64_t *cluster,
                     int32_t *coarse_table, int32_t *coarse_degree, int64_t *coarse_offset)
{
   int failed = 0;
#pragma omp parallel for schedule(dynamic, 1)
   for (size_t p = 0; p < patches; p++) {
      const dnt_character *c = patch[p].character;
      const size_t N = c->nodes, S = c->model_joints, at = p * n;
      int32_t *local = (int32_t *)malloc(N * sizeof *local), *depth = (int32_t *)malloc(n * sizeof *depth);
      float *coarse = (float *)malloc(6 * N * sizeof *coarse), *normal = coarse + 3 * N; /* only what is needed is filled */
      size_t pitch = dn__posed_pitch(S);
      float *palette = (float *)malloc((12 * c->joints + 3 * pitch + D) * sizeof *palette), *posed = palette + 12 * c->joints;
      float *row = posed + 3 * pitch, rotation[9];
      uint32_t *list = node + at;
      if (!local || !depth || !coarse || !palette) {
         failed = 1;
         free(local), free(depth), free(coarse), free(palette);
         continue;
      }
      memset(local, 0xff, N * sizeof *local);
      grow(c, &patch[p], n, list, local);
      pose_frame(c, patch[p].palette, root, palette, rotation);
      dn__posed_joints(palette, c->joint_map, c->joint_rest, S, posed);

      for (size_t q = 0; q < n; q++) { /* the coarse mesh of the patch and of the ring around it */
         size_t i = list[q];
         dn__lbs_range(c->rest, c->joint, c->weight, c->influences, palette, i, i + 1, coarse);
         for (uint32_t e = c->first[i]; e < c->first[i + 1]; e++)
            if (local[c->next[e]] < 0)
               dn__lbs_range(c->rest, c->joint, c->weight, c->influences, palette, c->next[e], c->next[e] + 1, coarse);
      }
      for (size_t q = 0; q < n; q++) {
         size_t i = list[q], to = 0, m = 1;
         float *out = rows + (at + q) * D, side = patch[p].mirror ? -1.0f : 1.0f;
         double place[3];
         for (int k = 0; k < 3; k++) place[k] = (double)coarse[3 * i + k];
         dn__normals_range(coarse, c->triangle, c->corner_first, c->corner_tri, i, i + 1, normal);
         for (const int32_t *f = features; *f >= 0; f++) {
            size_t w = *f == DN_GEODESIC || *f == DN_DISTANCE ? S : 3;
            if (*f == DN_POSITION) dn__rows_position(place, 0, 1, row + to, D);
            else if (*f == DN_RELATIVE)
               dn__rows_relative(c->rest + 3 * i, c->joint + c->influences * i, c->weight + c->influences * i, c->influences,
                                 NULL, palette, 0, 1, row + to, D);
            else if (*f == DN_NORMAL) dn__rows_normal(normal + 3 * i, 0, 1, row + to, D);
            else if (*f == DN_GEODESIC) dn__rows_geodesic(c->geodesic + S * i, S, 0, 1, row + to, D);
            else dn__rows_distance(place, posed, S, 0, 1, row + to, D);
            if (w == 3) out[to] = side * row[to], out[to + 1] = row[to + 1], out[to + 2] = row[to + 2];
            else if (!patch[p].mirror) memcpy(out + to, row + to, w * sizeof *out);
            else for (size_t s = 0; s < S; s++) out[to + s] = row[to + c->mirror[s]];
            to += w;
         }
         if (scale) for (size_t k = 0; k < D; k++) out[k] = (out[k] - scale[k]) * scale[D + k];
         if (patch[p].truth) {
            const float *t = patch[p].truth + 3 * (size_t)c->first_vertex[i];
            for (size_t k = 0; k < 3; k++) /* R^T truth - skinned in the frame */
               target[3 * (at + q) + k] = (k ? 1 : side) * (rotation[k] * t[0] + rotation[3 + k] * t[1] + rotation[6 + k] * t[2] - coarse[3 * i + k]);
         }
         table[(at + q) * width] = (int32_t)(at + q);
         depth[q] = halo;
         for (uint32_t e = c->first[i]; e < c->first[i + 1]; e++) {
            int32_t j = local[c->next[e]];
            if (j < 0) depth[q] = 0; /* the border */
            else if (m < width) table[(at + q) * width + m++] = (int32_t)at + j;
         }
         degree[at + q] = (int32_t)m;
         for (; m < width; m++) table[(at + q) * width + m] = (int32_t)(at + q);
      }
      for (int r = 1; r < halo; r++) /* how many rings from the border, up to halo */
         for (size_t q = 0; q < n; q++)
            if (depth[q] > r)
               for (int32_t m = 1; m < degree[at + q]; m++)
                  if (depth[(size_t)table[(at + q) * width + (size_t)m] - at] == r - 1) depth[q] = r;
      for (size_t q = 0; q < n; q++) use[at + q] = depth[q] >= halo ? 1.0f : 0.0f;

      if (members) { /* pairs that lie inside the patch; coarse nodes by their smaller member */
         size_t count = 0;
         for (size_t q = 0; q < n; q++) {
            int32_t w = c->partner[list[q]], other = w < 0 ? -1 - w : w, j = local[other];
            if (j < 0) j = (int32_t)q; /* the partner is outside: alone */
            if ((size_t)j < q) continue;
            members[2 * (at + count)] = (int64_t)at + (w < 0 ? j : (int32_t)q);
            members[2 * (at + count) + 1] = (int64_t)at + (w < 0 ? (int32_t)q : j);
            cluster[at + q] = cluster[at + (size_t)j] = (int64_t)count++;
         }
         coarse_offset[p + 1] = (int64_t)count;
      }
      free(local), free(depth), free(coarse), free(palette);
   }
   if (failed) return 0;
   if (!members) return 1;
   coarse_offset[0] = 0;
   for (size_t p = 0; p < patches; p++) { /* close the gaps between patches; the target never passes the source */
      size_t count = (size_t)coarse_offset[p + 1], to = (size_t)coarse_offset[p];
      memmove(members + 2 * to, members + 2 * p * n, 2 * count * sizeof *members);
      coarse_offset[p + 1] = (int64_t)(to + count);
   }
#pragma omp parallel for schedule(dynamic, 1)
   for (size_t p = 0; p < patches; p++) {
      for (size_t q = p * n; q < (p + 1) * n; q++) cluster[q] += coarse_offset[p];
      for (int64_t k = coarse_offset[p]; k < coarse_offset[p + 1]; k++) {
         int64_t i = members[2 * k], j = members[2 * k + 1];
         int32_t *ring = coarse_table + (size_t)k * coarse_width;
         size_t m = 1;
         ring[0] = (int32_t)k;
         slot[k] = 0;
         for (int32_t e = 1; i != j && e < degree[i]; e++)
            if (table[(size_t)i * width + (size_t)e] == j) slot[k] = e;
         for (int half = 0; half < (i == j ? 1 : 2); half++)
            for (int64_t a = half ? j : i, e = 1; e < degree[a]; e++) {
               int32_t other = (int32_t)cluster[table[(size_t)a * width + (size_t)e]];
               size_t s = 0;
               while (s < m && ring[s] != other) s++;
               if (s == m && m < coarse_width) ring[m++] = other;
            }
         coarse_degree[k] = (int32_t)m;
         for (; m < coarse_width; m++) ring[m] = (int32_t)k;
      }
   }
   return (size_t)coarse_offset[patches];
}

/* ------------------------------------------------------------------ the product: a model file on a character */
typedef struct dnt_deformer {
   dn_model *model; /* NULL: skins only */
   dn_rig *rig;
   char *scratch;
   size_t scratch_bytes, vertices;
} dnt_deformer;

API void dnt_deformer_free(dnt_deformer *d)
{
   if (!d) return;
   dn_rig_free(d->rig);
   dn_model_free(d->model);
   free(d->scratch);
   free(d);
}
/*  path NULL: skinning only, by dqs or LBS. names (joints), parents (joints), inverse_bind (joints,12) row-major;
    geodesic (N,S) known distances or NULL. NULL on failure, with the reason in info (240 bytes) */
API dnt_deformer *dnt_deformer_new(const char *path, const float *positions, size_t vertices, const uint32_t *triangle,
                                   size_t triangles, const uint32_t *joint, const float *weight, size_t influences,
                                   size_t joints, const char *const *names, const int32_t *parents, const float *inverse_bind,
                                   const float *geodesic, size_t geodesic_nodes, int dqs, char *info)
{
   dnt_deformer *d = (dnt_deformer *)calloc(1, sizeof *d);
   dn_parallel parallel = all_threads();
   dn_rig_desc desc;
   dn_skin_set skin;
   dn_error err;
   memset(&err, 0, sizeof err);
   memset(&desc, 0, sizeof desc);
   memset(&skin, 0, sizeof skin);
   if (!d) return NULL;
   skin.influences = influences;
   skin.joints = joint, skin.joint_type = DN_U32;
   skin.weights = weight, skin.weight_type = DN_F32;
   desc.mesh.vertices = vertices, desc.mesh.positions = positions;
   desc.mesh.triangles = triangles, desc.mesh.indices = triangle, desc.mesh.index_type = DN_U32;
   desc.mesh.skin_sets = 1, desc.mesh.skin = &skin;
   desc.skeleton.joints = joints, desc.skeleton.names = names, desc.skeleton.parents = parents;
   desc.skeleton.inverse_bind = inverse_bind, desc.skeleton.matrix = DN_3X4_ROWS;
   desc.skinning = dqs ? DN_DQS : DN_LBS;
   desc.geodesic = geodesic, desc.geodesic_nodes = geodesic_nodes;
   desc.parallel = &parallel;
   d->vertices = vertices;
   if (path) d->model = dn_model_load_file(path, NULL, NULL, &err);
   if (!path || d->model) d->rig = dn_rig_create(d->model, &desc, NULL, NULL, &err);
   if (d->rig) {
      d->scratch_bytes = dn_scratch_size(d->rig, parallel.workers);
      d->scratch = (char *)malloc(d->scratch_bytes + 64);
   }
   if (d->scratch) return d;
   memcpy(info, err.info, sizeof err.info);
   dnt_deformer_free(d);
   return NULL;
}
/* one pose: palette (joints,12) -> positions (V,3); returns a dn_result */
API int dnt_deform(const dnt_deformer *d, const float *palette, float *positions)
{
   dn_parallel parallel = all_threads();
   dn_pose pose;
   dn_output out;
   memset(&pose, 0, sizeof pose);
   memset(&out, 0, sizeof out);
   pose.palette = palette, pose.matrix = DN_3X4_ROWS, pose.strength = 1.0f;
   out.positions = positions;
   return (int)dn_deform(d->rig, &pose, &out, d->scratch + (64 - (uintptr_t)d->scratch % 64), d->scratch_bytes, &parallel, NULL);
}
/* the rows the header's rig makes for a pose (N,D), to be compared with dnt_batch */
API int dnt_rig_rows(const dnt_deformer *d, const float *palette, float *rows)
{
   char *scratch = d->scratch + (64 - (uintptr_t)d->scratch % 64);
   dn_parallel parallel = all_threads();
   dn_pose pose;
   dn_result r;
   memset(&pose, 0, sizeof pose);
   pose.palette = palette, pose.matrix = DN_3X4_ROWS, pose.strength = 1.0f;
   r = dn_stage_skin(d->rig, &pose, scratch, d->scratch_bytes, &parallel, NULL);
   if (r != DN_OK) return (int)r;
   dn_stage_rows(d->rig, scratch, &parallel);
   dn_rows(d->rig, scratch, rows);
   return 0;
}
