/*  bench.c - how fast deformnet is here: end to end, part by part, against this processor's peak and against its bars
    shows     the stages called apart, precisions and kernels side by side, the cost of every part and how it grows with the mesh
    not here  other libraries on the same weights: make peers
    run       make bench                      made networks of the papers' sizes on made meshes: needs no data
              build/bench --model M.safetensors --character C.glb --threads 2 --json report.json
    times     batch 1, everything from palette to normals. A run counts only when nothing else kept the processors busy
              (common/quiet.h); how many counted of how many made stands beside each figure. Two things that are compared
              take turns
    peak      multiply-adds of the same kernel and precision on as many threads, in loops between the runs (common/peak.h)
    errors    of a precision: mean |d - d_float32| over mean |d_float32|, d the nodes' displacements, in a pose that int8's
              ranges were not taken from */
#define _POSIX_C_SOURCE 200809L
#define DEFORMNET_IMPLEMENTATION
#include "../deformnet.h"
#include "common/made.h"
#include "common/peak.h"
#include "common/pool.h"
#include "common/quiet.h"
#include "common/ranges.h"
#include "common/scene.h"
#include "common/tool.h"
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* ===================================================================================== >>options */
static const char usage[] =
   "usage: bench [--model M.safetensors] [--character C.glb|C.safetensors | --nodes N] [--threads n]\n"
   "             [--precision f32|f16|bf16|int8] [--kernel ref|sse|avx2|avx512|neon|wasm|auto] [--arch A] [--pooling rest|dynamic]\n"
   "             [--shuffle] [--lite L.safetensors] [--largest N] [--seconds s] [--noise share] [--json R.json]\n"
   "  without --model   made ones of the papers' sizes: densegats, multiresgnet and clothnet, or the one of --arch\n"
   "  --nodes N         a made mesh of about N nodes in place of 10,220 (clothnet: 3,500)\n"
   "  --shuffle         its vertices in random order\n"
   "  --precision p     in detail, and beside float32; without it float32 in detail and all others beside it\n"
   "  --lite L          a small model, measured against multiresgnet on the same mesh; the one that ships, where it is found\n"
   "  --largest N       where the table of sizes ends; 0 leaves it out (1,000,000)\n"
   "  --seconds s       to look for quiet runs, for each line of figures (4)\n"
   "  --noise share     of a run's processor time that others may have (0.05)\n";

typedef struct options {
   const char *model, *character, *lite, *arch, *pooling, *json;
   size_t nodes, largest;
   int shuffle, precision; /* precision -1: all */
   dn_kernel kernel;
   unsigned threads;
   double seconds, noise;
} options;

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
   o.pooling = "rest", o.seconds = 4, o.noise = 0.05, o.largest = 1000000, o.precision = -1;
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
         if ((o.precision = ex_precision_named(value)) < 0) ex_die("--precision %s: expected f32, f16, bf16 or int8, as far as this version has them", value);
      } else if (strcmp(key, "--kernel") == 0) {
         for (k = DN_KERNEL_COUNT; --k > 0 && strcmp(value, k == DN_KERNEL_REF ? "ref" : dn_kernel_name((dn_kernel)k)) != 0;) {}
         if (k == 0 && strcmp(value, "auto") != 0) ex_die("--kernel %s: expected ref, sse, avx2, avx512, neon, wasm or auto", value);
         if (k > 0 && !dn_kernel_available((dn_kernel)k)) ex_die("--kernel %s does not run here", value);
         o.kernel = (dn_kernel)k;
      } else ex_die("unknown argument \"%s\" (--help lists them)", key);
   }
   if (o.character && (o.nodes || o.shuffle)) ex_die("--character brings its own mesh: --nodes and --shuffle are for made ones");
   if (strcmp(o.pooling, "rest") != 0 && strcmp(o.pooling, "dynamic") != 0) ex_die("--pooling %s: expected rest or dynamic", o.pooling);
   if (!o.threads) o.threads = ex_processors();
   if (o.kernel == DN_KERNEL_AUTO)
      for (k = DN_KERNEL_COUNT; --k > DN_KERNEL_AUTO && o.kernel == DN_KERNEL_AUTO;)
         if (dn_kernel_available((dn_kernel)k)) o.kernel = (dn_kernel)k;
   return o;
}

/* everything that the measurements share */
typedef struct bench {
   options o;
   ex_pool *pool;
   dn_parallel par[2];        /* one thread; all of them */
   ex_quiet *quiet;
   double peak[EX_PEAKS][2];  /* GFLOP/s on one thread and on all, the best seen so far */
   unsigned char *evict;
   FILE *json;
   int json_items, json_fields;
} bench;
enum { EVICT = 96 << 20 };

static void *take(size_t count, size_t size)
{
   void *p = ex_take(count, size);
   if (!p) ex_die("out of memory");
   return p;
}
static double megabytes(size_t bytes) { return (double)bytes / 1e6; }
static double middle(ex_times *t) { return ex_times_at(t, 0.5); }
static const char *kernel_text(const bench *b) { return b->o.kernel == DN_KERNEL_REF ? "ref" : dn_kernel_name(b->o.kernel); }

/* ===================================================================================== >>json
   A list of objects: what is printed, as numbers. The first field says what an object is about. */
static void json_text(bench *b, const char *key, const char *value)
{
   if (!b->json) return;
   fprintf(b->json, "%s\"%s\": \"", b->json_fields++ ? ", " : "", key);
   for (; *value; value++) {
      if (*value == '"' || *value == '\\') fputc('\\', b->json);
      fputc((unsigned char)*value < 32 ? ' ' : *value, b->json);
   }
   fputc('"', b->json);
}
static void json_number(bench *b, const char *key, double value)
{
   if (!b->json) return;
   fprintf(b->json, isfinite(value) ? "%s\"%s\": %.7g" : "%s\"%s\": null", b->json_fields++ ? ", " : "", key, value);
}
static void json_begin(bench *b, const char *about, const char *subject)
{
   if (!b->json) return;
   fputs(b->json_items++ ? ",\n  {" : "\n  {", b->json);
   b->json_fields = 0;
   json_text(b, "about", about);
   if (subject) json_text(b, "subject", subject);
}
static void json_end(bench *b)
{
   if (b->json) fputc('}', b->json), fflush(b->json);
}
static void json_times(bench *b, const char *key, ex_times *t) /* KEY_ms, KEY_least_ms, KEY_9_of_10_ms */
{
   char name[64];
   snprintf(name, sizeof name, "%s_ms", key), json_number(b, name, middle(t));
   snprintf(name, sizeof name, "%s_least_ms", key), json_number(b, name, ex_times_at(t, 0));
   snprintf(name, sizeof name, "%s_9_of_10_ms", key), json_number(b, name, ex_times_at(t, 0.9));
}

/* ===================================================================================== >>bars */
typedef struct bar { char what[160], bar[48], found[64]; int verdict; } bar; /* 1 met, 0 missed, -1 for information */
enum { BARS = 96 };
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
   printf("\n%-66s %-12s %s\n", "bar", "wanted", "found");
   for (i = 0; i < bar_count; i++) {
      const char *verdict = bars[i].verdict < 0 ? "" : bars[i].verdict ? "met" : "MISSED";
      printf("%-66s %-12s %-22s %s\n", bars[i].what, bars[i].bar, bars[i].found, verdict);
      json_begin(b, "bar", bars[i].what);
      json_text(b, "wanted", bars[i].bar), json_text(b, "found", bars[i].found), json_text(b, "verdict", verdict);
      json_end(b);
   }
}

