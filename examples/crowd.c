/*  crowd.c - many characters, one thread for frames and one for networks behind it
    shows     the budget calls of deformnet.h in an engine's shape: no frame waits for a network. The frames' thread copies a
              pose for each character that is due and goes on; a second thread evaluates them one by one; what is ready is
              put on the character's track when its next frame comes. Characters are due in turns (stagger)
    not here  the whole of deformnet's use (refine.c), a job system (common/pool.h)
    build     make crowd
    run       ./crowd [--characters n] [--every k] [--coarse share] [--fps n] [--frames n]      the bundled demo, n times
    flow      frames:    pose --due?--> post ... ready? --dn_track_put, dn_track_advance, dn_carry--> vertices, every frame
              networks:  post --dn_evaluate (on the coarse rig: dn_spread)--> ready */
#define _POSIX_C_SOURCE 200809L
#define DEFORMNET_IMPLEMENTATION
#include "../deformnet.h"
#include "common/scene.h"
#include "common/tool.h"
#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

typedef struct options { long characters, every, fps, frames; double coarse; } options;

/* whose turn it is with a character's palette and correction: the frames' thread in IDLE and READY, the other in POSTED */
enum { IDLE, POSTED, READY };
typedef struct character {
   dn_track track;
   float *correction;          /* (N,3) of the last evaluation */
   float *palette;             /* (S,12) the pose it was or is to be made for */
   long posted, put;           /* frames: when it was posted; when the evaluation before was put */
   int state;                  /* under the lock */
} character;

typedef struct crowd {
   options o;
   const dn_rig *rig, *coarse_rig;
   dn_coarse coarse;
   character *all;
   void *scratch;              /* the networks' */
   size_t scratch_bytes;
   float *small;               /* (M,3) */
   size_t *queue, head, count; /* (characters) posted, first come first served */
   int over;
   pthread_mutex_t lock;
   pthread_cond_t posted;
} crowd;

/* --- the networks' thread */
static void evaluate(crowd *c, character *who)
{
   dn_pose pose;
   memset(&pose, 0, sizeof pose);
   pose.palette = who->palette;
   if (!c->coarse_rig) dn_evaluate(c->rig, &pose, who->correction, c->scratch, c->scratch_bytes, NULL, NULL);
   else {
      dn_evaluate(c->coarse_rig, &pose, c->small, c->scratch, c->scratch_bytes, NULL, NULL);
      dn_spread(&c->coarse, c->coarse_rig, c->small, who->correction, NULL);
   }
}
static void *networks(void *user)
{
   crowd *c = (crowd *)user;
   pthread_mutex_lock(&c->lock);
   while (!c->over) {
      character *who;
      if (c->count == 0) {
         pthread_cond_wait(&c->posted, &c->lock);
         continue;
      }
      who = &c->all[c->queue[c->head]];
      c->head = (c->head + 1) % (size_t)c->o.characters;
      c->count--;
      pthread_mutex_unlock(&c->lock);
      evaluate(c, who);
      pthread_mutex_lock(&c->lock);
      who->state = READY;
   }
   pthread_mutex_unlock(&c->lock);
   return NULL;
}

/* --- the frames' thread */
typedef struct tally { double skinned, shown, latency, *ms; size_t evaluations, late; } tally;

/* character k in frame f: takes what is ready, posts what is due; never waits */
static void exchange(crowd *c, size_t k, long f, const float *palette, size_t joints, tally *t)
{
   character *who = &c->all[k];
   int due = (f + (long)k) % c->o.every == 0 || f == 0, state;
   pthread_mutex_lock(&c->lock);
   state = who->state;
   pthread_mutex_unlock(&c->lock);
   if (state == READY) {
      long since = f - who->put; /* evaluations come at their own pace: the glide lasts as long as the last one took to come */
      dn_track_put(&who->track, who->correction, (float)(since > c->o.every ? since : c->o.every), 0.5f);
      t->latency += (double)(f - who->posted);
      t->evaluations++;
      who->put = f;
      who->state = IDLE; /* the other thread does not look at it now */
   }
   if (!due) return;
   if (state == POSTED) {
      t->late++; /* still at the last one: this turn is left out */
      return;
   }
   memcpy(who->palette, palette, joints * 12 * sizeof *palette);
   who->posted = f;
   pthread_mutex_lock(&c->lock);
   who->state = POSTED;
   c->queue[(c->head + c->count++) % (size_t)c->o.characters] = k;
   pthread_cond_signal(&c->posted);
   pthread_mutex_unlock(&c->lock);
}

static double mean_distance(const float *a, const float *b, size_t n) /* centimetres */
{
   double sum = 0;
   for (size_t i = 0; i < n; i++) {
      float x = a[3 * i] - b[3 * i], y = a[3 * i + 1] - b[3 * i + 1], z = a[3 * i + 2] - b[3 * i + 2];
      sum += (double)sqrtf(x * x + y * y + z * z);
   }
   return 100 * sum / (double)n;
}

