/*  bench.c - how fast deformnet is here: end to end, part by part, against this processor's peak and against its bars
    shows     the stages called apart, the probe as a stopwatch, the cost of every part and how it grows with the mesh
    not here  other libraries on the same weights: make peers
    run       make bench                      made networks of the papers' sizes on made meshes: needs no data
              build/bench --model M.safetensors --character C.glb --threads 2 --json report.json
    times     batch 1, everything from palette to normals. A run counts only when nothing else kept the processors busy
              (common/quiet.h); how many counted of how many made stands beside each figure
    peak      float32 multiply-adds of the same kernel on as many threads, in loops between the runs */
#define _POSIX_C_SOURCE 200809L
#define DEFORMNET_IMPLEMENTATION
#include "../deformnet.h"
#include "common/made.h"
#include "common/pool.h"
#include "common/quiet.h"
#include "common/scene.h"
#include "common/tool.h"
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* ===================================================================================== >>small things */
static const char usage[] =
   "usage: bench [--model M.safetensors] [--character C.glb|C.safetensors | --nodes N] [--threads n] [--precision f32]\n"
   "             [--kernel ref|sse|avx2|avx512|neon|wasm|auto] [--arch A] [--pooling rest|dynamic] [--shuffle]\n"
   "             [--lite L.safetensors] [--largest N] [--seconds s] [--noise share] [--json R.json]\n"
   "  without --model   made ones of the papers' sizes: densegats, multiresgnet and clothnet, or the one of --arch\n"
   "  --nodes N         a made mesh of about N nodes in place of 10,220 (clothnet: 3,500)\n"
   "  --shuffle         its vertices in random order\n"
   "  --lite L          a small model, measured against multiresgnet on the same mesh\n"
   "  --largest N       where the table of sizes ends; 0 leaves it out (1,000,000)\n"
   "  --seconds s       to look for quiet runs, for each line of figures (4)\n"
   "  --noise share     of a run's processor time that others may have (0.05)\n";

typedef struct options {
   const char *model, *character, *lite, *arch, *pooling, *json, *kernel_name;
   size_t nodes, largest;
   int shuffle, kernel; /* a dn_kernel */
   unsigned threads;
   double seconds, noise;
} options;

static void *take(size_t count, size_t size)
{
   void *p = ex_take(count, size);
   if (!p) ex_die("out of memory");
   return p;
}
static double megabytes(size_t bytes) { return (double)bytes / 1e6; }

static const char *const kernel_names[] = { "auto", "ref", "sse", "avx2", "avx512", "neon", "wasm" };
static int kernel_best(void)
{
   int k = DN_KERNEL_COUNT;
   while (--k > DN_KERNEL_REF && !dn_kernel_available((dn_kernel)k)) {}
   return k;
}
static double number(const char *key, const char *text, double low, double high)
{
   char *end;
   double x = strtod(text, &end);
   if (end == text || *end || !(x >= low && x <= high)) ex_die("%s %s: expected a number from %g to %g", key, text, low, high);
   return x;
}
static options read_options(int argc, char **argv)
{
   options o;
   int i, k;
   memset(&o, 0, sizeof o);
   o.pooling = "rest", o.seconds = 4, o.noise = 0.05, o.largest = 1000000, o.kernel = kernel_best();
   for (i = 1; i < argc; i++) {
      const char *key = argv[i], *value = i + 1 < argc ? argv[i + 1] : NULL;
      const char **text = strcmp(key, "--model") == 0     ? &o.model
                        : strcmp(key, "--character") == 0 ? &o.character
                        : strcmp(key, "--lite") == 0      ? &o.lite
                        : strcmp(key, "--arch") == 0      ? &o.arch
                        : strcmp(key, "--pooling") == 0   ? &o.pooling
                        : strcmp(key, "--json") == 0      ? &o.json
                                                          : NULL;
      if (strcmp(key, "--help") == 0 || strcmp(key, "-h") == 0) fputs(usage, stdout), exit(0);
      if (strcmp(key, "--shuffle") == 0) {
         o.shuffle = 1;
         continue;
      }
      if (!value) ex_die("%s is unknown or needs a value (--help lists them)", key);
      i++;
      if (text) *text = value;
      else if (strcmp(key, "--nodes") == 0) o.nodes = (size_t)number(key, value, 12, 1e7);
      else if (strcmp(key, "--largest") == 0) o.largest = (size_t)number(key, value, 0, 1e7);
      else if (strcmp(key, "--threads") == 0) o.threads = (unsigned)number(key, value, 1, 200);
      else if (strcmp(key, "--seconds") == 0) o.seconds = number(key, value, 0.01, 3600);
      else if (strcmp(key, "--noise") == 0) o.noise = number(key, value, 0, 100);
      else if (strcmp(key, "--precision") == 0) {
         if (strcmp(value, "f32") != 0) ex_die("--precision %s: expected f32, the one precision there is", value);
      } else if (strcmp(key, "--kernel") == 0) {
         for (k = DN_KERNEL_COUNT; --k >= 0 && strcmp(value, kernel_names[k]) != 0;) {}
         if (k < 0) ex_die("--kernel %s: expected ref, sse, avx2, avx512, neon, wasm or auto", value);
         if (k != DN_KERNEL_AUTO && !dn_kernel_available((dn_kernel)k)) ex_die("--kernel %s does not run here", value);
         o.kernel = k == DN_KERNEL_AUTO ? kernel_best() : k;
      } else ex_die("unknown argument \"%s\" (--help lists them)", key);
   }
   if (o.character && (o.nodes || o.shuffle)) ex_die("--character brings its own mesh: --nodes and --shuffle are for made ones");
   if (strcmp(o.pooling, "rest") != 0 && strcmp(o.pooling, "dynamic") != 0) ex_die("--pooling %s: expected rest or dynamic", o.pooling);
   if (!o.threads) o.threads = ex_processors();
   o.kernel_name = kernel_names[o.kernel];
   return o;
}

/* everything that the measurements share */
typedef struct bench {
   options o;
   ex_pool *pool;
   dn_parallel par[2]; /* one thread; all of them */
   ex_quiet *quiet;
   double peak[2];     /* GFLOP/s, the best seen so far */
   unsigned char *evict;
   FILE *json;
   int json_items;
} bench;
enum { EVICT = 96 << 20 };