/* ===================================================================================== >>peak */
static ex_peak_kind peak_of(dn_precision p)
{
   const char *name = dn_precision_name(p);
   return strcmp(name, "bf16") == 0 ? EX_PEAK_BF16 : strcmp(name, "int8") == 0 ? EX_PEAK_INT8 : EX_PEAK_F32;
}
static void measure_peak(bench *b, ex_peak_kind kind) /* a few milliseconds each: keeps the best of all calls */
{
   int all, round;
   for (all = 0; all < 2; all++)
      for (round = 0; round < 8; round++) b->peak[kind][all] = fmax(b->peak[kind][all], ex_peak(kind, b->o.kernel, &b->par[1], all ? b->o.threads : 1));
}

/* ===================================================================================== >>subject
   What is measured: a model in some precision bound to a mesh, ready to run frames. */
typedef struct body { ex_made *made; ex_scene *scene; } body; /* one of the two */
typedef struct source { /* a model file in memory */
   const char *name;
   unsigned char *bytes;
   size_t size;
   int calibrated;      /* ranges were added here */
} source;
typedef struct subject {
   const char *name;
   dn_model *model; /* or NULL: skins only */
   dn_model_info info;
   dn_rig *rig;
   dn_rig_view view;
   dn_report report;
   float *positions, *normals, *palette;
   void *scratch;
   size_t scratch_bytes;
} subject;

static source source_of(const bench *b, const char *arch, const char *path) /* path NULL: a made one */
{
   source s;
   memset(&s, 0, sizeof s);
   s.name = arch;
   if (path) {
      FILE *f = fopen(path, "rb");
      long size = f && fseek(f, 0, SEEK_END) == 0 ? ftell(f) : -1;
      if (size < 0 || fseek(f, 0, SEEK_SET) != 0) ex_die("%s: cannot be read", path);
      s.bytes = (unsigned char *)take((size_t)size, 1);
      s.size = fread(s.bytes, 1, (size_t)size, f);
      fclose(f);
   } else {
      s.bytes = ex_made_model(arch, b->o.pooling, strcmp(arch, "clothnet") == 0 ? 24 : 65, &s.size);
      if (!s.bytes) ex_die("--arch %s: expected mlp, gat, neuroskinning, densegats, multiresgnet or clothnet", arch);
   }
   return s;
}
static dn_model *load(const bench *b, const source *s, dn_precision precision, dn_error *e)
{
   dn_model_options chosen;
   memset(&chosen, 0, sizeof chosen);
   chosen.kernel = b->o.kernel;
   chosen.precision = precision;
   return dn_model_load(s->bytes, s->size, &chosen, NULL, e);
}
static body body_made(const bench *b, size_t nodes, size_t joints)
{
   body r;
   r.scene = NULL;
   r.made = ex_made_mesh(nodes, joints, 0.5214, b->o.shuffle);
   if (!r.made) ex_die("out of memory for a mesh of %lu nodes", (unsigned long)nodes);
   return r;
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
static void pose(const body *m, unsigned number, float *palette) /* number 0: the one that is timed */
{
   if (m->made && number == 0) memcpy(palette, m->made->palette, m->made->joints * 12 * sizeof(float));
   else if (m->made) ex_made_pose(m->made, number, palette);
   else { /* every joint bent a little */
      const ex_scene *s = m->scene;
      float *local = (float *)take(s->joints, 10 * sizeof(float));
      size_t k;
      memcpy(local, s->rest, s->joints * 10 * sizeof(float));
      for (k = 0; k < s->joints; k++) local[10 * k + 3 + (k + number) % 3] += number % 2 ? -0.1f : 0.1f, local[10 * k + 6] -= 0.005f;
      ex_pose_local(s, local, palette);
      free(local);
   }
}
static subject subject_of(const bench *b, const char *name, dn_model *model, const body *m)
{
   subject s;
   dn_rig_desc d;
   dn_skin_set skin;
   dn_error e;
   memset(&s, 0, sizeof s);
   s.name = name;
   s.model = model;
   if (model) dn_model_describe(model, &s.info);
   if (m->made) made_desc(m->made, &d, &skin, model ? &s.info : NULL);
   else {
      ex_describe(m->scene, &d, &skin);
      if (s.info.joint_names && strcmp(s.info.joint_names[0], "joint0") == 0 && m->scene->joints == s.info.joints)
         d.skeleton.names = s.info.joint_names; /* a made model: its joints are anybody's */
   }
   d.kernel = b->o.kernel;
   d.parallel = &b->par[1];
   s.rig = dn_rig_create(model, &d, NULL, &s.report, &e);
   if (!s.rig) ex_die("%s: %s", name, e.info);
   dn_rig_describe(s.rig, &s.view);
   s.scratch = dn_scratch_create(s.rig, b->o.threads, NULL, &s.scratch_bytes, &e);
   if (!s.scratch) ex_die("%s: %s", name, e.info);
   s.positions = (float *)take(s.view.vertices, 3 * sizeof(float));
   s.normals = (float *)take(s.view.vertices, 3 * sizeof(float));
   s.palette = (float *)take(s.view.joints, 12 * sizeof(float));
   pose(m, 0, s.palette);
   return s;
}
static void subject_free(subject *s) /* and its model */
{
   dn_scratch_free(s->scratch, s->scratch_bytes, NULL);
   dn_rig_free(s->rig);
   dn_model_free(s->model);
   free(s->palette);
   free(s->positions);
   free(s->normals);
   memset(s, 0, sizeof *s);
}
/* skin, rows and network once, untimed */
static void run_network_once(const bench *b, const subject *s, const float *palette, const dn_probe *probe)
{
   dn_pose p;
   dn_error e;
   memset(&p, 0, sizeof p);
   p.palette = palette;
   p.strength = 1;
   if (dn_stage_skin(s->rig, &p, s->scratch, s->scratch_bytes, &b->par[1], &e) != DN_OK) ex_die("%s: %s", s->name, e.info);
   dn_stage_rows(s->rig, s->scratch, &b->par[1]);
   dn_stage_network(s->rig, s->scratch, &b->par[1], probe);
}
/* int8 needs ranges: of three other poses of the mesh at hand, where the file has none */
static void calibrate(const bench *b, source *s, const body *m)
{
   dn_error e;
   dn_model *model = load(b, s, DN_PRECISION_F32, &e);
   ex_ranges *r = ex_ranges_create();
   dn_probe probe;
   subject t;
   unsigned k;
   size_t joined;
   unsigned char *bytes = NULL;
   if (!model || !r) ex_die("%s: %s", s->name, model ? "out of memory" : e.info);
   t = subject_of(b, s->name, model, m);
   probe = ex_ranges_probe(r);
   for (k = 1; k <= 3; k++) {
      pose(m, k, t.palette);
      run_network_once(b, &t, t.palette, &probe);
   }
   if (ex_ranges_choose(r, 1)) bytes = ex_ranges_join(r, s->bytes, s->size, &joined);
   if (!bytes) ex_die("%s: ranges cannot be added", s->name);
   free(s->bytes);
   s->bytes = bytes, s->size = joined, s->calibrated = 1;
   subject_free(&t);
   ex_ranges_free(r);
}
/* NULL: this version does not run it so, and *e says why */
static dn_model *load_calibrated(const bench *b, source *s, dn_precision precision, const body *m, dn_error *e)
{
   dn_model *model = load(b, s, precision, e);
   if (model || e->code != DN_MISSING_TENSOR || s->calibrated) return model;
   calibrate(b, s, m);
   return load(b, s, precision, e);
}

/* ===================================================================================== >>frames */
enum { SKIN, FEATURES, NETWORK, OUTPUT, NORMALS, FRAME, COLD, PARTS };
static const char *const part_names[] = { "skin", "features", "network", "output", "normals", "frame", "cold frame" };
static const char *const part_keys[] = { "skin", "features", "network", "output", "normals", "frame", "cold_frame" };

typedef struct timing {
   ex_times part[PARTS];
   size_t made, counted;
} timing;

static void evict(bench *b) /* the caches, by writing something larger */
{
   size_t i;
   for (i = 0; i < EVICT; i += 64) b->evict[i]++;
}
static void frame_once(const subject *s, const dn_parallel *par, double ms[PARTS])
{
   dn_pose p;
   dn_output out;
   dn_error e;
   double t[7];
   int k;
   memset(&p, 0, sizeof p);
   memset(&out, 0, sizeof out);
   p.palette = s->palette;
   p.strength = 1.0f;
   out.positions = s->positions;
   t[0] = ex_now_ms();
   if (dn_stage_skin(s->rig, &p, s->scratch, s->scratch_bytes, par, &e) != DN_OK) ex_die("%s: %s", s->name, e.info);
   t[1] = ex_now_ms();
   dn_stage_rows(s->rig, s->scratch, par);
   t[2] = ex_now_ms();
   dn_stage_network(s->rig, s->scratch, par, NULL);
   t[3] = ex_now_ms();
   /* twice: the second time displaces once more, which costs the same, and makes the normals */
   if (dn_stage_output(s->rig, &p, &out, s->scratch, par, &e) != DN_OK) ex_die("%s: %s", s->name, e.info);
   t[4] = ex_now_ms();
   out.normals = s->normals;
   dn_stage_output(s->rig, &p, &out, s->scratch, par, &e);
   t[5] = ex_now_ms();
   for (k = 0; k < 4; k++) ms[k] = t[k + 1] - t[k];
   ms[NORMALS] = t[5] - t[4] > ms[OUTPUT] ? t[5] - t[4] - ms[OUTPUT] : 0;
   ms[FRAME] = t[3] - t[0] + t[5] - t[4];
}
/* warm frames until `wanted` counted or the time is over; then a few cold ones */
static void measure(bench *b, const subject *s, int all, size_t wanted, double seconds, timing *t)
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
   } while (ex_now_ms() < end && t->part[FRAME].n[0] < wanted);
   t->made = ex_quiet_made(b->quiet) - made;
   t->counted = ex_quiet_counted(b->quiet) - counted;
   for (k = 0; k < 6 && (k < 1 || ex_now_ms() < end + 500 * seconds); k++) {
      evict(b);
      ex_quiet_begin(b->quiet);
      frame_once(s, par, ms);
      ex_times_add(&t->part[COLD], ms[FRAME], ex_quiet_end(b->quiet));
   }
}
static void timing_clear(timing *t)
{
   int k;
   for (k = 0; k < PARTS; k++) ex_times_clear(&t->part[k]);
}
/* frames of several subjects in turns: one to warm the caches, then two that may count */
static void take_turns(bench *b, const subject *s, size_t count, size_t wanted, double seconds, ex_times *t)
{
   double end = ex_now_ms() + 1e3 * seconds, ms[PARTS];
   size_t k, least;
   int round;
   memset(t, 0, count * sizeof *t);
   do {
      for (least = SIZE_MAX, k = 0; k < count; k++) {
         frame_once(&s[k], &b->par[1], ms);
         for (round = 0; round < 2; round++) {
            ex_quiet_begin(b->quiet);
            frame_once(&s[k], &b->par[1], ms);
            ex_times_add(&t[k], ms[FRAME], ex_quiet_end(b->quiet));
         }
         least = t[k].n[0] < least ? t[k].n[0] : least;
      }
   } while (ex_now_ms() < end && least < wanted);
}

