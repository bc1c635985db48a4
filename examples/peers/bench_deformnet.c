/*  bench_deformnet.c - times deformnet's network on one case, one run for each line on standard input
    usage     bench_deformnet MODEL CASE THREADS [PRECISION] [--write FILE]
    int8      takes its ranges from the case's pose, a part of it and more of it, never from the pose itself
    --write   runs once and leaves what the other libraries need: the rows, the graph, the pairs that "rest" pooling
              chose, and the displacement to compare with
    otherwise prints "ready KERNEL", or "cannot REASON"; then for a line "prepare" skins and describes and answers
              "prepared", for a line "run" runs the network on those rows and answers with two numbers of milliseconds: the
              network, and the rows before it (dn_stage_rows). Of a clothnet model the network's time has its rows in it:
              those of its second stage need the first one's garment */
#define _POSIX_C_SOURCE 200809L
#define DEFORMNET_IMPLEMENTATION
#include "../../deformnet.h"
#include "../common/pool.h"
#include "../common/ranges.h"
#include "../common/tensors.h"
#include "../common/tool.h"
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct bench {
   const char *model_path, *case_path;
   unsigned char *model_file; /* its bytes, with ranges when they were needed */
   size_t model_size;
   dn_precision precision;
   float *palette, *part; /* (S,12) the case's; another made from it */
   double rows_ms;
   ex_tensors *file;
   dn_model *model;
   dn_rig *rig;          /* or a garment */
   dn_garment *garment;
   dn_garment_pose garment_pose;
   ex_pool *pool;
   dn_parallel parallel;
   dn_pose pose;
   void *block, *scratch;
   size_t bytes;
   uint32_t *pairs[2]; /* (pair_count,2), from the probe */
   size_t pair_count[2], pools;
   float *rows[2];     /* clothnet's two feature rows, from the probe */
} bench;

static void fail(const char *path, const char *why) { ex_die("%s: %s", path, why); }

static const void *get(const bench *b, const char *name, ex_dtype type, size_t rows, size_t columns, size_t *found)
{
   char error[EX_ERROR];
   size_t sides[2];
   const ex_tensor *t;
   sides[0] = rows, sides[1] = columns;
   t = ex_tensors_get(b->file, name, 2, sides, error);
   if (!t) fail(b->case_path, error);
   if (t->type != type) fail(b->case_path, "a tensor has an unexpected type");
   if (found) *found = t->shape[0];
   return t->data;
}

static void take_scratch(bench *b, size_t bytes)
{
   b->bytes = bytes;
   b->block = malloc(b->bytes + 64);
   if (!b->block) fail(b->case_path, "out of memory");
   b->scratch = (unsigned char *)b->block + (64 - ((uintptr_t)b->block & 63));
}
static void bind_garment(bench *b, const dn_rig_desc *body) /* shape: 3 alpha, 10 beta, 72 theta */
{
   dn_error err;
   dn_garment_desc d;
   const float *shape = (const float *)get(b, "shape", EX_F32, 1, 85, NULL);
   memset(&d, 0, sizeof d);
   d.body = body->mesh;
   d.skeleton = body->skeleton;
   d.garment.positions = (const float *)get(b, "garment_positions", EX_F32, 0, 3, &d.garment.vertices);
   d.garment.indices = get(b, "garment_indices", EX_I32, 0, 3, &d.garment.triangles);
   d.garment.index_type = DN_U32;
   d.refine = b->model;
   d.alpha = shape, d.alphas = 3;
   d.beta = shape + 3, d.betas = 10;
   d.thetas = 72;
   d.parallel = &b->parallel;
   b->garment = dn_garment_create(&d, NULL, NULL, &err);
   if (!b->garment) fail(b->case_path, err.info);
   memset(&b->garment_pose, 0, sizeof b->garment_pose);
   get(b, "palette", EX_F32, d.skeleton.joints, 12, NULL);
   b->garment_pose.palette = b->palette;
   b->garment_pose.theta = shape + 13;
   b->garment_pose.strength = 1.0f;
   take_scratch(b, dn_garment_scratch_size(b->garment, b->parallel.workers));
}
static void bind(bench *b)
{
   dn_error err;
   dn_model_info info;
   dn_rig_desc d;
   dn_skin_set skin;
   dn_model_describe(b->model, &info);
   memset(&d, 0, sizeof d);
   memset(&skin, 0, sizeof skin);
   d.mesh.positions = (const float *)get(b, "positions", EX_F32, 0, 3, &d.mesh.vertices);
   d.mesh.indices = get(b, "indices", EX_I32, 0, 3, &d.mesh.triangles);
   d.mesh.index_type = DN_U32; /* a negative index is refused as too large */
   skin.influences = 2;
   skin.joints = get(b, "joints", EX_I32, d.mesh.vertices, 2, NULL);
   skin.joint_type = DN_U32;
   skin.weights = get(b, "weights", EX_F32, d.mesh.vertices, 2, NULL);
   skin.weight_type = DN_F32;
   d.mesh.skin_sets = 1;
   d.mesh.skin = &skin;
   d.skeleton.joints = info.joints;
   d.skeleton.names = info.joint_names;
   d.order = DN_ORDER_NEAR; /* the other libraries get the graph in this order too */
   if (info.arch == DN_CLOTHNET) {
      bind_garment(b, &d);
      return;
   }
   d.geodesic = (const float *)get(b, "geodesic", EX_F32, d.mesh.vertices, info.joints, &d.geodesic_nodes);
   d.parallel = &b->parallel;
   b->rig = dn_rig_create(b->model, &d, NULL, NULL, &err);
   if (!b->rig) fail(b->case_path, err.info);
   memset(&b->pose, 0, sizeof b->pose);
   get(b, "palette", EX_F32, info.joints, 12, NULL);
   b->pose.palette = b->palette;
   b->pose.strength = 1.0f;
   take_scratch(b, dn_scratch_size(b->rig, b->parallel.workers));
}