static void report(bench *b, const char *format, ...) /* one object of the JSON list */
{
   va_list list;
   if (!b->json) return;
   fputs(b->json_items++ ? ",\n  {" : "\n  {", b->json);
   va_start(list, format);
   vfprintf(b->json, format, list);
   va_end(list);
   fputc('}', b->json);
}

/* ===================================================================================== >>peak
   Independent multiply-adds in registers, by the instructions of each kernel. 14 sums hide their latency. */
enum { PEAK_STEPS = 200000 };
#define EACH14(X) X(0) X(1) X(2) X(3) X(4) X(5) X(6) X(7) X(8) X(9) X(10) X(11) X(12) X(13)
#if defined(__GNUC__) && defined(__x86_64__)
   #include <immintrin.h>
__attribute__((target("avx512f"))) static float peak_avx512(float a, float b)
{
   const __m512 x = _mm512_set1_ps(a), y = _mm512_set1_ps(b);
   float out[16];
   size_t i;
   #define START(k) __m512 s##k = _mm512_set1_ps((float)k);
   #define STEP(k) s##k = _mm512_fmadd_ps(s##k, x, y);
   #define SUM(k) s0 = _mm512_add_ps(s0, s##k);
   EACH14(START)
   for (i = 0; i < PEAK_STEPS; i++) {
      EACH14(STEP)
   }
   EACH14(SUM)
   #undef START
   #undef STEP
   #undef SUM
   _mm512_storeu_ps(out, s0);
   return out[0];
}
__attribute__((target("avx2,fma"))) static float peak_avx2(float a, float b)
{
   const __m256 x = _mm256_set1_ps(a), y = _mm256_set1_ps(b);
   float out[8];
   size_t i;
   #define START(k) __m256 s##k = _mm256_set1_ps((float)k);
   #define STEP(k) s##k = _mm256_fmadd_ps(s##k, x, y);
   #define SUM(k) s0 = _mm256_add_ps(s0, s##k);
   EACH14(START)
   for (i = 0; i < PEAK_STEPS; i++) {
      EACH14(STEP)
   }
   EACH14(SUM)
   #undef START
   #undef STEP
   #undef SUM
   _mm256_storeu_ps(out, s0);
   return out[0];
}
static float peak_sse(float a, float b)
{
   const __m128 x = _mm_set1_ps(a), y = _mm_set1_ps(b);
   float out[4];
   size_t i;
   #define START(k) __m128 s##k = _mm_set1_ps((float)k);
   #define STEP(k) s##k = _mm_add_ps(_mm_mul_ps(s##k, x), y);
   #define SUM(k) s0 = _mm_add_ps(s0, s##k);
   EACH14(START)
   for (i = 0; i < PEAK_STEPS; i++) {
      EACH14(STEP)
   }
   EACH14(SUM)
   #undef START
   #undef STEP
   #undef SUM
   _mm_storeu_ps(out, s0);
   return out[0];
}
#endif
#if defined(__aarch64__)
   #include <arm_neon.h>
static float peak_neon(float a, float b)
{
   const float32x4_t x = vdupq_n_f32(a), y = vdupq_n_f32(b);
   size_t i;
   #define START(k) float32x4_t s##k = vdupq_n_f32((float)k);
   #define STEP(k) s##k = vfmaq_f32(y, s##k, x);
   #define SUM(k) s0 = vaddq_f32(s0, s##k);
   EACH14(START)
   for (i = 0; i < PEAK_STEPS; i++) {
      EACH14(STEP)
   }
   EACH14(SUM)
   #undef START
   #undef STEP
   #undef SUM
   return vgetq_lane_f32(s0, 0);
}
#endif
static float peak_plain(float a, float b)
{
   size_t i;
   #define START(k) float s##k = (float)k;
   #define STEP(k) s##k = s##k * a + b;
   #define SUM(k) s0 += s##k;
   EACH14(START)
   for (i = 0; i < PEAK_STEPS; i++) {
      EACH14(STEP)
   }
   EACH14(SUM)
   #undef START
   #undef STEP
   #undef SUM
   return s0;
}
typedef struct peak_job { int kernel; volatile float a, b, sink[256]; } peak_job;
static void peak_range(void *user, size_t begin, size_t end, unsigned worker)
{
   peak_job *j = (peak_job *)user;
   (void)worker;
   for (; begin < end; begin++) {
      float r;
      switch (j->kernel) {
#if defined(__GNUC__) && defined(__x86_64__)
      case DN_KERNEL_AVX512: r = peak_avx512(j->a, j->b); break;
      case DN_KERNEL_AVX2: r = peak_avx2(j->a, j->b); break;
      case DN_KERNEL_SSE: r = peak_sse(j->a, j->b); break;
#elif defined(__aarch64__)
      case DN_KERNEL_NEON: r = peak_neon(j->a, j->b); break;
#endif
      default: r = peak_plain(j->a, j->b); break;
      }
      j->sink[begin % 256] = r;
   }
}
static double peak_lanes(int kernel)
{
#if defined(__GNUC__) && defined(__x86_64__)
   if (kernel == DN_KERNEL_AVX512) return 16;
   if (kernel == DN_KERNEL_AVX2) return 8;
   if (kernel == DN_KERNEL_SSE) return 4;
#elif defined(__aarch64__)
   if (kernel == DN_KERNEL_NEON) return 4;
#endif
   (void)kernel;
   return 1;
}
/* a few milliseconds each: keeps the best of all calls, for a peak can be missed but not exceeded */
static void measure_peak(bench *b)
{
   int all, round;
   peak_job j;
   j.kernel = b->o.kernel, j.a = 0.999f, j.b = 0.001f;
   for (all = 0; all < 2; all++)
      for (round = 0; round < 8; round++) {
         size_t items = all ? 4 * b->o.threads : 4;
         double start = ex_now_ms(), took;
         if (all && b->o.threads > 1) b->par[1].run(b->par[1].user, items, 1, peak_range, &j);
         else peak_range(&j, 0, items, 0);
         took = ex_now_ms() - start;
         b->peak[all] = fmax(b->peak[all], (double)items * PEAK_STEPS * 14 * 2 * peak_lanes(j.kernel) / took * 1e-6);
      }
}

/* ===================================================================================== >>subject
   What is measured: a model bound to a mesh, ready to run frames. */
typedef struct subject {
   char name[96];
   dn_model *model;
   dn_model_info info;
   dn_rig *rig;
   dn_rig_view view;
   dn_report report;
   float *positions, *normals;
   const float *palette;
   void *scratch;
   size_t scratch_bytes;
   ex_made *made;
   ex_scene *scene;
} subject;