/* ===================================================================================== >>layers
   Each block of a model alone on numbers of its kind, with all threads: what its kind costs and what share of the peak it
   reaches. In a frame they run together, slice by slice, so that the parts need not add up to the network. */
enum { LINEAR, PRODUCTS, ATTENTION, POOLING, POINTWISE, KINDS };
static const char *const kind_names[] = { "linear layers before", "graph blocks: products", "graph blocks: attention", "pooling", "point-wise layers at the end" };
static const char *const kind_keys[] = { "linear", "products", "attention", "pooling", "pointwise" };
typedef struct layers {
   double ms[KINDS], flops[KINDS]; /* of a frame. The attention's scores, two columns a head, are columns of the products */
   double scores;                  /* flops of theirs */
} layers;

static int kind_of(const char *name)
{
   const char *last = name, *s;
   for (s = name; (s = strchr(s, '.')) != NULL; s++)
      if (s[1] >= 'a' && s[1] <= 'z') last = s + 1; /* "detail.dir.gat.0" -> "gat.0" */
   if (strncmp(last, "pool", 4) == 0 || strncmp(last, "unpool", 6) == 0) return POOLING;
   if (strncmp(last, "post.", 5) == 0 || strcmp(last, "out") == 0) return POINTWISE;
   if (strncmp(last, "pre.", 4) == 0 || strncmp(last, "parser.", 7) == 0) return LINEAR;
   return PRODUCTS;
}
typedef struct counter { const dn_model *model; size_t rows[256]; } counter; /* of each block, in a frame */
static void count_rows(void *user, const char *name, const float *rows, size_t first, size_t count, size_t width, size_t row_stride)
{
   counter *c = (counter *)user;
   size_t i;
   (void)rows, (void)first, (void)width, (void)row_stride;
   for (i = 0; i < c->model->block_count && i < 256; i++)
      if (strcmp(c->model->blocks[i].name, name) == 0) c->rows[i] += count;
}
/* ms of fn(job) once, the median of some quiet ones */
static double alone(bench *b, void (*fn)(void *job), void *job)
{
   ex_times t;
   double start, ms;
   int round;
   memset(&t, 0, sizeof t);
   fn(job); /* touches all memory */
   for (round = 0; round < 9; round++) {
      ex_quiet_begin(b->quiet);
      start = ex_now_ms();
      fn(job);
      start = ex_now_ms() - start;
      ex_times_add(&t, start, ex_quiet_end(b->quiet));
   }
   ms = middle(&t);
   ex_times_clear(&t);
   return ms;
}
typedef struct lone { /* a block or a pool on N rows */
   const dn_parallel *par;
   const dn__block *block;
   const dn_pool *pool;
   dn_clusters clusters;
   const dn_graph *g;
   size_t rows, in;
   unsigned char *x, *y, *z; /* cells of the block's precision; y has room for floats */
   float *coarse;
} lone;
static void lone_products_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const lone *j = (const lone *)job;
   const dn__block *l = j->block;
   const size_t x_pitch = l->in * dn__cell_of(l), y_pitch = l->out * sizeof(float), z_pitch = l->kind == DN__GAT_BLOCK ? dn__z_pitch(l) : 0;
   (void)worker;
   if (l->kind == DN__GAT_BLOCK) dn__block_products(l, j->x + begin * x_pitch, x_pitch, j->z + begin * z_pitch, j->y + begin * y_pitch, y_pitch, end - begin);
   else if (l->reduced.text) dn__reduced_products(&l->reduced, j->x + begin * x_pitch, x_pitch, NULL, 0, j->y + begin * y_pitch, y_pitch, end - begin);
   else dn_linear_run(&l->linear, (const float *)(const void *)j->x + begin * l->linear.in, l->linear.in, end - begin, (float *)(void *)(j->y + begin * y_pitch), l->out, NULL);
}
static void lone_attention_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const lone *j = (const lone *)job;
   const size_t y_pitch = j->block->out * sizeof(float);
   (void)worker;
   dn__block_attend(j->block, j->g, j->z, SIZE_MAX, j->y + begin * y_pitch, y_pitch, begin, end);
}
static void lone_run(lone *j, dn_range_fn *fn) /* strips of rows as a frame has them */
{
   if (j->par->run) j->par->run(j->par->user, j->rows, 168, fn, j);
   else fn(j, 0, j->rows, 0);
}
static void lone_products(void *job) { lone_run((lone *)job, lone_products_range); }
static void lone_attention(void *job) { lone_run((lone *)job, lone_attention_range); }
static void lone_pool(void *job) /* "rest" pooling: the contraction is known; rows are floats */
{
   lone *j = (lone *)job;
   const float *x = (const float *)(const void *)j->x;
   dn_pool_rescore(j->pool, j->g, x, j->in, &j->clusters, j->par);
   dn_pool_gather(j->pool, &j->clusters, x, j->in, j->in, j->coarse, j->in, j->par);
   dn_pool_scatter(j->pool, &j->clusters, j->coarse, j->in, j->in, j->rows, (float *)(void *)j->y, j->in, j->par);
}
static void fill(unsigned char *x, size_t cells, size_t size) /* numbers from -0.45 to 0.45, or as many steps */
{
   size_t i;
   for (i = 0; i < cells; i++) {
      float v = (float)(i % 31) * 0.03f - 0.45f;
      uint32_t u;
      memcpy(&u, &v, 4);
      if (size == 1) x[i] = (unsigned char)(i * 7 % 255 + 1);
      else if (size == 2) x[2 * i] = (unsigned char)(u >> 16), x[2 * i + 1] = (unsigned char)(u >> 24); /* little-endian bf16 */
      else memcpy(x + 4 * i, &v, 4);
   }
}
static layers measure_layers(bench *b, const subject *s)
{
   const dn_model *m = s->model;
   const size_t N = s->view.nodes;
   size_t i, widest = 0, z_bytes = 0;
   unsigned char *raw;
   counter c;
   dn_probe probe;
   lone j;
   layers r;
   memset(&r, 0, sizeof r);
   memset(&c, 0, sizeof c);
   memset(&j, 0, sizeof j);
   memset(&probe, 0, sizeof probe);
   c.model = m;
   probe.tap = count_rows, probe.user = &c;
   run_network_once(b, s, s->palette, &probe);
   for (i = 0; i < m->block_count; i++) {
      const dn__block *l = &m->blocks[i];
      widest = widest > l->in ? widest : l->in, widest = widest > l->out ? widest : l->out;
      if (l->kind == DN__GAT_BLOCK && z_bytes < dn__z_pitch(l)) z_bytes = dn__z_pitch(l);
   }
   j.par = &b->par[1], j.g = &s->view.graph, j.rows = N;
   raw = (unsigned char *)take(3 * 64 + N * (8 * widest + z_bytes), 1);
   j.x = raw + (64 - ((uintptr_t)raw & 63));
   j.y = j.x + (4 * N * widest + 63) / 64 * 64;
   j.z = j.y + (4 * N * widest + 63) / 64 * 64;
   for (i = 0; i < m->block_count && i < 256; i++) {
      const dn__block *l = &m->blocks[i];
      const int gat = l->kind == DN__GAT_BLOCK, kind = kind_of(l->name);
      const size_t heads = !gat ? 0 : l->reduced.text ? l->reduced.heads : l->gat.heads, sums = !gat ? 0 : heads * (l->reduced.text ? l->reduced.features : l->gat.features);
      const size_t in = gat || l->reduced.text ? l->in : l->linear.in; /* the first layer's constant columns cost nothing in a frame */
      double share = (double)c.rows[i] / (double)N;                   /* less than 1 on a pooled graph */
      if (in == 0) continue;
      j.block = l;
      fill(j.x, N * l->in, dn__cell_of(l));
      r.ms[kind] += share * alone(b, lone_products, &j);
      r.flops[kind] += 2.0 * (double)in * (double)(l->out + 2 * heads) * (double)c.rows[i];
      r.scores += 2.0 * (double)in * (double)(2 * heads) * (double)c.rows[i];
      if (!gat) continue;
      r.ms[ATTENTION] += share * alone(b, lone_attention, &j);
      /* about seven neighbours' z, each scaled and added */
      r.flops[ATTENTION] += 2.0 * (double)sums * 7.0 * (double)c.rows[i];
   }
   if (s->info.arch == DN_MULTIRESGNET) {
      const dn_pool *pool = &m->branch[0].pool;
      size_t edges = s->view.graph.first[N], bytes = dn_pool_scratch(N, edges);
      float *scores = (float *)take(edges, sizeof *scores);
      unsigned char *work = (unsigned char *)take(bytes + 64, 1);
      void *scratch = work + (64 - ((uintptr_t)work & 63));
      j.pool = pool, j.in = pool->in;
      fill(j.x, N * pool->in, sizeof(float));
      j.clusters.members = (uint32_t *)take(N, 2 * sizeof(uint32_t)), j.clusters.score = (float *)take(N, sizeof(float));
      j.clusters.cluster = (uint32_t *)take(N, sizeof(uint32_t)), j.clusters.coarse_first = (uint32_t *)take(N + 1, sizeof(uint32_t));
      j.clusters.coarse_next = (uint32_t *)take(edges, sizeof(uint32_t));
      j.coarse = (float *)take(N, pool->in * sizeof(float));
      dn_pool_scores(pool, j.g, (const float *)(const void *)j.x, j.in, scores, scratch, j.par);
      if (s->info.pooling == DN_POOL_DYNAMIC) {
         double start = ex_now_ms();
         dn_pool_scores(pool, j.g, (const float *)(const void *)j.x, j.in, scores, scratch, j.par);
         dn_pool_contract(j.g, scores, &j.clusters, scratch);
         r.ms[POOLING] = ex_now_ms() - start;
      } else dn_pool_contract(j.g, scores, &j.clusters, scratch);
      r.ms[POOLING] += alone(b, lone_pool, &j);
      free(scores), free(work), free(j.clusters.members), free(j.clusters.score), free(j.clusters.cluster);
      free(j.clusters.coarse_first), free(j.clusters.coarse_next), free(j.coarse);
   }
   free(raw);
   return r;
}