static void prepare(bench *b)
{
   dn_error err;
   if (b->garment) {
      if (dn_garment_stage_follow(b->garment, &b->garment_pose, b->scratch, b->bytes, &b->parallel, &err) != DN_OK) fail(b->case_path, err.info);
      return;
   }
   if (dn_stage_skin(b->rig, &b->pose, b->scratch, b->bytes, &b->parallel, &err) != DN_OK) fail(b->case_path, err.info);
   b->rows_ms = ex_now_ms();
   dn_stage_rows(b->rig, b->scratch, &b->parallel);
   b->rows_ms = ex_now_ms() - b->rows_ms;
}

static void run(bench *b, const dn_probe *probe)
{
   if (b->garment) {
      dn_garment_stage_coarse(b->garment, &b->garment_pose, b->scratch, &b->parallel, probe);
      dn_garment_stage_refine(b->garment, &b->garment_pose, b->scratch, &b->parallel, probe);
   } else dn_stage_network(b->rig, b->scratch, &b->parallel, probe);
}
static void tap(void *user, const char *name, const float *rows, size_t first, size_t count, size_t width, size_t row_stride)
{
   bench *b = (bench *)user;
   int detail = strcmp(name, "detail.features") == 0;
   (void)first, (void)row_stride;
   if (!detail && strcmp(name, "coarse.features") != 0) return;
   b->rows[detail] = (float *)malloc(count * width * sizeof *rows);
   if (!b->rows[detail]) fail(b->case_path, "out of memory");
   memcpy(b->rows[detail], rows, count * width * sizeof *rows);
}
static void keep_pairs(void *user, const char *name, const uint32_t *members, const float *score, size_t count)
{
   bench *b = (bench *)user;
   size_t k = b->pools++;
   (void)name, (void)score;
   if (k > 1) fail(b->case_path, "more than two pools");
   b->pairs[k] = (uint32_t *)malloc(2 * count * sizeof *members);
   if (!b->pairs[k]) fail(b->case_path, "out of memory");
   memcpy(b->pairs[k], members, 2 * count * sizeof *members);
   b->pair_count[k] = count;
}