static dn_model *load(const bench *b, const char *arch, const char *path) /* path NULL: a made one */
{
   dn_error e;
   dn_model *m;
   dn_model_options chosen;
   memset(&chosen, 0, sizeof chosen);
   chosen.kernel = (dn_kernel)b->o.kernel;
   if (path) m = dn_model_load_file(path, &chosen, NULL, &e);
   else {
      size_t size;
      unsigned char *file = ex_made_model(arch, b->o.pooling, strcmp(arch, "clothnet") == 0 ? 24 : 65, &size);
      if (!file) ex_die("--arch %s: expected mlp, gat, neuroskinning, densegats, multiresgnet or clothnet", arch);
      m = dn_model_load(file, size, &chosen, NULL, &e);
      free(file);
   }
   if (!m) ex_die("%s: %s", path ? path : arch, e.info);
   return m;
}
static void made_desc(const ex_made *made, dn_rig_desc *d, dn_skin_set *skin, const dn_model_info *info)
{
   memset(d, 0, sizeof *d);
   memset(skin, 0, sizeof *skin);
   d->mesh.vertices = made->vertices, d->mesh.positions = made->positions;
   d->mesh.triangles = made->triangles, d->mesh.indices = made->triangle, d->mesh.index_type = DN_U32;
   d->mesh.skin_sets = 1, d->mesh.skin = skin;
   skin->influences = 4, skin->joints = made->skin_joints, skin->joint_type = DN_U32;
   skin->weights = made->skin_weights, skin->weight_type = DN_F32;
   d->skeleton.joints = made->joints, d->skeleton.inverse_bind = made->inverse_bind;
   d->skeleton.names = info ? info->joint_names : NULL;
   d->geodesic = made->geodesic, d->geodesic_nodes = made->vertices;
   d->order = DN_ORDER_NEAR;
}
static void subject_ready(subject *s, const bench *b)
{
   dn_error e;
   dn_rig_describe(s->rig, &s->view);
   s->scratch = dn_scratch_create(s->rig, b->o.threads, NULL, &s->scratch_bytes, &e);
   if (!s->scratch) ex_die("%s: %s", s->name, e.info);
   s->positions = (float *)take(s->view.vertices, 3 * sizeof(float));
   s->normals = (float *)take(s->view.vertices, 3 * sizeof(float));
}
/* model NULL: skins only */
static subject subject_made(const bench *b, const char *name, dn_model *model, size_t nodes)
{
   subject s;
   dn_rig_desc d;
   dn_skin_set skin;
   dn_error e;
   memset(&s, 0, sizeof s);
   snprintf(s.name, sizeof s.name, "%s", name);
   s.model = model;
   if (model) dn_model_describe(model, &s.info);
   s.made = ex_made_mesh(nodes, model && s.info.joints ? s.info.joints : 65, 0.5214, b->o.shuffle);
   if (!s.made) ex_die("out of memory for a mesh of %lu nodes", (unsigned long)nodes);
   made_desc(s.made, &d, &skin, model ? &s.info : NULL);
   d.kernel = (dn_kernel)b->o.kernel;
   d.parallel = &b->par[1];
   s.rig = dn_rig_create(model, &d, NULL, &s.report, &e);
   if (!s.rig) ex_die("%s: %s", name, e.info);
   s.palette = s.made->palette;
   subject_ready(&s, b);
   return s;
}
static subject subject_character(const bench *b, const char *name, dn_model *model, ex_scene *scene)
{
   subject s;
   dn_rig_desc d;
   dn_skin_set skin;
   dn_error e;
   float *palette, *local;
   size_t k;
   memset(&s, 0, sizeof s);
   snprintf(s.name, sizeof s.name, "%s", name);
   s.model = model;
   dn_model_describe(model, &s.info);
   ex_describe(scene, &d, &skin);
   d.kernel = (dn_kernel)b->o.kernel;
   if (s.info.joint_names && strcmp(s.info.joint_names[0], "joint0") == 0 && scene->joints == s.info.joints)
      d.skeleton.names = s.info.joint_names; /* a made model: its joints are anybody's */
   d.parallel = &b->par[1];
   s.rig = dn_rig_create(model, &d, NULL, &s.report, &e);
   if (!s.rig) ex_die("%s: %s", scene->path, e.info);
   palette = (float *)take(scene->joints, 12 * sizeof(float));
   local = (float *)take(scene->joints, 10 * sizeof(float));
   memcpy(local, scene->rest, scene->joints * 10 * sizeof(float));
   for (k = 0; k < scene->joints; k++) local[10 * k + 3 + k % 3] += 0.1f, local[10 * k + 6] -= 0.005f; /* bent a little */
   ex_pose_local(scene, local, palette);
   free(local);
   s.palette = palette;
   s.scene = scene;
   subject_ready(&s, b);
   return s;
}
static void subject_free(subject *s)
{
   dn_scratch_free(s->scratch, s->scratch_bytes, NULL);
   dn_rig_free(s->rig);
   if (!s->made) free((void *)(uintptr_t)s->palette);
   ex_made_free(s->made);
   free(s->positions);
   free(s->normals);
   memset(s, 0, sizeof *s);
}

/* ===================================================================================== >>measure */
/* where the time of a frame goes. The kinds of layers are told apart by the probe, run by run; with a probe the layers at
   the end run on one thread, so their time is the network's without a probe less the others' */
enum { SKIN, FEATURES, NETWORK, OUTPUT, NORMALS, FRAME, COLD, PARTS };
enum { LINEAR, ATTENTION, POOLING, POINTWISE, KINDS };
static const char *const part_names[] = { "skin", "features", "network", "output", "normals", "frame", "cold frame" };
static const char *const kind_names[] = { "linear layers before", "graph attention", "pooling", "point-wise layers at the end" };

typedef struct timing {
   ex_times part[PARTS], kind[KINDS];
   double flops[KINDS], attention_flops; /* of a frame: matrix products by kind; scores and sums of the attention */
   size_t made, counted;
} timing;