/* ===================================================================================== >>tables */
static void print_parts(bench *b, const subject *s, timing *t, const layers *l, int judged)
{
   const double network = middle(&t->part[NETWORK]), peak = b->peak[peak_of(s->info.precision)][1];
   const double N = (double)s->view.nodes;
   double flops = 0, products = 0, products_ms = 0, share, strict;
   char key[64];
   int k;
   for (k = 0; k < KINDS; k++) flops += l->flops[k];
   for (k = 0; k < KINDS; k++)
      if (k != ATTENTION && k != POOLING) products += l->flops[k], products_ms += l->ms[k];
   printf("\n%s: %lu vertices, %lu nodes, %lu edges, %lu joints; %u threads, %s, kernel %s\n", s->name, (unsigned long)s->view.vertices,
          (unsigned long)s->view.nodes, (unsigned long)s->report.edges, (unsigned long)s->view.joints, b->o.threads,
          dn_precision_name(s->info.precision), kernel_text(b));
   printf("  %-34s %9s %9s %9s %9s\n", "ms", "median", "least", "9 of 10", "ns/node");
   json_begin(b, "network", s->name);
   json_text(b, "precision", dn_precision_name(s->info.precision)), json_text(b, "kernel", kernel_text(b));
   json_number(b, "threads", b->o.threads), json_number(b, "vertices", (double)s->view.vertices), json_number(b, "nodes", N);
   json_number(b, "edges", (double)s->report.edges), json_number(b, "joints", (double)s->view.joints);
   for (k = 0; k < PARTS; k++) {
      printf("  %-34s %9.3f %9.3f %9.3f %9.1f\n", part_names[k], middle(&t->part[k]), ex_times_at(&t->part[k], 0), ex_times_at(&t->part[k], 0.9),
             1e6 * middle(&t->part[k]) / N);
      json_times(b, part_keys[k], &t->part[k]);
   }
   printf("  %.2f GFLOP a frame (%.0f + %.0f kFLOP a node: products, attention); network %.1f GFLOP/s, %.1f %% of the peak %.0f\n", flops * 1e-9,
          1e-3 * (flops - l->flops[ATTENTION]) / N, 1e-3 * l->flops[ATTENTION] / N, flops / network * 1e-6, 100 * flops / network * 1e-6 / peak, peak);
   json_number(b, "gflop", flops * 1e-9), json_number(b, "attention_gflop", l->flops[ATTENTION] * 1e-9);
   json_number(b, "network_gflops", flops / network * 1e-6), json_number(b, "peak_gflops", peak);
   if (products_ms > 0) {
      printf("  kinds of layers, each alone\n");
      for (k = 0; k < KINDS; k++) {
         if (!(l->ms[k] > 0)) continue;
         printf("    %-32s %9.3f %9s %9s %9.1f", kind_names[k], l->ms[k], "", "", 1e6 * l->ms[k] / N);
         if (l->flops[k] > 0) printf("   %6.1f GFLOP/s, %4.1f %% of the peak", l->flops[k] / l->ms[k] * 1e-6, 100 * l->flops[k] / l->ms[k] * 1e-6 / peak);
         putchar('\n');
         snprintf(key, sizeof key, "%s_alone_ms", kind_keys[k]), json_number(b, key, l->ms[k]);
         snprintf(key, sizeof key, "%s_gflop", kind_keys[k]), json_number(b, key, l->flops[k] * 1e-9);
      }
      share = products / products_ms * 1e-6;
      strict = (products - l->scores) / products_ms * 1e-6;
      printf("    %-32s %9.3f %9s %9s %9.1f   %6.1f GFLOP/s, %4.1f %% of the peak; %.1f %% if scores were for nothing\n", "all products", products_ms, "", "",
             1e6 * products_ms / N, share, 100 * share / peak, 100 * strict / peak);
      json_number(b, "products_share_of_peak", share / peak), json_number(b, "products_share_of_peak_without_scores", strict / peak);
      if (s->info.precision == DN_PRECISION_F32) {
         snprintf(key, sizeof key, "%s: float32 matrix work, share of the peak", s->name);
         add_bar(judged ? share >= 0.75 * peak : -1, key, judged ? ">= 75 %" : "", "%.1f %% (%.1f without scores)", 100 * share / peak, 100 * strict / peak);
      }
   }
   printf("  bytes: model %.2f MB, rig %.2f MB, scratch %.2f MB; %lu of %lu runs counted\n", megabytes(s->info.bytes), megabytes(s->view.bytes),
          megabytes(s->scratch_bytes), (unsigned long)t->counted, (unsigned long)t->made);
   json_number(b, "model_bytes", (double)s->info.bytes), json_number(b, "rig_bytes", (double)s->view.bytes);
   json_number(b, "scratch_bytes", (double)s->scratch_bytes), json_number(b, "counted", (double)t->counted), json_number(b, "made", (double)t->made);
   json_end(b);
   fflush(stdout);
}
/* one network in one precision: all threads in detail, then one; judged by the bars, which speak of the papers' sizes */
static void run_detail(bench *b, const subject *s, int judged)
{
   timing all, one;
   layers parts;
   char what[160];
   ex_peak_kind kind = peak_of(s->info.precision);
   measure_peak(b, kind);
   measure(b, s, 1, 20, b->o.seconds, &all);
   measure_peak(b, kind);
   memset(&parts, 0, sizeof parts);
   parts = measure_layers(b, s);
   measure_peak(b, kind);
   print_parts(b, s, &all, &parts, judged);
   if (b->o.threads > 1) {
      double single, ratio;
      measure(b, s, 0, 10, b->o.seconds, &one);
      single = middle(&one.part[FRAME]), ratio = single / middle(&all.part[FRAME]);
      printf("  one thread %.3f ms, least %.3f; %u threads %.2f times as fast (%lu of %lu runs counted)\n", single, ex_times_at(&one.part[FRAME], 0),
             b->o.threads, ratio, (unsigned long)one.counted, (unsigned long)one.made);
      json_begin(b, "threads", s->name);
      json_text(b, "precision", dn_precision_name(s->info.precision));
      json_times(b, "one_thread_frame", &one.part[FRAME]);
      json_number(b, "threads", b->o.threads), json_number(b, "times_as_fast", ratio), json_number(b, "counted", (double)one.counted), json_number(b, "made", (double)one.made);
      json_end(b);
      snprintf(what, sizeof what, "%s: %u threads against one, %s", s->name, b->o.threads, dn_precision_name(s->info.precision));
      judged = judged && b->o.threads == 2 && s->info.precision == DN_PRECISION_F32;
      add_bar(judged ? ratio >= 1.8 : -1, what, judged ? ">= 1.8" : "", "%.2f", ratio);
      timing_clear(&one);
   }
   timing_clear(&all);
}
/* mean |d - d_float32| over mean |d_float32| in the pose that is timed */
static double displacement_error(const bench *b, const subject *plain, const subject *s)
{
   const float *d, *e;
   double off = 0, all = 0;
   size_t i;
   run_network_once(b, plain, plain->palette, NULL);
   run_network_once(b, s, s->palette, NULL);
   d = dn_scratch_displacement(plain->rig, plain->scratch), e = dn_scratch_displacement(s->rig, s->scratch);
   for (i = 0; i < plain->view.nodes; i++) {
      double x = (double)e[3 * i] - (double)d[3 * i], y = (double)e[3 * i + 1] - (double)d[3 * i + 1], z = (double)e[3 * i + 2] - (double)d[3 * i + 2];
      off += sqrt(x * x + y * y + z * z);
      x = (double)d[3 * i], y = (double)d[3 * i + 1], z = (double)d[3 * i + 2];
      all += sqrt(x * x + y * y + z * z);
   }
   return all > 0 ? off / all : off;
}
/* the bars that speak of densegats, at their number of nodes */
static void precision_bars(bench *b, const subject *s, double frame, double ratio, double error)
{
   const char *p = dn_precision_name(s->info.precision);
   const int bf16 = strcmp(p, "bf16") == 0, int8 = strcmp(p, "int8") == 0, dense = strcmp(s->name, "densegats") == 0 && s->view.nodes == 10220;
   char what[160];
   if (ratio > 0) {
      snprintf(what, sizeof what, "%s: %s frame over float32 frame", s->name, p);
      add_bar(dense && bf16 ? ratio <= 0.62 : dense && int8 ? ratio <= 0.45 : -1, what, dense && bf16 ? "<= 0.62" : dense && int8 ? "<= 0.45" : "", "%.3f", ratio);
      snprintf(what, sizeof what, "%s: %s displacement off, of the mean displacement", s->name, p);
      add_bar(bf16 ? error <= 0.01 : -1, what, bf16 ? "<= 1 %" : "", "%.3g %%", 100 * error);
   }
   if (!dense) return;
   snprintf(what, sizeof what, "densegats: scratch at 10,220 nodes, %s", p);
   if (bf16 || int8) add_bar(megabytes(s->scratch_bytes) <= 8, what, "<= 8 MB", "%.2f MB", megabytes(s->scratch_bytes));
   else add_bar(megabytes(s->scratch_bytes) <= 16, what, "<= 16 MB", "%.2f MB", megabytes(s->scratch_bytes));
   snprintf(what, sizeof what, "densegats: the aim, 10,220 vertices on two threads, %s", p);
   add_bar(b->o.threads == 2 ? frame <= 31 : -1, what, "31 ms", "%.1f ms", frame);
}
/* float32 and what else there is, in turns */
static void run_precisions(bench *b, source *from, const body *m)
{
   subject s[DN_PRECISION_COUNT];
   ex_times t[DN_PRECISION_COUNT];
   double plain;
   size_t count = 0, k;
   int p;
   dn_error e;
   for (p = 0; p < DN_PRECISION_COUNT; p++) {
      dn_model *model;
      if (p != DN_PRECISION_F32 && b->o.precision >= 0 && p != b->o.precision) continue;
      model = load_calibrated(b, from, (dn_precision)p, m, &e);
      if (model) s[count++] = subject_of(b, from->name, model, m);
      else printf("  %s: not run: %s\n", dn_precision_name((dn_precision)p), e.info);
   }
   take_turns(b, s, count, 16, b->o.seconds * (double)count, t);
   plain = middle(&t[0]);
   printf("  precisions in turns\n    %-6s %10s %10s %10s %12s %12s %10s %10s %12s\n", "", "frame ms", "least", "of f32", "off, %", "peak GFLOP/s", "model MB",
          "scratch MB", "counted");
   for (k = 0; k < count; k++) {
      double frame = middle(&t[k]), error = k ? displacement_error(b, &s[0], &s[k]) : 0;
      ex_peak_kind kind = peak_of(s[k].info.precision);
      measure_peak(b, kind);
      printf("    %-6s %10.3f %10.3f %10.3f %12.4g %12.0f %10.2f %10.2f %6lu of %lu\n", dn_precision_name(s[k].info.precision), frame, ex_times_at(&t[k], 0),
             frame / plain, 100 * error, b->peak[kind][1], megabytes(s[k].info.bytes), megabytes(s[k].scratch_bytes), (unsigned long)t[k].n[0], (unsigned long)t[k].n[1]);
      json_begin(b, "precision", from->name);
      json_text(b, "precision", dn_precision_name(s[k].info.precision)), json_text(b, "kernel", kernel_text(b)), json_number(b, "threads", b->o.threads);
      json_number(b, "nodes", (double)s[k].view.nodes), json_times(b, "frame", &t[k]), json_number(b, "of_f32", frame / plain), json_number(b, "error", error);
      json_number(b, "peak_gflops", b->peak[kind][1]), json_number(b, "model_bytes", (double)s[k].info.bytes), json_number(b, "scratch_bytes", (double)s[k].scratch_bytes);
      json_number(b, "counted", (double)t[k].n[0]), json_number(b, "made", (double)t[k].n[1]), json_number(b, "calibrated_here", from->calibrated);
      json_end(b);
      precision_bars(b, &s[k], frame, k ? frame / plain : 0, error);
   }
   for (k = 0; k < count; k++) ex_times_clear(&t[k]), subject_free(&s[k]);
   fflush(stdout);
}
/* a small model and multiresgnet at the paper's size, in turns */
static void run_lite(bench *b, const source *paper, const body *m)
{
   source from = source_of(b, "lite", b->o.lite);
   dn_error e;
   dn_model *model[2];
   subject s[2];
   ex_times t[2];
   double ratio;
   int k;
   model[0] = load(b, paper, DN_PRECISION_F32, &e);
   if (!model[0]) ex_die("%s: %s", paper->name, e.info);
   model[1] = load(b, &from, DN_PRECISION_F32, &e);
   if (!model[1]) ex_die("%s: %s", b->o.lite, e.info);
   for (k = 0; k < 2; k++) s[k] = subject_of(b, k ? from.name : paper->name, model[k], m);
   run_detail(b, &s[1], 0);
   take_turns(b, s, 2, 20, b->o.seconds, t);
   ratio = middle(&t[0]) / middle(&t[1]);
   printf("  in turns with %s at the paper's size: %.3f and %.3f ms, %.2f times as fast (%lu of %lu runs counted)\n", paper->name, middle(&t[0]), middle(&t[1]), ratio,
          (unsigned long)(t[0].n[0] + t[1].n[0]), (unsigned long)(t[0].n[1] + t[1].n[1]));
   json_begin(b, "lite", paper->name);
   json_times(b, "paper_frame", &t[0]), json_times(b, "lite_frame", &t[1]), json_number(b, "times_as_fast", ratio), json_number(b, "nodes", (double)s[0].view.nodes);
   json_end(b);
   add_bar(ratio >= 6, "lite model: times as fast as multiresgnet", ">= 6", "%.2f", ratio);
   for (k = 0; k < 2; k++) ex_times_clear(&t[k]), subject_free(&s[k]);
   free(from.bytes);
}

