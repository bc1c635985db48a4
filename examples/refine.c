/*  refine.c - refine a skinned, animated character with a trained network, and say what it gains and costs
    shows     the whole use of deformnet.h: load a model, bind a character, deform frame by frame with threads, time the
              stages apart, compare with a truth, write frames, a picture and a JSON report
    not here  reading files (common/scene.h), the pictures (common/picture.h), threads (common/pool.h), training (train/)
    build     make refine
    run       ./refine                                     the bundled demo
              ./refine --character C.glb --motion A.glb --out refined.glb
              ./refine --character C.glb --truth T.safetensors --picture errors.png --json report.json
    flow      character --bind--> rig --+
              motion or truth --> palettes (S,3,4) --skin, features, network, normals--> vertices (V,3), every frame
              truth (V,3) ----------------------------------------------------------> errors, picture */
#define _POSIX_C_SOURCE 200809L
#define DEFORMNET_IMPLEMENTATION
#include "../deformnet.h"
#include "common/picture.h"
#include "common/pool.h"
#include "common/scene.h"
#include "common/tool.h"
#include <errno.h>
#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* ===================================================================================== >>small things */
static const char usage[] =
   "usage: refine [--model M.safetensors] [--character C.glb|C.safetensors] [--motion A.glb] [--animation NAME]\n"
   "              [--frames a:b] [--truth T.safetensors] [--threads n] [--precision f32|f16|bf16|int8]\n"
   "              [--every k [--lead x] [--ahead]] [--coarse share]\n"
   "              [--out O.glb|O.safetensors] [--picture P.png] [--json R.json]\n"
   "  without --character, --motion and --truth: the bundled demo\n"
   "  --frames a:b  frames a, a+1 .. b-1 (either may be left out); with --truth, by the truth's own frame numbers\n"
   "  --precision   what the network computes in (f32); int8 needs a model with ranges: calibrate makes one\n"
   "  --truth       evaluates the truth's poses; frames that it marks as not settled are left out and counted\n"
   "                with --motion: plays that motion in full, and compares the frames that the truth has\n"
   "  --every k     beside the plain run, one with the network in every k-th frame only, and what that costs and saves\n"
   "  --lead x      ... aims past each evaluation by x of its step, 0 .. 1; default 0.5\n"
   "  --ahead       ... evaluates the pose of k - 1 frames on, as a program can that knows the motion; lead 0\n"
   "  --coarse x    the second run's network sees that share of the nodes, 0 .. 1; with --every or alone\n";

static int by_float(const void *a, const void *b)
{
   float x = *(const float *)a, y = *(const float *)b;
   return (x > y) - (x < y);
}
typedef struct figures { double mean, p99, max; } figures; /* centimetres */
static figures measure(float *error, size_t n) /* metres; sorts error. The 99th percentile is interpolated linearly */
{
   figures f = { 0, 0, 0 };
   double at = 0.99 * (double)(n ? n - 1 : 0);
   size_t i = (size_t)at;
   if (n == 0) return f;
   qsort(error, n, sizeof *error, by_float);
   for (i = 0; i < n; i++) f.mean += (double)error[i];
   f.mean *= 100.0 / (double)n;
   f.max = 100.0 * (double)error[n - 1];
   i = (size_t)at;
   f.p99 = 100.0 * ((double)error[i] + (at - (double)i) * (double)(error[i + 1 < n ? i + 1 : i] - error[i]));
   return f;
}

/* ===================================================================================== >>options */
typedef struct options {
   const char *model, *character, *motion, *animation, *truth, *out, *picture, *json;
   long first, end; /* frames */
   unsigned threads;
   dn_precision precision;
   unsigned every;  /* 0: no second run */
   float lead, coarse; /* coarse 0: the full mesh */
   int ahead;
} options;

static int read_number(const char *s, const char **end, long *value)
{
   char *e;
   errno = 0;
   *value = strtol(s, &e, 10);
   *end = e;
   return e == s || errno != 0 || *value < 0;
}

static int read_share(const char *s, float low, float high, float *value) /* non-zero: it is none */
{
   char *e;
   *value = strtof(s, &e);
   return e == s || *e || !(*value >= low && *value <= high);
}

static int read_options(options *o, int argc, char **argv)
{
   int i;
   memset(o, 0, sizeof *o);
   o->end = LONG_MAX;
   o->lead = -1;
   for (i = 1; i < argc; i++) {
      const char *key = argv[i], *value = i + 1 < argc ? argv[i + 1] : NULL, *rest;
      const char **text = strcmp(key, "--model") == 0     ? &o->model
                        : strcmp(key, "--character") == 0 ? &o->character
                        : strcmp(key, "--motion") == 0    ? &o->motion
                        : strcmp(key, "--animation") == 0 ? &o->animation
                        : strcmp(key, "--truth") == 0     ? &o->truth
                        : strcmp(key, "--out") == 0       ? &o->out
                        : strcmp(key, "--picture") == 0   ? &o->picture
                        : strcmp(key, "--json") == 0      ? &o->json
                                                          : NULL;
      long n;
      if (strcmp(key, "--help") == 0 || strcmp(key, "-h") == 0) {
         fputs(usage, stdout);
         exit(0);
      }
      if (strcmp(key, "--ahead") == 0) {
         o->ahead = 1;
         continue;
      }
      if (!text && strcmp(key, "--threads") != 0 && strcmp(key, "--frames") != 0 && strcmp(key, "--every") != 0 &&
          strcmp(key, "--lead") != 0 && strcmp(key, "--coarse") != 0 && strcmp(key, "--precision") != 0)
         return ex_say("unknown argument \"%s\" (--help lists them)", key);
      if (!value) return ex_say("%s needs a value", key);
      i++;
      if (text) *text = value;
      else if (strcmp(key, "--precision") == 0) {
         if (ex_precision_named(value) < 0) return ex_say("--precision %s: expected f32, f16, bf16 or int8", value);
         o->precision = (dn_precision)ex_precision_named(value);
      } else if (strcmp(key, "--threads") == 0) {
         if (read_number(value, &rest, &n) || *rest || n < 1 || n > 256) return ex_say("--threads %s: expected 1 to 256", value);
         o->threads = (unsigned)n;
      } else if (strcmp(key, "--every") == 0) {
         if (read_number(value, &rest, &n) || *rest || n < 1 || n > 1000) return ex_say("--every %s: expected 1 to 1000", value);
         o->every = (unsigned)n;
      } else if (strcmp(key, "--coarse") == 0) {
         if (read_share(value, 1e-4f, 1, &o->coarse)) return ex_say("--coarse %s: expected a share above 0, at most 1", value);
      } else if (strcmp(key, "--lead") == 0) {
         if (read_share(value, 0, 1, &o->lead)) return ex_say("--lead %s: expected 0 to 1", value);
      } else {
         rest = value;
         if (*rest != ':' && read_number(rest, &rest, &o->first)) return ex_say("--frames %s: expected a:b", value);
         if (*rest++ != ':' || (*rest && read_number(rest, &rest, &o->end)) || *rest || o->end <= o->first)
            return ex_say("--frames %s: expected a:b with a < b", value);
      }
   }
   if (o->out && !ex_ends_with(o->out, ".glb") && !ex_ends_with(o->out, ".safetensors"))
      return ex_say("--out %s: expected a name ending in .glb or .safetensors", o->out);
   if (o->coarse > 0 && !o->every) o->every = 1;
   if ((o->ahead || o->lead >= 0) && !o->every) return ex_say("--lead and --ahead belong to --every");
   if (o->ahead && o->lead > 0) return ex_say("--ahead needs no --lead: its evaluations come in time");
   if (o->lead < 0) o->lead = o->ahead || o->every < 2 ? 0 : 0.5f;
   if (!o->threads) o->threads = ex_processors();
   return 0;
}