static void unbind(bench *b)
{
   free(b->block);
   dn_garment_free(b->garment);
   dn_rig_free(b->rig);
   dn_model_free(b->model);
   b->block = NULL, b->garment = NULL, b->rig = NULL, b->model = NULL;
}
static int load(bench *b, dn_precision precision, dn_error *err)
{
   dn_model_options chosen;
   memset(&chosen, 0, sizeof chosen);
   chosen.precision = precision;
   b->model = dn_model_load(b->model_file, b->model_size, &chosen, NULL, err);
   return b->model != NULL;
}
/* ranges from float32 runs in poses between rest and the case's, and beyond */
static void calibrate(bench *b)
{
   static const float parts[] = { 0.5f, 0.8f, 1.2f };
   ex_ranges *r = ex_ranges_create();
   dn_probe probe;
   dn_error err;
   dn_model_info info;
   unsigned char *bytes = NULL;
   size_t k, i, joined;
   if (!r || !load(b, DN_PRECISION_F32, &err)) fail(b->model_path, r ? err.info : "out of memory");
   dn_model_describe(b->model, &info);
   b->part = (float *)ex_take(info.joints, 12 * sizeof(float));
   if (!b->part) fail(b->model_path, "out of memory");
   bind(b);
   probe = ex_ranges_probe(r);
   b->pose.palette = b->garment_pose.palette = b->part;
   for (k = 0; k < sizeof parts / sizeof *parts; k++) {
      for (i = 0; i < 12 * info.joints; i++) {
         float rest = i % 12 % 5 == 0 ? 1.0f : 0.0f;
         b->part[i] = rest + parts[k] * (b->palette[i] - rest);
      }
      prepare(b);
      run(b, &probe);
   }
   if (ex_ranges_choose(r, 1)) bytes = ex_ranges_join(r, b->model_file, b->model_size, &joined);
   if (!bytes) fail(b->model_path, "ranges cannot be added");
   free(b->model_file);
   b->model_file = bytes, b->model_size = joined;
   ex_ranges_free(r);
   unbind(b);
}
static void open_case(bench *b)
{
   char error[EX_ERROR];
   const ex_tensor *palette;
   FILE *f = fopen(b->model_path, "rb");
   long size = f && fseek(f, 0, SEEK_END) == 0 ? ftell(f) : -1;
   if (size < 0 || fseek(f, 0, SEEK_SET) != 0 || !(b->model_file = (unsigned char *)malloc((size_t)size + 1))) fail(b->model_path, "cannot be read");
   b->model_size = fread(b->model_file, 1, (size_t)size, f);
   fclose(f);
   b->file = ex_tensors_open(b->case_path, error);
   if (!b->file) fail(b->case_path, error);
   palette = ex_tensors_find(b->file, "palette");
   if (!palette || !(b->palette = (float *)ex_take(palette->count, sizeof(float)))) fail(b->case_path, "has no palette");
   ex_tensor_f32(palette, b->palette);
}

static size_t declare(ex_writer *w, const char *name, ex_dtype type, size_t rows, size_t columns)
{
   size_t sides[2];
   sides[0] = rows, sides[1] = columns;
   return ex_writer_tensor(w, name, type, columns ? 2 : 1, sides);
}
static void write_garment(bench *b, const char *path)
{
   char error[EX_ERROR];
   dn_model_info info;
   dn_garment_view view;
   dn_garment_nodes nodes;
   dn_probe probe;
   ex_writer *w = ex_writer_open(path, error);
   size_t n, i, edges, id[8];
   float *both;
   if (!w) fail(path, error);
   dn_model_describe(b->model, &info);
   dn_garment_describe(b->garment, &view);
   n = view.nodes, edges = view.graph.first[n];
   both = (float *)malloc(n * 6 * sizeof *both);
   if (!both) fail(path, "out of memory");
   memset(&probe, 0, sizeof probe);
   probe.tap = tap, probe.pool = keep_pairs, probe.user = b;
   prepare(b);
   run(b, &probe);
   nodes = dn_garment_nodes_of(b->garment, b->scratch);
   for (i = 0; i < n; i++) {
      memcpy(both + 6 * i, nodes.coarse_displacement + 3 * i, 12);
      memcpy(both + 6 * i + 3, nodes.displacement + 3 * i, 12);
   }
   id[0] = declare(w, "coarse_rows", EX_F32, n, info.row_width);
   id[1] = declare(w, "detail_rows", EX_F32, n, info.detail_width);
   id[2] = declare(w, "shape", EX_F32, 1, 85);
   id[3] = declare(w, "first", EX_I32, n + 1, 0);
   id[4] = declare(w, "next", EX_I32, edges, 0);
   id[5] = declare(w, "displacement", EX_F32, n, 6);
   id[6] = declare(w, "pairs", EX_I32, b->pair_count[0], 2);
   id[7] = declare(w, "pairs_len", EX_I32, b->pair_count[1], 2);
   ex_writer_put(w, id[0], 0, b->rows[0], n * info.row_width);
   ex_writer_put(w, id[1], 0, b->rows[1], n * info.detail_width);
   ex_writer_put(w, id[2], 0, get(b, "shape", EX_F32, 1, 85, NULL), 85);
   ex_writer_put(w, id[3], 0, view.graph.first, n + 1);
   ex_writer_put(w, id[4], 0, view.graph.next, edges);
   ex_writer_put(w, id[5], 0, both, 6 * n);
   for (i = 0; i < 2; i++) ex_writer_put(w, id[6 + i], 0, b->pairs[i], 2 * b->pair_count[i]);
   if (!ex_writer_close(w, error)) fail(path, error);
   free(both);
}
static void write_case(bench *b, const char *path)
{
   char error[EX_ERROR];
   dn_model_info info;
   dn_rig_view view;
   dn_probe probe;
   ex_writer *w = ex_writer_open(path, error);
   size_t n, edges, id[5];
   float *rows;
   if (!w) fail(path, error);
   dn_model_describe(b->model, &info);
   dn_rig_describe(b->rig, &view);
   n = view.nodes, edges = view.graph.first[n];
   rows = (float *)malloc(n * info.row_width * sizeof *rows);
   if (!rows) fail(path, "out of memory");
   memset(&probe, 0, sizeof probe);
   probe.tap = tap, probe.pool = keep_pairs, probe.user = b;
   prepare(b);
   dn_rows(b->rig, b->scratch, rows);
   run(b, &probe);
   id[0] = declare(w, "rows", EX_F32, n, info.row_width);
   id[1] = declare(w, "first", EX_I32, n + 1, 0);
   id[2] = declare(w, "next", EX_I32, edges, 0);
   id[3] = declare(w, "displacement", EX_F32, n, 3);
   id[4] = b->pools ? declare(w, "pairs", EX_I32, b->pair_count[0], 2) : 0;
   ex_writer_put(w, id[0], 0, rows, n * info.row_width);
   ex_writer_put(w, id[1], 0, view.graph.first, n + 1);
   ex_writer_put(w, id[2], 0, view.graph.next, edges);
   ex_writer_put(w, id[3], 0, dn_scratch_displacement(b->rig, b->scratch), 3 * n);
   if (b->pools) ex_writer_put(w, id[4], 0, b->pairs[0], 2 * b->pair_count[0]);
   if (!ex_writer_close(w, error)) fail(path, error);
   free(rows);
}