/* linear blend skinning alone: a rig without a model, one thread. The bar was set against a peak of 115 GFLOP/s a core */
static void run_skinning(bench *b)
{
   body m = body_made(b, 10220, 65);
   subject s = subject_of(b, "skinning", NULL, &m);
   ex_times t;
   dn_pose p;
   dn_error e;
   int k;
   double end = ex_now_ms() + 500 * b->o.seconds, ns, least, bar_ns;
   char wanted[48];
   memset(&t, 0, sizeof t);
   memset(&p, 0, sizeof p);
   p.palette = s.palette;
   measure_peak(b, EX_PEAK_F32);
   do { /* a hundred at a time: one takes some ten microseconds */
      double start;
      ex_quiet_begin(b->quiet);
      start = ex_now_ms();
      for (k = 0; k < 100; k++)
         if (dn_stage_skin(s.rig, &p, s.scratch, s.scratch_bytes, NULL, &e) != DN_OK) ex_die("skinning: %s", e.info);
      start = ex_now_ms() - start;
      ex_times_add(&t, start / 100, ex_quiet_end(b->quiet));
   } while (ex_now_ms() < end && t.n[0] < 200);
   ns = 1e6 * middle(&t) / (double)s.view.vertices, least = 1e6 * ex_times_at(&t, 0) / (double)s.view.vertices;
   bar_ns = 3.45 * 115 / b->peak[EX_PEAK_F32][0];
   printf("\nskinning (LBS): %lu vertices, 4 influences, %lu joints, one thread: %.2f ns a vertex, least %.2f (%lu of %lu counted)\n",
          (unsigned long)s.view.vertices, (unsigned long)s.view.joints, ns, least, (unsigned long)t.n[0], (unsigned long)t.n[1]);
   json_begin(b, "skinning", "lbs");
   json_text(b, "kernel", kernel_text(b)), json_number(b, "vertices", (double)s.view.vertices), json_number(b, "joints", (double)s.view.joints);
   json_number(b, "ns_per_vertex", ns), json_number(b, "least_ns_per_vertex", least), json_number(b, "peak_gflops", b->peak[EX_PEAK_F32][0]);
   json_number(b, "counted", (double)t.n[0]), json_number(b, "made", (double)t.n[1]);
   json_end(b);
   snprintf(wanted, sizeof wanted, "<= %.2f ns", bar_ns);
   add_bar(ns <= bar_ns, "LBS, 4 influences, one thread (3.45 ns at 115 GFLOP/s a core)", wanted, "%.2f ns", ns);
   ex_times_clear(&t);
   subject_free(&s);
   ex_made_free(m.made);
}