/* ===================================================================================== >>truth */
typedef struct truth {
   ex_tensors *file;
   const ex_tensor *vertices; /* (F,V,3) */
   uint32_t *numbers;         /* (F) frame numbers of the motion */
   float *settled;            /* (F) 0: left out; NULL: the file does not say */
   size_t frames;
} truth;

static void truth_close(truth *t)
{
   ex_tensors_close(t->file);
   free(t->numbers);
   free(t->settled);
   memset(t, 0, sizeof *t);
}

static int truth_open(truth *t, const char *path, const ex_scene *scene)
{
   char error[EX_ERROR];
   size_t sides[3], f;
   const ex_tensor *numbers, *settled;
   memset(t, 0, sizeof *t);
   t->file = ex_tensors_open(path, error);
   if (!t->file) return ex_say("%s", error);
   sides[0] = 0, sides[1] = scene->vertices, sides[2] = 3;
   t->vertices = ex_tensors_get(t->file, "vertices", 3, sides, error);
   if (!t->vertices) return ex_say("%s", error);
   if (t->vertices->type != EX_F32) return ex_say("%s: vertices: expected F32, file has %s", path, ex_dtype_name(t->vertices->type));
   t->frames = t->vertices->shape[0];
   t->numbers = (uint32_t *)ex_take(t->frames, sizeof *t->numbers);
   if (!t->numbers) return ex_say("%s: out of memory", path);
   for (f = 0; f < t->frames; f++) t->numbers[f] = (uint32_t)f;
   if (ex_tensors_find(t->file, "frames")) {
      numbers = ex_tensors_get(t->file, "frames", 1, &t->frames, error);
      if (!numbers || !ex_tensor_u32(t->file, numbers, t->numbers, error)) return ex_say("%s", error);
   }
   if (ex_tensors_find(t->file, "settled")) {
      settled = ex_tensors_get(t->file, "settled", 1, &t->frames, error);
      t->settled = settled ? (float *)ex_take(t->frames, sizeof *t->settled) : NULL;
      if (!t->settled) return ex_say("%s", settled ? "out of memory" : error);
      ex_tensor_f32(settled, t->settled);
   }
   return 0;
}

/* ===================================================================================== >>bind */
static int show_progress(void *user, const char *stage, float done)
{
   (void)user;
   fprintf(stderr, "\r%s %3.0f %%  %s", stage, (double)(done * 100), done >= 1 ? "\r                              \r" : "");
   return 0;
}

/* coarse: NULL, or the mesh to bind in place of the scene's */
static dn_rig *bind(const dn_model *model, const ex_scene *s, const dn_coarse *coarse, const dn_parallel *parallel, dn_report *report,
                    dn_error *err)
{
   dn_rig_desc d;
   dn_skin_set set;
   dn_progress progress;
   memset(&progress, 0, sizeof progress);
   ex_describe(s, &d, &set);
   if (isatty(2)) progress.step = show_progress;
   d.progress = &progress;
   d.parallel = parallel;
   if (coarse) dn_coarse_describe(coarse, &d, &d);
   return dn_rig_create(model, &d, NULL, report, err);
}

/* ===================================================================================== >>budget */
/* a second run of the same frames with less of the network, beside the plain one */
typedef struct budget {
   dn_track track;
   void *track_block, *scratch_block, *scratch;
   size_t scratch_bytes;
   float *correction;                /* (N,3) */
   dn_coarse coarse;                 /* with --coarse: the mesh that the network runs on */
   dn_rig *coarse_rig;
   void *coarse_block, *coarse_scratch_block, *coarse_scratch;
   size_t coarse_scratch_bytes;
   float *coarse_correction;         /* (M,3) */
   double ms_coarse;                 /* to make and bind it */
   float *positions, *normals;       /* (V,3) */
   float *error;                     /* (compared,V) with a truth */
   float *gap;                       /* (frames,V) to the plain run */
   float *jump, *before[2];          /* as the plain run's */
   double *ms_carry, *ms_evaluate;   /* (frames), (evaluations) */
   size_t evaluations, worse_frames;
   figures ours, gaps, jumps;
   double ms_mean, ms_carried, ms_evaluated;
} budget;

/* ===================================================================================== >>the job */
enum { SKIN, FEATURES, NETWORK, NORMALS, STAGES };