static const char usage[] =
   "usage: crowd [--characters n] [--every k] [--coarse share] [--fps n] [--frames n]\n"
   "  the bundled demo n times, each elsewhere in its clip; --coarse 1: the network sees the full mesh\n";

static int read_options(options *o, int argc, char **argv)
{
   o->characters = 8, o->every = 4, o->fps = 24, o->frames = 144;
   o->coarse = 0.25;
   for (int i = 1; i < argc; i += 2) {
      const char *key = argv[i], *value = i + 1 < argc ? argv[i + 1] : NULL;
      long *n = !strcmp(key, "--characters") ? &o->characters : !strcmp(key, "--every") ? &o->every : !strcmp(key, "--fps") ? &o->fps
              : !strcmp(key, "--frames") ? &o->frames : NULL;
      if (strcmp(key, "--help") == 0 || strcmp(key, "-h") == 0) {
         fputs(usage, stdout);
         exit(0);
      }
      if (!n && strcmp(key, "--coarse") != 0) return ex_say("unknown argument \"%s\" (--help lists them)", key);
      if (!value) return ex_say("%s needs a value", key);
      if (n && !ex_read_whole(value, 1, 10000, n)) return ex_say("%s %s: expected 1 to 10000", key, value);
      if (!n) {
         char *end;
         o->coarse = strtod(value, &end);
         if (end == value || *end || !(o->coarse > 1e-4 && o->coarse <= 1)) return ex_say("--coarse %s: expected a share above 0, at most 1", value);
      }
   }
   return 0;
}