/* weld, graph and geodesic distances of a character, or of a ring of about a person's volume */
static void run_bind(bench *b, ex_scene *scene)
{
   dn_error e;
   source from = source_of(b, "densegats", NULL);
   dn_model *m = load(b, &from, DN_PRECISION_F32, &e);
   ex_made *made = scene ? NULL : ex_made_mesh(13000, 65, 0.09, 0);
   ex_times t;
   dn_report r;
   double end = ex_now_ms() + 1e3 * b->o.seconds, ms;
   if (!m || (!scene && !made)) ex_die("bind: out of memory");
   memset(&t, 0, sizeof t);
   memset(&r, 0, sizeof r);
   do {
      dn_rig_desc d;
      dn_skin_set skin;
      dn_model_info info;
      dn_rig *rig;
      double start;
      dn_model_describe(m, &info);
      if (scene) ex_describe(scene, &d, &skin);
      else made_desc(made, &d, &skin, &info);
      if (scene && scene->joints == info.joints) d.skeleton.names = info.joint_names;
      d.geodesic = NULL;
      d.parallel = &b->par[1];
      ex_quiet_begin(b->quiet);
      start = ex_now_ms();
      rig = dn_rig_create(m, &d, NULL, &r, &e);
      start = ex_now_ms() - start;
      ex_times_add(&t, start, ex_quiet_end(b->quiet));
      if (!rig) ex_die("bind: %s", e.info);
      dn_rig_free(rig);
   } while (ex_now_ms() < end && t.n[0] < 5);
   ms = middle(&t);
   printf("\nbind: %lu vertices, %lu nodes, %lu solid cells, %u threads: %.0f ms, least %.0f (%lu of %lu counted)\n", (unsigned long)r.vertices,
          (unsigned long)r.nodes, (unsigned long)r.solid_cells, b->o.threads, ms, ex_times_at(&t, 0), (unsigned long)t.n[0], (unsigned long)t.n[1]);
   json_begin(b, "bind", scene ? scene->path : "made");
   json_number(b, "vertices", (double)r.vertices), json_number(b, "nodes", (double)r.nodes), json_number(b, "solid_cells", (double)r.solid_cells);
   json_number(b, "threads", b->o.threads), json_times(b, "bind", &t), json_number(b, "counted", (double)t.n[0]), json_number(b, "made", (double)t.n[1]);
   json_end(b);
   add_bar(b->o.threads == 2 ? ms <= 1000 : -1, scene ? "bind of the character, R = 128" : "bind of 13,000 vertices, 65 joints, R = 128", "<= 1000 ms", "%.0f ms", ms);
   ex_times_clear(&t);
   ex_made_free(made);
   dn_model_free(m);
   free(from.bytes);
}