typedef struct job {
   options o;
   dn_model *model;
   dn_model_info info;
   ex_scene *scene;
   ex_motion *motion;
   truth truth;
   ex_pool *pool;
   dn_parallel parallel;
   dn_rig *rig;
   dn_rig_view view;
   dn_report report;
   void *scratch_block, *scratch;
   size_t scratch_bytes;
   size_t *frame, frames, unsettled; /* the motion's frames evaluated */
   size_t *wanted, compared;         /* (frames) the truth's frame beside each, or NONE; how many have one */
   double *ms[STAGES], *total;       /* (frames) */
   double ms_bind, ms_stage[STAGES], ms_total;
   float *refined, *normals;         /* (frames,V,3) when they are written out, else (V,3) */
   float *skinned, *skinned_normals; /* (V,3) of the frame at hand */
   float *lbs_error, *refined_error; /* (compared,V) with a truth, else (frames,V) */
   float *before[2][2];              /* (V,3) refined - skinned and truth - skinned, one and two frames ago */
   float *jump[2];                   /* (frames,V) their second differences in time */
   figures jumps[2];
   double *lbs_mean, *refined_mean;  /* (compared) centimetres; without a truth refined_mean is the displacement's */
   float *worst[6];                  /* the picture's frame: skinned, refined, truth positions, then their normals */
   size_t worst_frame, worst_number; /* among the compared; in the motion */
   budget budget;
   size_t fallback_nodes, fallback_frames, worse_frames, resting, resting_kept;
   figures lbs, ours;
} job;

static const size_t NONE = (size_t)-1;

/* Which of the motion's frames are asked for, and of those, which the truth calls settled. A motion that is not the truth's
   own is played in full, whatever the truth has of it */
static int choose_frames(job *j)
{
   size_t f, t;
   int whole = j->truth.file && j->o.motion;
   j->frame = (size_t *)ex_take(j->motion->frames, sizeof *j->frame);
   j->wanted = (size_t *)ex_take(j->motion->frames, sizeof *j->wanted);
   if (!j->frame || !j->wanted) return ex_say("out of memory");
   for (f = 0; f < j->motion->frames; f++) {
      unsigned long number = j->truth.file && !whole ? j->truth.numbers[f] : (unsigned long)f;
      size_t want = j->truth.file && !whole ? f : NONE;
      if (number < (unsigned long)j->o.first || number >= (unsigned long)j->o.end) continue;
      for (t = 0; whole && t < j->truth.frames; t++)
         if (j->truth.numbers[t] == number) want = t;
      if (want != NONE && j->truth.settled && !(j->truth.settled[want] > 0)) {
         j->unsettled++;
         want = NONE;
         if (!whole) continue;
      }
      j->compared += want != NONE || !j->truth.file;
      j->wanted[j->frames] = want;
      j->frame[j->frames++] = f;
   }
   if (j->compared) return 0;
   if (j->unsettled) return ex_say("%s: none of the %zu frames asked for has settled", j->o.truth, j->unsettled);
   if (j->truth.file && j->truth.frames)
      return ex_say("--frames: no frame in that range; the truth has %zu, from %lu to %lu", j->truth.frames,
                 (unsigned long)j->truth.numbers[0], (unsigned long)j->truth.numbers[j->truth.frames - 1]);
   return ex_say("--frames: no frame in that range; there are %zu", j->motion->frames);
}

static int allocate(job *j)
{
   size_t v = j->scene->vertices, kept = j->o.out ? j->frames : 1, i;
   int bad = 0;
   j->scratch_bytes = dn_scratch_size(j->rig, j->parallel.workers);
   j->scratch_block = ex_take(j->scratch_bytes + 63, 1);
   j->scratch = (void *)(((uintptr_t)j->scratch_block + 63) & ~(uintptr_t)63);
   for (i = 0; i < STAGES; i++) bad |= !(j->ms[i] = (double *)ex_take(j->frames, sizeof **j->ms));
   bad |= !(j->total = (double *)ex_take(j->frames, sizeof *j->total));
   bad |= !(j->lbs_mean = (double *)ex_take(j->compared, sizeof *j->lbs_mean));
   bad |= !(j->refined_mean = (double *)ex_take(j->compared, sizeof *j->refined_mean));
   bad |= !(j->skinned = (float *)ex_take(v, 12)) || !(j->skinned_normals = (float *)ex_take(v, 12));
   for (i = 0; i < 6; i++) bad |= !(j->worst[i] = (float *)ex_take(v, 12));
   if (v > SIZE_MAX / 12 / kept) return ex_say("out of memory");
   bad |= !(j->refined = (float *)ex_take(kept * v, 12)) || !(j->normals = (float *)ex_take(kept * v, 12));
   if (v > SIZE_MAX / 4 / j->frames) return ex_say("out of memory");
   bad |= !(j->lbs_error = (float *)ex_take(j->compared * v, 4)) || !(j->refined_error = (float *)ex_take(j->compared * v, 4));
   for (i = 0; i < 4; i++) bad |= !(j->before[i / 2][i % 2] = (float *)ex_take(v, 12));
   for (i = 0; i < 2; i++) bad |= !(j->jump[i] = (float *)ex_take(j->frames * v, 4));
   return bad || !j->scratch_block ? ex_say("out of memory for %zu frames of %zu vertices", j->frames, v) : 0;
}

static float distance(const float *a, const float *b)
{
   float x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
   return sqrtf(x * x + y * y + z * z);
}

static const float *truth_of(const job *j, size_t i) /* (V,3) of frame i, or NULL */
{
   return j->wanted[i] == NONE ? NULL : (const float *)j->truth.vertices->data + j->wanted[i] * j->scene->vertices * 3;
}

/* What skinning does moves evenly; what is added to it must too, or it pops: second differences in time of
   target - skinned. before: those one and two frames ago */