static int kind_of(const char *name)
{
   const char *last = name, *s;
   for (s = name; (s = strchr(s, '.')) != NULL; s++)
      if (s[1] >= 'a' && s[1] <= 'z') last = s + 1; /* "detail.dir.gat.0" -> "gat.0" */
   if (strncmp(last, "pool", 4) == 0 || strncmp(last, "unpool", 6) == 0) return POOLING;
   if (strncmp(last, "post.", 5) == 0 || strcmp(last, "out") == 0) return POINTWISE;
   if (strncmp(last, "pre.", 4) == 0 || strncmp(last, "parser.", 7) == 0) return LINEAR;
   return ATTENTION;
}
typedef struct stopwatch {
   const dn_model *model;
   double last, ms[KINDS], flops[KINDS], attention_flops;
} stopwatch;
static void stopwatch_tap(void *user, const char *name, const float *rows, size_t first, size_t count, size_t width, size_t row_stride)
{
   stopwatch *w = (stopwatch *)user;
   double now = ex_now_ms();
   int kind = kind_of(name);
   size_t i;
   (void)rows, (void)first, (void)width, (void)row_stride;
   w->ms[kind] += now - w->last;
   for (i = 0; i < w->model->block_count; i++) {
      const dn__block *l = &w->model->blocks[i];
      if (strcmp(l->name, name) != 0) continue;
      w->flops[kind] += 2.0 * (double)l->in * (double)l->out * (double)count;
      /* two scores a head, then about seven neighbours' z, each scaled and added */
      if (l->gat.heads) w->attention_flops += 2.0 * (double)(l->gat.heads * l->gat.features) * 9.0 * (double)count;
      break;
   }
   w->last = ex_now_ms();
}
static void evict(bench *b) /* the caches, by writing something larger */
{
   size_t i;
   for (i = 0; i < EVICT; i += 64) b->evict[i]++;
}

static void frame_once(const subject *s, const dn_parallel *par, double ms[PARTS])
{
   dn_pose pose;
   dn_output out;
   dn_error e;
   double t[7];
   int k;
   memset(&pose, 0, sizeof pose);
   memset(&out, 0, sizeof out);
   pose.palette = s->palette;
   pose.strength = 1.0f;
   out.positions = s->positions;
   t[0] = ex_now_ms();
   if (dn_stage_skin(s->rig, &pose, s->scratch, s->scratch_bytes, par, &e) != DN_OK) ex_die("%s: %s", s->name, e.info);
   t[1] = ex_now_ms();
   dn_stage_rows(s->rig, s->scratch, par);
   t[2] = ex_now_ms();
   dn_stage_network(s->rig, s->scratch, par, NULL);
   t[3] = ex_now_ms();
   /* twice: the second time displaces once more, which costs the same, and makes the normals */
   if (dn_stage_output(s->rig, &pose, &out, s->scratch, par, &e) != DN_OK) ex_die("%s: %s", s->name, e.info);
   t[4] = ex_now_ms();
   out.normals = s->normals;
   dn_stage_output(s->rig, &pose, &out, s->scratch, par, &e);
   t[5] = ex_now_ms();
   for (k = 0; k < 4; k++) ms[k] = t[k + 1] - t[k];
   ms[NORMALS] = t[5] - t[4] > ms[OUTPUT] ? t[5] - t[4] - ms[OUTPUT] : 0;
   ms[FRAME] = t[3] - t[0] + t[5] - t[4];
}
/* warm frames until `wanted` counted or the time is over, with a probed one after each if `split`; then a few cold ones */
static void measure(bench *b, const subject *s, int all, int split, size_t wanted, double seconds, timing *t)
{
   const dn_parallel *par = &b->par[all];
   double end = ex_now_ms() + 1e3 * seconds, ms[PARTS];
   size_t made = ex_quiet_made(b->quiet), counted = ex_quiet_counted(b->quiet);
   int k, counts;
   memset(t, 0, sizeof *t);
   frame_once(s, par, ms); /* touches all memory */
   do {
      ex_quiet_begin(b->quiet);
      frame_once(s, par, ms);
      counts = ex_quiet_end(b->quiet);
      for (k = 0; k < COLD; k++) ex_times_add(&t->part[k], ms[k], counts);
      if (split && s->model) {
         stopwatch w;
         dn_probe probe;
         memset(&w, 0, sizeof w);
         memset(&probe, 0, sizeof probe);
         w.model = s->model;
         probe.tap = stopwatch_tap, probe.user = &w;
         ex_quiet_begin(b->quiet);
         w.last = ex_now_ms();
         dn_stage_network(s->rig, s->scratch, par, &probe); /* on rows already scaled: the numbers differ, the work does not */
         counts = ex_quiet_end(b->quiet);
         for (k = 0; k < KINDS; k++) ex_times_add(&t->kind[k], w.ms[k], counts);
         memcpy(t->flops, w.flops, sizeof t->flops);
         t->attention_flops = w.attention_flops;
      }
   } while (ex_now_ms() < end && t->part[FRAME].n[0] < wanted);
   for (k = 0; k < 6 && (k < 1 || ex_now_ms() < end + 500 * seconds); k++) {
      evict(b);
      ex_quiet_begin(b->quiet);
      frame_once(s, par, ms);
      ex_times_add(&t->part[COLD], ms[FRAME], ex_quiet_end(b->quiet));
   }
   t->made = ex_quiet_made(b->quiet) - made;
   t->counted = ex_quiet_counted(b->quiet) - counted;
}
static void timing_clear(timing *t)
{
   int k;
   for (k = 0; k < PARTS; k++) ex_times_clear(&t->part[k]);
   for (k = 0; k < KINDS; k++) ex_times_clear(&t->kind[k]);
}
static double middle(ex_times *t) { return ex_times_at(t, 0.5); }

/* the matrix products of a model alone, layer after layer through dn_linear_run: what share of the peak they reach */
static double measure_products(bench *b, const subject *s)
{
   const dn_model *m = s->model;
   size_t i, widest = 0, N = s->view.nodes, round;
   double flops = 0, ms = 0;
   float *x, *y;
   for (i = 0; i < m->block_count; i++) widest = widest > m->blocks[i].in ? widest : m->blocks[i].in;
   for (i = 0; i < m->block_count; i++) widest = widest > m->blocks[i].out ? widest : m->blocks[i].out;
   x = (float *)take(N, widest * sizeof *x);
   y = (float *)take(N, widest * sizeof *y);
   for (i = 0; i < N * widest; i++) x[i] = (float)(i % 31) * 0.03f - 0.45f;
   for (i = 0; i < m->block_count; i++) {
      const dn__block *l = &m->blocks[i];
      size_t bytes = dn_linear_size(l->in, l->out), k;
      float *weight = (float *)take(l->out, l->in * sizeof *weight);
      unsigned char *raw = (unsigned char *)take(bytes + 64, 1);
      dn_linear layer;
      ex_times t;
      memset(&t, 0, sizeof t);
      for (k = 0; k < l->in * l->out; k++) weight[k] = (float)(k % 17) * 0.01f - 0.08f;
      dn_linear_pack(&layer, l->in, l->out, weight, NULL, NULL, DN_ACT_NONE, raw + (64 - ((uintptr_t)raw & 63)));
      layer.kernel = (dn_kernel)b->o.kernel;
      for (round = 0; round < 12; round++) {
         double start;
         ex_quiet_begin(b->quiet);
         start = ex_now_ms();
         dn_linear_run(&layer, x, l->in, N, y, l->out, &b->par[1]);
         start = ex_now_ms() - start;
         ex_times_add(&t, start, ex_quiet_end(b->quiet) && round > 0);
      }
      ms += middle(&t);
      flops += 2.0 * (double)l->in * (double)l->out * (double)N;
      ex_times_clear(&t);
      free(raw);
      free(weight);
   }
   free(x);
   free(y);
   return flops / ms * 1e-6;
}