/* cost against size. Meshes that do not fit into a part of the memory that is free are left out, and said so */
static void run_sizes(bench *b, source *from)
{
   static const size_t sizes[] = { 1000, 3000, 10000, 30000, 100000, 300000, 1000000 };
   double at_ten = 0, at_million = 0;
   size_t i;
   char what[96];
   dn_precision precision = b->o.precision >= 0 ? (dn_precision)b->o.precision : DN_PRECISION_F32;
   printf("\n%s against the number of nodes, %u threads, %s\n  %9s %10s %10s %12s %10s %10s %10s\n", from->name, b->o.threads, dn_precision_name(precision), "nodes",
          "frame ms", "least", "ns/node", "cold ms", "rig MB", "scratch MB");
   for (i = 0; i < sizeof sizes / sizeof *sizes && sizes[i] <= b->o.largest; i++) {
      double pages = (double)sysconf(_SC_AVPHYS_PAGES) * (double)sysconf(_SC_PAGESIZE), needs, ns;
      dn_error e;
      dn_model *model;
      dn_model_info info;
      subject s;
      body m;
      timing t;
      m.made = NULL, m.scene = NULL;
      model = load(b, from, precision, &e);
      if (!model) ex_die("%s: %s", from->name, e.info);
      dn_model_describe(model, &info);
      needs = (double)sizes[i] * (double)(info.row_width + 900 + 3 * info.joints) * sizeof(float);
      if (needs > 0.8 * pages) {
         printf("  %9lu left out: needs about %.1f GB, %.1f GB are free\n", (unsigned long)sizes[i], needs * 1e-9, pages * 1e-9);
         dn_model_free(model);
         continue;
      }
      m = body_made(b, sizes[i], info.joints ? info.joints : 65);
      s = subject_of(b, from->name, model, &m);
      measure(b, &s, 1, sizes[i] > 100000 ? 3 : 10, b->o.seconds / 2, &t);
      ns = 1e6 * middle(&t.part[FRAME]) / (double)s.view.nodes;
      if (sizes[i] == 10000) at_ten = ns;
      if (sizes[i] == 1000000) at_million = ns;
      printf("  %9lu %10.3f %10.3f %12.1f %10.3f %10.2f %10.2f   (%lu of %lu counted)\n", (unsigned long)s.view.nodes, middle(&t.part[FRAME]),
             ex_times_at(&t.part[FRAME], 0), ns, middle(&t.part[COLD]), megabytes(s.view.bytes), megabytes(s.scratch_bytes), (unsigned long)t.counted, (unsigned long)t.made);
      json_begin(b, "size", from->name);
      json_text(b, "precision", dn_precision_name(precision)), json_number(b, "threads", b->o.threads), json_number(b, "nodes", (double)s.view.nodes);
      json_times(b, "frame", &t.part[FRAME]), json_times(b, "cold_frame", &t.part[COLD]), json_number(b, "ns_per_node", ns);
      json_number(b, "rig_bytes", (double)s.view.bytes), json_number(b, "scratch_bytes", (double)s.scratch_bytes);
      json_number(b, "counted", (double)t.counted), json_number(b, "made", (double)t.made);
      json_end(b);
      fflush(stdout);
      timing_clear(&t);
      subject_free(&s);
      ex_made_free(m.made);
   }
   snprintf(what, sizeof what, "%s: ns per node at 1,000,000 over 10,000", from->name);
   if (at_ten > 0 && at_million > 0) add_bar(at_million <= 1.3 * at_ten, what, "<= 1.3", "%.2f", at_million / at_ten);
}