static void follow(const job *j, size_t i, const float *target, float *before[2], float *jump)
{
   float *b = before[0], *a = before[1];
   size_t v, n = j->scene->vertices;
   for (v = 0; v < n; v++) {
      const float *x = target + 3 * v, *s = j->skinned + 3 * v;
      float d[3];
      d[0] = x[0] - s[0], d[1] = x[1] - s[1], d[2] = x[2] - s[2];
      if (i >= 2) {
         float u[3];
         u[0] = a[3 * v] - 2 * b[3 * v] + d[0], u[1] = a[3 * v + 1] - 2 * b[3 * v + 1] + d[1], u[2] = a[3 * v + 2] - 2 * b[3 * v + 2] + d[2];
         jump[(i - 2) * n + v] = sqrtf(u[0] * u[0] + u[1] * u[1] + u[2] * u[2]);
      }
      memcpy(a + 3 * v, d, sizeof d);
   }
   before[0] = a, before[1] = b;
}

/* errors of frame i (with a truth) or its displacement, and the frame to picture. at: which of the compared it is */
static void compare(job *j, size_t i, size_t at, const float *refined, const float *refined_normals)
{
   size_t v, n = j->scene->vertices;
   const float *want = truth_of(j, i);
   float *lbs = j->lbs_error + at * n, *ours = j->refined_error + at * n;
   double sum_lbs = 0, sum_ours = 0;
   for (v = 0; v < n; v++) {
      const float resting = 0.0005f; /* metres: here skinning was right */
      lbs[v] = want ? distance(j->skinned + 3 * v, want + 3 * v) : 0;
      ours[v] = distance(refined + 3 * v, (want ? want : j->skinned) + 3 * v);
      sum_lbs += (double)lbs[v], sum_ours += (double)ours[v];
      if (want && lbs[v] <= resting) j->resting++, j->resting_kept += ours[v] <= resting;
   }
   j->lbs_mean[at] = 100 * sum_lbs / (double)n;
   j->refined_mean[at] = 100 * sum_ours / (double)n;
   if (want && sum_ours > sum_lbs) j->worse_frames++;
   if (at == 0 || (want ? j->lbs_mean[at] > j->lbs_mean[j->worst_frame] : j->refined_mean[at] > j->refined_mean[j->worst_frame])) {
      j->worst_frame = at;
      j->worst_number = i;
      memcpy(j->worst[0], j->skinned, n * 12), memcpy(j->worst[3], j->skinned_normals, n * 12);
      memcpy(j->worst[1], refined, n * 12), memcpy(j->worst[4], refined_normals, n * 12);
      if (want) memcpy(j->worst[2], want, n * 12);
   }
}

static void *take_aligned(size_t bytes, void **block) /* 64 bytes; *block is what to free */
{
   *block = bytes > SIZE_MAX - 63 ? NULL : ex_take(bytes + 63, 1);
   return *block ? (void *)(((uintptr_t)*block + 63) & ~(uintptr_t)63) : NULL;
}
static int budget_coarse(job *j)
{
   budget *b = &j->budget;
   size_t bytes, scratch_bytes;
   void *memory, *scratch, *block = NULL;
   dn_report report;
   dn_error err;
   double t0 = ex_now_ms();
   if (dn_coarse_size(j->rig, &bytes, &scratch_bytes, &err) != DN_OK) return ex_say_error("--coarse", &err);
   memory = take_aligned(bytes, &b->coarse_block);
   scratch = take_aligned(scratch_bytes, &block);
   if (!memory || !scratch) return free(block), ex_say("out of memory");
   if (dn_coarse_init(j->rig, j->o.coarse, memory, bytes, scratch, scratch_bytes, &b->coarse, &err) != DN_OK)
      return free(block), ex_say_error("--coarse", &err);
   free(block);
   b->coarse_rig = bind(j->model, j->scene, &b->coarse, &j->parallel, &report, &err);
   if (!b->coarse_rig) return ex_say_error("--coarse", &err);
   b->ms_coarse = ex_now_ms() - t0;
   b->coarse_scratch_bytes = dn_scratch_size(b->coarse_rig, j->parallel.workers);
   b->coarse_scratch = take_aligned(b->coarse_scratch_bytes, &b->coarse_scratch_block);
   b->coarse_correction = (float *)ex_take(b->coarse.nodes, 12);
   return b->coarse_scratch && b->coarse_correction ? 0 : ex_say("out of memory");
}
static int budget_allocate(job *j)
{
   budget *b = &j->budget;
   size_t v = j->scene->vertices, nodes = j->view.nodes, i;
   void *memory = take_aligned(dn_track_size(nodes), &b->track_block);
   int bad = !memory;
   if (memory) dn_track_init(&b->track, nodes, memory);
   b->scratch_bytes = dn_carry_scratch(j->rig, j->parallel.workers);
   bad |= !(b->scratch = take_aligned(b->scratch_bytes, &b->scratch_block));
   bad |= !(b->correction = (float *)ex_take(nodes, 12));
   bad |= !(b->positions = (float *)ex_take(v, 12)) || !(b->normals = (float *)ex_take(v, 12));
   bad |= !(b->error = (float *)ex_take(j->compared * v, 4)) || !(b->gap = (float *)ex_take(j->frames * v, 4));
   bad |= !(b->jump = (float *)ex_take(j->frames * v, 4));
   for (i = 0; i < 2; i++) bad |= !(b->before[i] = (float *)ex_take(v, 12));
   bad |= !(b->ms_carry = (double *)ex_take(j->frames, sizeof(double))) || !(b->ms_evaluate = (double *)ex_take(j->frames, sizeof(double)));
   if (bad) return ex_say("out of memory for %zu frames of %zu vertices", j->frames, v);
   return j->o.coarse > 0 ? budget_coarse(j) : 0;
}