/* ===================================================================================== >>bars */
typedef struct bar { char what[160], bar[48], found[48]; int verdict; /* 1 met, 0 missed, -1 for information */ } bar;
enum { BARS = 64 };
static bar bars[BARS];
static size_t bar_count;
static void add_bar(int verdict, const char *what, const char *limit, const char *format, ...)
{
   bar *r = &bars[bar_count];
   va_list list;
   if (bar_count == BARS) return;
   bar_count++;
   snprintf(r->what, sizeof r->what, "%s", what);
   snprintf(r->bar, sizeof r->bar, "%s", limit);
   va_start(list, format);
   vsnprintf(r->found, sizeof r->found, format, list);
   va_end(list);
   r->verdict = verdict;
}
static void print_bars(bench *b)
{
   size_t i;
   printf("\n%-62s %-18s %s\n", "bar", "wanted", "found");
   for (i = 0; i < bar_count; i++) {
      const char *verdict = bars[i].verdict < 0 ? "" : bars[i].verdict ? "met" : "MISSED";
      printf("%-62s %-18s %-22s %s\n", bars[i].what, bars[i].bar, bars[i].found, verdict);
      report(b, "\"bar\": \"%s\", \"wanted\": \"%s\", \"found\": \"%s\", \"verdict\": \"%s\"", bars[i].what, bars[i].bar, bars[i].found, verdict);
   }
}

/* ===================================================================================== >>tables */
static void print_split(bench *b, const subject *s, timing *t, int all)
{
   double network = middle(&t->part[NETWORK]), rest = network, flops = t->attention_flops, kind_ms[KINDS];
   double peak = b->peak[all];
   size_t N = s->view.nodes;
   int k;
   for (k = 0; k < KINDS; k++) {
      flops += t->flops[k];
      kind_ms[k] = middle(&t->kind[k]);
      if (k != POINTWISE) rest -= kind_ms[k];
   }
   if (rest > 0 && t->flops[POINTWISE] > 0) kind_ms[POINTWISE] = rest;
   else kind_ms[POINTWISE] /= all ? b->o.threads : 1; /* noise swallowed the difference */
   printf("\n%s: %lu vertices, %lu nodes, %lu edges, %lu joints; %u threads, float32, kernel %s\n", s->name, (unsigned long)s->view.vertices,
          (unsigned long)N, (unsigned long)s->report.edges, (unsigned long)s->view.joints, all ? b->o.threads : 1, b->o.kernel_name);
   printf("  %-34s %9s %9s %9s %9s\n", "ms", "median", "least", "9 of 10", "ns/node");
   for (k = 0; k < PARTS; k++) {
      double m = middle(&t->part[k]);
      printf("  %-34s %9.3f %9.3f %9.3f %9.1f\n", part_names[k], m, ex_times_at(&t->part[k], 0), ex_times_at(&t->part[k], 0.9), 1e6 * m / (double)N);
      if (k == NETWORK) {
         int i;
         for (i = 0; i < KINDS; i++)
            if (i == POOLING && kind_ms[i] > 0) printf("    %-32s %9.3f %9s %9s %9.1f\n", kind_names[i], kind_ms[i], "", "", 1e6 * kind_ms[i] / (double)N);
            else if (t->flops[i] > 0)
               printf("    %-32s %9.3f %9s %9s %9.1f   %6.1f GFLOP/s, %4.1f %% of peak\n", kind_names[i], kind_ms[i], "", "",
                      1e6 * kind_ms[i] / (double)N, (t->flops[i] + (i == ATTENTION ? t->attention_flops : 0)) / kind_ms[i] * 1e-6,
                      100 * (t->flops[i] + (i == ATTENTION ? t->attention_flops : 0)) / kind_ms[i] * 1e-6 / peak);
      }
   }
   printf("  %.2f GFLOP a frame (%.0f + %.0f kFLOP a node); network %.1f GFLOP/s, %.1f %% of the peak %.0f\n", flops * 1e-9,
          1e-3 * (flops - t->attention_flops) / (double)N, 1e-3 * t->attention_flops / (double)N, flops / network * 1e-6,
          100 * flops / network * 1e-6 / peak, peak);
   printf("  bytes: model %.2f MB, rig %.2f MB, scratch %.2f MB; %lu of %lu runs counted\n", megabytes(s->info.bytes), megabytes(s->view.bytes),
          megabytes(s->scratch_bytes), (unsigned long)t->counted, (unsigned long)t->made);
   report(b, "\"subject\": \"%s\", \"precision\": \"f32\", \"kernel\": \"%s\", \"threads\": %u, \"vertices\": %lu, \"nodes\": %lu, \"frame_ms\": %.4f, "
          "\"frame_least_ms\": %.4f, \"cold_ms\": %.4f, \"skin_ms\": %.4f, \"features_ms\": %.4f, \"network_ms\": %.4f, \"output_ms\": %.4f, \"normals_ms\": %.4f, "
          "\"linear_ms\": %.4f, \"attention_ms\": %.4f, \"pooling_ms\": %.4f, \"pointwise_ms\": %.4f, \"gflop\": %.4f, \"peak_gflops\": %.2f, "
          "\"model_bytes\": %lu, \"rig_bytes\": %lu, \"scratch_bytes\": %lu, \"counted\": %lu, \"made\": %lu",
          s->name, b->o.kernel_name, all ? b->o.threads : 1, (unsigned long)s->view.vertices, (unsigned long)N, middle(&t->part[FRAME]),
          ex_times_at(&t->part[FRAME], 0), middle(&t->part[COLD]), middle(&t->part[SKIN]), middle(&t->part[FEATURES]), network, middle(&t->part[OUTPUT]),
          middle(&t->part[NORMALS]), kind_ms[LINEAR], kind_ms[ATTENTION], kind_ms[POOLING], kind_ms[POINTWISE], flops * 1e-9, peak,
          (unsigned long)s->info.bytes, (unsigned long)s->view.bytes, (unsigned long)s->scratch_bytes, (unsigned long)t->counted, (unsigned long)t->made);
   fflush(stdout);
}