int main(int argc, char **argv)
{
   static crowd c;
   char path[3][1024], error[EX_ERROR];
   dn_error err;
   dn_rig_desc desc, coarse_desc;
   dn_skin_set skin;
   dn_rig_view view;
   tally t;
   pthread_t thread;
   ex_program("crowd");
   if (read_options(&c.o, argc, argv)) return 1;

   /* once: the model, one rig for all (they are the same body), its coarse mesh, what each character owns */
   dn_model *model = dn_model_load_file(ex_bundled(argv[0], "models/humanoid.safetensors", path[0], sizeof path[0]), NULL, NULL, &err);
   if (!model) return ex_say_error(path[0], &err);
   ex_scene *scene = ex_scene_load(ex_bundled(argv[0], "demo/humanoid.safetensors", path[1], sizeof path[1]), error);
   if (!scene) return ex_say("%s", error);
   ex_motion *motion = ex_motion_load(ex_bundled(argv[0], "demo/truth.safetensors", path[2], sizeof path[2]), NULL, scene, error);
   ex_tensors *file = motion ? ex_tensors_open(path[2], error) : NULL;
   size_t V = scene->vertices, S = scene->joints, n = (size_t)c.o.characters, bytes, scratch_bytes, small_bytes;
   size_t sides[3] = { motion ? motion->frames : 0, V, 3 };
   const ex_tensor *truth = file ? ex_tensors_get(file, "vertices", 3, sides, error) : NULL;
   if (!truth) return ex_say("%s", error);
   ex_describe(scene, &desc, &skin);
   dn_rig *rig = dn_rig_create(model, &desc, NULL, NULL, &err), *coarse_rig = NULL;
   if (!rig) return ex_say_error(path[1], &err);
   dn_rig_describe(rig, &view);
   c.rig = rig;
   void *coarse_memory = NULL, *block, *track_memory;
   if (c.o.coarse < 1) {
      if (dn_coarse_size(rig, &bytes, &scratch_bytes, &err) != DN_OK) return ex_say_error("crowd", &err);
      if (posix_memalign(&coarse_memory, 64, bytes) || posix_memalign(&block, 64, scratch_bytes)) return ex_say("out of memory");
      if (dn_coarse_init(rig, (float)c.o.coarse, coarse_memory, bytes, block, scratch_bytes, &c.coarse, &err) != DN_OK) return ex_say_error("crowd", &err);
      free(block);
      dn_coarse_describe(&c.coarse, &desc, &coarse_desc);
      if (!(coarse_rig = dn_rig_create(model, &coarse_desc, NULL, NULL, &err))) return ex_say_error("crowd", &err);
      c.coarse_rig = coarse_rig;
   }
   c.scratch = dn_scratch_create(coarse_rig ? coarse_rig : rig, 1, NULL, &c.scratch_bytes, &err);
   small_bytes = dn_carry_scratch(rig, 1);
   bytes = dn_track_size(view.nodes);
   c.all = (character *)ex_take(n, sizeof *c.all);
   c.queue = (size_t *)ex_take(n, sizeof *c.queue);
   c.small = (float *)ex_take(view.nodes, 12);
   float *palette = (float *)ex_take(S, 12 * sizeof(float)), *positions = (float *)ex_take(V, 12), *skinned = (float *)ex_take(V, 12);
   memset(&t, 0, sizeof t);
   t.ms = (double *)ex_take((size_t)c.o.frames, sizeof *t.ms);
   if (!c.scratch || !c.all || !c.queue || !c.small || !palette || !positions || !skinned || !t.ms || posix_memalign(&block, 64, small_bytes))
      return ex_say("out of memory");
   for (size_t k = 0; k < n; k++) {
      if (posix_memalign(&track_memory, 64, bytes)) return ex_say("out of memory");
      dn_track_init(&c.all[k].track, view.nodes, track_memory);
      c.all[k].correction = (float *)ex_take(view.nodes, 12);
      c.all[k].palette = (float *)ex_take(S, 12 * sizeof(float));
      if (!c.all[k].correction || !c.all[k].palette) return ex_say("out of memory");
   }
   pthread_mutex_init(&c.lock, NULL);
   pthread_cond_init(&c.posted, NULL);
   if (pthread_create(&thread, NULL, networks, &c)) return ex_say("cannot start a thread");

   /* each frame: every character is posed, corrected by what is known, and drawn: here, compared with the truth */
   for (long f = 0; f < c.o.frames; f++) {
      double start = ex_now_ms(), spent = 0;
      for (size_t k = 0; k < n; k++) {
         size_t at = ((size_t)f + k * motion->frames / n) % motion->frames;
         const float *want = (const float *)truth->data + at * V * 3;
         dn_pose pose;
         dn_output out;
         double t0;
         memset(&pose, 0, sizeof pose);
         memset(&out, 0, sizeof out);
         ex_pose(scene, motion, at, palette);
         pose.palette = palette;
         pose.strength = 1;
         out.positions = positions;
         t0 = ex_now_ms();
         exchange(&c, k, f, palette, S, &t);
         dn_track_advance(&c.all[k].track, 1);
         dn_carry(rig, &pose, &c.all[k].track, &out, block, small_bytes, NULL, NULL);
         spent += ex_now_ms() - t0;
         if (f < 2 * c.o.every) continue; /* the first evaluations are on their way */
         t.shown += mean_distance(positions, want, V);
         pose.strength = 0;
         out.positions = skinned;
         dn_carry(rig, &pose, &c.all[k].track, &out, block, small_bytes, NULL, NULL);
         t.skinned += mean_distance(skinned, want, V);
      }
      t.ms[f] = spent;
      start += 1000.0 / (double)c.o.fps - ex_now_ms();
      if (start > 0) {
         struct timespec wait;
         wait.tv_sec = (time_t)(start / 1000);
         wait.tv_nsec = (long)((start - 1000 * (double)wait.tv_sec) * 1e6);
         nanosleep(&wait, NULL);
      }
   }
   pthread_mutex_lock(&c.lock);
   c.over = 1;
   pthread_cond_signal(&c.posted);
   pthread_mutex_unlock(&c.lock);
   pthread_join(thread, NULL);

   double most = 0;
   for (long f = 0; f < c.o.frames; f++) most = t.ms[f] > most ? t.ms[f] : most;
   printf("crowd       %ld characters of %zu vertices, %ld frames at %ld a second; each evaluated every %ld frames on %zu nodes\n", c.o.characters, V,
          c.o.frames, c.o.fps, c.o.every, coarse_rig ? c.coarse.nodes : view.nodes);
   printf("frames      %.2f ms of the frames' thread (median; at most %.2f), of %.2f there are\n", ex_median(t.ms, (size_t)c.o.frames), most,
          1000.0 / (double)c.o.fps);
   printf("networks    %zu evaluations on one thread behind, %.1f frames old on average when they come; %zu turns left out\n", t.evaluations,
          t.evaluations ? t.latency / (double)t.evaluations : 0.0, t.late);
   if (c.o.frames > 2 * c.o.every)
      printf("error       %.3f of skinning's, on average (once the first evaluations are there)\n", t.shown / t.skinned);

   for (size_t k = 0; k < n; k++) free(c.all[k].track.from), free(c.all[k].correction), free(c.all[k].palette);
   pthread_mutex_destroy(&c.lock);
   pthread_cond_destroy(&c.posted);
   dn_scratch_free(c.scratch, c.scratch_bytes, NULL);
   free(block), free(c.all), free(c.queue), free(c.small), free(palette), free(positions), free(skinned), free(t.ms), free(coarse_memory);
   ex_tensors_close(file);
   ex_motion_free(motion);
   ex_scene_free(scene);
   dn_rig_free(coarse_rig);
   dn_rig_free(rig);
   dn_model_free(model);
   return 0;
}