/* frame i again: the network when it is due, else only what it found before. palette is overwritten with --ahead */
static int budget_frame(job *j, size_t i, size_t at, float *palette, const float *plain)
{
   budget *b = &j->budget;
   size_t v, n = j->scene->vertices, every = j->o.every;
   const float *want = truth_of(j, i);
   double sum_lbs = 0, sum_ours = 0, t0, t1, t2;
   dn_pose pose;
   dn_output out;
   dn_error err;
   dn_result r = DN_OK;
   memset(&pose, 0, sizeof pose);
   memset(&out, 0, sizeof out);
   pose.palette = palette;
   pose.strength = 1;
   out.positions = b->positions;
   out.normals = b->normals;
   if (j->o.ahead && i % every == 0) ex_pose(j->scene, j->motion, j->frame[i + every <= j->frames ? i + every - 1 : j->frames - 1], palette);
   t0 = ex_now_ms();
   if (i % every == 0) {
      if (b->coarse_rig) {
         r = dn_evaluate(b->coarse_rig, &pose, b->coarse_correction, b->coarse_scratch, b->coarse_scratch_bytes, &j->parallel, &err);
         dn_spread(&b->coarse, b->coarse_rig, b->coarse_correction, b->correction, &j->parallel);
      } else r = dn_evaluate(j->rig, &pose, b->correction, j->scratch, j->scratch_bytes, &j->parallel, &err);
      if (r == DN_OK || r == DN_NOT_FINITE) dn_track_put(&b->track, b->correction, (float)every, j->o.lead);
   }
   t1 = ex_now_ms();
   if (j->o.ahead) ex_pose(j->scene, j->motion, j->frame[i], palette);
   t2 = ex_now_ms();
   if (r == DN_OK || r == DN_NOT_FINITE) {
      dn_track_advance(&b->track, 1);
      r = dn_carry(j->rig, &pose, &b->track, &out, b->scratch, b->scratch_bytes, &j->parallel, &err);
   }
   b->ms_carry[i] = ex_now_ms() - t2;
   if (i % every == 0) b->ms_evaluate[b->evaluations++] = t1 - t0;
   if (r != DN_OK && r != DN_NOT_FINITE) return ex_say_error("budget", &err);
   for (v = 0; v < n; v++) b->gap[i * n + v] = distance(b->positions + 3 * v, plain + 3 * v);
   follow(j, i, b->positions, b->before, b->jump);
   if (!want) return 0;
   for (v = 0; v < n; v++) {
      float e = b->error[at * n + v] = distance(b->positions + 3 * v, want + 3 * v);
      sum_ours += (double)e;
      sum_lbs += (double)distance(j->skinned + 3 * v, want + 3 * v);
   }
   b->worse_frames += sum_ours > sum_lbs;
   return 0;
}

static void budget_measure(job *j)
{
   budget *b = &j->budget;
   size_t n = j->scene->vertices;
   b->ms_carried = ex_median(b->ms_carry, j->frames);
   b->ms_evaluated = ex_median(b->ms_evaluate, b->evaluations);
   b->ms_mean = b->ms_carried + b->ms_evaluated * (double)b->evaluations / (double)j->frames; /* of medians: a strange moment counts for nothing */
   b->gaps = measure(b->gap, j->frames * n);
   if (j->truth.file) b->ours = measure(b->error, j->compared * n);
   if (j->frames > 2) b->jumps = measure(b->jump, (j->frames - 2) * n);
}

static void budget_free(budget *b)
{
   dn_rig_free(b->coarse_rig);
   free(b->coarse_block), free(b->coarse_scratch_block), free(b->coarse_correction);
   free(b->track_block), free(b->scratch_block), free(b->correction), free(b->positions), free(b->normals), free(b->error), free(b->gap);
   free(b->jump), free(b->before[0]), free(b->before[1]), free(b->ms_carry), free(b->ms_evaluate);
}

static int deform_frames(job *j, const char *character)
{
   float *palette = (float *)ex_take(j->scene->joints, 12 * sizeof *palette);
   size_t i, at = 0, n = j->scene->vertices * 3;
   int bad = palette ? 0 : ex_say("out of memory");
   for (i = 0; i < j->frames && !bad; i++) {
      size_t keep = j->o.out ? i * n : 0;
      dn_pose pose;
      dn_output out, plain;
      dn_error err;
      dn_result result;
      double t[STAGES + 1];
      memset(&pose, 0, sizeof pose);
      memset(&out, 0, sizeof out);
      memset(&plain, 0, sizeof plain);
      ex_pose(j->scene, j->motion, j->frame[i], palette);
      pose.palette = palette;
      pose.matrix = DN_3X4_ROWS;
      pose.strength = 1;
      out.positions = j->refined + keep;
      out.normals = j->normals + keep;
      /* the four stages of dn_deform, called one by one to time them */
      t[SKIN] = ex_now_ms();
      result = dn_stage_skin(j->rig, &pose, j->scratch, j->scratch_bytes, &j->parallel, &err);
      t[FEATURES] = ex_now_ms();
      if (result == DN_OK || result == DN_NOT_FINITE) {
         dn_stage_rows(j->rig, j->scratch, &j->parallel);
         t[NETWORK] = ex_now_ms();
         dn_stage_network(j->rig, j->scratch, &j->parallel, NULL);
         t[NORMALS] = ex_now_ms();
         result = dn_stage_output(j->rig, &pose, &out, j->scratch, &j->parallel, &err);
         t[STAGES] = ex_now_ms();
      }
      if (result != DN_OK && result != DN_NOT_FINITE) {
         bad = ex_say_error(character, &err);
         break;
      }
      if (out.fallback_nodes) j->fallback_nodes += out.fallback_nodes, j->fallback_frames++;
      for (size_t s = 0; s < STAGES; s++) j->ms[s][i] = t[s + 1] - t[s];
      j->total[i] = t[STAGES] - t[SKIN];
      pose.strength = 0; /* and the skinned mesh, to compare with */
      plain.positions = j->skinned;
      plain.normals = j->skinned_normals;
      dn_stage_skin(j->rig, &pose, j->scratch, j->scratch_bytes, &j->parallel, NULL);
      dn_stage_output(j->rig, &pose, &plain, j->scratch, &j->parallel, NULL);
      follow(j, i, out.positions, j->before[0], j->jump[0]);
      if (j->truth.file && !j->o.motion) follow(j, i, truth_of(j, i), j->before[1], j->jump[1]);
      if (j->o.every) bad = budget_frame(j, i, at, palette, out.positions);
      if (j->wanted[i] != NONE || !j->truth.file) compare(j, i, at++, out.positions, out.normals);
   }
   free(palette);
   return bad;
}