/* one network: all threads in detail, then one thread for the ratio. Returns the frame's median */
static double run_network(bench *b, const subject *s)
{
   timing all, one;
   double frame, single, share;
   char what[160];
   measure_peak(b);
   measure(b, s, 1, 1, 20, b->o.seconds, &all);
   measure_peak(b);
   frame = middle(&all.part[FRAME]);
   print_split(b, s, &all, 1);
   share = measure_products(b, s);
   measure_peak(b);
   printf("  matrix products alone: %.1f GFLOP/s, %.1f %% of the peak\n", share, 100 * share / b->peak[1]);
   snprintf(what, sizeof what, "%s: float32 matrix work, share of the peak", s->name);
   add_bar(share >= 0.75 * b->peak[1], what, ">= 75 %", "%.1f %%", 100 * share / b->peak[1]);
   if (b->o.threads > 1) {
      measure(b, s, 0, 0, 10, b->o.seconds, &one);
      single = middle(&one.part[FRAME]);
      printf("  one thread %.3f ms, %u threads %.2f times as fast (%lu of %lu runs counted)\n", single, b->o.threads, single / frame,
             (unsigned long)one.counted, (unsigned long)one.made);
      snprintf(what, sizeof what, "%s: %u threads against one", s->name, b->o.threads);
      add_bar(b->o.threads == 2 ? single / frame >= 1.8 : -1, what, b->o.threads == 2 ? ">= 1.8" : "", "%.2f", single / frame);
      timing_clear(&one);
   }
   timing_clear(&all);
   return frame;
}

/* linear blend skinning alone: a rig without a model, one thread. The bar was set against a peak of 115 GFLOP/s a core */
static void run_skinning(bench *b)
{
   subject s = subject_made(b, "skinning", NULL, 10220);
   ex_times t;
   dn_pose pose;
   dn_error e;
   int k;
   double end = ex_now_ms() + 500 * b->o.seconds, ns, bar_ns;
   char wanted[48];
   memset(&t, 0, sizeof t);
   memset(&pose, 0, sizeof pose);
   pose.palette = s.palette;
   measure_peak(b);
   do { /* a hundred at a time: one takes some ten microseconds */
      double start;
      ex_quiet_begin(b->quiet);
      start = ex_now_ms();
      for (k = 0; k < 100; k++)
         if (dn_stage_skin(s.rig, &pose, s.scratch, s.scratch_bytes, NULL, &e) != DN_OK) ex_die("skinning: %s", e.info);
      start = ex_now_ms() - start;
      ex_times_add(&t, start / 100, ex_quiet_end(b->quiet));
   } while (ex_now_ms() < end && t.n[0] < 200);
   ns = 1e6 * middle(&t) / (double)s.view.vertices;
   bar_ns = 3.45 * 115 / b->peak[0];
   printf("\nskinning (LBS): %lu vertices, 4 influences, %lu joints, one thread: %.2f ns a vertex, least %.2f (%lu of %lu counted)\n",
          (unsigned long)s.view.vertices, (unsigned long)s.view.joints, ns, 1e6 * ex_times_at(&t, 0) / (double)s.view.vertices,
          (unsigned long)t.n[0], (unsigned long)t.n[1]);
   report(b, "\"subject\": \"lbs\", \"kernel\": \"%s\", \"ns_per_vertex\": %.4f, \"least\": %.4f, \"peak_gflops\": %.2f", b->o.kernel_name, ns,
          1e6 * ex_times_at(&t, 0) / (double)s.view.vertices, b->peak[0]);
   snprintf(wanted, sizeof wanted, "<= %.2f ns", bar_ns);
   add_bar(ns <= bar_ns, "LBS, 4 influences, one thread (3.45 ns at 115 GFLOP/s a core)", wanted, "%.2f ns", ns);
   ex_times_clear(&t);
   subject_free(&s);
}

/* weld, graph and geodesic distances of a character, or of a ring of about a person's volume */
static void run_bind(bench *b, ex_scene *scene)
{
   dn_error e;
   size_t size;
   unsigned char *file = ex_made_model("densegats", "rest", scene ? scene->joints : 65, &size);
   dn_model *m = file ? dn_model_load(file, size, NULL, NULL, &e) : NULL;
   ex_made *made = scene ? NULL : ex_made_mesh(13000, 65, 0.09, 0);
   ex_times t;
   dn_report r;
   double end = ex_now_ms() + 1e3 * b->o.seconds, ms;
   free(file);
   if (!m || (!scene && !made)) ex_die("bind: out of memory");
   memset(&t, 0, sizeof t);
   memset(&r, 0, sizeof r);
   do {
      double start;
      ex_quiet_begin(b->quiet);
      start = ex_now_ms();
      if (scene) {
         subject s = subject_character(b, "bind", m, scene);
         start = ex_now_ms() - start;
         r = s.report;
         subject_free(&s);
      } else {
         dn_rig_desc d;
         dn_skin_set skin;
         dn_model_info info;
         dn_rig *rig;
         dn_model_describe(m, &info);
         made_desc(made, &d, &skin, &info);
         d.geodesic = NULL;
         d.parallel = &b->par[1];
         rig = dn_rig_create(m, &d, NULL, &r, &e);
         start = ex_now_ms() - start;
         if (!rig) ex_die("bind: %s", e.info);
         dn_rig_free(rig);
      }
      ex_times_add(&t, start, ex_quiet_end(b->quiet));
   } while (ex_now_ms() < end && t.n[0] < 5);
   ms = middle(&t);
   printf("\nbind: %lu vertices, %lu nodes, %lu solid cells, %u threads: %.0f ms, least %.0f (%lu of %lu counted)\n", (unsigned long)r.vertices,
          (unsigned long)r.nodes, (unsigned long)r.solid_cells, b->o.threads, ms, ex_times_at(&t, 0), (unsigned long)t.n[0], (unsigned long)t.n[1]);
   report(b, "\"subject\": \"bind\", \"vertices\": %lu, \"solid_cells\": %lu, \"threads\": %u, \"ms\": %.2f", (unsigned long)r.vertices,
          (unsigned long)r.solid_cells, b->o.threads, ms);
   add_bar(b->o.threads == 2 ? ms <= 1000 : -1, scene ? "bind of the character, R = 128" : "bind of 13,000 vertices, 65 joints, R = 128", "<= 1000 ms", "%.0f ms", ms);
   ex_times_clear(&t);
   ex_made_free(made);
   dn_model_free(m);
}