/* a garment of the clothing paper on a body: coarse stage, parser and detail */
static void run_garment(bench *b, size_t nodes)
{
   source from = source_of(b, "clothnet", NULL);
   dn_error e;
   dn_model *m = load(b, &from, DN_PRECISION_F32, &e);
   dn_model_info info;
   ex_made *wearer = ex_made_mesh(6000, 24, 0.4, 0), *cloth = ex_made_mesh(nodes, 24, 0.46, b->o.shuffle);
   dn_garment_desc d;
   dn_rig_desc rig;
   dn_skin_set skin;
   dn_garment *g;
   dn_garment_view view;
   dn_garment_pose p;
   dn_garment_output out;
   float fixed[85], *positions, *normals;
   size_t bytes, k;
   void *scratch;
   ex_times t[5];
   static const char *const keys[] = { "follow", "coarse", "detail", "output", "frame" };
   static const char *const names[] = { "follow", "coarse stage", "detail stage", "output and normals", "frame" };
   double end;
   if (!m) ex_die("clothnet: %s", e.info);
   if (!wearer || !cloth) ex_die("out of memory");
   dn_model_describe(m, &info);
   memset(&d, 0, sizeof d);
   memset(&p, 0, sizeof p);
   memset(&out, 0, sizeof out);
   memset(t, 0, sizeof t);
   for (k = 0; k < 85; k++) fixed[k] = 0.2f * (float)(k % 5) - 0.4f;
   made_desc(wearer, &rig, &skin, &info);
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
   p.palette = wearer->palette, p.theta = fixed + 13, p.strength = 1;
   out.positions = positions, out.normals = normals;
   end = ex_now_ms() + 1e3 * b->o.seconds;
   dn_garment_deform(g, &p, &out, scratch, bytes, &b->par[1], &e);
   do {
      double at[5];
      int counts;
      ex_quiet_begin(b->quiet);
      at[0] = ex_now_ms();
      if (dn_garment_stage_follow(g, &p, scratch, bytes, &b->par[1], &e) != DN_OK) ex_die("clothnet: %s", e.info);
      at[1] = ex_now_ms();
      dn_garment_stage_coarse(g, &p, scratch, &b->par[1], NULL);
      at[2] = ex_now_ms();
      dn_garment_stage_refine(g, &p, scratch, &b->par[1], NULL);
      at[3] = ex_now_ms();
      if (dn_garment_stage_output(g, &p, &out, scratch, &b->par[1], &e) != DN_OK) ex_die("clothnet: %s", e.info);
      at[4] = ex_now_ms();
      counts = ex_quiet_end(b->quiet);
      for (k = 0; k < 4; k++) ex_times_add(&t[k], at[k + 1] - at[k], counts);
      ex_times_add(&t[4], at[4] - at[0], counts);
   } while (ex_now_ms() < end && t[4].n[0] < 20);
   printf("\nclothnet: garment of %lu nodes on a body of %lu; %u threads, float32, kernel %s\n  %-34s %9s %9s %9s %9s\n", (unsigned long)view.nodes,
          (unsigned long)view.body_nodes, b->o.threads, kernel_text(b), "ms", "median", "least", "9 of 10", "ns/node");
   for (k = 0; k < 5; k++)
      printf("  %-34s %9.3f %9.3f %9.3f %9.1f\n", names[k], middle(&t[k]), ex_times_at(&t[k], 0), ex_times_at(&t[k], 0.9), 1e6 * middle(&t[k]) / (double)view.nodes);
   printf("  bytes: model %.2f MB, garment %.2f MB, scratch %.2f MB; %lu of %lu runs counted\n", megabytes(info.bytes), megabytes(view.bytes),
          megabytes(bytes), (unsigned long)t[4].n[0], (unsigned long)t[4].n[1]);
   json_begin(b, "garment", "clothnet");
   json_text(b, "precision", "f32"), json_text(b, "kernel", kernel_text(b)), json_number(b, "threads", b->o.threads), json_number(b, "nodes", (double)view.nodes);
   json_number(b, "body_nodes", (double)view.body_nodes);
   for (k = 0; k < 5; k++) json_times(b, keys[k], &t[k]);
   json_number(b, "model_bytes", (double)info.bytes), json_number(b, "garment_bytes", (double)view.bytes), json_number(b, "scratch_bytes", (double)bytes);
   json_number(b, "counted", (double)t[4].n[0]), json_number(b, "made", (double)t[4].n[1]);
   json_end(b);
   for (k = 0; k < 5; k++) ex_times_clear(&t[k]);
   dn_scratch_free(scratch, bytes, NULL);
   dn_garment_free(g);
   dn_model_free(m);
   ex_made_free(wearer);
   ex_made_free(cloth);
   free(positions);
   free(normals);
   free(from.bytes);
}

/* ===================================================================================== >>main */
static void run_network(bench *b, const char *arch, const char *path, ex_scene *scene, int first)
{
   source from = source_of(b, arch, path);
   dn_precision precision = b->o.precision >= 0 ? (dn_precision)b->o.precision : DN_PRECISION_F32;
   dn_error e;
   dn_model *m = load(b, &from, DN_PRECISION_F32, &e);
   dn_model_info info;
   subject s;
   body mesh;
   if (!m) ex_die("%s: %s", path ? path : arch, e.info);
   dn_model_describe(m, &info);
   if (info.arch > DN_MULTIRESGNET) ex_die("%s: a %s model; here run those for characters", path, info.arch_name);
   from.name = info.arch_name; /* static text */
   mesh.made = NULL, mesh.scene = scene;
   if (!scene) mesh = body_made(b, b->o.nodes ? b->o.nodes : 10220, info.joints ? info.joints : 65);
   if (precision != DN_PRECISION_F32) {
      dn_model_free(m);
      m = load_calibrated(b, &from, precision, &mesh, &e);
      if (!m) ex_die("%s: %s", from.name, e.info);
   }
   s = subject_of(b, from.name, m, &mesh);
   run_detail(b, &s, !path);
   subject_free(&s);
   run_precisions(b, &from, &mesh);
   if (info.arch == DN_MULTIRESGNET && b->o.lite && !path) run_lite(b, &from, &mesh);
   ex_made_free(mesh.made);
   if (first && b->o.largest && !scene) run_sizes(b, &from);
   free(from.bytes);
}
int main(int argc, char **argv)
{
   static const char *const standard[] = { "densegats", "multiresgnet", "clothnet" };
   static bench b;
   ex_scene *scene = NULL;
   char error[EX_ERROR], lite[1024];
   size_t k, count;
   ex_program("bench");
   b.o = read_options(argc, argv);
   if (!b.o.lite) {
      b.o.lite = ex_bundled(argv[0], "models/humanoid_lite.safetensors", lite, sizeof lite);
      if (access(b.o.lite, R_OK) != 0) b.o.lite = NULL;
   }
   b.pool = ex_pool_create(b.o.threads);
   b.quiet = b.pool ? ex_quiet_create(b.o.noise) : NULL;
   b.evict = (unsigned char *)take(EVICT, 1);
   if (!b.quiet) ex_die("out of memory or threads");
   b.par[1] = ex_pool_parallel(b.pool);
   if (b.o.json && !(b.json = fopen(b.o.json, "w"))) ex_die("%s: cannot be written", b.o.json);
   if (b.json) fputs("[", b.json);
   if (b.o.character && !(scene = ex_scene_load(b.o.character, error))) ex_die("%s", error);
   if (ex_quiet_blind(b.quiet)) puts("/proc does not tell how busy the processors are: every run counts");
   for (k = 0; k < EX_PEAKS; k++) measure_peak(&b, (ex_peak_kind)k);
   printf("deformnet %d.%d.%d, kernel %s, %u threads of %ld processors\npeak, GFLOP/s on one and on all threads: float32 %.0f %.0f, bf16 %.0f %.0f, int8 %.0f %.0f\n",
          DN_VERSION / 10000, DN_VERSION / 100 % 100, DN_VERSION % 100, kernel_text(&b), b.o.threads, sysconf(_SC_NPROCESSORS_ONLN), b.peak[0][0],
          b.peak[0][1], b.peak[1][0], b.peak[1][1], b.peak[2][0], b.peak[2][1]);
   run_skinning(&b);
   run_bind(&b, scene);
   count = b.o.model || b.o.arch ? 1 : 3;
   for (k = 0; k < count; k++) {
      const char *arch = b.o.model ? "model" : b.o.arch ? b.o.arch : standard[k];
      if (strcmp(arch, "clothnet") == 0) run_garment(&b, b.o.nodes ? b.o.nodes : 3500);
      else run_network(&b, arch, b.o.model, scene, k == 0);
   }
   print_bars(&b);
   printf("\n%lu of %lu runs counted: during the others the machine was busy with something else\n", (unsigned long)ex_quiet_counted(b.quiet),
          (unsigned long)ex_quiet_made(b.quiet));
   json_begin(&b, "run", NULL);
   json_text(&b, "kernel", kernel_text(&b)), json_number(&b, "threads", b.o.threads), json_number(&b, "processors", (double)sysconf(_SC_NPROCESSORS_ONLN));
   json_number(&b, "counted", (double)ex_quiet_counted(b.quiet)), json_number(&b, "made", (double)ex_quiet_made(b.quiet));
   json_number(&b, "peak_f32_gflops", b.peak[0][0]), json_number(&b, "peak_f32_all_gflops", b.peak[0][1]), json_number(&b, "peak_bf16_gflops", b.peak[1][0]);
   json_number(&b, "peak_bf16_all_gflops", b.peak[1][1]), json_number(&b, "peak_int8_gflops", b.peak[2][0]), json_number(&b, "peak_int8_all_gflops", b.peak[2][1]);
   json_end(&b);
   if (b.json && (fputs("\n]\n", b.json) == EOF || fclose(b.json) != 0)) ex_die("%s: cannot be written", b.o.json);
   ex_scene_free(scene);
   ex_quiet_free(b.quiet);
   ex_pool_free(b.pool);
   free(b.evict);
   return 0;
}