/* ===================================================================================== >>results */
static void print_report(const job *j, const char *model, const char *character)
{
   const double mb = 1.0 / (1024 * 1024);
   printf("model       %s: %s, %zu parameters\n", model, j->info.arch_name, j->info.parameters);
   printf("character   %s: %zu vertices, %zu nodes, %zu edges, %zu joints", character, j->view.vertices, j->view.nodes,
          j->report.edges, j->scene->joints);
   if (j->report.joints_folded) printf(" (%zu not in the model)", j->report.joints_folded);
   printf("\nframes      %zu", j->frames);
   if (j->truth.file && j->o.motion) printf(", %zu compared with the truth, %zu of it had not settled", j->compared, j->unsettled);
   else if (j->truth.file) printf(" of the truth, %zu that had not settled left out", j->unsettled);
   printf("\nbind        %.0f ms, once\n", j->ms_bind);
   printf("per frame   skin %.2f + features %.2f + network %.2f + normals %.2f: %.2f ms (medians; %u thread%s, %s, %s)\n",
          j->ms_stage[SKIN], j->ms_stage[FEATURES], j->ms_stage[NETWORK], j->ms_stage[NORMALS], j->ms_total,
          j->parallel.workers, j->parallel.workers == 1 ? "" : "s", dn_precision_name(j->info.precision), dn_kernel_name(j->info.kernel));
   printf("memory      model %.2f MB, rig %.2f MB, scratch %.2f MB\n", (double)j->info.bytes * mb, (double)j->view.bytes * mb,
          (double)j->scratch_bytes * mb);
   if (j->fallback_frames)
      printf("not finite  %zu nodes in %zu frames kept plain skinning\n", j->fallback_nodes, j->fallback_frames);
   if (!j->truth.file) {
      printf("moved by    %.3f cm on average, %.2f cm at most (no truth to compare with)\n", j->ours.mean, j->ours.max);
      return;
   }
   printf("error, cm       mean     99 %%      max\n");
   printf("  skinned   %8.3f %8.3f %8.3f\n", j->lbs.mean, j->lbs.p99, j->lbs.max);
   printf("  refined   %8.3f %8.3f %8.3f\n", j->ours.mean, j->ours.p99, j->ours.max);
   if (j->lbs.mean > 0 && j->lbs.p99 > 0 && j->lbs.max > 0)
      printf("  ratio     %8.3f %8.3f %8.3f\n", j->ours.mean / j->lbs.mean, j->ours.p99 / j->lbs.p99, j->ours.max / j->lbs.max);
   if (j->resting)
      printf("resting     %.1f %% of the vertices that skinning had right (within 0.5 mm) are still right\n",
             100 * (double)j->resting_kept / (double)j->resting);
   printf("worse       %zu of %zu frames are worse than skinned, on average\n", j->worse_frames, j->compared);
   if (j->frames > 2 && !j->o.motion) /* else the truth may have gaps */
      printf("in time     99 %% of second differences of what is added to skinning: refined %.3f, truth %.3f cm\n", j->jumps[0].p99,
             j->jumps[1].p99);
}

static void print_budget(const job *j)
{
   const budget *b = &j->budget;
   size_t bytes = b->scratch_bytes + dn_track_size(j->view.nodes) + 12 * j->view.nodes;
   const double network = b->ms_evaluated * (double)b->evaluations / (double)j->frames;
   printf("budget      the network in %zu of %zu frames", b->evaluations, j->frames);
   if (j->o.ahead) printf(", each ahead of its time");
   else if (j->o.every > 1) printf(", lead %.2g", (double)j->o.lead);
   if (b->coarse_rig) {
      dn_rig_view view;
      dn_rig_describe(b->coarse_rig, &view);
      printf(", on %zu of %zu nodes (bound in %.0f ms)", b->coarse.nodes, j->view.nodes, b->ms_coarse);
      bytes += b->coarse.bytes + view.bytes + b->coarse_scratch_bytes + 12 * b->coarse.nodes;
   }
   printf("\n  time      network %.2f + other %.2f: %.2f ms on average, %.2f of the plain run (medians); %.2f MB more\n", network,
          b->ms_carried, b->ms_mean, b->ms_mean / j->ms_total,
          (double)bytes / (1024 * 1024));
   if (j->truth.file) {
      printf("  error, cm %8.3f %8.3f %8.3f\n", b->ours.mean, b->ours.p99, b->ours.max);
      if (j->lbs.mean > 0 && j->lbs.p99 > 0 && j->lbs.max > 0)
         printf("  ratio     %8.3f %8.3f %8.3f\n", b->ours.mean / j->lbs.mean, b->ours.p99 / j->lbs.p99, b->ours.max / j->lbs.max);
      printf("  worse     %zu of %zu frames are worse than skinned, on average\n", b->worse_frames, j->compared);
   }
   printf("  apart, cm %8.3f %8.3f %8.3f from the plain run\n", b->gaps.mean, b->gaps.p99, b->gaps.max);
   if (j->frames > 2) printf("  in time   %.3f cm, the plain run %.3f\n", b->jumps.p99, j->jumps[0].p99);
}

static void json_figure(FILE *f, const char *key, int known, double value)
{
   if (known) fprintf(f, ",\n  \"%s\": %.6g", key, value);
   else fprintf(f, ",\n  \"%s\": null", key);
}