/* cost against size. Meshes that do not fit into a part of the memory that is free are left out, and said so */
static void run_sizes(bench *b, dn_model *model, const char *name)
{
   static const size_t sizes[] = { 1000, 3000, 10000, 30000, 100000, 300000, 1000000 };
   double at_ten = 0, at_million = 0;
   size_t i;
   dn_model_info info;
   char what[96];
   dn_model_describe(model, &info);
   printf("\n%s against the number of nodes, %u threads\n  %9s %10s %10s %12s %10s %12s\n", name, b->o.threads, "nodes", "frame ms", "least", "ns/node",
          "cold ms", "scratch MB");
   for (i = 0; i < sizeof sizes / sizeof *sizes && sizes[i] <= b->o.largest; i++) {
      double pages = (double)sysconf(_SC_AVPHYS_PAGES) * (double)sysconf(_SC_PAGESIZE), ns;
      double needs = (double)sizes[i] * (double)(info.row_width + 900 + 3 * info.joints) * sizeof(float);
      subject s;
      timing t;
      if (needs > 0.8 * pages) {
         printf("  %9lu left out: needs about %.1f GB, %.1f GB are free\n", (unsigned long)sizes[i], needs * 1e-9, pages * 1e-9);
         continue;
      }
      s = subject_made(b, name, model, sizes[i]);
      measure(b, &s, 1, 0, sizes[i] > 100000 ? 3 : 10, b->o.seconds / 2, &t);
      ns = 1e6 * middle(&t.part[FRAME]) / (double)s.view.nodes;
      if (sizes[i] == 10000) at_ten = ns;
      if (sizes[i] == 1000000) at_million = ns;
      printf("  %9lu %10.3f %10.3f %12.1f %10.3f %12.2f   (%lu of %lu counted)\n", (unsigned long)s.view.nodes, middle(&t.part[FRAME]),
             ex_times_at(&t.part[FRAME], 0), ns, middle(&t.part[COLD]), megabytes(s.scratch_bytes), (unsigned long)t.counted, (unsigned long)t.made);
      report(b, "\"subject\": \"%s\", \"sizes\": true, \"nodes\": %lu, \"frame_ms\": %.4f, \"ns_per_node\": %.2f, \"scratch_bytes\": %lu", name,
             (unsigned long)s.view.nodes, middle(&t.part[FRAME]), ns, (unsigned long)s.scratch_bytes);
      fflush(stdout);
      timing_clear(&t);
      subject_free(&s);
   }
   snprintf(what, sizeof what, "%s: ns per node at 1,000,000 over 10,000", name);
   if (at_ten > 0 && at_million > 0) add_bar(at_million <= 1.3 * at_ten, what, "<= 1.3", "%.2f", at_million / at_ten);
}

/* a garment of the clothing paper on a body: coarse stage, parser and detail */
static void run_garment(bench *b, size_t nodes)
{
   dn_model *m = load(b, "clothnet", NULL);
   dn_model_info info;
   ex_made *body = ex_made_mesh(6000, 24, 0.4, 0), *cloth = ex_made_mesh(nodes, 24, 0.46, b->o.shuffle);
   dn_garment_desc d;
   dn_rig_desc rig;
   dn_skin_set skin;
   dn_garment *g;
   dn_garment_view view;
   dn_garment_pose pose;
   dn_garment_output out;
   dn_error e;
   float fixed[85], *positions, *normals;
   size_t bytes, k;
   void *scratch;
   ex_times t[5];
   static const char *const names[] = { "follow", "coarse stage", "detail stage", "output and normals", "frame" };
   double end;
   if (!body || !cloth) ex_die("out of memory");
   dn_model_describe(m, &info);
   memset(&d, 0, sizeof d);
   memset(&pose, 0, sizeof pose);
   memset(&out, 0, sizeof out);
   memset(t, 0, sizeof t);
   for (k = 0; k < 85; k++) fixed[k] = 0.2f * (float)(k % 5) - 0.4f;
   made_desc(body, &rig, &skin, &info);
   d.body = rig.mesh;
   d.skeleton = rig.skeleton;
   d.garment = rig.mesh;
   d.garment.vertices = cloth->vertices, d.garment.positions = cloth->positions, d.garment.triangles = cloth->triangles;
   d.garment.indices = cloth->triangle, d.garment.skin_sets = 0, d.garment.skin = NULL;
   d.refine = m;
   d.alpha = fixed, d.alphas = 3, d.beta = fixed, d.betas = 10, d.thetas = 72;
   d.parallel = &b->par[1];
   g = dn_garment_create(&d, NULL, NULL, &e);
   if (!g) ex_die("clothnet: %s", e.info);
   dn_garment_describe(g, &view);
   scratch = dn_garment_scratch_create(g, b->o.threads, NULL, &bytes, &e);
   if (!scratch) ex_die("clothnet: %s", e.info);
   positions = (float *)take(view.vertices, 3 * sizeof(float));
   normals = (float *)take(view.vertices, 3 * sizeof(float));
   pose.palette = body->palette, pose.theta = fixed + 13, pose.strength = 1;
   out.positions = positions, out.normals = normals;
   end = ex_now_ms() + 1e3 * b->o.seconds;
   dn_garment_deform(g, &pose, &out, scratch, bytes, &b->par[1], &e);
   do {
      double at[5];
      int counts;
      ex_quiet_begin(b->quiet);
      at[0] = ex_now_ms();
      if (dn_garment_stage_follow(g, &pose, scratch, bytes, &b->par[1], &e) != DN_OK) ex_die("clothnet: %s", e.info);
      at[1] = ex_now_ms();
      dn_garment_stage_coarse(g, &pose, scratch, &b->par[1], NULL);
      at[2] = ex_now_ms();
      dn_garment_stage_refine(g, &pose, scratch, &b->par[1], NULL);
      at[3] = ex_now_ms();
      if (dn_garment_stage_output(g, &pose, &out, scratch, &b->par[1], &e) != DN_OK) ex_die("clothnet: %s", e.info);
      at[4] = ex_now_ms();
      counts = ex_quiet_end(b->quiet);
      for (k = 0; k < 4; k++) ex_times_add(&t[k], at[k + 1] - at[k], counts);
      ex_times_add(&t[4], at[4] - at[0], counts);
   } while (ex_now_ms() < end && t[4].n[0] < 20);
   printf("\nclothnet: garment of %lu nodes on a body of %lu; %u threads, float32, kernel %s\n  %-34s %9s %9s %9s %9s\n", (unsigned long)view.nodes,
          (unsigned long)view.body_nodes, b->o.threads, b->o.kernel_name, "ms", "median", "least", "9 of 10", "ns/node");
   for (k = 0; k < 5; k++)
      printf("  %-34s %9.3f %9.3f %9.3f %9.1f\n", names[k], middle(&t[k]), ex_times_at(&t[k], 0), ex_times_at(&t[k], 0.9), 1e6 * middle(&t[k]) / (double)view.nodes);
   printf("  bytes: model %.2f MB, garment %.2f MB, scratch %.2f MB; %lu of %lu runs counted\n", megabytes(info.bytes), megabytes(view.bytes),
          megabytes(bytes), (unsigned long)t[4].n[0], (unsigned long)t[4].n[1]);
   report(b, "\"subject\": \"clothnet\", \"precision\": \"f32\", \"kernel\": \"%s\", \"threads\": %u, \"nodes\": %lu, \"frame_ms\": %.4f, \"coarse_ms\": %.4f, "
          "\"detail_ms\": %.4f, \"scratch_bytes\": %lu", b->o.kernel_name, b->o.threads, (unsigned long)view.nodes, middle(&t[4]), middle(&t[1]), middle(&t[2]),
          (unsigned long)bytes);
   for (k = 0; k < 5; k++) ex_times_clear(&t[k]);
   dn_scratch_free(scratch, bytes, NULL);
   dn_garment_free(g);
   dn_model_free(m);
   ex_made_free(body);
   ex_made_free(cloth);
   free(positions);
   free(normals);
}