static void serve(bench *b)
{
   char line[32];
   printf("ready %s-%s\n", dn_precision_name(b->precision), dn_kernel_name(DN_KERNEL_AUTO));
   fflush(stdout);
   while (fgets(line, sizeof line, stdin)) {
      if (strcmp(line, "prepare\n") == 0) {
         prepare(b);
         puts("prepared");
      } else if (strcmp(line, "run\n") == 0) {
         double start = ex_now_ms();
         run(b, NULL);
         start = ex_now_ms() - start;
         printf("%.4f %.4f\n", start, b->rows_ms);
      } else fail("standard input", "expected a line prepare or run");
      fflush(stdout);
   }
}

int main(int argc, char **argv)
{
   static bench b;
   dn_error err;
   long threads = 0;
   int named = argc == 5 || argc == 7, write = argc >= 6 && strcmp(argv[argc - 2], "--write") == 0;
   int precision = named ? ex_precision_named(argv[4]) : (int)DN_PRECISION_F32;
   ex_program("bench_deformnet");
   if (argc != 4 + named + 2 * write || !ex_read_whole(argv[3], 1, 256, &threads)) {
      fprintf(stderr, "usage: bench_deformnet MODEL CASE THREADS [PRECISION] [--write FILE]\n");
      return 2;
   }
   b.model_path = argv[1], b.case_path = argv[2];
   b.pool = threads > 1 ? ex_pool_create((unsigned)threads) : NULL;
   if (threads > 1 && !b.pool) fail(argv[3], "cannot start that many threads");
   b.parallel = ex_pool_parallel(b.pool);
   open_case(&b);
   if (precision < 0) {
      puts("cannot no such precision in this version");
      return 0;
   }
   b.precision = (dn_precision)precision;
   if (!load(&b, b.precision, &err) && err.code == DN_MISSING_TENSOR && b.precision != DN_PRECISION_F32) {
      calibrate(&b);
      load(&b, b.precision, &err);
   }
   if (!b.model) {
      if (b.precision == DN_PRECISION_F32) fail(b.model_path, err.info);
      printf("cannot %s\n", err.info);
      return 0;
   }
   bind(&b);
   if (write && b.garment) write_garment(&b, argv[argc - 1]);
   else if (write) write_case(&b, argv[argc - 1]);
   else serve(&b);
   free(b.pairs[0]);
   free(b.pairs[1]);
   free(b.rows[0]);
   free(b.rows[1]);
   unbind(&b);
   free(b.model_file);
   free(b.palette);
   free(b.part);
   ex_tensors_close(b.file);
   ex_pool_free(b.pool);
   return 0;
}