static int write_json(const job *j)
{
   FILE *f = fopen(j->o.json, "w");
   int known = j->truth.file != NULL, bad;
   if (!f) return ex_say("%s: cannot write there: %s", j->o.json, strerror(errno));
   fprintf(f, "{\n  \"frames\": %zu,\n  \"vertices\": %zu,\n  \"nodes\": %zu,\n  \"threads\": %u", j->frames, j->view.vertices,
           j->view.nodes, j->parallel.workers);
   json_figure(f, "ms_bind", 1, j->ms_bind);
   json_figure(f, "ms_skin", 1, j->ms_stage[SKIN]);
   json_figure(f, "ms_features", 1, j->ms_stage[FEATURES]);
   json_figure(f, "ms_network", 1, j->ms_stage[NETWORK]);
   json_figure(f, "ms_normals", 1, j->ms_stage[NORMALS]);
   json_figure(f, "ms_total", 1, j->ms_total);
   fprintf(f, ",\n  \"bytes_model\": %zu,\n  \"bytes_rig\": %zu,\n  \"bytes_scratch\": %zu", j->info.bytes, j->view.bytes,
           j->scratch_bytes);
   json_figure(f, "lbs_mean_cm", known, j->lbs.mean);
   json_figure(f, "lbs_p99_cm", known, j->lbs.p99);
   json_figure(f, "lbs_max_cm", known, j->lbs.max);
   json_figure(f, "refined_mean_cm", known, j->ours.mean);
   json_figure(f, "refined_p99_cm", known, j->ours.p99);
   json_figure(f, "refined_max_cm", known, j->ours.max);
   fprintf(f, ",\n  \"unsettled\": %zu", j->unsettled);
   json_figure(f, "resting_kept", known && j->resting, j->resting ? (double)j->resting_kept / (double)j->resting : 0);
   json_figure(f, "worse_frames", known, (double)j->worse_frames);
   json_figure(f, "refined_jump_p99_cm", j->frames > 2, j->jumps[0].p99);
   json_figure(f, "truth_jump_p99_cm", known && j->frames > 2 && !j->o.motion, j->jumps[1].p99);
   if (j->o.every) {
      const budget *b = &j->budget;
      json_figure(f, "budget_ms_network", 1, b->ms_evaluated * (double)b->evaluations / (double)j->frames);
      json_figure(f, "budget_ms_carry", 1, b->ms_carried);
      json_figure(f, "budget_ms_total", 1, b->ms_mean);
      json_figure(f, "budget_mean_cm", known, b->ours.mean);
      json_figure(f, "budget_p99_cm", known, b->ours.p99);
      json_figure(f, "budget_max_cm", known, b->ours.max);
      json_figure(f, "budget_worse_frames", known, (double)b->worse_frames);
      json_figure(f, "budget_apart_mean_cm", 1, b->gaps.mean);
      json_figure(f, "budget_apart_p99_cm", 1, b->gaps.p99);
      json_figure(f, "budget_jump_p99_cm", j->frames > 2, b->jumps.p99);
   }
   fprintf(f, ",\n  \"fallback_nodes\": %zu,\n  \"kernels\": \"%s\",\n  \"precision\": \"%s\"\n}\n", j->fallback_nodes, dn_kernel_name(j->info.kernel),
           dn_precision_name(j->info.precision));
   bad = ferror(f) != 0;
   bad |= fclose(f) != 0;
   return bad ? ex_say("%s: writing failed", j->o.json) : 0;
}

static int write_frames(const job *j)
{
   char error[EX_ERROR];
   size_t v = j->scene->vertices, i;
   int good = 0;
   float *times = (float *)ex_take(j->frames, sizeof *times);
   if (!times) return ex_say("out of memory");
   for (i = 0; i < j->frames; i++) times[i] = j->motion->times[j->frame[i]] - j->motion->times[j->frame[0]];
   if (ex_ends_with(j->o.out, ".glb")) {
      ex_baked baked;
      memset(&baked, 0, sizeof baked);
      baked.name = "refined";
      baked.vertices = v;
      baked.triangles = j->scene->triangles;
      baked.frames = j->frames;
      baked.triangle = j->scene->triangle;
      baked.positions = j->refined;
      baked.normals = j->normals;
      baked.times = times;
      good = ex_write_glb(j->o.out, &baked, error);
   } else {
      ex_writer *w = ex_writer_open(j->o.out, error);
      if (w) {
         size_t shape[3], vertices, frames, times_id;
         uint32_t *number = (uint32_t *)ex_take(j->frames, sizeof *number);
         shape[0] = j->frames, shape[1] = v, shape[2] = 3;
         ex_writer_meta(w, "units", "metres");
         vertices = ex_writer_tensor(w, "vertices", EX_F32, 3, shape);
         frames = ex_writer_tensor(w, "frames", EX_I32, 1, shape);
         times_id = ex_writer_tensor(w, "times", EX_F32, 1, shape);
         ex_writer_put(w, vertices, 0, j->refined, j->frames * v * 3);
         for (i = 0; i < j->frames && number; i++)
            number[i] = j->truth.file && !j->o.motion ? j->truth.numbers[j->frame[i]] : (uint32_t)j->frame[i];
         if (number) ex_writer_put(w, frames, 0, number, j->frames);
         ex_writer_put(w, times_id, 0, times, j->frames);
         free(number);
         good = ex_writer_close(w, error);
      }
   }
   free(times);
   return good ? 0 : ex_say("%s", error);
}