/* ===================================================================================== >>main */
int main(int argc, char **argv)
{
   static const char *const standard[] = { "densegats", "multiresgnet", "clothnet" };
   bench b;
   ex_scene *scene = NULL;
   char error[EX_ERROR];
   size_t k, count;
   ex_program("bench");
   memset(&b, 0, sizeof b);
   b.o = read_options(argc, argv);
   b.pool = ex_pool_create(b.o.threads);
   b.quiet = b.pool ? ex_quiet_create(b.o.noise) : NULL;
   b.evict = (unsigned char *)take(EVICT, 1);
   if (!b.quiet) ex_die("out of memory or threads");
   b.par[1] = ex_pool_parallel(b.pool);
   if (b.o.json && !(b.json = fopen(b.o.json, "w"))) ex_die("%s: cannot be written", b.o.json);
   if (b.json) fputs("[", b.json);
   if (b.o.character && !(scene = ex_scene_load(b.o.character, error))) ex_die("%s", error);
   if (ex_quiet_blind(b.quiet)) puts("/proc does not tell how busy the processors are: every run counts");
   measure_peak(&b);
   printf("deformnet %d.%d.%d, kernel %s, %u threads of %ld processors; float32 peak %.0f GFLOP/s on one, %.0f on all threads\n", DN_VERSION / 10000,
          DN_VERSION / 100 % 100, DN_VERSION % 100, b.o.kernel_name, b.o.threads, sysconf(_SC_NPROCESSORS_ONLN), b.peak[0], b.peak[1]);
   run_skinning(&b);
   run_bind(&b, scene);
   count = b.o.model || b.o.arch ? 1 : 3;
   for (k = 0; k < count; k++) {
      const char *arch = b.o.model ? "model" : b.o.arch ? b.o.arch : standard[k];
      dn_model *m;
      dn_model_info info;
      subject s;
      double frame;
      if (strcmp(arch, "clothnet") == 0) {
         run_garment(&b, b.o.nodes ? b.o.nodes : 3500);
         continue;
      }
      m = load(&b, arch, b.o.model);
      dn_model_describe(m, &info);
      if (dn__is_garment(m) || info.arch == DN_NEURALBLENDSHAPES) ex_die("%s: a %s model; here run those for characters", b.o.model, info.arch_name);
      arch = info.arch_name;
      s = scene ? subject_character(&b, arch, m, scene) : subject_made(&b, arch, m, b.o.nodes ? b.o.nodes : 10220);
      frame = run_network(&b, &s);
      if (strcmp(arch, "densegats") == 0 && s.view.nodes == 10220) {
         add_bar(s.scratch_bytes <= 16000000, "densegats: scratch at 10,220 nodes, float32", "<= 16 MB", "%.2f MB", megabytes(s.scratch_bytes));
         add_bar(b.o.threads == 2 ? frame <= 31 : -1, "densegats: the aim, 10,220 vertices on two threads", "31 ms", "%.1f ms", frame);
      }
      if (strcmp(arch, "multiresgnet") == 0 && b.o.lite) {
         dn_model *small = load(&b, "lite", b.o.lite);
         subject t = scene ? subject_character(&b, "lite", small, scene) : subject_made(&b, "lite", small, b.o.nodes ? b.o.nodes : 10220);
         double lite = run_network(&b, &t);
         add_bar(frame >= 6 * lite, "lite model: times as fast as multiresgnet", ">= 6", "%.2f", frame / lite);
         subject_free(&t);
         dn_model_free(small);
      }
      subject_free(&s);
      if (k == 0 && b.o.largest && !scene) run_sizes(&b, m, arch);
      dn_model_free(m);
   }
   print_bars(&b);
   printf("\n%lu of %lu runs counted: during the others the machine was busy with something else\n", (unsigned long)ex_quiet_counted(b.quiet),
          (unsigned long)ex_quiet_made(b.quiet));
   if (b.json && (fputs("\n]\n", b.json) == EOF || fclose(b.json) != 0)) ex_die("%s: cannot be written", b.o.json);
   ex_scene_free(scene);
   ex_quiet_free(b.quiet);
   ex_pool_free(b.pool);
   free(b.evict);
   return 0;
}