static int write_picture(job *j, const char *character)
{
   ex_comparison c;
   ex_shape shape[3];
   char title[200], text[2][96];
   const char *name = strrchr(character, '/'), *why, *dot;
   size_t n = j->scene->vertices, i, w = j->worst_frame;
   unsigned long number = (unsigned long)j->frame[j->worst_number];
   float *error[2], *sorted = (float *)ex_take(n, sizeof *sorted);
   if (j->truth.file && !j->o.motion) number = j->truth.numbers[number];
   if (!sorted) return ex_say("out of memory");
   name = name ? name + 1 : character;
   dot = strrchr(name, '.');
   memset(&c, 0, sizeof c);
   memset(shape, 0, sizeof shape);
   error[0] = j->lbs_error + w * n, error[1] = j->refined_error + w * n;
   for (i = 0; i < 2; i++) {
      figures f;
      memcpy(sorted, error[i], n * sizeof *sorted);
      f = measure(sorted, n);
      snprintf(text[i], sizeof text[i], "mean %.2f cm, 99 %% %.2f cm, max %.2f cm", f.mean, f.p99, f.max);
   }
   for (i = 0; i < 3; i++) shape[i].positions = j->worst[i], shape[i].normals = j->worst[3 + i];
   shape[0].title = "Linear blend skinning";
   shape[1].title = "Refined by the network";
   shape[1].value = error[1];
   shape[1].caption = text[1];
   c.shapes = 2;
   if (j->truth.file) {
      shape[0].value = error[0];
      shape[0].caption = text[0];
      shape[2].title = "Truth";
      shape[2].caption = "elastic simulation, offline";
      ex_normals(n, j->worst[2], j->scene->triangles, j->scene->triangle, j->worst[5]);
      c.shapes = 3;
   }
   snprintf(title, sizeof title, "%.*s, frame %lu: %s", dot ? (int)(dot - name) : (int)strlen(name), name, number,
            j->truth.file ? "where skinning is worst" : "where the network moves most");
   c.title = title;
   c.scale_title = j->truth.file ? "distance to the truth" : "moved by the network";
   c.vertices = n;
   c.triangles = j->scene->triangles;
   c.triangle = j->scene->triangle;
   c.shape = shape;
   c.looked_at = j->truth.file ? 0 : 1;
   why = ex_compare(j->o.picture, &c);
   free(sorted);
   return why ? ex_say("%s: %s", j->o.picture, why) : 0;
}

/* ===================================================================================== >>main */
static int run(job *j, int argc, char **argv)
{
   char paths[3][1024], error[EX_ERROR];
   const char *program = argc ? argv[0] : "refine", *model, *character, *motion;
   dn_error err;
   dn_model_options chosen;
   double t0;
   size_t i, n;
   int bundled_character;
   memset(&err, 0, sizeof err);
   if (read_options(&j->o, argc, argv)) return 1;
   bundled_character = !j->o.character;
   if (bundled_character && !j->o.motion && !j->o.truth)
      j->o.truth = ex_bundled(program, "demo/truth.safetensors", paths[0], sizeof paths[0]);
   model = j->o.model ? j->o.model : ex_bundled(program, "models/humanoid_lite.safetensors", paths[1], sizeof paths[1]);
   character = bundled_character ? ex_bundled(program, "demo/humanoid.safetensors", paths[2], sizeof paths[2]) : j->o.character;
   motion = j->o.motion ? j->o.motion : j->o.truth ? j->o.truth : character;

   memset(&chosen, 0, sizeof chosen);
   chosen.precision = j->o.precision;
   j->model = dn_model_load_file(model, &chosen, NULL, &err);
   if (!j->model) return ex_say_error(model, &err);
   dn_model_describe(j->model, &j->info);
   j->scene = ex_scene_load(character, error);
   if (!j->scene) return ex_say("%s", error);
   if (j->o.truth && truth_open(&j->truth, j->o.truth, j->scene)) return 1;
   j->motion = ex_motion_load(motion, j->o.animation, j->scene, error);
   if (!j->motion) return ex_say("%s%s", error, motion == character ? "; give --motion or --truth" : "");
   if (j->truth.file && !j->o.motion && j->motion->frames != j->truth.frames)
      return ex_say("%s: palettes of %zu frames, vertices of %zu", j->o.truth, j->motion->frames, j->truth.frames);
   if (choose_frames(j)) return 1;

   if (j->o.threads > 1 && !(j->pool = ex_pool_create(j->o.threads))) return ex_say("cannot start %u threads", j->o.threads);
   j->parallel = ex_pool_parallel(j->pool);
   t0 = ex_now_ms();
   j->rig = bind(j->model, j->scene, NULL, &j->parallel, &j->report, &err);
   if (!j->rig) return ex_say_error(character, &err);
   j->ms_bind = ex_now_ms() - t0;
   dn_rig_describe(j->rig, &j->view);
   if (allocate(j) || (j->o.every && budget_allocate(j)) || deform_frames(j, character)) return 1;

   for (i = 0; i < STAGES; i++) j->ms_stage[i] = ex_median(j->ms[i], j->frames);
   j->ms_total = ex_median(j->total, j->frames);
   if (j->o.out && write_frames(j)) return 1;
   if (j->o.picture && write_picture(j, character)) return 1; /* before measure() sorts the errors */
   n = j->compared * j->scene->vertices;
   j->ours = measure(j->refined_error, n);
   if (j->truth.file) j->lbs = measure(j->lbs_error, n);
   for (i = 0; i < 2 && j->frames > 2; i++) j->jumps[i] = measure(j->jump[i], (j->frames - 2) * j->scene->vertices);
   if (j->o.every) budget_measure(j);
   if (j->o.json && write_json(j)) return 1;
   print_report(j, model, character);
   if (j->o.every) print_budget(j);
   if (j->o.out) printf("wrote       %s\n", j->o.out);
   if (j->o.picture) printf("wrote       %s\n", j->o.picture);
   if (j->o.json) printf("wrote       %s\n", j->o.json);
   return 0;
}

int main(int argc, char **argv)
{
   job j;
   size_t i;
   int code;
   ex_program("refine");
   memset(&j, 0, sizeof j);
   code = run(&j, argc, argv);
   for (i = 0; i < STAGES; i++) free(j.ms[i]);
   for (i = 0; i < 6; i++) free(j.worst[i]);
   for (i = 0; i < 4; i++) free(j.before[i / 2][i % 2]);
   for (i = 0; i < 2; i++) free(j.jump[i]);
   free(j.total), free(j.lbs_mean), free(j.refined_mean), free(j.lbs_error), free(j.refined_error);
   free(j.refined), free(j.normals), free(j.skinned), free(j.skinned_normals), free(j.frame), free(j.wanted), free(j.scratch_block);
   budget_free(&j.budget);
   dn_rig_free(j.rig);
   ex_pool_free(j.pool);
   truth_close(&j.truth);
   ex_motion_free(j.motion);
   ex_scene_free(j.scene);
   dn_model_free(j.model);
   return code;
}
